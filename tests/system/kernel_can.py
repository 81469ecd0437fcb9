"""Peers on the kernel's CAN: raw sockets, can-utils, ip; and the daemon beside them."""

import json
import socket
import struct
import subprocess
import time
from contextlib import contextmanager
from pathlib import Path

from processes import process

SO_MEMINFO, DROPS = 55, 8


def ip(*words):
    subprocess.run(["ip", *words], check=True, capture_output=True, text=True)


def raw(interface, *, fd=False):
    """Open a plain raw socket."""
    sock = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    if fd:
        sock.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, 1)
    sock.bind((interface,))
    return sock


def can_frame(can_id, data=b""):
    return struct.pack("=IB3x8s", can_id, len(data), data)


def drops_of(sock):
    """Return how many frames the kernel has dropped at a socket."""
    words = sock.getsockopt(socket.SOL_SOCKET, SO_MEMINFO, 36)
    return struct.unpack("=9I", words)[DROPS]


def listeners(interface):
    """Return how many filters the kernel has of all sockets of an interface; other interfaces come and go beside it."""
    lists = Path("/proc/net/can").glob("rcvlist_*")
    return sum(line.split()[:1] == [interface] for each in lists for line in each.read_text().splitlines())


@contextmanager
def candump(*arguments, log):
    """Write what candump prints to a file; it listens already."""
    with Path(log).open("wb") as file:
        interface = arguments[-1].partition(",")[0]
        before = listeners(interface)
        dump = subprocess.Popen(["candump", *arguments], stdout=file)
        try:
            wait_for(lambda: listeners(interface) > before)
            yield dump
        finally:
            time.sleep(0.2)
            dump.terminate()
            dump.wait(60)


@contextmanager
def daemon(config, *options, cwd, bus="socketcan:vcan0"):
    """Run the gateway with JSON events; yields the process, with ``events()``."""
    chosen = ["--bus", bus] if bus else []
    with process(
        "run", config, *chosen, "--json", "--memory", "f.sqlite", *options,
        cwd=cwd, ready="monitoring",
    ) as started:  # fmt: skip
        started.events = lambda: events_in(cwd)
        yield started


def events_in(cwd):
    lines = (Path(cwd) / "run.out").read_text().splitlines()
    return [json.loads(line) for line in lines if line.endswith("}")]


def wait_for(what, *, seconds=120.0):
    """Wait until a condition holds; returns what it returned. The limit is for what hangs, not for what is slow."""
    limit = time.monotonic() + seconds
    while not (found := what()):
        assert time.monotonic() < limit, what
        time.sleep(0.05)
    return found

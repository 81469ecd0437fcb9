"""A storm of verdicts on the live daemon: does a tester get its answers?

16 messages, 4000 frames a second, every other CRC of each message wrong, debounce 1 and 1: each frame changes a status
byte, on disk before it is told. A tester sends 3E 00 every 20 ms and wants each answer within P2.

    python bench/storm.py [--seconds 60] [--rate 4000] [--random] [--json]

Sender and receiver are processes of their own. It ends with 1 if an answer was late or anything was lost here.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import random
import resource
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from live import BUFFER, StructBus, write_config
from live_sender import BASE, MESSAGES, datagrams, spoilt

from gateway.config.load import load_config
from gateway.live.clock import Clock
from gateway.live.link import Link
from gateway.live.loop import Live
from gateway.runtime.app import Gateway

P2_S = 0.050
EVERY_S = 0.020
REQUEST, RESPONSE = 0x7E0, 0x7E8
TESTER_PRESENT = REQUEST.to_bytes(4, "little") + bytes([8, 0, 0, 0]) + b"\x02\x3e\x00" + bytes(5)
ANSWER = bytes([2, 0x7E, 0x00])
#: An answer later than this is taken to be lost [s].
PATIENCE_S = 5.0
SEED = 21
#: Right frames of a message that prove its rule.
PROVEN = 16


def _waited_s() -> float:
    """Return how long this thread has waited for a processor [s]; others may use the machine, too."""
    return int(Path("/proc/self/schedstat").read_text().split()[1]) / 1e9


def receive(descriptor: int, config: Path, memory: Path) -> None:
    """Run the live loop until SIGTERM; tell as JSON what it did."""
    ours = socket.socket(fileno=descriptor)
    told = 0

    def count(event: dict) -> None:
        nonlocal told
        told += event["event"] == "dtc" and event["fault"].endswith(".crc")

    gateway = Gateway(load_config(config), memory)
    gateway.listen(count)
    gateway.write_beside()  # as the daemon does
    clock = Clock()
    link = Link("test:live", 0, "b", lambda uri, index: StructBus(ours, index), clock=clock)
    link.start()
    gateway.start(time.time_ns())
    live = Live(gateway, [link], lambda event: None, clock=clock)
    ended = False

    def end(*_: object) -> None:
        nonlocal ended
        ended = True

    signal.signal(signal.SIGTERM, end)
    for _ in range(20):
        live.turn()
    begun, waited = resource.getrusage(resource.RUSAGE_SELF), _waited_s()
    print("ready", flush=True)
    live.run(lambda: ended)
    used = resource.getrusage(resource.RUSAGE_SELF)
    limit = time.monotonic() + 60
    while time.monotonic() < limit:  # what waits still belongs to it
        counters = gateway.engine.counters()
        live.turn()
        if gateway.engine.counters()["frames"] == counters["frames"]:
            break
    gateway.stop(gateway.engine.now_ns)
    counters = gateway.engine.counters()
    stored = {entry.fault: entry.record.occurrence for entry in gateway.memory.entries()}
    found = {
        "frames": counters["frames"],
        "decoded": counters["decoded"],
        "crc_failed": counters["crc_failed"],
        "events_lost": counters["events_lost"],
        "overflow": link.statistics.overflow,
        "unsent": link.unsent,
        "told": told,
        "commits": getattr(gateway.memory, "commits", None),
        "failing": sum(1 for fault in stored if fault.endswith(".crc")),
        "waited_s": _waited_s() - waited,
        "cpu_s": used.ru_utime + used.ru_stime - begun.ru_utime - begun.ru_stime,
    }
    gateway.close()
    print(json.dumps(found), flush=True)


class Sender:
    """Sends the storm, and what the tester asks; knows what must come of it."""

    def __init__(self, sock: socket.socket, *, alternating: bool) -> None:
        self._sock = sock
        self._frames = datagrams()
        self._bad = [spoilt(datagram) for datagram in self._frames]
        self._alternating = alternating
        self._random = random.Random(SEED)
        self._failing = [False] * MESSAGES
        self.sent = self.full = self.changes = self.asked = 0
        self.answers: list[float] = []
        self._waiting: list[float] = []

    def _next(self) -> None:
        k = self.sent % MESSAGES
        turn = self.sent // MESSAGES
        wrong = turn % 2 == 1 if self._alternating else self._random.random() < 0.5
        wrong = wrong and turn >= PROVEN  # before, it is the rule that is doubted
        frames = self._bad if wrong else self._frames
        try:
            self._sock.send(frames[self.sent % len(frames)])
        except BlockingIOError:
            self.full += 1
        else:
            self.changes += wrong != self._failing[k]
            self._failing[k] = wrong
        self.sent += 1

    def _listen(self) -> None:
        while True:
            try:
                got = self._sock.recv(72)
            except BlockingIOError:
                return
            if int.from_bytes(got[:4], "little") == RESPONSE and got[8:11] == ANSWER:
                self.answers.append(time.perf_counter() - self._waiting.pop(0))

    def run(self, rate: float, seconds: float) -> None:
        """Send so many frames a second for so long; then wait for what is due."""
        self._sock.setblocking(False)
        begun = time.perf_counter()
        next_ask = 0.0
        while (now := time.perf_counter() - begun) < seconds:
            while self.sent < int(now * rate):
                self._next()
            if now >= next_ask:
                next_ask = now + EVERY_S
                self.asked += 1
                try:
                    self._sock.send(TESTER_PRESENT)
                    self._waiting.append(time.perf_counter())
                except BlockingIOError:
                    self.full += 1
            self._listen()
            time.sleep(0.0001)
        limit = time.perf_counter() + PATIENCE_S
        while self._waiting and time.perf_counter() < limit:
            self._listen()
            time.sleep(0.001)


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Run a receiver, and send to it."""
    with tempfile.TemporaryDirectory() as folder:
        config = write_config(Path(folder))
        config.write_text(config.read_text() + "[output.uds]\n")
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        for sock in (ours, theirs):
            try:
                sock.setsockopt(socket.SOL_SOCKET, 32, BUFFER)  # SO_SNDBUFFORCE
            except PermissionError:
                sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, BUFFER)
        command = [
            sys.executable,
            __file__,
            "--receive",
            str(ours.fileno()),
            str(config),
            f"{folder}/f.sqlite",
        ]
        child = subprocess.Popen(
            command,
            stdout=subprocess.PIPE,
            text=True,
            pass_fds=[ours.fileno()],
        )
        ours.close()
        if child.stdout.readline() != "ready\n":
            raise SystemExit("the receiver did not start")
        sender = Sender(theirs, alternating=not options.random)
        sender.run(options.rate, options.seconds)
        child.send_signal(signal.SIGTERM)
        found = json.loads(child.stdout.readline())
        child.wait(60)
        theirs.close()
    late = sum(answer > P2_S for answer in sender.answers)
    times = np.asarray(sender.answers or [np.nan]) * 1e3
    missing = sender.sent - sender.full - found["decoded"] - found["crc_failed"]
    return {
        "frames": sender.sent,
        "asked": sender.asked,
        "in_time": len(sender.answers) - late,
        "p50_ms": round(float(np.percentile(times, 50)), 3),
        "p99_ms": round(float(np.percentile(times, 99)), 3),
        "max_ms": round(float(times.max()), 3),
        "lost": sender.full + found["overflow"] + max(missing, 0) + found["events_lost"],
        "changes": sender.changes,
        "changes_told": found["told"],
        "commits": found["commits"],
        "waited_for_cpu_s": round(found["waited_s"], 2),
        "cpu_us_per_frame": round(found["cpu_s"] / max(found["frames"], 1) * 1e6, 1),
    }


def main() -> None:
    if sys.argv[1:2] == ["--receive"]:
        receive(int(sys.argv[2]), Path(sys.argv[3]), Path(sys.argv[4]))
        return
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--rate", type=float, default=4000.0)
    parser.add_argument("--random", action="store_true", help="wrong CRCs at random, half of them")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    here = measure(options)
    machine = f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"
    if options.json:
        print(json.dumps(here | {"machine": machine, "seed": SEED}, indent=2))
    else:
        print(f"{machine}; {options.rate:g} frames/s for {options.seconds:g} s; ids from 0x{BASE:X}")
        for key, value in here.items():
            print(f"  {key:20}{value!s:>12}")
    good = here["in_time"] == here["asked"] and not here["lost"]
    if not (good and here["changes"] == here["changes_told"]):
        raise SystemExit(1)


if __name__ == "__main__":
    main()

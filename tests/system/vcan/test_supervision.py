"""The daemon while its interface goes down, away and comes back, on the real kernel."""

import json
import re
import socket
import subprocess
import threading
import time
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest
import warm
from bench_config import beat, write_config
from kernel_can import can_frame, daemon, drops_of, events_in, ip, raw, wait_for
from processes import GATEWAY, process

from gateway.faults.service import daemon_state

pytestmark = pytest.mark.vcan

ROOT = Path(__file__).parents[3]


def make(interface):
    ip("link", "add", "dev", interface, "type", "vcan")
    ip("link", "set", interface, "mtu", "72", "up")


@contextmanager
def interface(name):
    make(name)
    try:
        yield name
    finally:
        with suppress(subprocess.CalledProcessError):
            ip("link", "del", name)


class Ecu:
    """Sends Beat every 20 ms from a thread, whatever becomes of the interface."""

    def __init__(self, name):
        self.name = name
        self.sent = 0
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run)

    def _run(self):
        while not self._ended.is_set():
            with suppress(OSError), raw(self.name) as sock:
                while not self._ended.wait(0.02):
                    sock.send(can_frame(0x300, beat(self.sent)))
                    self.sent += 1
            self._ended.wait(0.02)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._ended.set()
        self._thread.join()


def states(running, state):
    return [e for e in running.events() if e["event"] == "bus" and e["state"] == state]


def dtcs(running):
    return [(e["dtc"], e["status"] & 1) for e in running.events() if e["event"] == "dtc"]


def closed(running):
    return states(running, "closed")[0]


def clean(running):
    """No exception, and only the lines that tell of the bus."""
    for line in running.log:
        assert "Traceback" not in line
        assert json.loads(line)["event"] in ("bus lost", "bus is back"), line


def test_down_up_and_away_and_back_with_exact_counters(tmp_path):
    """Frames pause around each change, so that every one of them must be counted."""
    with interface("vcan5"):
        config = write_config(tmp_path, timeout_ms=60_000.0)
        with daemon(config, cwd=tmp_path, bus="socketcan:vcan5") as running:
            wait_for(lambda: states(running, "open"))
            sent = 0
            changes = [
                lambda: None,
                lambda: (ip("link", "set", "vcan5", "down"), time.sleep(0.3)),
                lambda: (ip("link", "del", "vcan5"), time.sleep(0.3)),
            ]
            back = [
                lambda: None,
                lambda: ip("link", "set", "vcan5", "up"),
                lambda: make("vcan5"),
            ]
            for k, (change, mend) in enumerate(zip(changes, back, strict=True)):
                change()
                mend()
                wait_for(lambda k=k: states(running, "open")[k:])
                with raw("vcan5") as sock:
                    for _ in range(50):
                        sock.send(can_frame(0x300, beat(sent)))
                        sent += 1
        clean(running)
    assert running.code == 0
    end = closed(running)
    assert (end["received"], end["losses"], end["overflow"], end["rejected"]) == (sent, 2, 0, 0)
    summary = running.events()[-1]
    assert summary["decoded"] == sent == 150
    assert summary["buses"] == {"chassis": {}}
    assert dtcs(running) == [("U0001-31", 1), ("U0001-31", 0)] * 2


def test_during_traffic_the_bus_is_the_fault_and_not_its_messages(tmp_path):
    """Each change is waited for: on a busy machine the daemon learns of it late, and of two in a row only the last."""
    with interface("vcan5"):
        config = write_config(tmp_path, timeout_ms=3000.0)
        with daemon(config, cwd=tmp_path, bus="socketcan:vcan5") as running, Ecu("vcan5") as ecu:
            wait_for(lambda: ecu.sent > 20)
            for k in range(2):
                ip("link", "set", "vcan5", "down")
                wait_for(lambda k=k: len(dtcs(running)) == 4 * k + 1)
                time.sleep(3.5)  # longer than the timeout of the message
                ip("link", "set", "vcan5", "up")
                wait_for(lambda k=k: len(dtcs(running)) == 4 * k + 2)
                sent = ecu.sent
                wait_for(lambda sent=sent: ecu.sent > sent + 10)
                ip("link", "del", "vcan5")
                make("vcan5")
                wait_for(lambda k=k: len(dtcs(running)) == 4 * k + 4)
                sent = ecu.sent
                wait_for(lambda sent=sent: ecu.sent > sent + 10)
        clean(running)
    assert running.code == 0
    assert dtcs(running) == [("U0001-31", 1), ("U0001-31", 0)] * 4
    assert closed(running)["losses"] == 4
    assert ecu.sent > running.events()[-1]["decoded"] > 40


def test_an_interface_that_is_missing_at_the_start(tmp_path):
    config = write_config(tmp_path)
    with daemon(config, cwd=tmp_path, bus="socketcan:vcan6") as running:
        (lost,) = wait_for(lambda: states(running, "lost"))
        assert "No such device" in lost["reason"]
        assert wait_for(lambda: dtcs(running)) == [("U0001-31", 1)]
        time.sleep(2)
        with interface("vcan6"):
            wait_for(lambda: states(running, "open"))
            with Ecu("vcan6"):
                wait_for(lambda: ("U0001-31", 0) in dtcs(running))
                time.sleep(1)
            running.terminate()
            running.wait(300)
    assert running.code == 0
    assert not any(code == "U0100-87" for code, _ in dtcs(running)[:2])
    listed = warm.run(
        [*GATEWAY, "faults", "list", "--json", "--memory", "f.sqlite"],
        cwd=tmp_path, capture_output=True, text=True, check=True,
    ).stdout  # fmt: skip
    assert "U0001-31" in {entry["dtc"] for entry in json.loads(listed)}, "kept"


def test_overflow_of_a_stopped_daemon_is_counted_exactly_and_shown_everywhere(tmp_path):
    """The daemon stands still while 3000 frames come; what the kernel then says was lost is what is told."""
    with interface("vcan5"), raw("vcan5") as sock:
        config = write_config(tmp_path, timeout_ms=60_000.0)
        with daemon(config, cwd=tmp_path, bus="socketcan:vcan5?rcvbuf=65536") as running:
            wait_for(lambda: states(running, "open"))
            running.send_signal(19)  # SIGSTOP
            try:
                for k in range(3000):
                    sock.send(can_frame(0x300, beat(k)))
            finally:
                running.send_signal(18)  # SIGCONT
            time.sleep(0.5)
            sent = 3000

            def overflowed():
                """Send one frame more: the kernel says with the next one that it takes how many were lost before."""
                nonlocal sent
                sock.send(can_frame(0x300, beat(sent)))
                sent += 1
                return states(running, "overflow")

            (overflow,) = wait_for(overflowed)
            told = wait_for(lambda: sum(b["overflow"] for b in daemon_state(tmp_path / "f.sqlite")["buses"]))
            text = warm.run(
                [*GATEWAY, "doctor", "--memory", "f.sqlite"],
                cwd=tmp_path, capture_output=True, text=True, check=True,
            ).stdout  # fmt: skip
        clean_but_overflow(running)
    end = closed(running)
    assert end["overflow"] > 0
    assert end["received"] + end["overflow"] == sent, "every frame was received or counted as lost"
    assert told == overflow["overflow"] == end["overflow"]
    assert f"{told} frames lost before they were read" in text
    assert running.events()[-1]["buses"] == {"chassis": {"lost": told}}
    assert ("U0001-04", 1) in dtcs(running)
    assert not any(code.startswith("U0401") for code, _ in dtcs(running)), "no fault of the sender"


def clean_but_overflow(running):
    for line in running.log:
        assert json.loads(line)["event"] == "frames lost in a queue", line


def test_the_kernel_says_the_same_of_a_socket_that_is_not_read():
    """The oracle of the test above: frames sent less frames received are the kernel's drops."""
    with raw("vcan1") as sender, raw("vcan1") as idle:
        idle.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        for k in range(500):
            sender.send(can_frame(0x300, beat(k)))
        idle.setblocking(False)
        got = 0

        def all_are_accounted_for():
            nonlocal got
            with suppress(BlockingIOError):
                while idle.recv(16):
                    got += 1
            return got + drops_of(idle) == 500

        wait_for(all_are_accounted_for)  # the kernel delivers beside the sender


def test_what_the_container_starts_works_with_the_interfaces_of_the_host(tmp_path, monkeypatch):
    """CMD of the Dockerfile, as `docker run --network host` starts it."""
    (command,) = re.findall(r"^CMD (\[.*\])$", (ROOT / "Dockerfile").read_text(), re.M)
    words = json.loads(command)
    assert words[0] == "run"
    monkeypatch.setenv("GATEWAY_MEMORY__PATH", str(tmp_path / "faults.sqlite"))
    with process(*words, "--json", cwd=tmp_path, ready="monitoring socketcan:vcan0") as running:
        running.events = lambda: events_in(tmp_path)
        wait_for(lambda: states(running, "open"))
        healthy = [*GATEWAY, "doctor", "--running"]
        wait_for(lambda: warm.run(healthy, cwd=tmp_path, check=False).returncode == 0)
    assert running.code == 0
    assert warm.run(healthy, cwd=tmp_path, check=False).returncode == 1, "HEALTHCHECK"

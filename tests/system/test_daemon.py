"""The daemon as a service: notifications, reload, a bus that comes back, several buses, an always-on recording."""

import json
import re
import signal
import socket
import subprocess
import time
from collections import Counter
from contextlib import ExitStack, contextmanager, suppress
from functools import reduce
from itertools import pairwise
from operator import and_
from pathlib import Path

import can
import pytest
from bench_config import beat, write_config
from debian import program
from kernel_can import daemon, events_in, wait_for
from processes import bus, gateway, process

from gateway.bus.logs import LogReader
from gateway.bus.ring import segments
from gateway.faults.service import daemon_state

pytestmark = pytest.mark.system

ROOT = Path(__file__).parents[2]


@contextmanager
def ecu_on(uri):
    host, port = re.match(r"loopback:(.+):(\d+)", uri).groups()
    with can.Bus(interface="socketcand", host=host, port=int(port), channel="can0") as opened:
        yield lambda count: opened.send(can.Message(arbitration_id=0x300, is_extended_id=False, data=beat(count)))


class Manager:
    """What systemd is to a service: a datagram socket."""

    def __init__(self, path):
        self.path = str(path)
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(self.path)
        self._socket.settimeout(300)
        self.heard = []

    def wait(self, wanted):
        while True:
            words = self._socket.recv(4096).decode().splitlines()
            self.heard += [(time.monotonic(), word) for word in words]
            if any(word.startswith(wanted) for word in words):
                return words


def test_a_service_manager_is_told_all_it_wants_to_know(tmp_path, monkeypatch):
    manager = Manager(tmp_path / "notify")
    monkeypatch.setenv("NOTIFY_SOCKET", manager.path)
    monkeypatch.setenv("WATCHDOG_USEC", "400000")
    with bus(tmp_path) as uri:
        config = write_config(tmp_path, buses=[("chassis", uri)], timeout_ms=60_000.0)
        with daemon(config, cwd=tmp_path, bus=None) as running:
            assert any("monitoring" in word for word in manager.wait("READY=1"))
            for _ in range(5):
                manager.wait("WATCHDOG=1")
            beats = [at for at, word in manager.heard if word == "WATCHDOG=1"]
            assert beats[-1] - beats[0] < 4 * 0.4, "more often than asked for"
            running.send_signal(signal.SIGHUP)
            reloading = manager.wait("RELOADING=1")
            assert any(word.startswith("MONOTONIC_USEC=") for word in reloading)
            manager.wait("READY=1")
            running.send_signal(signal.SIGTERM)
            manager.wait("STOPPING=1")
    assert running.code == 0


def test_the_hub_ends_and_comes_back_and_the_daemon_stays(tmp_path):
    """The loopback bus has the same supervision: lost, DTC set, back, DTC healed, nothing of the memory lost."""
    with ExitStack() as stack:
        with bus(tmp_path) as uri:
            config = write_config(tmp_path, buses=[("chassis", uri)], timeout_ms=60_000.0)
            running = stack.enter_context(daemon(config, cwd=tmp_path, bus=None))
            with ecu_on(uri) as send:
                for k in (0, 2, 4, 6, 8):
                    send(k)
                wait_for(lambda: ("U0401-82", 1) in dtcs(running))
        wait_for(lambda: dtcs(running)[-1] == ("U0001-31", 1))
        wait_for(lambda: [b["state"] for b in doctor(tmp_path)["buses"]][:1] == ["lost"])
        told = gateway("doctor", "--memory", "f.sqlite", "--json", cwd=tmp_path)
        assert json.loads(told.stdout)["daemon"]["buses"][0]["state"] == "lost"
        ill = gateway("doctor", "--running", "--memory", "f.sqlite", cwd=tmp_path)
        assert ill.returncode == 1
        assert "chassis (loopback:" in ill.stdout
        assert "lost 1 times" in ill.stdout
        port = uri.rpartition(":")[2]
        with process("bus", f"127.0.0.1:{port}", cwd=tmp_path, ready="serving"):
            wait_for(lambda: dtcs(running)[-1] == ("U0001-31", 0))
            with ecu_on(uri) as send:
                for k in range(9, 70):
                    send(k)
                wait_for(lambda: dtcs(running)[-1] == ("U0401-82", 0))
            wait_for(lambda: [b["state"] for b in doctor(tmp_path)["buses"]][:1] == ["open"])
            well = gateway("doctor", "--running", "--memory", "f.sqlite", cwd=tmp_path)
            assert well.returncode == 0, well.stdout
            running.terminate()
            running.wait(300)
        assert not doctor(tmp_path)["running"]
    assert running.code == 0
    assert [json.loads(line)["event"] for line in running.log] == ["bus lost", "bus is back"]


def doctor(folder):
    return daemon_state(folder / "f.sqlite")


def dtcs(running):
    return [(e["dtc"], e["status"] & 1) for e in running.events() if e["event"] == "dtc"]


def configs(running):
    return [e["state"] for e in running.events() if e["event"] == "config"]


@pytest.mark.evidence("Live is replay: reload traffic")
def test_a_reload_under_traffic_loses_no_frame_no_memory_and_no_state(tmp_path):
    with bus(tmp_path) as uri:
        config = write_config(tmp_path, buses=[("chassis", uri)], timeout_ms=60_000.0)
        text = config.read_text()
        with daemon(config, cwd=tmp_path, bus=None) as running, ecu_on(uri) as send:
            sent = []

            def say(count, *, step=1):
                for _ in range(count):
                    sent.append((sent[-1] if sent else 0) + step)
                    send(sent[-1])
                    time.sleep(0.002)

            def until(count):
                limit = time.monotonic() + 120
                while len(configs(running)) < count:
                    say(10)
                    assert time.monotonic() < limit

            say(20)
            say(4, step=3)
            wait_for(lambda: dtcs(running) == [("U0401-82", 1)])
            say(30)  # thirty of fifty good ones that heal it
            config.write_text(text.replace('"beat"', '"changed"', 1))
            running.send_signal(signal.SIGHUP)
            until(1)
            config.write_text(text.replace('"Beat"', '"Nobody"'))
            running.send_signal(signal.SIGHUP)
            until(2)
            config.write_text(text + '\n[memory]\npath = "elsewhere.sqlite"\n')
            running.send_signal(signal.SIGHUP)
            until(3)
            config.write_text(text.replace("60000.0", "-1.0"))
            running.send_signal(signal.SIGHUP)
            until(4)
            say(60)
            # what is still in a socket when the daemon is told to end is lost with it, rightly
            wait_for(lambda: sum(b["received"] for b in doctor(tmp_path)["buses"]) >= len(sent))
    assert running.code == 0
    events = running.events()
    assert configs(running) == ["reloaded", "refused", "reloaded", "refused"], "-- memory overrides"
    reasons = [e["reason"] for e in events if e["event"] == "config" and e["reason"]]
    assert "beat.toml" in reasons[0]
    assert "Nobody" in reasons[0]
    assert "timeout_ms" in reasons[1]
    (end,) = [e for e in events if e["event"] == "bus" and e["state"] == "closed"]
    assert end["received"] == events[-1]["decoded"] == len(sent)
    assert dtcs(running) == [("U0401-82", 1), ("U0401-82", 0)]
    healed = [e for e in events if e["event"] == "dtc"][-1]
    assert healed["occurrence"] == 1
    shown = gateway("faults", "show", "U0401-82", "--memory", "f.sqlite", "--json", cwd=tmp_path)
    assert json.loads(shown.stdout)["occurrence"] == 1
    assert not (tmp_path / "elsewhere.sqlite").exists()


def test_a_reload_may_change_buses(tmp_path):
    """A second bus is opened, the first goes on without a gap; then the first is taken away."""
    other = tmp_path / "other"
    other.mkdir()
    with bus(tmp_path) as uri, bus(other) as second:
        config = write_config(tmp_path, buses=[("chassis", uri)], timeout_ms=60_000.0)
        with daemon(config, cwd=tmp_path, bus=None) as running, ecu_on(uri) as send:
            for k in range(10):
                send(k)
            write_config(tmp_path, buses=[("drive", second), ("chassis", uri)], timeout_ms=60_000.0)
            running.send_signal(signal.SIGHUP)
            wait_for(lambda: configs(running) == ["reloaded"])
            with ecu_on(second) as send_second:
                for k in range(10, 20):
                    send(k)
                    send_second(k)
                for k in (22, 25, 28, 31):  # jumps of the bus that has another index now
                    send(k)
                wait_for(lambda: dtcs(running))
                wait_for(lambda: [b["received"] for b in doctor(tmp_path)["buses"]] == [10, 24])
                write_config(tmp_path, buses=[("drive", second)], timeout_ms=60_000.0)
                running.send_signal(signal.SIGHUP)
                wait_for(lambda: len(configs(running)) == 2)
                for k in range(20, 30):
                    send(k)
                    send_second(k)
                wait_for(lambda: [b["received"] for b in doctor(tmp_path)["buses"]] == [20])
    assert running.code == 0
    assert running.events()[-1]["decoded"] == 10 + 20 + 4 + 10
    faults = [(e["fault"], e["bus"]) for e in running.events() if e["event"] == "dtc"]
    assert faults == [("chassis.Beat.counter", "chassis")]
    (end,) = [e for e in running.events() if e["event"] == "bus" and e["state"] == "closed"]
    assert (end["bus"], end["received"]) == ("drive", 20)


def descriptors(running):
    """Files, sockets and pipes that stay open: seen in each of ten looks within half a second. A file that is read
    or written is open for a moment only. Two of the fault memory's log are SQLite's own and are not counted."""
    looks = []
    for _ in range(10):
        found = Counter()
        for descriptor in Path(f"/proc/{running.pid}/fd").iterdir():
            with suppress(FileNotFoundError):  # closed meanwhile
                found[str(descriptor.readlink())] += 1
        looks.append(found)
        time.sleep(0.05)
    stay = reduce(and_, looks)
    return sum(max(count - 2, 0) if name.endswith("-wal") else count for name, count in stay.items())


def test_a_reload_leaves_nothing_open_and_refuses_what_it_cannot_do(tmp_path):
    """A bus that goes is closed; of a configuration that is refused nothing stays; the memory cannot change."""
    other = tmp_path / "other"
    other.mkdir()
    with bus(tmp_path) as uri, bus(other) as second:
        config = write_config(tmp_path, buses=[("chassis", uri)], timeout_ms=60_000.0)
        first = config.read_text()
        with process("run", config, "--json", cwd=tmp_path, ready="monitoring") as running:
            running.events = lambda: events_in(tmp_path)

            def reload(text, state):
                count = len(configs(running))
                config.write_text(text)
                running.send_signal(signal.SIGHUP)
                wait_for(lambda: configs(running)[count:] == [state])

            reload(first, "reloaded")
            usual = descriptors(running)
            write_config(tmp_path, buses=[("chassis", uri), ("drive", second)], timeout_ms=60_000.0)
            two = config.read_text()
            reload(two, "reloaded")
            assert descriptors(running) == usual + 1
            reload(first, "reloaded")
            assert descriptors(running) == usual
            write_config(
                tmp_path, buses=[("chassis", uri), ("drive", second), ("odd", "canalystii:0")], timeout_ms=60_000.0
            )
            own = '[fault."odd.Beat.{}"]\ndtc = "{}"\n'
            codes = {"timeout": "U0141-87", "counter": "U0423-82", "length": "U0423-81"}
            text = config.read_text()
            for name, code in codes.items():
                old = text.index(f'[fault."odd.Beat.{name}"]')
                text = text[:old] + own.format(name, code) + text[text.index("\n", text.index("dtc", old)) + 1 :]
            reload(text, "refused")
            assert "no library for canalystii" in running.events()[-1]["reason"], "after the second bus was opened"
            assert descriptors(running) == usual, "the bus that was opened is closed again"
            reload(first + '\n[memory]\npath = "elsewhere.sqlite"\n', "refused")
            assert "cannot change while the gateway runs" in running.events()[-1]["reason"]
    assert running.code == 0


def test_the_recording_keeps_what_came_before_kill_9(tmp_path):
    with bus(tmp_path) as uri:
        more = f'[record]\nfolder = "{tmp_path}/ring"\nsegment_mb = 0.004\nkeep_mb = 0.02\n'
        config = write_config(tmp_path, buses=[("chassis", uri)], more=more)
        with daemon(config, cwd=tmp_path, bus=None) as running, ecu_on(uri) as send:
            for k in range(1200):
                send(k)
                time.sleep(0.0005)
            wait_for(lambda: newest(tmp_path / "ring") == 1199 % 256)
            running.kill()
            running.wait(300)
        size = sum(path.stat().st_size for path in segments(tmp_path / "ring"))
        assert size <= 0.024e6, "the bound, and what was begun meanwhile"
        frames = [f for batch in LogReader(tmp_path / "ring") for f in batch]
        kept = [int(f["data"][0]) for f in frames if f["can_id"] == 0x300]
        assert len(kept) > 100
        assert all((b - a) % 256 == 1 for a, b in pairwise(kept)), "no gap"
        replayed = gateway("replay", tmp_path / "ring", "-c", config, "--json", cwd=tmp_path).stdout.splitlines()
        assert json.loads(replayed[-1])["decoded"] == len(kept)
        first = segments(tmp_path / "ring")[-1].name
        with daemon(config, cwd=tmp_path, bus=None):
            pass
        assert segments(tmp_path / "ring")[-1].name > first, "numbers go on"


def newest(folder):
    frames = [f for batch in LogReader(folder) for f in batch if f is not None]
    mine = [int(f["data"][0]) for f in frames if f["can_id"] == 0x300]
    return mine[-1] if mine else -1


def names_of(*uris):
    """Return the names of the buses in a recording, with their places."""
    return {f"127.0.0.1_{uri.rpartition(':')[2]}": k for k, uri in enumerate(uris)}


def recorded(ring, *uris):
    """Return how many frames of the ECU are in a ring by now."""
    return sum(int((batch["can_id"] == 0x300).sum()) for batch in LogReader(ring, names_of(*uris)))


@pytest.mark.parametrize("form", ["log", "blf"])
def test_record_alone_takes_several_buses_down(tmp_path, form):
    other = tmp_path / "other"
    other.mkdir()
    with bus(tmp_path) as uri, bus(other) as second:
        target = ["--ring", "ring", "--format", form] if form == "log" else ["--out", "drive.blf"]
        with (
            process("record", uri, second, *target, "--json", cwd=tmp_path, ready="recording") as recorder,
            ecu_on(uri) as send,
            ecu_on(second) as send_second,
        ):
            wait_for(lambda: len(opened(tmp_path)) == 2)
            for k in range(30):
                send(k)
                send_second(k)
                time.sleep(0.002)
            if form == "log":  # what is still in a socket at the end is lost with it; of a BLF nothing is seen before
                wait_for(lambda: recorded(tmp_path / "ring", uri, second) == 60)
            time.sleep(0.5)
        assert recorder.code == 0
        assert "62 frames recorded" in "".join(recorder.log), "with the condition of each bus"
    path = tmp_path / ("ring" if form == "log" else "drive.blf")
    channels = names_of(uri, second) if form == "log" else {"0": 0, "1": 1}
    frames = [f for batch in LogReader(path, channels) for f in batch]
    for index in (0, 1):
        mine = [f for f in frames if f["can_id"] == 0x300 and f["bus"] == index]
        assert [int(f["data"][0]) for f in mine] == list(range(30))
        # Between the buses the order holds for what arrives within the merger's time (tests/live/test_merge.py).
        stamps = [int(f["t_ns"]) for f in mine]
        assert stamps == sorted(stamps)


def test_a_log_of_several_buses_is_replayed_by_its_names(tmp_path):
    """By the name of the bus, of its interface, or can0, can1 as logs without names have them."""
    config = write_config(tmp_path, buses=[("chassis", "socketcan:can5"), ("drive", "loopback:127.0.0.1:1")])
    for names in (("can5", "drive"), ("chassis", "drive"), ("can0", "can1")):
        lines = [
            f"({k / 100 + index / 1000:.6f}) {name} 300#{beat(k).hex()}\n"
            for k in range(20)
            for index, name in enumerate(names)
        ]
        (tmp_path / "two.log").write_text("".join(lines) + "(9.0) vcan9 300#00\n")
        said = gateway("replay", "two.log", "-c", config, "--json", cwd=tmp_path).stdout
        assert json.loads(said.splitlines()[-1])["decoded"] == 40
        assert "U0401" not in said
        assert "U0422" not in said


def opened(folder):
    lines = (folder / "record.out").read_text().splitlines()
    return [line for line in lines if json.loads(line)["state"] == "open"]


@pytest.mark.evidence("Releases: unit")
@pytest.mark.parametrize("name", ["gateway", "gateway-page", "gateway-fleet", "fleet/gateway-collector"])
def test_the_unit_is_one_that_systemd_takes_and_calls_hardened(tmp_path, name):
    analyze = program("systemd-analyze", "systemd")
    unit = tmp_path / f"{name.rpartition('/')[2]}.service"
    text = (ROOT / f"deploy/{name}.service").read_text()
    unit.write_text(text.replace("/opt/gateway/venv/bin/gateway", "/bin/true"))
    verified = subprocess.run([analyze, "verify", "--man=no", str(unit)], capture_output=True, text=True, check=False)
    assert verified.returncode == 0, verified.stderr
    assert "Unknown" not in verified.stderr
    exposure = subprocess.run(
        [analyze, "security", "--offline=true", "--threshold=20", str(unit)],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert exposure.returncode == 0, exposure.stdout[-400:]
    (command,) = re.findall(r"^ExecStart=\S+/gateway (.*)$", text, re.M)
    words = {"gateway": "run", "gateway-page": "serve", "gateway-fleet": "fleet join"}.get(name, "fleet collect")
    assert command.startswith(words)

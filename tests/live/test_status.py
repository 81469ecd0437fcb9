"""The status socket: events never lost, ticks where there is room, the daemon never waits."""

import json
import socket
import stat

import numpy as np
import pytest
from daemon_rig import World
from talkative import CONFIG, DBC

from gateway.engine.buckets import TickRow
from gateway_fdi.errors import InputError
from gateway_serve import status_socket as module
from gateway_serve.status_socket import StatusSocket


class Client:
    """Reads what the socket says, without waiting."""

    def __init__(self, path):
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self.socket.connect(str(path))
        self.socket.setblocking(False)
        self.heard = b""
        self.told = []

    def read(self):
        while True:
            try:
                data = self.socket.recv(1 << 20)
            except BlockingIOError:
                break
            except ConnectionResetError:
                return "ended"
            if not data:
                return "ended"
            self.heard += data
        while b"\n" in self.heard:
            head, _, rest = self.heard.partition(b"\n")
            message = json.loads(head)
            size = message.get("size", 0)
            if len(rest) < size:
                break
            message["data"], self.heard = rest[:size], rest[size:]
            self.told.append(message)
        return self.told

    def of(self, kind):
        self.read()
        return [message for message in self.told if message["kind"] == kind]

    def ask(self, **command):
        self.socket.send(json.dumps(command).encode() + b"\n")


@pytest.fixture
def place(tmp_path):
    (tmp_path / "one.dbc").write_text(DBC)
    (tmp_path / "gateway.toml").write_text(CONFIG)
    return tmp_path


class Bench:
    """A daemon with a status socket, in this process."""

    def __init__(self, place, monkeypatch):
        self.world = World()
        self.path = place / "gateway.status"
        config = place / "gateway.toml"
        text = config.read_text()
        if "[status]" not in text:
            config.write_text(text + f'\n[status]\nsocket = "{self.path}"\nreaders = 3\n')
        self.daemon = self.world.daemon(config, place / "faults.sqlite")

    def play(self, script):
        self.world.play(self.daemon, script)

    def levels(self, values):
        """One frame a turn, 5 ms apart."""
        return self.world.wait(len(values) * 0.005, lambda k: self.put(values[k]))

    def put(self, value):
        self.world.put(0x100, round(value * 100).to_bytes(2, "little", signed=True) + bytes(6))


@pytest.fixture
def bench(place, monkeypatch):
    made = Bench(place, monkeypatch)
    yield made
    made.daemon.close()


def test_a_residual_of_one_sample_is_in_a_tick_and_the_dtc_among_the_events(bench):
    reader = Client(bench.path)
    assert stat.S_IMODE(bench.path.stat().st_mode) == 0o600
    values = [5.0 + (k % 3) * 0.1 for k in range(200)]
    values[100] = 9.75

    def script():
        yield from bench.world.wait(0.1)  # until the reader has come in
        yield from bench.levels(values)
        yield from bench.world.wait(0.2)  # the tick of the last ones

    bench.play(script())
    hello = reader.of("hello")[0]
    assert hello["protocol"] == 1
    assert hello["buses"][0]["bitrate"] == 500000
    index = [fault["id"] for fault in hello["faults"]].index("level.Level.high")
    rows = [np.frombuffer(tick["data"], TickRow.dtype) for tick in reader.of("tick")]
    mine = [row for part in rows for row in part[part["fault"] == index] if row["count"]]
    assert sum(int(row["count"]) for row in mine) == 200, "each result is in one tick"
    peaks = [row for row in mine if row["high"] == 9.75]
    assert len(peaks) == 1
    assert peaks[0]["ratio"] == pytest.approx(0.975)
    bus = reader.of("buses")[-1]["buses"][0]
    assert bus["state"] == "open"
    assert bus["traffic"]["frames"] > 0
    assert bus["traffic"]["nominal_bits"] > 100 * bus["traffic"]["frames"]
    events = [message["event"] for message in reader.of("event")]
    assert events == [event for _, event in bench.world.events][-len(events) :]


def test_a_dtc_is_cleared_and_the_tester_and_the_events_say_so(bench):
    reader = Client(bench.path)

    def script():
        yield from bench.levels([50.0] * 200)
        assert [dtc for dtc, failed in bench.world.dtcs() if failed]
        reader.ask(id="c1", do="clear")
        yield from bench.levels([5.0] * 40)
        assert not bench.daemon.gateway.memory.entries()
        reader.ask(id="c2", do="clear", dtc="P9999-99")
        reader.ask(id="c3", do="values", signals=["One.Level"])
        reader.ask(id="c4", do="values", signals=["One.Lavel"])
        reader.ask(id="c5", do="cycle")
        reader.socket.send(b'{"do": "explode"}\n[1\n')
        yield from bench.levels([5.0] * 40)

    bench.play(script())
    answers = {answer["id"]: answer for answer in reader.of("answer")}
    assert answers["c1"]["ok"]
    assert answers["c1"]["cleared"] == 1
    assert not answers["c2"]["ok"]
    assert answers["c3"]["values"] == {"One.Level": 5.0}
    assert "did you mean One.Level" in answers["c4"]["error"]
    assert answers["c5"]["number"] == 2
    assert len([a for a in reader.of("answer") if a["id"] is None and not a["ok"]]) == 2
    kinds = [message["event"]["event"] for message in reader.of("event")]
    assert kinds.index("dtc") < kinds.index("clear") < kinds.index("intervention")


def test_what_a_reader_switched_off_is_on_again_when_it_leaves(bench):
    reader = Client(bench.path)

    def script():
        yield from bench.levels([5.0] * 10)
        reader.ask(id=1, do="settings", dtcs=False)
        yield from bench.levels([50.0] * 200)
        assert bench.world.dtcs() == [("U3000-53", 1)], "no result counts but that it is so"
        reader.socket.close()
        yield from bench.levels([50.0] * 200)
        assert bench.world.dtcs()[1] == ("U3000-53", 0)
        assert len(bench.world.dtcs()) > 2

    bench.play(script())


@pytest.mark.evidence("Nothing is silent: readers")
def test_a_reader_that_does_not_read_loses_ticks_and_no_event(bench, monkeypatch):
    monkeypatch.setattr(module, "ENOUGH_BYTES", 4000)
    slow = Client(bench.path)
    slow.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
    sent = []

    def script():
        yield from bench.levels([5.0] * 4)  # until the reader has come in
        for k in range(400):
            event = {"event": "note", "number": k, "text": "x" * 600}
            sent.append(event)
            bench.daemon.status.report(event)
            yield from bench.levels([5.0] * 4)
        for _ in range(400):
            slow.read()
            yield from bench.levels([5.0] * 4)

    bench.play(script())
    got = [m["event"] for m in slow.of("event") if m["event"]["event"] == "note"]
    assert got == sent
    numbers = [tick["number"] for tick in slow.of("tick")]
    assert numbers[-1] - numbers[0] + 1 > len(numbers), "some were missed"
    assert sum(m["count"] for m in slow.of("missed")) > 0


def test_a_reader_that_never_takes_its_events_is_sent_away_and_the_daemon_goes_on(bench, monkeypatch):
    monkeypatch.setattr(module, "MOST_BYTES", 200_000)
    dead, alive = Client(bench.path), Client(bench.path)

    def script():
        yield from bench.levels([5.0] * 4)
        for k in range(1500):
            bench.daemon.status.report({"event": "note", "number": k, "text": "x" * 1000})
            alive.read()
            yield from bench.levels([5.0])

    bench.play(script())
    assert bench.daemon.status.sent_away == 1
    assert dead.read() == "ended"
    assert len([m for m in alive.of("event") if m["event"]["event"] == "note"]) == 1500


def test_readers_and_what_they_say_are_bounded(bench):
    def script():
        readers = [Client(bench.path) for _ in range(5)]
        yield from bench.levels([5.0] * 10)
        assert [reader.read() == "ended" for reader in readers] == [False] * 3 + [True] * 2
        assert bench.daemon.status.refused == 2
        readers[0].socket.send(b"x" * 70_000)
        readers[1].socket.send(b"{}\n" * 100)
        yield from bench.levels([5.0] * 10)
        for reader in readers[:2]:
            assert reader.read() == "ended"
        assert readers[2].read() != "ended"

    bench.play(script())


def test_a_socket_that_was_left_behind_gives_way_and_others_do_not(bench, tmp_path):
    left = tmp_path / "left.status"
    behind = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    behind.bind(str(left))
    behind.close()
    StatusSocket(left, bench.daemon.gateway).close()
    assert not left.exists()
    with pytest.raises(InputError, match="another gateway listens"):
        StatusSocket(bench.path, bench.daemon.gateway)
    file = tmp_path / "file"
    file.write_text("mine")
    with pytest.raises(InputError, match="no socket"):
        StatusSocket(file, bench.daemon.gateway)
    assert file.read_text() == "mine"
    with pytest.raises(InputError, match="can be made here"):
        StatusSocket(tmp_path / ("x" * 200), bench.daemon.gateway)


def test_where_no_descriptors_are_left_the_daemon_does_not_spin(bench, monkeypatch):
    left = {"count": 3}

    real = socket.socket.accept

    def accept(listener):
        if left["count"]:
            left["count"] -= 1
            raise OSError(24, "Too many open files")
        return real(listener)

    monkeypatch.setattr(socket.socket, "accept", accept)
    reader = Client(bench.path)
    bench.play(bench.world.wait(2.5))
    assert left["count"] == 0, "once a second"
    assert not reader.of("hello")
    bench.play(bench.world.wait(2.0))
    assert reader.of("hello")


def test_without_a_reader_nothing_is_counted(bench):
    bench.play(bench.levels([5.0] * 50))
    assert bench.daemon.status.ticks == 0
    assert bench.path.exists()
    bench.daemon.close()
    assert not bench.path.exists()

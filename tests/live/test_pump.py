"""The pump: what it feeds is what the loop of Python feeds, and whatever is unusual comes to Python."""

import os
import socket
from collections import Counter

import numpy as np
import pytest

from bench.live import StructBus
from gateway.bus.can_structs import Packer
from gateway.bus.conditions import are_steps
from gateway.bus.frames import ERROR, EXTENDED, FD, REMOTE, copied, empty, put
from gateway.config.load import load_config
from gateway.live import fast_path_kernel
from gateway.live.clock import Clock
from gateway.live.link import Link
from gateway.live.loop import Live
from gateway.runtime.app import Gateway
from gateway.runtime.fast_path_conditions import NOBODY
from gateway_fdi.common.resources import shipped
from gateway_fdi.jit import COMPILED
from tests.system.bench_config import beat, write_config

#: Plain Python feeds each batch itself, so that the reasons to leave are others.
compiled = pytest.mark.skipif(not COMPILED, reason="other reasons")

SEED = 4901
pack = Packer()
MS = 1_000_000
REQUEST = 0x7E0
DTC_ID = b"\xf0\x06"


class NoSocket(StructBus):
    """As an adapter of python-can: only Python receives from it, and sends."""

    raw = None


class Rig:
    """A gateway on pairs of sockets, whose every frame and time is noted as it was fed."""

    def __init__(self, config, kinds=(StructBus,), memory=None):
        self.ends, self.events, self.calls, self.why = [], [], [], []
        self.clock = Clock()
        self.links = []
        for k, kind in enumerate(kinds):
            ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
            theirs.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1 << 20)
            ours.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1 << 20)
            theirs.setblocking(False)
            self.ends.append(theirs)
            name = load_config(config).bus[k].name
            self.links.append(Link(f"test:{k}", k, name, lambda _, i, end=ours, kind=kind: kind(end, i), self.clock))
            self.links[-1].start()
        self.gateway = Gateway(load_config(config), memory)
        self.gateway.write_beside()
        self.gateway.listen(self.events.append)
        self.start_ns = self.clock.now()
        self.gateway.start(self.start_ns)
        self._note("took", "feed", "advance", "poll")
        self.live = Live(self.gateway, self.links, self.events.append, clock=self.clock, tick_s=0.0, settle=print)
        self.live.turn()
        self.sent = [[] for _ in self.ends]

    def _note(self, *names):
        for name in names:
            inner = getattr(self.gateway, name)

            def noted(value, *more, inner=inner, name=name):
                what = copied(value) if isinstance(value, np.ndarray) else value
                self.calls.append((name, what, *more))
                return inner(value, *more)

            setattr(self.gateway, name, noted)
        finish = Live._finish_pass

        def noted_pass(live, left):
            self.why.append(left.why)
            return finish(live, left)

        self._finish = finish
        Live._finish_pass = noted_pass

    def turn(self):
        self.live.turn()
        self.receive()

    def receive(self):
        for k, end in enumerate(self.ends):
            try:
                while True:
                    self.sent[k].append(end.recv(72))
            except BlockingIOError:
                pass

    def send(self, bus, *frames):
        for frame in frames:
            self.ends[bus].send(pack(frame))

    def close(self):
        Live._finish_pass = self._finish
        for link, end in zip(self.links, self.ends, strict=True):
            link.close()
            end.close()
        self.gateway.close()


@pytest.fixture
def rigs():
    made = []

    def make(*arguments):
        made.append(Rig(*arguments))
        return made[-1]

    yield make
    for rig in made:
        rig.close()


def frame(can_id, data=b"", flags=0):
    out = empty(1)
    put(out, 0, 0, can_id, data, flags=flags)
    return out[0]


def reference(config, rig):
    """Return a gateway that got by Python what the rig's got, and its events and frames."""
    gateway, events, sent = Gateway(load_config(config)), [], []
    gateway.listen(events.append)
    gateway.start(rig.start_ns)
    for name, what, *_ in rig.calls:
        sent.append(gateway.feed(what) if name == "took" else getattr(gateway, name)(what))
    return gateway, events, sent


def assert_equal(one, other):
    """Assert that two gateways are in the same state, byte for byte."""
    ours, theirs = one.engine.tables, other.engine.tables
    for name in ("mailbox", "vectors", "debounces", "checks", "health", "buckets", "cycles", "pages", "watches"):
        assert np.asarray(getattr(ours, name)).tobytes() == np.asarray(getattr(theirs, name)).tobytes(), name
    assert one.engine.counters() == other.engine.counters()
    assert one.engine.readout() == other.engine.readout()
    for k in range(len(one.engine.monitors)):
        assert one.engine.state_of(k).tobytes() == other.engine.state_of(k).tobytes()


def assert_sent(ours, theirs):
    """Assert that a pump has sent what Python would have.

    A DTC frame leaves at its verdict, and not at the end of the batch: of two changes in one batch both are told, and
    the detection counter (byte 4) is that of then.
    """
    dtcs = [Counter(raw[:12] + raw[13:] for raw in sent if raw[:2] == DTC_ID) for sent in (ours, theirs)]
    assert not dtcs[1] - dtcs[0], f"DTC frames; seed {SEED}"
    others = [sorted(raw for raw in sent if raw[:2] != DTC_ID) for sent in (ours, theirs)]
    assert others[0] == others[1], f"monitors' messages and answers; seed {SEED}"


@pytest.mark.evidence("Live is replay: pump")
@compiled
@pytest.mark.parametrize(("bus", "can"), [(StructBus, True), (NoSocket, True), (NoSocket, False)])
def test_a_rough_bus_gives_what_python_gives(rigs, bus, can, monkeypatch):
    """Right, wrong, short, long, unknown, remote, error and own-looking frames, requests; in pieces of any size."""
    from bench.engine import make_log

    monkeypatch.setattr("gateway.live.fast_path.CAN", can)  # without SocketCAN Python waits
    monkeypatch.setattr("gateway.live.fast_path.BATCH", 4)  # more waits than a call takes, or just as much
    config, rng = shipped("gateway.toml"), np.random.default_rng(SEED)
    rig = rigs(config, [bus])
    log, at = make_log(3000), 0
    while at < len(log):
        count = int(rng.integers(1, 40))
        for each in log[at : at + count]:
            kind = rng.random()
            if kind < 0.01:
                each["data"][0] ^= 0xFF
            elif kind < 0.015:
                each["length"] = 5
            elif kind < 0.02:
                continue
            rig.send(0, each)
            if kind > 0.985:
                other = [
                    frame(0x123, b"\1"),
                    frame(0x18DB33F1 | EXTENDED, b"\2\1\0"),
                    frame(0x700 | REMOTE),
                    frame(ERROR | 0x004, bytes([0, 0x10, 0, 0, 0, 0, 0, 0])),
                    frame(ERROR, b"\1"),
                    frame(0x345, bytes(range(64)), FD),
                    frame(REQUEST, bytes([3, 0x19, 2, 0xFF, 0, 0, 0, 0])),
                ]
                rig.send(0, other[int(rng.integers(len(other)))])
        at += count
        for _ in range(int(rng.integers(1, 4))):
            rig.turn()
    for _ in range(50):
        rig.turn()
    gateway, events, sent = reference(config, rig)
    assert_equal(rig.gateway, gateway)
    assert [e for e in rig.events if e["event"] != "bus"] == events
    assert_sent(rig.sent[0], [pack(each) for part in sent for each in part])
    for why in (
        fast_path_kernel.TIME,
        fast_path_kernel.RAW if bus is StructBus else fast_path_kernel.BUS,
        fast_path_kernel.WANTED,
        fast_path_kernel.EVENTS,
    ):
        assert why in rig.why, f"reason {why}; seed {SEED}"
    assert fast_path_kernel.BUS not in rig.why or bus is NoSocket
    assert any(event["event"] == "dtc" for event in events)
    gateway.close()


@compiled
def test_ecus_are_asked_while_it_runs(rigs, tmp_path):
    """Requests leave in time though no frame comes to Python; answers have one frame, and 23."""
    from asking_rig import DBC

    (tmp_path / "cells.dbc").write_text(DBC)
    config = write_config(tmp_path)
    ecu = 'name = "battery"\nrequest = 0x7E4\nresponse = 0x7EC\nsignals = ["cells.dbc"]\n'
    config.write_text(
        config.read_text().replace("[[bus]]", "[[bus]]\nask = { requests_per_s = 200 }", 1)
        + f"\n[[ecu]]\n{ecu}read = [{{ did = 0x2101, every_ms = 10 }}, {{ did = 0x1111, every_ms = 10 }}]\n"
        + 'check = [{ message = "Cells", timeout_ms = 5000.0, lost = "U0123", invalid = "U0456" }]\n'
    )
    rig, seen, asked = rigs(config), 0, 0
    for count in range(100_000):
        rig.send(0, frame(0x300, beat(count)))
        rig.turn()
        for raw in rig.sent[0][seen:]:
            can_id, data = int.from_bytes(raw[:4], "little"), raw[8:16]
            if can_id == 0x7E4 and data[0] == 0x30:
                rig.send(0, *(frame(0x7EC, bytes([0x20 | (1 + k) & 15]) + bytes(7)) for k in range(22)))
            elif can_id == 0x7E4:
                asked += 1
                long = data[2:4] == b"\x21\x01"
                rig.send(0, frame(0x7EC, b"\x10\x99\x62\x21\x01\x0e\x74\0" if long else b"\x04\x62\x11\x11\x07\0\0\0"))
        seen = len(rig.sent[0])
        if asked == 30:
            break
    (state,) = rig.gateway.asking.states()
    assert state["requests"] == asked == 30
    assert 0 <= asked - state["answers"] - state["absent"] <= 1
    assert state["answers_decoded"] > 10
    assert state["answers_cut"] == 0
    assert fast_path_kernel.WANTED in rig.why
    gateway, events, sent = reference(config, rig)
    assert_equal(rig.gateway, gateway)
    assert [e for e in rig.events if e["event"] != "bus"] == events
    assert_sent(rig.sent[0], [pack(each) for part in sent for each in part])
    gateway.close()


@compiled
@pytest.mark.parametrize("kinds", [(StructBus, StructBus), (StructBus, NoSocket), (NoSocket, NoSocket)])
def test_two_buses_in_one_order(rigs, tmp_path, kinds):
    config = write_config(tmp_path, buses=(("chassis", "virtual:a"), ("body", "virtual:b")))
    rig, rng, counts = rigs(config, kinds), np.random.default_rng(SEED), [0, 0]
    for _ in range(400):
        for _ in range(int(rng.integers(1, 9))):
            bus = int(rng.integers(2))
            counts[bus] += 1 + (rng.random() < 0.01)
            rig.send(bus, frame(0x300, beat(counts[bus])))
        rig.turn()
    for _ in range(3000):
        rig.turn()
        if not rig.live._pump.holding:
            break
    assert fast_path_kernel.EVENTS in rig.why
    fed = np.concatenate([what for name, what, *_ in rig.calls if name in ("took", "feed")])
    assert (np.diff(fed["t_ns"]) >= 0).all(), "in order of time"
    for bus in (0, 1):
        mine = fed[(fed["bus"] == bus) & (fed["can_id"] == 0x300)]["data"][:, 0]
        assert (np.diff(mine.astype(np.int64)) % 256 <= 2).all(), "each bus's in its own order"
    assert rig.gateway.engine.counters()["frames"] == len(fed)
    gateway, events, _ = reference(config, rig)
    assert_equal(rig.gateway, gateway)
    assert [e for e in rig.events if e["event"] != "bus"] == events
    gateway.close()


@compiled
def test_of_a_j1939_bus_python_gets_what_it_listens_to_and_nothing_else(rigs, tmp_path):
    """Identifiers of all senders: DM1, packets to all, requests; other groups stay in the pump."""
    config = write_config(tmp_path)
    text = config.read_text().replace("[[bus]]", "[[bus]]\ndm1 = true", 1)
    config.write_text(text + "[output.j1939]\naddress = 0\n")
    rig = rigs(config)
    for _ in range(300):
        rig.turn()  # the address is claimed
    others = [frame(0x300, beat(k)) for k in range(40)] + [frame(0x0CF00421 | EXTENDED, bytes(8))]
    for sender in (0x21, 0x32):
        for heard in (0x18FECA00, 0x1CECFF00, 0x18EAFF00, 0x18EA0000):
            rig.why.clear()
            rig.send(0, *others[:20])
            rig.turn()
            assert fast_path_kernel.WANTED not in rig.why
            rig.send(0, others[40], frame(heard | sender | EXTENDED, b"\0\0\x64\0\3\1\xff\xff"))
            rig.turn()
            assert fast_path_kernel.WANTED in rig.why, f"{heard | sender:X}"
    gateway, events, _ = reference(config, rig)
    assert_equal(rig.gateway, gateway)
    assert [e for e in rig.events if e["event"] != "bus"] == events
    assert {e["dtc"] for e in events if e["event"] == "ecu_dtc"} == {"SPN 100 FMI 3"}
    gateway.close()


def test_a_step_of_the_wall_clock_is_python_s(rigs, monkeypatch):
    """Noticed in the pump its frames are Python's, which looks itself; noticed by Python it is told."""
    rig = rigs(shipped("gateway.toml"))
    rig.turn()
    rig.send(0, frame(0x123), frame(0x124))
    with monkeypatch.context() as patched:
        patched.setattr(Clock, "difference_ns", property(lambda clock: clock._difference - 3_000_000_000))
        rig.turn()
    assert fast_path_kernel.STEPPED in rig.why[-2:]
    rig.send(0, frame(0x125))
    rig.clock._difference -= 3_000_000_000  # as if the wall clock had been set forward
    for _ in range(20):
        rig.turn()
    fed = np.concatenate([what for name, what, *_ in rig.calls if name in ("took", "feed")])
    assert [f"{each:x}" for each in fed["can_id"] if each < 0x700] == ["123", "124", "125"]
    assert are_steps(fed).sum() == 1
    assert [event["event"] for event in rig.events if event["event"] == "clock"] == ["clock"]


def test_a_door_and_a_dead_bus_end_a_pass(rigs):
    rig = rigs(shipped("gateway.toml"))

    class Door:
        def __init__(self):
            self.event, self.knocks = os.eventfd(1), 0

        def fileno(self):
            return self.event

        def listening(self):
            return False

        def on_frames(self, frames):
            pass

        def turn(self, now_s, *, wanted):
            self.knocks += wanted

    door = Door()
    rig.live._door = door
    for _ in range(3):
        rig.turn()
    assert fast_path_kernel.DOOR in rig.why
    assert door.knocks >= 1
    rig.ends[0].close()
    for _ in range(5):
        rig.live.turn()
    assert fast_path_kernel.BUS in rig.why
    os.close(door.event)


class Tap:
    def __init__(self):
        self.taken = []

    def write(self, frames):
        self.taken += list(frames.copy())


def changes_of(sent):
    return [raw for raw in sent if raw[:2] == DTC_ID and raw[13] == 0 and any(raw[8:11])]


@compiled
@pytest.mark.parametrize("way", ["in process", "first", "stored", "taken down", "switched off"])
def test_a_dtc_leaves_before_python_has_its_verdict(rigs, tmp_path, way):
    """Where the memory is on the disk the journal sends it; each is sent, and taken down, once."""
    more = '[memory]\ntell = "first"\n' if way == "first" else ""
    memory = tmp_path / "faults.sqlite" if way in ("first", "stored") else None
    config = write_config(tmp_path, timeout_ms=60_000.0, more=more)  # its clock is the machine's, which may be busy
    debounce = "failed_after = 1\npassed_after = 1\njump_down = true\njump_up = true\n"
    text = config.read_text().replace("cycle_ms", "min_interval_ms = 0\ncycle_ms")
    config.write_text(text + f'[fault."chassis.Beat.counter".debounce]\n{debounce}')
    rig = rigs(config, (StructBus,), memory)
    if way == "taken down":
        rig.live._taps = [Tap()]
    if way == "switched off":
        rig.gateway.controls.set_communication(receive=True, send=False)
    early, tell = [], rig.gateway.deliver

    def noted(gone):
        rig.receive()
        early.extend(pack(each) for each in gone)
        if way != "stored":  # else the journal sends them when they are on the disk
            assert not Counter(early) - Counter(changes_of(rig.sent[0])), "they are on the bus"
        return tell(gone)

    rig.gateway.deliver, count = noted, 0
    for k in range(60):
        while k == 20 and way != "switched off" and rig.gateway.quiet().foretells == NOBODY:
            rig.turn()  # the start is being written
        count += 1 + (k in (20, 40))
        rig.send(0, frame(0x300, beat(count)))
        rig.turn()
    while not rig.gateway.stored:
        rig.turn()
    for _ in range(200):  # what Python sends leaves with a turn after the write, on a busy machine not with the first
        rig.turn()
        dtcs = [event for event in rig.events if event["event"] == "dtc"]
        if way == "switched off" or len(changes_of(rig.sent[0])) >= len(dtcs):
            break
    assert [event["status"] & 1 for event in dtcs] == [1, 0, 1, 0][: len(dtcs)]
    assert len(dtcs) >= 1
    told = changes_of(rig.sent[0])
    if way == "switched off":
        assert not told
        return
    assert [raw[11] for raw in told] == [event["status"] for event in dtcs], "each once"
    assert {event["stored"] for event in dtcs} == {way != "first"}
    assert rig.gateway.servers.counters()["dtc_frames_corrected"] == 0
    assert early, "not all: the next verdict may come while the file is written, or Python reads the bus"
    if way == "taken down":
        assert changes_of([pack(each) for each in rig.live._taps[0].taken]) == told

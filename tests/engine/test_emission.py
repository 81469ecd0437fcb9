"""A monitor's own message reaches the bus, and the other monitors, in the batch that caused it."""

import cantools
import crccheck
import numpy as np
import pytest
from amount import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.bus import conditions
from gateway.bus.frames import CYCLIC, ERROR, empty, payload, put
from gateway.engine.build import build_engine
from gateway.engine.checks.bus_health import BusInstance
from gateway.engine.instances import MonitorInstance
from gateway.monitors import contract
from gateway.monitors.contract import (
    Emission,
    Fault,
    Monitor,
    MonitorParams,
    Readout,
    Signal,
    report,
)
from gateway.signals.database import load_database
from gateway_fdi.errors import InputError, InputErrors
from gateway_fdi.jit import Record, f8, i8, kernel

DBC = """VERSION ""
NS_ :
BS_:
BU_: A B
BO_ 256 Input: 8 A
 SG_ Value : 0|16@1- (0.5,0) [-1000|1000] "V" B
BO_ 257 Output: 8 B
 SG_ Crc : 0|8@1+ (1,0) [0|255] "" A
 SG_ FrameCnt : 8|4@1+ (1,0) [0|15] "" A
 SG_ Double : 16|16@1- (0.5,0) [-10000|10000] "V" A
"""


class Params(MonitorParams):
    """Nothing."""


class State(Record):
    steps: i8
    last: f8


class Const(Record):
    unused: f8


class Inputs(contract.Inputs):
    value: f8


class Outputs(Record):
    double: f8


@kernel
def _double(s, c, u, out):
    s.steps += 1
    s.last = u.value
    out.values.double = 2.0 * u.value
    out.send = 1


@kernel
def _listen(s, c, u, out):
    s.steps += 1
    s.last = u.value
    report(out, 0, u.value > 100.0, u.value, 100.0)


def monitor(name, step, message, signal, emission=None, faults=()):
    return Monitor(
        type=name,
        api=2,
        params=Params,
        state=State,
        const=Const,
        inputs=Inputs,
        outputs=None if emission is None else Outputs,
        step=step,
        connect=lambda p: {"value": Signal(f"{message}.{signal}", triggers=True)},
        prepare=lambda p, s, c: None,
        faults=lambda p: faults,
        emits=None if emission is None else lambda p: emission,
        capabilities=(Readout(("steps", "last")),),
    )


DOUBLE = monitor("double", _double, "Input", "Value", Emission("Output", {"double": "Double"}))
LISTEN = monitor("listen", _listen, "Output", "Double", faults=(Fault("high", "P0100-11", ""),))


@pytest.fixture
def made(tmp_path):
    path = tmp_path / "a.dbc"
    path.write_text(DBC)
    database = load_database([path])

    def build(*, send=True, listen=True):
        monitors = [MonitorInstance("d", DOUBLE, Params(), emission=database.message("Output") if send else None)]
        if listen:
            monitors.append(MonitorInstance("l", LISTEN, Params()))
        return build_engine([(0, database)], monitors, [])

    build.message = cantools.database.load_file(path).get_message_by_name("Output")
    return build


def frames_of(values):
    frames = empty(len(values))
    for k, value in enumerate(values):
        put(frames, k, k * 1000, 0x100, int(value * 2).to_bytes(2, "little", signed=True) + bytes(6))
    return frames


def test_the_message_is_counted_protected_and_stamped(made):
    engine = made()
    sent = engine.process(frames_of([1.5, -7.0, 100.0]), lambda events: None)
    assert sent["t_ns"].tolist() == [0, 1000, 2000]
    for k, frame in enumerate(sent):
        body = payload(frame)
        values = made.message.decode(body)
        assert values["Double"] == [3.0, -14.0, 200.0][k]
        assert values["FrameCnt"] == k
        data = body[1:] + (0x101).to_bytes(2, "little")
        assert values["Crc"] == crccheck.crc.Crc8SaeJ1850.calc(data)
        assert int(frame["rank"]) == CYCLIC


def test_other_monitors_get_it_at_once(made):
    events = []
    engine = made()
    engine.process(frames_of([1.0, 60.0, 2.0]), lambda e: events.extend(e.copy()))
    shown = engine.readout()
    assert shown["l"] == {"steps": 3, "last": 4.0, "not_tested": 0}
    failed = [int(e["t_ns"]) for e in events if e["kind"] == events[1]["kind"]]
    assert 1000 in failed
    assert engine.counters()["unknown"] == 0
    assert engine.counters()["frames"] == 3, "frames received, not those sent"


def test_nothing_is_sent_unless_asked(made):
    engine = made(send=False)
    assert len(engine.process(frames_of([1.0]), lambda events: None)) == 0
    assert engine.readout()["l"]["steps"] == 0


@settings(max_examples=examples(30), deadline=None)
@given(st.lists(st.integers(-300, 300), min_size=1, max_size=60), st.data())
def test_batches_change_neither_frames_nor_events(tmp_path_factory, values, data):
    path = tmp_path_factory.mktemp("e") / "a.dbc"
    path.write_text(DBC)
    database = load_database([path])

    def run(cuts):
        engine = build_engine(
            [(0, database)],
            [
                MonitorInstance("d", DOUBLE, Params(), emission=database.message("Output")),
                MonitorInstance("l", LISTEN, Params()),
            ],
            [],
        )
        frames, events, sent = frames_of(values), [], []
        for a, b in zip([0, *cuts], [*cuts, len(values)], strict=True):
            sent.append(engine.process(frames[a:b], lambda e: events.append(e.copy())))
            sent.append(engine.advance(b * 1000 - 500, lambda e: events.append(e.copy())))
        return np.concatenate(sent).tobytes(), b"".join(e.tobytes() for e in events)

    cuts = sorted(data.draw(st.lists(st.integers(0, len(values)), max_size=8), label="cuts"))
    assert run([]) == run(cuts)


@pytest.mark.costly
def test_more_than_one_pass_can_hold(made):
    engine = made(listen=False)
    sent = engine.process(frames_of(np.arange(5000) % 100), lambda events: None)
    assert len(sent) == 5000
    assert engine.counters()["sent_lost"] == 0
    assert made.message.decode(payload(sent[-1]))["FrameCnt"] == 4999 % 16


def test_a_message_without_the_signal_is_refused(tmp_path):
    path = tmp_path / "a.dbc"
    path.write_text(DBC.replace("Double", "Other"))
    database = load_database([path])
    with pytest.raises((InputError, InputErrors), match="no signal 'Double'"):
        build_engine(
            [(0, database)],
            [MonitorInstance("d", DOUBLE, Params(), emission=database.message("Output"))],
            [],
        )


@kernel
def _tick(s, c, u, out):
    s.steps += 1
    out.values.double = 2.0 * u.value
    out.send = 1
    out.wake_ns = u.t_ns + 1_000_000


def test_what_the_gateway_says_itself_does_not_prove_that_it_hears(tmp_path):
    (tmp_path / "a.dbc").write_text(DBC)
    database = load_database([tmp_path / "a.dbc"])
    ticking = monitor("tick", _tick, "Input", "Value", Emission("Output", {"double": "Double"}))
    instance = MonitorInstance("t", ticking, Params(), emission=database.message("Output"))
    engine = build_engine([(0, database)], [instance], [], buses=[BusInstance("a")])
    off = [slot.id for slot in engine.faults].index("a.bus_off")
    failed = empty(1)
    put(failed, 0, 500_000, ERROR | conditions.BUS_OFF, bytes(8))
    engine.process(np.concatenate([frames_of([1.0]), failed]), lambda events: None)
    assert len(engine.advance(5_500_000, lambda events: None)) == 5
    assert engine.fault_detection_counter(off) == 127
    again = frames_of([1.0])
    again["t_ns"] = 6_000_000
    engine.process(again, lambda events: None)
    assert engine.fault_detection_counter(off) == -128

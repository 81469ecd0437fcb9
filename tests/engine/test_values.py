"""Floating-point signals that carry no value: rejected where they enter, told, and told as healed."""

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway.bus.frames import FD, empty, put
from gateway.engine.build import build_engine
from gateway.engine.checks import message
from gateway.engine.checks.communication import CheckInstance
from gateway.engine.events import QUALIFIED_FAILED, QUALIFIED_PASSED
from gateway.signals.database import load_database
from gateway.signals.tables import LARGEST, SignalRef

DBC = """VERSION ""
NS_ :
BS_:
BU_: A
BO_ 256 Plant: 24 A
 SG_ Free : 0|64@1- (1,0) [0|0] "V" A
 SG_ Ranged : 64|32@1- (2,0) [-10|30] "V" A
 SG_ Count : 96|8@1+ (1,0) [0|255] "" A
 SG_ Unused : 128|64@1- (1,0) [0|0] "V" A
SIG_VALTYPE_ 256 Free : 2;
SIG_VALTYPE_ 256 Ranged : 1;
SIG_VALTYPE_ 256 Unused : 2;
BO_ 257 Whole: 8 A
 SG_ Value : 0|16@1+ (1,0) [0|10] "V" A
"""
REFS = (SignalRef(0, "Plant", "Free"), SignalRef(0, "Plant", "Ranged"))


@pytest.fixture(scope="module")
def database(tmp_path_factory):
    path = tmp_path_factory.mktemp("dbc") / "values.dbc"
    path.write_text(DBC)
    return load_database([path])


def engine_of(database):
    checks = [
        CheckInstance(message.Params(message="Plant"), 0, "can.Plant"),
        CheckInstance(message.Params(message="Whole", invalid="U0402"), 0, "can.Whole"),
    ]
    extra = {*REFS, SignalRef(0, "Whole", "Value")}
    return build_engine([(0, database)], [], checks, extra=extra)


def frames_of(values):
    frames = empty(len(values))
    for k, (free, ranged) in enumerate(values):
        with np.errstate(over="ignore"):
            data = struct.pack("<d", free) + np.float32(ranged).tobytes() + bytes([k & 255])
        data = data.ljust(16, b"\0") + struct.pack("<d", np.nan)  # nobody asks for the last
        put(frames, k, t_ns=10_000_000 * (k + 1), can_id=256, payload=data, flags=FD)
    return frames


def feed(engine, values):
    events = []
    engine.process(frames_of(values), lambda batch: events.extend(batch.copy()))
    return events


def valid(free, ranged):
    """The range of ``Ranged`` is -10..30: as much again on each side is -50..70; its raw value is half of it."""
    return abs(free) <= LARGEST and -50.0 <= 2.0 * float(np.float32(ranged)) <= 70.0


@given(st.lists(st.tuples(st.floats(), st.floats(width=32)), min_size=1, max_size=20))
def test_the_mailbox_holds_the_last_values_of_frames_that_carry_some(database, values):
    engine = engine_of(database)
    feed(engine, values)
    good = [pair for pair in values if valid(*pair)]
    assert engine.counters()["invalid_values"] == len(values) - len(good)
    if good:
        assert engine.signal(REFS[0]) == good[-1][0]
        assert engine.signal(REFS[1]) == 2.0 * float(np.float32(good[-1][1]))
    else:
        assert np.isnan(engine.signal(REFS[0]))


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 2e15])
def test_it_is_a_fault_of_the_message_with_evidence_and_heals(database, value):
    engine = engine_of(database)
    ids = [slot.id for slot in engine.faults]
    at = ids.index("can.Plant.value")
    assert engine.faults[at].fault.dtc == "U0401-29"
    events = feed(engine, [(1.0, 1.0), (value, 1.0), (value, 1.0), *[(1.0, 1.0)] * 60])
    told = [(int(e["kind"]), int(e["t_ns"])) for e in events if e["fault"] == at]
    assert (QUALIFIED_FAILED, 30_000_000) in told
    assert told[-1][0] == QUALIFIED_PASSED
    (failed,) = [e for e in events if e["fault"] == at and e["kind"] == QUALIFIED_FAILED]
    assert failed["evidence"][0] == 0
    assert np.array_equal(failed["evidence"][1], value, equal_nan=True)


def test_a_message_of_integers_has_no_such_fault(database):
    ids = [slot.id for slot in engine_of(database).faults]
    assert "can.Whole.value" not in ids
    assert "can.Whole.length" in ids


def test_it_can_be_left_out(database):
    check = CheckInstance(message.Params(message="Plant", value=False), 0, "can.Plant")
    engine = build_engine([(0, database)], [], [check], extra=set(REFS))
    assert not any("value" in slot.id for slot in engine.faults)
    feed(engine, [(np.nan, 1.0)])
    assert engine.counters()["invalid_values"] == 1

"""DTC frames that are made at a verdict are those that are made after it, whatever happened before."""

from pathlib import Path

import cantools
import numpy as np
import pytest
from fault_examples import AtOnce, catalogue, event, nothing
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.bus.frames import FRAME, payload
from gateway.engine.events import EVENT, RESULT_CHANGED
from gateway.faults.settings import POWER
from gateway.faults.store import Store
from gateway.servers import prepared_frames as knowledge
from gateway.servers.dtc_frame import DtcFrameParams, DtcFrameSender
from gateway.servers.prepared_frames_kernel import MOST, prepare_next

DBC = Path(__file__).parents[2] / "dbc" / "gateway.dbc"
MESSAGE = cantools.database.load_file(DBC).get_message_by_name("GW_DTC")
MS = 1_000_000
FAULTS = 10


def sender(memory, **params):
    return DtcFrameSender(DtcFrameParams(**params), DBC, 1, memory, lambda fault: -5)


def prepared(made, verdicts, t_ns):
    """Return the frames made at events at a time, before these are taken."""
    made.prepared.foresee()
    events = np.zeros(max(len(verdicts), 1), EVENT)
    for row, told in zip(events, verdicts, strict=False):
        for name in ("t_ns", "fault", "kind", "fdc"):
            row[name] = getattr(told, name)
    count = prepare_next(made.prepared.tables, events.view(np.recarray), len(verdicts), t_ns)
    return made.prepared.tables.frames[:count].copy().view(FRAME).reshape(-1)


def taken(made, memory, verdicts, t_ns):
    """Return the frames made after the same events."""
    changes = [change for each in verdicts for change in memory.apply(each, nothing)]
    return made.on_changes([change for change in changes if change.concerns_fault], t_ns)


verdict = st.tuples(st.integers(0, FAULTS - 1), st.booleans())
step = st.one_of(
    st.tuples(st.just("verdicts"), st.lists(verdict, min_size=1, max_size=MOST + 1)),
    st.tuples(st.just("verdicts"), st.lists(verdict, min_size=1, max_size=2)),
    st.tuples(st.sampled_from(["hold", "confirm", "clear"]), st.integers(0, FAULTS - 1)),
    st.tuples(st.sampled_from(["end", "start", "room"]), st.none()),
)


@settings(max_examples=150, derandomize=True)
@given(st.lists(step, max_size=25), st.sampled_from([None, 4]), st.sampled_from([0.0, 3.0]), st.booleans())
def test_they_are_those_that_are_made_after_it(steps, size, interval_ms, waits):
    memory = AtOnce(catalogue((1, 1, 2, 1, 2, 1, 3, 1, 1, 2)), Store(None), size=size)
    if waits:
        memory.wait_for_causes({"m.f0", "m.f1", "m.f2"})
    memory.start_cycle(0)
    made = sender(memory, min_interval_ms=interval_ms)
    for k, (kind, what) in enumerate(steps):
        t_ns = (k + 1) * 2 * MS
        if kind == "verdicts":
            verdicts = [event(fault, failed, t_ns) for fault, failed in what]
            made.on_changes([], t_ns)  # those that min_interval_ms held back are sent when they are due
            before = prepared(made, verdicts, t_ns)
            after = taken(made, memory, verdicts, t_ns)
            if len(before):
                assert before.tobytes() == after.tobytes()
            elif size is None and not interval_ms and len({fault for fault, _ in what}) == len(what) <= MOST:
                assert not len(after), "told only afterwards, without a reason"
        elif kind == "hold" and memory.record(f"m.f{what}").hold:
            memory.hold(f"m.f{what}")
        elif kind == "confirm":
            memory.confirm(f"m.f{what}", 127, t_ns)
        elif kind == "clear":
            memory.clear(memory.record(f"m.f{what}").dtc)
        elif kind == "end":
            memory.end_cycle(t_ns)
        elif kind == "start":
            memory.start_cycle(t_ns, POWER)
        elif kind == "room":
            memory.admit_refused(t_ns)
        memory.commit()


def test_they_are_as_the_database_says():
    memory = AtOnce(catalogue(), Store(None))
    memory.start_cycle(0)
    (frame,) = prepared(sender(memory), [event(1, True, 3 * MS)], 3 * MS)
    assert (int(frame["can_id"]), int(frame["bus"]), int(frame["t_ns"])) == (0x6F0, 1, 3 * MS)
    values = {"Dtc": 0x030111, "Status": 0x27, "FaultDetectionCounter": 127, "Index": 0, "Count": 1, "Occurrence": 1}
    assert MESSAGE.decode(payload(frame)) == values


def test_an_event_of_another_kind_is_pythons():
    memory = AtOnce(catalogue(), Store(None))
    memory.start_cycle(0)
    made = sender(memory)
    told = event(1, True)
    assert len(prepared(made, [told._replace(kind=RESULT_CHANGED), told], 0)) == 1
    assert not len(prepared(made, [told, told._replace(kind=9)], 0))
    memory.end_cycle(1)
    assert not len(prepared(made, [told], 0)), "it does not count outside of its operation cycle"


def test_many_faults_are_foreseen_in_several_calls(monkeypatch):
    monkeypatch.setattr(knowledge, "AT_ONCE", 2)
    memory = AtOnce(catalogue((1,) * FAULTS), Store(None))
    memory.start_cycle(0)
    made, last = sender(memory), [event(FAULTS - 1, True)]
    calls = [len(prepared(made, last, 0)) for _ in range(FAULTS // 2 + 1)]
    assert calls == [0] * (FAULTS // 2 - 1) + [1, 1]
    memory.start_cycle(1)
    assert not len(prepared(made, last, 0)), "what was foreseen before counts no more"


def test_a_frame_that_has_gone_is_not_sent_again_and_a_wrong_one_is_corrected(capsys):
    memory = AtOnce(catalogue(), Store(None))
    memory.start_cycle(0)
    made, verdicts = sender(memory), [event(0, True), event(1, True)]
    made.prepared.note(prepared(made, verdicts, 0)[:1])
    changes = [change for each in verdicts for change in memory.apply(each, nothing)]
    assert not len(made.correct(changes, 0))
    (left,) = made.on_changes(changes, 0)
    assert MESSAGE.decode(payload(left))["Dtc"] == 0x030111
    made.prepared.foresee()
    made.prepared.tables.following["passed"][0] = 0x55
    made.prepared.note(prepared(made, [event(0, False)], 20 * MS))
    changes = memory.apply(event(0, False), nothing)
    (again,) = made.correct(changes, 20 * MS)
    assert MESSAGE.decode(payload(again))["Status"] == int(memory.status("m.f0"))
    assert "m.f0" in capsys.readouterr().out
    assert made.counters() == {"dtc_frames_corrected": 1}
    assert not len(made.correct(changes, 20 * MS))


@pytest.mark.parametrize("sent", [True, False])
def test_of_what_the_journal_has_not_sent_python_sends_the_newest(sent):
    """It has passed again before the file had the failure: the failure is told by the journal, or never."""
    memory, asked = AtOnce(catalogue(), Store(None)), []
    memory.start_cycle(0)
    made = sender(memory, min_interval_ms=0.0)
    made.prepared.withdraw = lambda number: asked.append(number) or sent
    for again in (False, True):
        frames = prepared(made, [event(0, True)], 0)
        made.prepared.tables.made["number"][0] = 7
        made.prepared.note(frames)
        changes = memory.apply(event(0, True), nothing)
        assert not len(made.correct(changes, 0))
        if again:
            assert len(made.on_changes(changes, 0)) == (not sent)
        else:
            changes += memory.apply(event(0, False), nothing)
            (left,) = made.on_changes(changes, 0)
            assert not MESSAGE.decode(payload(left))["Status"] & 1
    assert asked == [7, 7]

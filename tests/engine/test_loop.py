"""Vector table, priorities, timers, mailbox, event ring: the loop as a whole."""

from itertools import pairwise

import numpy as np
import pytest
from amount import examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gateway.bus.frames import ERROR, REMOTE
from gateway.engine.events import QUALIFIED_FAILED, QUALIFIED_PASSED, RESULT_CHANGED, SHORT
from gateway.monitors.contract import NOT_TESTED
from gateway_fdi.errors import InputError


def test_a_failure_is_debounced_qualified_and_carries_its_evidence(build, tools):
    engine = build(("m", 0, {"tag": 7.0}))
    seen = tools.Collector()
    engine.process(tools.batch(*(tools.alpha(k, 20.5) for k in range(3))), seen)
    assert [(e[0], e[2], e[4]) for e in seen.events] == [
        (0, RESULT_CHANGED, 63),
        (1_000_000, QUALIFIED_FAILED, 127),
    ]
    assert seen.events[1][5:7] == (20.5, 10.0)
    assert seen.events[1][7][:2] == (7.0, 41.0)
    engine.process(tools.batch(*(tools.alpha(10 + k, 0) for k in range(9))), seen)
    assert seen.events[-1][2] == QUALIFIED_PASSED
    assert engine.fault_detection_counter(0) == -128


def test_monitors_of_one_message_step_by_priority(build, tools):
    engine = build(
        ("late", 5, {"tag": 5.0}),
        ("first", 0, {"tag": 0.0}),
        ("middle", 2, {"tag": 2.0}),
    )
    seen = tools.Collector()
    engine.process(tools.batch(tools.alpha(0, 99), tools.alpha(1, 99)), seen)
    qualified = [e for e in seen.events if e[2] == QUALIFIED_FAILED]
    assert [e[7][0] for e in qualified] == [0.0, 2.0, 5.0]
    assert [slot.id for slot in engine.faults[::2]] == ["first.high", "middle.high", "late.high"]


def test_the_mailbox_is_as_at_the_event_when_python_sees_it(build, tools):
    engine = build(("m", 0, {}))
    slot = engine.plan.slot(0, "Alpha", "Value")
    values = []

    def sink(events):
        values.extend(engine.value(slot) for e in events if e["kind"] == QUALIFIED_FAILED)

    rows = [tools.alpha(k, v) for k, v in enumerate([11.0, 12.0, 0.0, 0.0, 0.0, 0.0, 13.0, 14.0, 1.0])]
    engine.process(tools.batch(*rows), sink)
    assert values == [12.0, 14.0]
    assert engine.value(slot) == 1.0


def test_unknown_remote_and_error_frames_are_counted_not_decoded_short_ones_in_part(build, tools):
    engine = build(("m", 0, {}))
    seen = tools.Collector()
    engine.process(
        tools.batch(
            (0, 0x7FF, b""),
            (1, 256 | REMOTE, b""),
            (2, 256 | ERROR, bytes(8)),
            (3, 256, bytes(2)),
            (4, 256 | tools.EXTENDED, bytes(8)),
        ),
        seen,
    )
    counters = engine.counters()
    assert counters["frames"] == 5
    assert counters["decoded"] == 1
    assert (counters["unknown"], counters["remote"], counters["error"]) == (2, 1, 1)
    assert counters["too_short"] == 1
    assert [event[2] for event in seen.events] == [SHORT]
    assert np.isnan(engine.value(engine.plan.slot(0, "Alpha", "Value")))
    assert engine.tables.handlers["steps"].tolist() == [0], "its input is beyond the end"


def test_a_timer_runs_at_its_deadline_whatever_the_batches(build, tools):
    for split in (False, True):
        engine = build(("m", 0, {"wake_ms": 30.0}))
        seen = tools.Collector()
        rows = [tools.alpha(0, 0), tools.alpha(100, 0), tools.alpha(110, 0)]
        if split:
            for row in rows:
                engine.advance(round(row[0] * 1e6) - 1, seen)
                engine.process(tools.batch(row), seen)
        else:
            engine.process(tools.batch(*rows), seen)
        woken = [e for e in seen.events if e[1] == 1 and e[2] == QUALIFIED_FAILED]
        assert [e[0] for e in woken] == [30_000_000]


def test_a_message_timeout_is_reported_at_each_deadline_and_heals(build, tools):
    engine = build(("m", 0, {}), checks=[{"message": "Alpha", "timeout_ms": 50.0}])
    seen = tools.Collector()
    engine.process(tools.batch(tools.alpha(0, 0)), seen)
    engine.advance(40_000_000, seen)
    timeout = next(k for k, slot in enumerate(engine.faults) if slot.id.endswith(".timeout"))
    assert not any(e[1] == timeout and e[2] == QUALIFIED_FAILED for e in seen.events)
    engine.advance(175_000_000, seen)
    failed = [e for e in seen.events if e[1] == timeout and e[2] == QUALIFIED_FAILED]
    assert [(e[0], e[7][0]) for e in failed] == [(50_000_000, 50.0)]
    assert engine.counters()["timeouts"] == 3
    engine.process(tools.batch(*(tools.alpha(180 + k, 0) for k in range(6))), seen)
    assert seen.events[-1][2] == QUALIFIED_PASSED


def test_a_jump_of_the_clock_by_decades_is_one_timeout(build, tools):
    engine = build(checks=[{"message": "Alpha", "timeout_ms": 0.001}])
    seen = tools.Collector()
    engine.process(tools.batch(tools.alpha(0, 0)), seen)
    engine.advance(2**60, seen)
    assert len([e for e in seen.events if e[2] == QUALIFIED_FAILED]) == 1
    assert engine.counters()["timeouts"] == 2**60 // 1000


def test_a_message_that_never_comes_times_out(build, tools):
    engine = build(checks=[{"message": "Alpha", "timeout_ms": 50.0}])
    seen = tools.Collector()
    engine.advance(1_000_000, seen)
    engine.advance(60_000_000, seen)
    assert [(e[0], e[2]) for e in seen.events] == [(51_000_000, QUALIFIED_FAILED)]


def test_a_monitor_with_a_missing_or_stale_input_reports_not_tested(build, tools):
    engine = build(
        ("m", 0, {"signals": ("Alpha.Value", "Beta.Value")}),
        checks=[{"message": "Beta", "timeout_ms": 50.0}],
    )
    seen = tools.Collector()
    engine.process(tools.batch(tools.alpha(0, 99)), seen)
    assert engine.readout()["m"] == {"steps": 0, "last_ns": 0, "total": 0.0, "not_tested": 1}
    engine.process(tools.batch(tools.beta(1, 3), tools.alpha(2, 99)), seen)
    assert engine.readout()["m"]["steps"] == 1
    counter = engine.fault_detection_counter(0)
    engine.process(tools.batch(tools.alpha(60, 99), tools.alpha(61, 99)), seen)
    assert engine.readout()["m"]["steps"] == 1
    assert engine.fault_detection_counter(0) == counter
    changed = [e for e in seen.events if e[1] == 0 and e[3] == NOT_TESTED]
    assert [e[0] for e in changed] == [60_000_000]


def test_events_beyond_the_ring_are_counted(build, tools):
    engine = build(*((f"m{k}", 0, {}) for k in range(5)), ring=2)
    seen = tools.Collector()
    engine.process(tools.batch(tools.alpha(0, 99)), seen)
    assert len(seen.events) == 2
    assert engine.counters()["events_lost"] == 3


def test_late_frames_are_handled_and_counted(build, tools):
    engine = build(("m", 0, {}))
    seen = tools.Collector()
    engine.process(tools.batch(tools.alpha(5, 1), tools.alpha(3, 2)), seen)
    assert engine.counters()["late"] == 1
    assert engine.readout()["m"]["steps"] == 2
    assert engine.now_ns == 5_000_000


def test_clearing_resets_the_debounce(build, tools):
    engine = build(("m", 0, {}))
    seen = tools.Collector()
    engine.process(tools.batch(tools.alpha(0, 99), tools.alpha(1, 99)), seen)
    engine.reset_debounce([0])
    assert engine.fault_detection_counter(0) == 0
    engine.process(tools.batch(tools.alpha(2, 99), tools.alpha(3, 99)), seen)
    assert [e[2] for e in seen.events].count(QUALIFIED_FAILED) == 2


def test_wrong_names_are_named(build):
    with pytest.raises(InputError, match="Valu"):
        build(("m", 0, {"signals": ("Alpha.Valu",)}))
    with pytest.raises(InputError, match="Alph"):
        build(checks=[{"message": "Alph", "timeout_ms": 1.0}])


rows = st.lists(
    st.tuples(
        st.integers(0, 40),
        st.sampled_from([256, 257, 256, 0x123]),
        st.integers(-40, 40),
        st.integers(0, 15),
        st.sampled_from([8, 8, 8, 8, 3]),
    ),
    max_size=60,
)


@settings(
    deadline=None,
    max_examples=examples(60),
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(rows, st.lists(st.integers(0, 60), max_size=8), st.lists(st.integers(0, 60), max_size=6))
def test_batch_boundaries_never_change_an_event(build, tools, rows, cuts, ticks):
    """The property that makes live equal replay."""
    t_ms, made = 0, []
    for gap, can_id, value, count, length in rows:
        t_ms += gap
        body = tools.alpha(t_ms, value / 2, count)[2]
        made.append((t_ms, can_id, body[:length]))
    frames = tools.batch(*made)

    def run(pieces, ticked):
        engine = build(
            ("a", 0, {"wake_ms": 25.0}),
            ("b", 1, {"signals": ("Alpha.Value", "Beta.Value")}),
            checks=[
                {
                    "message": "Alpha",
                    "timeout_ms": 50.0,
                    "counter": {"signal": "Count", "max_step": 2},
                }
            ],
        )
        seen = tools.Collector()
        engine.advance(0, seen)
        for k, piece in enumerate(pieces):
            engine.process(piece, seen)
            if ticked and k in ticks and len(piece):
                engine.advance(int(piece[-1]["t_ns"]), seen)
        engine.advance((t_ms + 100) * 1_000_000, seen)
        return seen.events, engine.counters(), engine.readout()

    edges = [0, *sorted(min(c, len(frames)) for c in cuts), len(frames)]
    pieces = [frames[a:b] for a, b in pairwise(edges)]
    assert run([frames], False) == run(pieces, True)

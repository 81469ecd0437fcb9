"""When test results count, and what begins and ends operation cycles."""

import math

import pytest
from everywhere import everywhere

from gateway.engine.events import (
    CYCLE_BEGAN,
    CYCLE_ENDED,
    FDC_REACHED,
    QUALIFIED_FAILED,
    QUALIFIED_PASSED,
    RESULT_CHANGED,
)
from gateway.engine.gate import Condition, CycleWatch, Gate
from gateway.monitors.contract import Debounce
from gateway.signals.tables import SignalRef
from gateway_fdi.errors import InputError

BETA = SignalRef(0, "Beta", "Value")
HIGH, SILENT = 0, 1


def kinds(collector, fault=HIGH):
    return [(e[0] // 10**6, e[2]) for e in collector.events if e[1] == fault]


def gated(build, *, debounce=None, **gate):
    return build(
        ("m", 0, {}),
        debounces=everywhere(debounce),
        gates={"m.high": Gate(**gate)},
    )


@pytest.mark.evidence("AUTOSAR DEM: enable conditions")
@pytest.mark.parametrize("resets", [False, True])
def test_results_count_only_while_the_enable_condition_is_met(build, tools, resets):
    engine = gated(build, debounce=Debounce(3, 3), conditions=(Condition(BETA, 5, 10),), resets=resets)
    seen = tools.Collector()
    rows = [tools.beta(0, 7), tools.alpha(1, 20), tools.alpha(2, 20)]
    engine.process(tools.batch(*rows), seen)
    assert engine.fault_detection_counter(HIGH) == 84
    # Out of range: two failures more do not qualify.
    engine.process(tools.batch(tools.beta(3, 11), tools.alpha(4, 20), tools.alpha(5, 20)), seen)
    assert engine.fault_detection_counter(HIGH) == (0 if resets else 84)
    assert kinds(seen)[-1] == (4, RESULT_CHANGED), "said once that it is not tested"
    # Both ends belong to the range.
    engine.process(tools.batch(tools.beta(6, 10), tools.alpha(7, 20)), seen)
    assert (kinds(seen)[-1] == (7, QUALIFIED_FAILED)) == (not resets)
    engine.process(tools.batch(tools.beta(8, 5), tools.alpha(9, 20), tools.alpha(10, 20)), seen)
    assert engine.fault_detection_counter(HIGH) == 127


def test_a_condition_whose_signal_is_unknown_or_overdue_is_not_met(build, tools):
    engine = build(
        ("m", 0, {}),
        checks=[{"message": "Beta", "timeout_ms": 10}],
        gates={"m.high": Gate((Condition(BETA, 0, 100),))},
    )
    seen = tools.Collector()
    engine.process(tools.batch(tools.alpha(1, 20), tools.alpha(2, 20)), seen)
    assert kinds(seen) == [], "Beta has never come"
    engine.process(tools.batch(tools.beta(3, 7), tools.alpha(14, 20), tools.alpha(15, 20)), seen)
    assert kinds(seen) == [], "Beta is overdue"
    engine.process(tools.batch(tools.beta(16, 7), tools.alpha(17, 20), tools.alpha(18, 20)), seen)
    assert kinds(seen)[-1] == (18, QUALIFIED_FAILED)


@pytest.mark.evidence("AUTOSAR DEM: event dependencies")
def test_a_root_cause_comes_before_its_symptom(build, tools):
    """The sensor's own fault takes longer to qualify than what is computed from it, and still comes alone."""
    engine = build(
        ("sensor", 0, {"limit": 10.0, "tag": 1.0}),
        ("physics", 1, {"limit": 10.0, "tag": 2.0}),
        debounces={
            "sensor.high": {"failed_after": 5, "passed_after": 5},
            "physics.high": {"failed_after": 2, "passed_after": 2},
        },
        gates={"physics.high": Gate(roots=("sensor.high",))},
    )
    names = {slot.id: k for k, slot in enumerate(engine.faults)}
    seen = tools.Collector()
    engine.process(tools.batch(*[tools.alpha(t, 20) for t in range(8)]), seen)
    assert kinds(seen, names["sensor.high"])[-1] == (4, QUALIFIED_FAILED)
    assert QUALIFIED_FAILED not in [kind for _, kind in kinds(seen, names["physics.high"])]
    # The sensor heals; from then on its symptom counts again, in its own right.
    engine.process(tools.batch(*[tools.alpha(t, 0) for t in range(8, 20)]), seen)
    assert kinds(seen, names["sensor.high"])[-1][1] == QUALIFIED_PASSED
    healed = kinds(seen, names["sensor.high"])[-1][0]
    assert kinds(seen, names["physics.high"])[-1][0] >= healed
    assert kinds(seen, names["physics.high"])[-1][1] == QUALIFIED_PASSED


def test_a_fault_known_from_before_is_a_root_cause_until_its_test_says_otherwise(build, tools):
    engine = build(
        ("sensor", 0, {"messages": ["Beta"], "signals": ["Beta.Value"]}),
        ("physics", 1, {}),
        gates={"physics.high": Gate(roots=("sensor.high",))},
    )
    names = {slot.id: k for k, slot in enumerate(engine.faults)}
    seen = tools.Collector()
    engine.set_active(names["sensor.high"], True)
    engine.process(tools.batch(*[tools.alpha(t, 20) for t in range(5)]), seen)
    assert kinds(seen, names["physics.high"]) == []
    engine.process(
        tools.batch(tools.beta(5, 0), tools.beta(6, 0), tools.alpha(7, 20), tools.alpha(8, 20)),
        seen,
    )
    assert kinds(seen, names["physics.high"])[-1] == (8, QUALIFIED_FAILED)


def test_unknown_root_causes_are_refused(build):
    for wrong in ("m.nothing", "m.high"):
        with pytest.raises(InputError, match=r'fault\."m\.high"\.caused_by'):
            build(("m", 0, {}), gates={"m.high": Gate(roots=(wrong,))})


def test_held_results_do_not_count_and_then_do_again(build, tools):
    engine = gated(build, debounce=Debounce(2, 2))
    seen = tools.Collector()
    engine.process(tools.batch(tools.alpha(0, 20)), seen)
    engine.hold_results(True)
    engine.process(tools.batch(*[tools.alpha(t, 20) for t in range(1, 9)]), seen)
    assert QUALIFIED_FAILED not in [kind for _, kind in kinds(seen)]
    engine.hold_results(False)
    engine.process(tools.batch(tools.alpha(9, 20)), seen)
    assert kinds(seen)[-1] == (9, QUALIFIED_FAILED), "what was counted before was frozen"


TIMED = Debounce(failed_ms=30, passed_ms=50)


def test_time_debounce_takes_edge_reporters_and_periodic_ones_alike(build, tools):
    """One result at 0 ms, or one each millisecond: both qualify at 30 ms, from a timer or a frame."""
    for times in ([0], range(100)):
        engine = gated(build, debounce=TIMED)
        seen = tools.Collector()
        engine.process(tools.batch(*[tools.alpha(t, 20) for t in times]), seen)
        engine.advance(100 * 10**6, seen)
        qualified = [e for e in seen.events if e[2] == QUALIFIED_FAILED]
        assert [e[0] for e in qualified] == [30 * 10**6]
        assert qualified[0][5:7] == (20.0, 10.0), "value and limit of the result that made it"
        assert qualified[0][7][1] >= 20.0, "and its evidence"


def test_time_debounce_starts_anew_when_the_result_turns(build, tools):
    engine = gated(build, debounce=TIMED)
    seen = tools.Collector()
    rows = [tools.alpha(0, 20), tools.alpha(29, 0), tools.alpha(30, 20), tools.alpha(59, 20)]
    engine.process(tools.batch(*rows), seen)
    assert QUALIFIED_FAILED not in [kind for _, kind in kinds(seen)]
    engine.advance(60 * 10**6, seen)
    assert kinds(seen)[-1] == (60, QUALIFIED_FAILED)
    engine.process(tools.batch(tools.alpha(70, 0)), seen)
    engine.advance(200 * 10**6, seen)
    assert kinds(seen)[-1] == (120, QUALIFIED_PASSED)


def test_time_debounce_counter_rises_in_proportion(build, tools):
    engine = gated(build, debounce=TIMED)
    engine.process(tools.batch(tools.alpha(0, 20)), tools.Collector())
    for t, expected in ((0, 0), (10, 42), (15, 63), (29, 122), (30, 127), (99, 127)):
        engine.advance(t * 10**6, tools.Collector())
        assert engine.fault_detection_counter(HIGH) == expected


def test_time_debounce_behind_a_closed_gate_starts_anew(build, tools):
    engine = gated(build, debounce=TIMED, conditions=(Condition(BETA, 5, 10),))
    seen = tools.Collector()
    engine.process(tools.batch(tools.beta(0, 7), tools.alpha(1, 20), tools.beta(20, 0)), seen)
    engine.advance(40 * 10**6, seen)
    assert QUALIFIED_FAILED not in [kind for _, kind in kinds(seen)]
    engine.process(tools.batch(tools.beta(41, 7)), seen)
    engine.advance(200 * 10**6, seen)
    assert kinds(seen)[-1] == (61, QUALIFIED_FAILED), "30 ms after its time came and found it closed"


def test_a_jump_of_the_clock_by_decades_costs_one_step(build, tools):
    engine = gated(build, debounce=TIMED)
    seen = tools.Collector()
    engine.process(tools.batch(tools.alpha(0, 20)), seen)
    engine.advance(10**18, seen)
    assert kinds(seen)[-1] == (30, QUALIFIED_FAILED)


@pytest.mark.parametrize("debounce", [Debounce(10, 10), Debounce(failed_ms=10, passed_ms=10)])
def test_the_freeze_frame_is_asked_for_once_on_the_way_up(build, tools, debounce):
    engine = gated(build, debounce=debounce, trigger_fdc=60)
    seen = tools.Collector()
    engine.process(tools.batch(*[tools.alpha(t, 20) for t in range(12)]), seen)
    asked = [e for e in seen.events if e[2] == FDC_REACHED]
    assert len(asked) == 1
    assert asked[0][4] >= 60
    assert asked[0][4] - 13 < 60, "at the first step that reaches it"
    assert [e[2] for e in seen.events if e[2] == QUALIFIED_FAILED] == [QUALIFIED_FAILED]


def test_time_alone_reaches_for_the_freeze_frame_too(build, tools):
    engine = gated(build, debounce=Debounce(failed_ms=100, passed_ms=100), trigger_fdc=64)
    seen = tools.Collector()
    engine.process(tools.batch(tools.alpha(0, 20)), seen)
    engine.advance(10**9, seen)
    found = [(e[0], e[2], e[4]) for e in seen.events if e[2] in (FDC_REACHED, QUALIFIED_FAILED)]
    (asked, kind, fdc), (failed, _, _) = found
    assert (kind, fdc) == (FDC_REACHED, 64)
    assert 50 * 10**6 < asked < 51 * 10**6
    assert failed == 100 * 10**6


@pytest.mark.evidence("AUTOSAR DEM: fault detection counter")
def test_near_misses_are_counted_from_half_the_way_up(build, tools):
    engine = gated(build, debounce=Debounce(10, 1, jump_down=True))
    t = 0
    for failures in (4, 5, 9, 3, 8):
        engine.process(tools.batch(*[tools.alpha(t + k, 20) for k in range(failures)]), tools.Collector())
        t += failures
        engine.process(tools.batch(tools.alpha(t, 0)), tools.Collector())
        t += 1
    assert engine.fold_statistics(HIGH) == (3, 9 * 127 // 10)
    assert engine.fold_statistics(HIGH) == (0, 0), "each is told once"
    engine.process(tools.batch(*[tools.alpha(t + k, 20) for k in range(10)]), tools.Collector())
    engine.process(tools.batch(tools.alpha(t + 10, 0)), tools.Collector())
    assert engine.fold_statistics(HIGH) == (0, 127), "a failure is no near miss"


@pytest.mark.evidence("AUTOSAR DEM: cycle signals")
def test_signals_begin_and_end_operation_cycles(build, tools):
    cycles = [
        CycleWatch(Condition(BETA, 400, math.inf), Condition(BETA, -math.inf, 50)),
        CycleWatch(Condition(BETA, 70, math.inf, rise=22.0), Condition(BETA, -math.inf, 10)),
    ]
    engine = build(("m", 0, {}), cycles=cycles)
    seen = tools.Collector()
    speeds = [60, 60, 81, 82, 399, 400, 300, 51, 50, 500, 0]
    engine.process(tools.batch(*[tools.beta(t, v) for t, v in enumerate(speeds)]), seen)
    found = [(e[0] // 10**6, e[1], e[2]) for e in seen.events if e[2] in (CYCLE_BEGAN, CYCLE_ENDED)]
    assert found == [
        (3, 1, CYCLE_BEGAN),  # 82 is 22 above 60; 81 is not
        (5, 0, CYCLE_BEGAN),
        (8, 0, CYCLE_ENDED),
        (9, 0, CYCLE_BEGAN),
        (10, 0, CYCLE_ENDED),
        (10, 1, CYCLE_ENDED),
    ]
    # After an end the lowest value counts from then on: 22 above 0, though not above the end's 5.
    engine.process(tools.batch(tools.beta(12, 5), tools.beta(13, 71)), seen)
    assert [(e[0] // 10**6, e[2]) for e in seen.events if e[1] == 1][-1] == (13, CYCLE_BEGAN)
    engine.process(tools.batch(tools.beta(14, 65), tools.beta(15, 500)), seen)
    engine.end_cycles()
    engine.process(tools.batch(tools.beta(20, 490)), seen)
    assert [e[1] for e in seen.events if e[0] == 20 * 10**6 and e[2] == CYCLE_BEGAN] == [0], (
        "the warm-up cycle needs a rise of its own after the start"
    )
    engine.process(tools.batch(tools.beta(21, 0), tools.beta(22, 500)), seen)
    assert [(e[0] // 10**6, e[1]) for e in seen.events if e[2] == CYCLE_BEGAN][-2:] == [
        (22, 0),
        (22, 1),
    ]


def test_cycles_whose_ends_are_in_other_messages_than_their_beginnings(build, tools):
    alpha = SignalRef(0, "Alpha", "Value")
    cycles = [
        CycleWatch(Condition(BETA, 10, math.inf), Condition(alpha, -math.inf, 1)),
        CycleWatch(Condition(alpha, 10, math.inf), Condition(BETA, -math.inf, 1)),
    ]
    engine = build(("m", 0, {}), cycles=cycles)
    seen = tools.Collector()
    rows = [tools.beta(0, 20), tools.alpha(1, 20), tools.beta(2, 0), tools.alpha(3, 0)]
    engine.process(tools.batch(*rows), seen)
    found = [(e[0] // 10**6, e[1], e[2]) for e in seen.events if e[2] in (CYCLE_BEGAN, CYCLE_ENDED)]
    assert found == [
        (0, 0, CYCLE_BEGAN),
        (1, 1, CYCLE_BEGAN),
        (2, 1, CYCLE_ENDED),
        (3, 0, CYCLE_ENDED),
    ]


def test_a_rise_is_counted_anew_once_its_cycle_has_begun(build, tools):
    alpha = SignalRef(0, "Alpha", "Value")
    warm_up = CycleWatch(Condition(BETA, 70, math.inf, rise=22.0), Condition(alpha, -math.inf, 1))
    engine = build(("m", 0, {}), cycles=[warm_up])
    seen = tools.Collector()
    rows = [tools.beta(0, 60), tools.beta(1, 82), tools.alpha(2, 0), tools.beta(3, 90)]
    engine.process(tools.batch(*rows, tools.beta(4, 104)), seen)
    found = [(e[0] // 10**6, e[2]) for e in seen.events if e[2] in (CYCLE_BEGAN, CYCLE_ENDED)]
    assert found == [(1, CYCLE_BEGAN), (2, CYCLE_ENDED), (4, CYCLE_BEGAN)]

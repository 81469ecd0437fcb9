"""Debounce: many test results in, few qualified verdicts out.

It runs inside the jitted loop because it sees every test result of every monitor; the fault memory
sees only the changes. As in AUTOSAR DEM the internal counter runs between two thresholds, in results or in
nanoseconds, and the fault detection counter of ISO 14229-1 Annex D is that counter scaled: -128 qualified
passed, +127 qualified failed, clamped at both ends.
"""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np

from gateway.common.times import NEVER
from gateway.engine.events import (
    FDC_REACHED,
    QUALIFIED_FAILED,
    QUALIFIED_PASSED,
    RESULT_CHANGED,
)
from gateway.monitors.contract import EVIDENCE, FAILED, NOT_TESTED, PASSED, Debounce
from gateway_fdi.jit import Record, f8, f8s, i4, i8, kernel, means, u1


class DebouncePlace(Record):
    """Places in other tables, and settings that the state does not depend on."""

    trigger: i8 = means("counter at which the freeze frame is wanted; 0: never")
    timer: i4 = means("of a debounce by time; -1: it counts results")
    cycle: i4 = means("operation cycle; -1: the gateway's run")
    first_condition: i4 = means("conditions[first_condition:+conditions]: enable conditions")
    conditions: i4 = means("how many these are")
    first_root: i4 = means("roots[first_root:+roots]: root causes")
    roots: i4 = means("how many these are")
    jump_up_to: i8 = means("counter that a failed result jumps up to")
    jump_down_to: i8 = means("counter that a passed result jumps down to")
    jump_up: u1 = means("1: a failed result jumps")
    jump_down: u1 = means("1: a passed result jumps")
    gated: u1 = means("1: gates may hold it")
    resets: u1 = means("whether it is reset while it is held")
    is_root: u1 = means("whether it closes the gates of other faults")
    bus: u1 = means("number of the bus")


class DebounceConst(Record):
    """Constants that the state is counted in: results, or ns if ``timed``."""

    failed_after: i8 = means("counter at which it is failed")
    passed_after: i8 = means("minus the counter at which it is passed")
    failed_step: i8 = means("what a failed result adds")
    passed_step: i8 = means("what a passed result takes off")
    timed: u1 = means("1: the counter is in ns")


class DebounceState(Record):
    """Counter, last result, last verdict."""

    last: u1 = means("last result")
    verdict: u1 = means("last verdict")
    direction: u1 = means("where a time debounce runs to: PASSED or FAILED")
    active: u1 = means("1: the fault is there, like testFailed")
    triggered: u1 = means("1: the freeze frame was wanted in this episode")
    missed: u1 = means("1: the episode is a near miss, if it ends now")
    counter: i8 = means("the counter")
    since_ns: i8 = means(unit="ns")
    deadline_ns: i8 = means(unit="ns")
    episode: i8 = means("greatest counter since it was last 0")
    peak: i8 = means("greatest counter since :func:`fold`")
    near: i8 = means("near misses since :func:`fold`")
    value: f8 = means("what the last result tested")
    limit: f8 = means("what it was tested against")
    evidence: Annotated[f8s, EVIDENCE] = means("its evidence, for a verdict that time brings")


#: Fields that a result touches if it changes nothing: one line of the cache.
_NEAR: tuple[str, ...] = (
    "gated",
    "timed",
    "last",
    "verdict",
    "jump_up",
    "jump_down",
    "missed",
    "triggered",
    "active",
    "direction",
    "bus",
)
_NEAR += ("is_root", "timer", "counter", "passed_after", "passed_step", "episode", "value", "limit")


class DebounceRow(DebounceState, DebounceConst, DebouncePlace, near=_NEAR):
    """Debounce of one fault."""


def configure(row: np.void, debounce: Debounce, *, trigger_fdc: int = 0) -> None:
    """Fill the constants of one row.

    Args:
        row: of DebounceRow.
        debounce: the fault's.
        trigger_fdc: fault detection counter at which its freeze frame is wanted, 0: not before the verdict.
    """
    row["timed"] = debounce.timed
    if debounce.failed_ms is not None and debounce.passed_ms is not None:
        row["failed_after"] = max(round(debounce.failed_ms * 1e6), 1)
        row["passed_after"] = max(round(debounce.passed_ms * 1e6), 1)
    else:
        row["failed_after"] = debounce.failed_after
        row["passed_after"] = debounce.passed_after
    row["failed_step"], row["passed_step"] = debounce.failed_step, debounce.passed_step
    row["jump_up"], row["jump_up_to"] = debounce.jump_up, debounce.jump_up_to
    row["jump_down"], row["jump_down_to"] = debounce.jump_down, debounce.jump_down_to
    # The least counter whose scaled value is at least the one asked for.
    row["trigger"] = -(-trigger_fdc * int(row["failed_after"]) // 127)
    row["deadline_ns"] = NEVER
    row["missed"] = 1


@kernel
def _scaled(counter: int, failed_after: int, passed_after: int) -> int:
    if counter >= 0:
        return int(counter * 127 // failed_after)
    return -int(-counter * 128 // passed_after)


@kernel
def fault_detection_counter(d: Any, t_ns: int) -> int:
    """Return the counter at a time, scaled to -128..127: the ends mean a verdict, and only they do."""
    return _scaled(_at(d, t_ns), d.failed_after, d.passed_after)


@kernel
def all_detection_counters(debounces: Any, t_ns: int, into: Any) -> None:
    """Write the detection counter of each fault at a time; ``into``: int8, shape (faults,)."""
    for k in range(debounces.shape[0]):
        into[k] = fault_detection_counter(debounces[k], t_ns)


@kernel
def _at(d: Any, t_ns: int) -> int:
    """Return the counter at a time."""
    counter = d.counter
    if d.timed == 1 and t_ns > d.since_ns:
        if d.direction == FAILED:
            counter = min(counter + (t_ns - d.since_ns), d.failed_after)
        elif d.direction == PASSED:
            counter = max(counter - (t_ns - d.since_ns), -d.passed_after)
    return int(counter)


@kernel
def _remember(d: Any) -> None:
    """Keep statistics: the greatest counter, and rises to half the way that came to nothing."""
    if d.counter > 0:
        d.peak = max(d.peak, d.counter)
        d.episode = max(d.episode, d.counter)
    elif d.episode > 0 or d.missed == 0 or d.triggered == 1:
        if d.episode * 2 >= d.failed_after and d.missed == 1:
            d.near += 1
        d.episode = 0
        d.missed = 1
        d.triggered = 0


@kernel
def _verdict(d: Any) -> int:
    """Return the kind of event that the counter makes now: a verdict, its trigger, or 0."""
    if d.counter <= 0:
        if d.counter == -d.passed_after and d.verdict != PASSED:
            d.verdict = PASSED
            d.active = 0
            return QUALIFIED_PASSED
    elif d.counter == d.failed_after:
        d.missed = 0
        if d.verdict != FAILED:
            d.verdict = FAILED
            d.active = 1
            d.triggered = 1
            return QUALIFIED_FAILED
    elif d.trigger > 0 and d.counter >= d.trigger and d.triggered == 0:
        d.triggered = 1
        return FDC_REACHED
    return 0


@kernel
def is_settled(d: Any) -> bool:
    """Return whether one more pass changes nothing: the debounce counts results, is qualified, and at its end."""
    return bool(d.timed == 0 and d.last == PASSED and d.verdict == PASSED and d.counter == -d.passed_after)


@kernel
def report_counter_based(d: Any, result: int) -> int:
    """Count one test result of a fault; returns the kind of event it makes, 0 for none.

    Args:
        d: record of :class:`DebounceRow`, counter based.
        result: PASSED or FAILED.
    """
    changed = d.last != result
    d.last = result
    if result == FAILED:
        if d.jump_up == 1:
            d.counter = max(d.counter, d.jump_up_to)
        d.counter = min(d.counter + d.failed_step, d.failed_after)
    else:
        if d.jump_down == 1:
            d.counter = min(d.counter, d.jump_down_to)
        d.counter = max(d.counter - d.passed_step, -d.passed_after)
    kind = _verdict(d)
    _remember(d)
    if kind == 0 and changed:
        return RESULT_CHANGED
    return kind


@kernel
def qualify_by_time(d: Any, t_ns: int) -> int:
    """Bring a time debounce up to a time; returns the kind of event it makes, 0 for none."""
    d.counter = _at(d, t_ns)
    d.since_ns = max(d.since_ns, t_ns)
    kind = _verdict(d)
    _remember(d)
    d.deadline_ns = NEVER
    if d.direction == FAILED and d.verdict != FAILED:
        goal = d.failed_after if d.triggered == 1 or d.trigger == 0 else d.trigger
        d.deadline_ns = d.since_ns + goal - d.counter
    elif d.direction == PASSED and d.verdict != PASSED:
        d.deadline_ns = d.since_ns + d.counter + d.passed_after
    return kind


@kernel
def report_time_based(d: Any, t_ns: int, result: int) -> int:
    """Take one test result of a time debounce; returns the kind of event it makes, 0 for none."""
    changed = d.last != result
    d.last = result
    kind = qualify_by_time(d, t_ns)
    if d.direction != result:
        d.direction = result
        if result == FAILED:
            d.counter = max(d.counter, 0)
        else:
            d.counter = min(d.counter, 0)
        d.since_ns = max(d.since_ns, t_ns)
        if kind == 0:
            kind = qualify_by_time(d, t_ns)
    if kind == 0 and changed:
        return RESULT_CHANGED
    return kind


@kernel
def jump_to_end(d: Any, t_ns: int, result: int) -> None:
    """Bring the counter to where the next equal result qualifies (AUTOSAR DEM: a monitor that has debounced itself)."""
    d.counter = d.failed_after if result == FAILED else -d.passed_after
    if d.timed == 1:
        d.direction = result
        d.since_ns = max(d.since_ns, t_ns)


@kernel
def hold(d: Any, t_ns: int) -> None:
    """Stop counting; the counts are kept (freeze), or given up if the fault is set to (reset)."""
    d.last = NOT_TESTED
    if d.timed == 1:
        d.counter = _at(d, t_ns)
        d.since_ns = max(d.since_ns, t_ns)
        d.direction = NOT_TESTED
        d.deadline_ns = NEVER
        _remember(d)
    if d.gated == 1 and d.resets == 1:
        d.counter = 0
        d.verdict = NOT_TESTED
        d.episode = 0
        d.triggered = 0
        d.missed = 1


@kernel
def reset(d: Any) -> None:
    """Start again: at the start of an operation cycle, and when the fault is cleared."""
    d.counter = 0
    d.last = NOT_TESTED
    d.verdict = NOT_TESTED
    d.direction = NOT_TESTED
    d.deadline_ns = NEVER
    d.episode = 0
    d.triggered = 0
    d.missed = 1
    d.value = 0.0
    d.limit = 0.0


@kernel
def reset_all(debounces: Any, faults: Any) -> None:
    """Start some of all debounces again; ``faults``: int64, their places, shape (n,)."""
    for k in range(faults.shape[0]):
        reset(debounces[faults[k]])


def fold(d: np.void) -> tuple[int, int]:
    """Return the near misses and the greatest fault detection counter since the last call."""
    peak = int(d["peak"])
    found = int(d["near"]), int(_scaled(peak, int(d["failed_after"]), int(d["passed_after"])))
    d["near"], d["peak"] = 0, 0
    return found

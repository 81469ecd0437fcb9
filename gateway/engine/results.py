"""From a test result to an event: its bucket, debounce, the event ring, and the evidence of both."""

from __future__ import annotations

from typing import Any

from gateway.engine.buckets import note
from gateway.engine.debounce import (
    fault_detection_counter,
    hold,
    is_settled,
    jump_to_end,
    report_counter_based,
    report_time_based,
)
from gateway.engine.events import RESULT_CHANGED
from gateway.engine.gate import closed
from gateway.engine.timers import arm
from gateway.monitors.contract import FAILED, NOT_TESTED, PASSED
from gateway_fdi.jit import kernel


@kernel
def is_new(d: Any) -> bool:
    """Return whether a fault is not there, and has no verdict: that its test passes is nobody's hurry."""
    return bool(d.verdict == NOT_TESTED and d.active == 0)


@kernel
def push(T: Any, t_ns: int, fault: int, kind: int, result: int, value: float, limit: float, new: bool) -> int:
    """Append an event to the ring, ``new``: of a fault as :func:`is_new`; returns its place, -1: it is full (counted).

    Of a car that starts, each test of each message passes for the first time: these are told together.
    """
    clock = T.clock[0]
    place = clock.events
    if place >= T.ring.shape[0]:
        clock.events_lost += 1
        return -1
    event = T.ring[place]
    d = T.debounces[fault]
    event.t_ns = t_ns + clock.offset_ns
    event.fault = fault
    event.kind = kind
    event.result = result
    event.fdc = fault_detection_counter(d, t_ns)
    event.bus = d.bus
    event.value = value
    event.threshold = limit
    for k in range(event.evidence.shape[0]):
        event.evidence[k] = 0.0
    clock.events = place + 1
    if not new or result != PASSED or clock.heeds == 1:
        clock.urgent = 1
        if kind != RESULT_CHANGED:
            clock.stop = 1
    return int(place)


@kernel
def announce(T: Any, t_ns: int, kind: int, index: int, bus: int, value: float, limit: float) -> None:
    """Append an event that is no test result, and leave the loop after it."""
    clock = T.clock[0]
    clock.stop = clock.urgent = 1
    if clock.events >= T.ring.shape[0]:
        clock.events_lost += 1
        return
    event = T.ring[clock.events]
    event.t_ns = t_ns + clock.offset_ns
    event.fault = index
    event.kind = kind
    event.result = NOT_TESTED
    event.fdc = 0
    event.bus = bus
    event.value = value
    event.threshold = limit
    for k in range(event.evidence.shape[0]):
        event.evidence[k] = 0.0
    clock.events += 1


@kernel
def report_result(T: Any, t_ns: int, fault: int, failed: bool, value: float, limit: float) -> int:
    """Debounce one test result; returns the place of the event it made, -1 for none."""
    d = T.debounces[fault]
    if (d.gated == 1 or T.clock[0].held == 1) and closed(T, t_ns, d):
        not_tested(T, t_ns, fault)
        return -1
    result = FAILED if failed else PASSED
    d.value, d.limit = value, limit
    note(T, t_ns, fault, failed, value, limit)
    if failed and d.is_root == 1:
        T.clock[0].gate_changes += 1
    if not failed and is_settled(d):  # as nearly every result of a healthy car
        return -1
    new = is_new(d)
    if d.timed == 1:
        before_ns = d.deadline_ns
        kind = report_time_based(d, t_ns, result)
        if d.deadline_ns < before_ns:
            arm(T, d.timer, d.deadline_ns)
    else:
        kind = report_counter_based(d, result)
    if kind == 0:
        return -1
    return push(T, t_ns, fault, kind, result, value, limit, new)


@kernel
def report_verdict(T: Any, t_ns: int, fault: int, failed: bool, value: float, limit: float) -> int:
    """Take a test result that qualifies at once; returns the place of the event it made, -1 for none."""
    d = T.debounces[fault]
    if not ((d.gated == 1 or T.clock[0].held == 1) and closed(T, t_ns, d)):
        jump_to_end(d, t_ns, FAILED if failed else PASSED)
    return int(report_result(T, t_ns, fault, failed, value, limit))


@kernel
def store_evidence(T: Any, fault: int, place: int, k: int, value: float) -> None:
    """Keep evidence value ``k`` of a result: with its event, and for one that time makes of it later."""
    if place >= 0:
        T.ring[place].evidence[k] = value
    if T.debounces[fault].timed == 1:
        T.debounces[fault].evidence[k] = value


@kernel
def not_tested(T: Any, t_ns: int, fault: int) -> None:
    """Note that a fault's test could not run, or does not count; its counter is held."""
    d = T.debounces[fault]
    changed = d.last != NOT_TESTED
    hold(d, t_ns)
    if changed:
        push(T, t_ns, fault, RESULT_CHANGED, NOT_TESTED, 0.0, 0.0, False)

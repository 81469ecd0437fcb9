"""Communication checks of messages: what a frame shows, and what its absence does."""

from __future__ import annotations

from typing import Any

from gateway.bus.conditions import RUNNING
from gateway.engine.checks.communication import (
    ACCEPT,
    COUNTER,
    CRC,
    LENGTH,
    REJECT,
    TIMEOUT,
    VALUE,
    check_crc,
    counter_step,
)
from gateway.engine.results import report_result, store_evidence
from gateway.jit import kernel
from gateway.monitors.contract import NOT_TESTED
from gateway.signals.decode import INVALID_VALUE, OK, TOO_SHORT


@kernel
def report_timeout(T: Any, due: int, c: Any) -> None:
    """Report one elapsed timeout of a message, and set its next deadline."""
    T.clock[0].timeouts += 1
    c.deadline_ns += c.timeout_ns
    c.silent_ns += c.timeout_ns
    place = report_result(T, due, c.fault[TIMEOUT], True, c.silent_ns * 1e-6, c.timeout_ns * 1e-6)
    store_evidence(T, c.fault[TIMEOUT], place, 0, c.silent_ns * 1e-6)


@kernel
def skip_settled_timeouts(T: Any, t_ns: int, c: Any) -> None:
    """Let the deadlines go by that can change nothing any more: the timeout is qualified already.

    A jump of the clock by years must not cost a step for each timeout in it.
    """
    d = T.debounces[c.fault[TIMEOUT]]
    settled = d.timed == 1 or d.counter == d.failed_after or d.last == NOT_TESTED
    if settled and c.deadline_ns <= t_ns:
        skipped = (t_ns - c.deadline_ns) // c.timeout_ns + 1
        T.clock[0].timeouts += skipped
        c.deadline_ns += skipped * c.timeout_ns
        c.silent_ns += skipped * c.timeout_ns


@kernel
def restart_supervision(T: Any, t_ns: int, bus: int, condition: int) -> None:
    """Forget what a gap in the frames of a bus would make look like a fault of the senders."""
    for k in range(T.checks.shape[0]):
        c = T.checks[k]
        if c.bus != bus:
            continue
        c.seen = 0
        if condition == RUNNING and c.timeout_ns > 0:
            c.deadline_ns = t_ns + c.timeout_ns
            c.silent_ns = 0
            T.clock[0].deadline_ns = min(T.clock[0].deadline_ns, c.deadline_ns)


@kernel
def check_message(T: Any, t_ns: int, c: Any, words: Any, length: int, status: int, bad: int) -> int:
    """Communication check of one frame: reports each test, returns ACCEPT or REJECT.

    Args:
        T: the tables.
        t_ns: the frame's time.
        c: its record of CHECK.
        words: payload, 8 little-endian uint64.
        length: payload length [byte].
        status: of the decoder.
        bad: place of a signal that carries no value, -1: none.
    """
    clock = T.clock[0]
    if c.timeout_ns > 0:
        c.deadline_ns = t_ns + c.timeout_ns
        c.silent_ns = 0
        clock.deadline_ns = min(clock.deadline_ns, c.deadline_ns)
        report_result(T, t_ns, c.fault[TIMEOUT], False, 0.0, c.timeout_ns * 1e-6)
    if c.fault[LENGTH] >= 0:
        place = report_result(T, t_ns, c.fault[LENGTH], status == TOO_SHORT, length, c.length)
        store_evidence(T, c.fault[LENGTH], place, 0, length)
    if status not in (OK, INVALID_VALUE):
        c.unread += 1
        return REJECT
    if c.fault[CRC] >= 0:
        received, computed = check_crc(c, words, length, T.crc_tables)
        place = report_result(T, t_ns, c.fault[CRC], received != computed, received, computed)
        store_evidence(T, c.fault[CRC], place, 0, received)
        store_evidence(T, c.fault[CRC], place, 1, computed)
        if received != computed:
            clock.crc_failed += 1
            c.unread += 1
            return REJECT
    if c.fault[COUNTER] >= 0:
        received = int(T.values[c.counter])
        step_by = counter_step(c, received)
        # The counters of rejected frames went by unread; those frames were not lost.
        wrong = step_by == 0 or step_by > c.max_step + c.unread
        c.unread = 0
        place = report_result(T, t_ns, c.fault[COUNTER], wrong, step_by, c.max_step)
        store_evidence(T, c.fault[COUNTER], place, 0, step_by)
        store_evidence(T, c.fault[COUNTER], place, 1, c.last_counter)
        store_evidence(T, c.fault[COUNTER], place, 2, received)
        c.last_counter = received
        c.seen = 1
        if step_by == 0:
            clock.repeated += 1
            return REJECT
    if c.fault[VALUE] >= 0:
        value = T.values[bad] if bad >= 0 else 0.0
        place = report_result(T, t_ns, c.fault[VALUE], bad >= 0, value, 0.0)
        store_evidence(T, c.fault[VALUE], place, 0, bad)
        store_evidence(T, c.fault[VALUE], place, 1, value)
    return ACCEPT if status == OK else REJECT

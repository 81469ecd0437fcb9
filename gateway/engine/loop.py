"""The jitted loop: frames and timers in, events out.

For each frame, in this order: timers that fall due up to its time stamp; look-up in the vector
table; decode; communication check; mailbox; the kernels that the message triggers, by priority.

The loop is left after any frame (and before any frame, for timers) that qualified a verdict, so that
Python finds the mailbox as it was at that very event; it is entered again at the next frame. Batch
boundaries therefore never change a result, and live equals replay. That a test passes for the first time, of a fault
that is not there, needs no mailbox: these verdicts wait for the end of the pass, unless something fails.

A message that a monitor sends is made here too, and goes to the other monitors like a frame that was
received at that moment.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from gateway.bus.conditions import LOSS
from gateway.bus.frames import ERROR, WOVEN
from gateway.engine.checks.activity import look_at_activity
from gateway.engine.checks.bus_health import (
    SILENT,
    UNKNOWN,
    WHOLE,
    await_anybody,
    heal_later,
    on_timer,
    reports_loss,
    watch_clock,
)
from gateway.engine.checks.bus_health_steps import on_sign_of_life, report_bus_results, skip_settled_windows
from gateway.engine.checks.bus_sleep import judge_silence
from gateway.engine.checks.communication import NOT_YET
from gateway.engine.checks.communication_steps import restart_supervision, skip_settled_timeouts, take_timeout
from gateway.engine.checks.sources_steps import watch_others
from gateway.engine.debounce import qualify_by_time
from gateway.engine.dispatch import dispatch, expect, join_woven
from gateway.engine.gate import closed
from gateway.engine.handlers import step
from gateway.engine.results import is_new, not_tested, push, report_result, report_verdict, store_evidence
from gateway.engine.tables import NEVER
from gateway.engine.timers import CHECK, DEBOUNCE, HANDLER, arm, next_due, put_right
from gateway.monitors.contract import FAILED, NOT_TESTED, TIMER
from gateway_fdi.jit import kernel

#: With more messages than fit the processor's nearest cache, the data of the frame ``_AHEAD`` places on are fetched.
_MANY, _AHEAD = 100, 6


@kernel
def advance_time_debounce(T: Any, due: int, fault: int) -> None:
    """Let time qualify the verdict of a fault; if its gate is closed by now, its time starts again."""
    d = T.debounces[fault]
    if (d.gated == 1 or T.clock[0].held == 1) and closed(T, due, d):
        d.since_ns = due
    new = is_new(d)
    kind = qualify_by_time(d, due)
    if kind != 0:
        place = push(T, due, fault, kind, d.last, d.value, d.limit, new)
        if place >= 0:
            for e in range(d.evidence.shape[0]):
                T.ring[place].evidence[e] = d.evidence[e]


@kernel(inlined=False)
def run_timers(T: Any, t_ns: int) -> None:
    """Run every timer due at or before ``t_ns``, in order of deadline, each at its own time."""
    while True:
        timer = next_due(T, t_ns)
        if timer < 0:
            return
        t = T.timers[timer]
        due, index = T.heap[0].noted_ns, t.index
        if t.kind == CHECK:
            if take_timeout(T, due, T.checks[index]):
                skip_settled_timeouts(T, t_ns, T.checks[index])
                if T.vectors[T.checks[index].row].others > 0:
                    watch_others(T, due, T.checks[index])
        elif t.kind == HANDLER:
            h = T.handlers[index]
            h.wake_ns = NEVER
            step(T, due, TIMER, h)
        elif t.kind == DEBOUNCE:
            advance_time_debounce(T, due, index)
        else:
            h = T.health[index]
            on_timer(h, due)
            if h.look_ns <= due:
                look_at_activity(T, due, index)
            if h.silence == WHOLE and h.until[SILENT] == NEVER and h.quiet_ns > 0:
                judge_silence(T, due, index)
            report_bus_results(T, due, h)
            skip_settled_windows(T, t_ns, h)
        put_right(T, timer)


@kernel(inlined=False)
def take_reports(T: Any) -> None:
    """Debounce the results that are none of a monitor's, at the time it is."""
    clock = T.clock[0]
    for k in range(clock.reported):
        r = T.reports[k]
        if r.result == NOT_TESTED:
            not_tested(T, clock.now_ns, r.fault)
            continue
        if r.at_once == 1:
            place = report_verdict(T, clock.now_ns, r.fault, r.result == FAILED, r.value, r.limit)
        else:
            place = report_result(T, clock.now_ns, r.fault, r.result == FAILED, r.value, r.limit)
        for e in range(r.evidence.shape[0]):
            store_evidence(T, r.fault, place, e, r.evidence[e])
    clock.reported = 0


@kernel
def advance(T: Any, t_ns: int) -> None:
    """Move the clock to ``t_ns``, running the timers on the way; starts it at the first call."""
    clock = T.clock[0]
    if clock.started == 0:
        clock.started = 1
        clock.now_ns = t_ns
        for k in range(T.health.shape[0]):
            h = T.health[k]
            h.heard_ns = t_ns
            if k < T.health.shape[0] - 1:
                await_anybody(h, t_ns)
                arm(T, h.timer, h.deadline_ns)
            if h.fault[UNKNOWN] >= 0:
                heal_later(h, UNKNOWN, t_ns)
                arm(T, h.timer, h.deadline_ns)
        for k in range(T.checks.shape[0]):
            c = T.checks[k]
            if c.timeout_ns > 0:
                c.deadline_ns = t_ns + c.wake_ns
                c.coming = NOT_YET
                arm(T, c.timer, c.deadline_ns)
        own = T.health[T.health.shape[0] - 1]
        watch_clock(own, t_ns)
        arm(T, own.timer, own.deadline_ns)
    if t_ns > clock.now_ns:
        # Most looks find that a deadline has moved on: no call is made for these, of which the tables are the cost.
        if clock.deadline_ns <= t_ns and next_due(T, t_ns) >= 0:
            run_timers(T, t_ns)
        clock.now_ns = t_ns


@kernel
def take(T: Any, frame: Any, words: Any, own: int) -> None:
    """Handle a frame at the present time; one of our own is neither evidence that the bus works, nor traffic."""
    clock = T.clock[0]
    decoded, length = clock.decoded, int(frame["length"])
    if own == 0 and frame["can_id"] & ERROR == 0:
        on_sign_of_life(T, frame["t_ns"], frame["bus"])
    elif frame["can_id"] & WOVEN == WOVEN:
        length = join_woven(T, frame["flags"], length, words)
        if length < 0:
            return
        words = T.woven[0, 2:]
    dispatch(T, frame["t_ns"], frame["bus"], frame["can_id"], length, words, own)
    if own == 1:
        clock.decoded = decoded


@kernel
def advance_to(T: Any, frame: Any, words: Any) -> None:
    """Move the clock to a frame."""
    if frame["can_id"] & WOVEN == ERROR and reports_loss(frame["can_id"], int(np.int64(words[0]))):
        # Before the deadlines in the gap: the frame that tells of a loss comes after the gap.
        restart_supervision(T, frame["t_ns"], frame["bus"], LOSS)
    advance(T, frame["t_ns"])


@kernel
def is_full(T: Any) -> bool:
    """Return whether there is little room left for events, which do not wait then, or for frames to send."""
    clock = T.clock[0]
    if clock.events >= T.ring.shape[0] // 2:
        clock.urgent = 1
        return True
    return bool(clock.sent >= T.outbox.shape[0] // 2)


@kernel
def run(T: Any, frames: Any, cells: Any, start: int, until_ns: int) -> int:
    """Walk a batch from frame ``start``; returns the first frame not handled yet.

    Args:
        T: the tables, a :class:`gateway.engine.tables.Tables`.
        frames: batch, shape (n,) of FRAME.
        cells: the same batch as uint64, shape (n, 10): two of header, eight of payload.
        start: where to begin.
        until_ns: let time pass to here after the frames; NEVER: it ends with the last frame.
    """
    clock = T.clock[0]
    clock.stop = 0
    if clock.reported > 0:
        take_reports(T)
        if clock.stop == 1:
            return start
    outbox_room = T.outbox.shape[0] // 2
    i = start
    count = int(frames.shape[0])
    expected = count - _AHEAD if T.vectors.shape[0] > _MANY else 0
    while True:
        if clock.fed < clock.sent:
            # A monitor's message reaches the other monitors before anything later does.
            k = clock.fed
            clock.fed = k + 1
            frame, words, own = T.outbox[k], T.outbox_cells[k, 2:], 1
            if frame["rank"] == 0:
                if clock.fed == clock.sent and clock.sent >= outbox_room:
                    return i
                continue
        elif i < count:
            frame, words, own = frames[i], cells[i, 2:], 0
            if i < expected:
                expect(T, frames[i + _AHEAD]["bus"], frames[i + _AHEAD]["can_id"])
            if frame["t_ns"] < clock.now_ns:
                clock.late += 1
            else:
                advance_to(T, frame, words)
                if clock.stop == 1:
                    return i
                if clock.fed < clock.sent:
                    continue
            clock.frames += 1
            i += 1
        elif until_ns != NEVER and (clock.started == 0 or clock.now_ns < until_ns):
            advance(T, until_ns)
            if clock.stop == 1:
                return count
            continue
        else:
            return count
        take(T, frame, words, own)
        if clock.stop == 1 or (clock.fed == clock.sent and is_full(T)):
            return i

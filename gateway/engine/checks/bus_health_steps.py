"""Health of the buses and of our own clock: their own reports, debounced."""

from __future__ import annotations

from typing import Any

from gateway.bus.conditions import LOSS, RUNNING, STEPPED
from gateway.bus.frames import ID_MASK
from gateway.common.times import NEVER
from gateway.engine.checks.activity import UNUSUAL, begin_waking, set_waking, waits_to_settle
from gateway.engine.checks.bus_health import (
    ASLEEP,
    SILENT,
    SPOKEN,
    WHOLE,
    await_anybody,
    note,
    note_step,
    on_frame_received,
)
from gateway.engine.checks.bus_health import CLOCK_STEPPED as STEP_FAULT
from gateway.engine.checks.bus_sleep import MOST_PARKS
from gateway.engine.checks.communication_steps import report_timeout, restart_supervision
from gateway.engine.events import CLOCK_STEPPED, NO_BUS
from gateway.engine.results import announce, report_result, store_evidence
from gateway.engine.timers import arm
from gateway.monitors.contract import NOT_TESTED
from gateway_fdi.jit import kernel


@kernel
def report_bus_results(T: Any, t_ns: int, h: Any) -> None:
    """Debounce the verdicts that the health of a bus has just come to."""
    for k in range(h.fault.shape[0]):
        fault, bit = h.fault[k], 1 << k
        if fault >= 0 and (h.failed | h.passed) & bit:
            failed = h.failed & bit != 0
            place = report_result(T, t_ns, fault, failed, h.value if failed else 0.0, h.limit)
            for e in range(h.evidence.shape[0]):
                store_evidence(T, fault, place, e, h.evidence[e] if failed else 0.0)


@kernel
def on_step(T: Any, t_ns: int, step_us: int) -> None:
    """Take a step of the wall clock: from here on what people read is stamped by the clock as it was set.

    Nothing else changes: ``t_ns`` and every timer are of the engine's own time, which had no step.
    """
    clock = T.clock[0]
    clock.offset_ns += step_us * 1000
    clock.clock_steps += 1
    announce(T, t_ns, CLOCK_STEPPED, -1, NO_BUS, step_us * 1e-6, 0.0)
    h = T.health[T.health.shape[0] - 1]
    if h.fault[STEP_FAULT] >= 0:
        note_step(h, t_ns, step_us * 1e-6, clock.clock_steps)
        report_bus_results(T, t_ns, h)
        arm(T, h.timer, h.deadline_ns)


@kernel
def skip_settled_windows(T: Any, t_ns: int, h: Any) -> None:
    """Let the windows without a step go by that can change nothing any more: the pass is qualified already."""
    fault = h.fault[STEP_FAULT]
    if fault < 0 or h.until[STEP_FAULT] > t_ns:
        return
    d = T.debounces[fault]
    if d.timed == 1 or d.counter == -d.passed_after or d.last == NOT_TESTED:
        h.until[STEP_FAULT] += ((t_ns - h.until[STEP_FAULT]) // h.window_ns + 1) * h.window_ns
        h.deadline_ns = h.until[STEP_FAULT]


@kernel(inlined=False)
def on_error_frame(T: Any, t_ns: int, bus: int, can_id: int, word: int) -> None:
    """Judge what a bus says of itself."""
    clock = T.clock[0]
    if can_id & ID_MASK == 0 and word & 0xFF == STEPPED:
        on_step(T, t_ns, word >> 8)
        return
    clock.error += 1
    if bus >= T.health.shape[0] - 1:
        return
    h = T.health[bus]
    condition = note(h, t_ns, can_id, word)
    if condition == RUNNING:
        h.heard_ns = t_ns
        await_anybody(h, t_ns)
    if condition in (LOSS, RUNNING):
        restart_supervision(T, t_ns, bus, condition)
    report_bus_results(T, t_ns, h)
    arm(T, h.timer, h.deadline_ns)


@kernel
def on_sign_of_life(T: Any, t_ns: int, bus: int) -> None:
    """Take a frame that was received: a bus that was said to be off or lost is not, and its missed time is over."""
    if bus >= T.health.shape[0] - 1:
        return
    h = T.health[bus]
    silent_ns = t_ns - h.heard_ns
    h.heard_ns = max(h.heard_ns, t_ns)  # a late frame is no news
    h.frames += 1
    if h.bad != 0:
        unheard = h.bad != 1 << SILENT
        on_frame_received(h)
        if unheard:
            restart_supervision(T, t_ns, bus, RUNNING)
        report_bus_results(T, t_ns, h)
    if h.silence != SPOKEN or (h.quiet_ns > 0 and silent_ns > h.gap_ns):
        end_silence(T, t_ns, bus, silent_ns)


@kernel(inlined=False)
def end_silence(T: Any, t_ns: int, bus: int, silent_ns: int) -> None:
    """Take the first frame after the bus was silent for longer than usual.

    After a silence of the whole bus, and one that it fell asleep before, each message has its time to wake. A shorter
    one that is longer than the shortest timeout may have been the time of a frame of any message two fifths of whose
    time is over (a cycle less its jitter, where the time is two cycles): it starts again. One that is
    shorter still is added to the time of each to which it matters. A message that misses :data:`MOST_PARKS` of them is
    not there: on a bus where little is sent, nearly all time is such a silence.

    Args:
        T: the tables.
        t_ns: now.
        bus: its index.
        silent_ns: how long the bus was silent.
    """
    h = T.health[bus]
    whole = h.silence == WHOLE or (h.activity == ASLEEP and h.fell_ns > h.joined_ns)
    long = silent_ns > UNUSUAL * h.gap_ns
    h.silence = SPOKEN
    h.asleep = 0
    h.until[SILENT] = NEVER
    if long:
        h.talks_ns = t_ns
    if whole:
        begin_waking(T, t_ns, bus)
        return
    if h.activity == ASLEEP:
        set_waking(T, t_ns, bus)
    for k in range(T.checks.shape[0]):
        c = T.checks[k]
        if c.bus != bus or c.timeout_ns <= 0:
            continue
        parked_ns, c.parked_ns = c.parked_ns, 0
        due_ns = parked_ns if parked_ns > 0 else c.deadline_ns
        missed = long and due_ns - t_ns <= c.timeout_ns * 3 // 5
        if parked_ns > 0 and c.parks >= MOST_PARKS:
            c.silent_ns += t_ns - parked_ns
            c.deadline_ns = t_ns
            if not waits_to_settle(T, t_ns, c):
                report_timeout(T, t_ns, c)
        elif parked_ns > 0 or (missed and c.parks < MOST_PARKS):
            c.parks += 1
            c.deadline_ns = t_ns + c.timeout_ns if missed else parked_ns + silent_ns - h.gap_ns
            c.silent_ns += c.deadline_ns - due_ns
        elif not long and silent_ns > c.timeout_ns // UNUSUAL and due_ns - t_ns <= c.timeout_ns:
            c.deadline_ns += silent_ns - h.gap_ns
            c.silent_ns += silent_ns - h.gap_ns
        arm(T, c.timer, c.deadline_ns)

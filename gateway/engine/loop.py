"""The jitted loop: frames and timers in, events out.

For each frame, in this order: timers that fall due up to its time stamp; look-up in the vector
table; decode; communication check; mailbox; the kernels that the message triggers, by priority.

The loop is left after any frame (and before any frame, for timers) that qualified a verdict, so that
Python finds the mailbox as it was at that very event; it is entered again at the next frame. Batch
boundaries therefore never change a result, and live equals replay.

A message that a monitor sends is made here too, and goes to the other monitors like a frame that was
received at that moment.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from gateway.bus.conditions import LOSS, RUNNING
from gateway.engine.debounce import count, fault_detection_counter, hold, mature, turn
from gateway.engine.emission import emit
from gateway.engine.events import CYCLE_BEGAN, CYCLE_ENDED, RESULT_CHANGED
from gateway.engine.gate import closed, reached
from gateway.engine.tables import NEVER, Tables, borrowed
from gateway.jit import borrow, call_entry, kernel
from gateway.monitors.bus_health import disproved, elapsed, note
from gateway.monitors.communication import (
    ACCEPT,
    COUNTER,
    CRC,
    LENGTH,
    REJECT,
    TIMEOUT,
    check_crc,
    counter_step,
)
from gateway.monitors.shape import FAILED, NOT_TESTED, PASSED, TIMER
from gateway.signals.decode import OK, TOO_SHORT, UNKNOWN_MUX, commit, decode, lookup

_ERROR, _REMOTE = 0x2000_0000, 0x4000_0000


@kernel
def push(T: Any, t_ns: int, fault: int, kind: int, result: int, value: float, limit: float) -> int:
    """Append an event to the ring; returns its place, -1 when the ring is full (counted)."""
    clock = T.clock[0]
    place = clock.events
    if place >= T.ring.shape[0]:
        clock.events_lost += 1
        return -1
    event = T.ring[place]
    d = T.debounces[fault]
    event.t_ns = t_ns
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
    if kind != RESULT_CHANGED:
        clock.stop = 1
    return int(place)


@kernel
def tested(T: Any, t_ns: int, fault: int, failed: bool, value: float, limit: float) -> int:
    """Debounce one test result; returns the place of the event it made, -1 for none."""
    d = T.debounces[fault]
    if (d.gated == 1 or T.clock[0].held == 1) and closed(T, t_ns, d):
        not_tested(T, t_ns, fault)
        return -1
    result = FAILED if failed else PASSED
    if d.timed == 1:
        d.value, d.limit = value, limit
        kind = turn(d, t_ns, result)
        clock = T.clock[0]
        clock.deadline_ns = min(clock.deadline_ns, d.deadline_ns)
    else:
        kind = count(d, result)
    if kind == 0:
        return -1
    return push(T, t_ns, fault, kind, result, value, limit)


@kernel
def witness(T: Any, fault: int, place: int, k: int, value: float) -> None:
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
        push(T, t_ns, fault, RESULT_CHANGED, NOT_TESTED, 0.0, 0.0)


@kernel
def skip(T: Any, t_ns: int, h: Any) -> None:
    """Skip a monitor whose inputs are stale or invalid: not tested, state held."""
    h.skipped += 1
    if h.tested == 1:
        h.tested = 0
        for k in range(h.faults):
            not_tested(T, t_ns, h.fault + k)


@kernel
def fresh(T: Any, t_ns: int, h: Any) -> bool:
    """Tell whether every message that feeds a monitor has arrived and is not overdue."""
    for k in range(h.first_source, h.first_source + h.sources):
        if not reached(T, t_ns, T.sources[k]):
            return False
    return True


@kernel
def step(T: Any, t_ns: int, trigger: int, h: Any) -> None:
    """Step one monitor and debounce what it reports."""
    at = h.inputs
    T.pool_ns[at] = t_ns
    T.pool_ns[at + 1] = trigger
    for k in range(h.slots):
        T.pool[at + 2 + k] = T.mailbox[T.slots[h.first_slot + k]]
    out = T.out[0]
    out.n = 0
    out.overflow = 0
    out.wake_ns = 0
    out.send = 0
    call_entry(h.entry, h.state, h.const, h.inputs_address, T.out_address[0])
    h.steps += 1
    h.tested = 1
    h.wake_ns = out.wake_ns if out.wake_ns > 0 else NEVER
    clock = T.clock[0]
    clock.deadline_ns = min(clock.deadline_ns, h.wake_ns)
    clock.results_lost += out.overflow
    if out.send == 1 and h.emit >= 0:
        emit(T, t_ns, T.emits[h.emit])
    for k in range(out.n):
        r = out.results[k]
        fault = h.fault + r.fault
        place = tested(T, t_ns, fault, r.result == FAILED, r.value, r.threshold)
        if place >= 0 or T.debounces[fault].timed == 1:
            for e in range(r.evidence.shape[0]):
                witness(T, fault, place, e, r.evidence[e])


@kernel
def time_out(T: Any, due: int, c: Any) -> None:
    """Report one elapsed timeout of a message, and set its next deadline."""
    T.clock[0].timeouts += 1
    c.deadline_ns += c.timeout_ns
    c.silent_ns += c.timeout_ns
    place = tested(T, due, c.fault[TIMEOUT], True, c.silent_ns * 1e-6, c.timeout_ns * 1e-6)
    witness(T, c.fault[TIMEOUT], place, 0, c.silent_ns * 1e-6)


@kernel
def pass_over(T: Any, t_ns: int, c: Any) -> None:
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
def ripen(T: Any, due: int, fault: int) -> None:
    """Let time qualify the verdict of a fault; if its gate is closed by now, its time starts anew."""
    d = T.debounces[fault]
    if (d.gated == 1 or T.clock[0].held == 1) and closed(T, due, d):
        d.since_ns = due
    kind = mature(d, due)
    if kind != 0:
        place = push(T, due, fault, kind, d.last, d.value, d.limit)
        if place >= 0:
            for e in range(d.evidence.shape[0]):
                T.ring[place].evidence[e] = d.evidence[e]


@kernel
def conclude(T: Any, t_ns: int, h: Any) -> None:
    """Debounce the verdicts that the health of a bus has just come to."""
    for k in range(h.fault.shape[0]):
        fault, bit = h.fault[k], 1 << k
        if fault >= 0 and (h.failed | h.passed) & bit:
            failed = h.failed & bit != 0
            place = tested(T, t_ns, fault, failed, h.value if failed else 0.0, h.limit)
            for e in range(h.evidence.shape[0]):
                witness(T, fault, place, e, h.evidence[e] if failed else 0.0)


@kernel
def start_anew(T: Any, t_ns: int, bus: int, condition: int) -> None:
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
def on_error_frame(T: Any, t_ns: int, bus: int, can_id: int, word: int) -> None:
    """Judge what a bus says of itself."""
    clock = T.clock[0]
    clock.error += 1
    if bus >= T.health.shape[0]:
        return
    h = T.health[bus]
    condition = note(h, t_ns, can_id, word)
    if condition in (LOSS, RUNNING):
        start_anew(T, t_ns, bus, condition)
    conclude(T, t_ns, h)
    clock.deadline_ns = min(clock.deadline_ns, h.deadline_ns)


@kernel
def run_timers(T: Any, t_ns: int) -> None:
    """Run every timer due at or before ``t_ns``, in order of deadline, each at its own time."""
    clock = T.clock[0]
    while clock.deadline_ns <= t_ns:
        due, check, handler, fault, bus = NEVER, -1, -1, -1, -1
        for k in range(T.checks.shape[0]):
            if T.checks[k].deadline_ns < due:
                due, check = T.checks[k].deadline_ns, k
        for k in range(T.handlers.shape[0]):
            if T.handlers[k].wake_ns < due:
                due, check, handler = T.handlers[k].wake_ns, -1, k
        if clock.timed == 1:
            for k in range(T.debounces.shape[0]):
                if T.debounces[k].deadline_ns < due:
                    due, check, handler, fault = T.debounces[k].deadline_ns, -1, -1, k
        for k in range(T.health.shape[0]):
            if T.health[k].deadline_ns < due:
                due, bus = T.health[k].deadline_ns, k
        clock.deadline_ns = due
        if due > t_ns:
            return
        if bus >= 0:
            elapsed(T.health[bus], due)
            conclude(T, due, T.health[bus])
        elif fault >= 0:
            ripen(T, due, fault)
        elif check >= 0:
            time_out(T, due, T.checks[check])
            pass_over(T, t_ns, T.checks[check])
        else:
            h = T.handlers[handler]
            h.wake_ns = NEVER
            step(T, due, TIMER, h)


@kernel
def watch(T: Any, t_ns: int, w: Any) -> None:
    """Begin or end an operation cycle by the value of a signal."""
    value = T.mailbox[w.slot]
    w.lowest = min(w.lowest, value)
    is_open = T.cycles[w.cycle]
    if is_open == w.begins or not w.low <= value <= w.high or value - w.lowest < w.rise:
        return
    T.cycles[w.cycle] = w.begins
    w.lowest = value
    clock = T.clock[0]
    clock.stop = 1
    if clock.events >= T.ring.shape[0]:
        clock.events_lost += 1
        return
    event = T.ring[clock.events]
    event.t_ns = t_ns
    event.fault = w.cycle
    event.kind = CYCLE_BEGAN if w.begins == 1 else CYCLE_ENDED
    event.result = NOT_TESTED
    event.fdc = 0
    event.bus = w.bus
    event.value = value
    event.threshold = w.low
    for k in range(event.evidence.shape[0]):
        event.evidence[k] = 0.0
    clock.events += 1


@kernel
def judge(T: Any, t_ns: int, c: Any, words: Any, length: int, status: int) -> int:
    """Communication check of one frame: reports each test, returns ACCEPT or REJECT.

    Args:
        T: the tables.
        t_ns: the frame's time.
        c: its record of CHECK.
        words: payload, 8 little-endian uint64.
        length: payload length [byte].
        status: of the decoder.
    """
    clock = T.clock[0]
    if c.timeout_ns > 0:
        c.deadline_ns = t_ns + c.timeout_ns
        c.silent_ns = 0
        clock.deadline_ns = min(clock.deadline_ns, c.deadline_ns)
        tested(T, t_ns, c.fault[TIMEOUT], False, 0.0, c.timeout_ns * 1e-6)
    if c.fault[LENGTH] >= 0:
        place = tested(T, t_ns, c.fault[LENGTH], status == TOO_SHORT, length, c.length)
        witness(T, c.fault[LENGTH], place, 0, length)
    if status != OK:
        c.unread += 1
        return REJECT
    if c.fault[CRC] >= 0:
        received, computed = check_crc(c, words, length, T.crc_tables)
        place = tested(T, t_ns, c.fault[CRC], received != computed, received, computed)
        witness(T, c.fault[CRC], place, 0, received)
        witness(T, c.fault[CRC], place, 1, computed)
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
        place = tested(T, t_ns, c.fault[COUNTER], wrong, step_by, c.max_step)
        witness(T, c.fault[COUNTER], place, 0, step_by)
        witness(T, c.fault[COUNTER], place, 1, c.last_counter)
        witness(T, c.fault[COUNTER], place, 2, received)
        c.last_counter = received
        c.seen = 1
        if step_by == 0:
            clock.repeated += 1
            return REJECT
    return ACCEPT


@kernel
def dispatch(T: Any, t_ns: int, bus: int, can_id: int, length: int, words: Any) -> None:
    """Handle one frame: vector table, decode, check, mailbox, monitors."""
    clock = T.clock[0]
    if can_id & _ERROR:
        on_error_frame(T, t_ns, bus, can_id, int(np.int64(words[0])))
        return
    if bus < T.health.shape[0] and T.health[bus].bad != 0:
        disproved(T.health[bus])
        conclude(T, t_ns, T.health[bus])
    if can_id & _REMOTE:
        clock.remote += 1
        return
    row = lookup(T.keys, T.rows, bus, can_id)
    if row < 0:
        clock.unknown += 1
        return
    v = T.vectors[row]
    status = decode(words, length, row, T.messages, T.signals, T.mux_ids, T.values, T.present)
    if status == TOO_SHORT:
        clock.too_short += 1
    elif status == UNKNOWN_MUX:
        clock.unknown_mux += 1
    verdict = ACCEPT if status == OK else REJECT
    if v.check >= 0:
        verdict = judge(T, t_ns, T.checks[v.check], words, length, status)
    if verdict == REJECT:
        for k in range(v.first, v.first + v.count):
            skip(T, t_ns, T.handlers[T.triggers[k]])
        return
    clock.decoded += 1
    commit(row, T.messages, T.signals, T.values, T.present, T.mailbox)
    v.arrived_ns = t_ns
    for k in range(v.first_watch, v.first_watch + v.watches):
        watch(T, t_ns, T.watches[k])
    for k in range(v.first, v.first + v.count):
        h = T.handlers[T.triggers[k]]
        if fresh(T, t_ns, h):
            step(T, t_ns, row, h)
        else:
            skip(T, t_ns, h)


@kernel
def advance(T: Any, t_ns: int) -> None:
    """Move the clock to ``t_ns``, running the timers on the way; starts it at the first call."""
    clock = T.clock[0]
    if clock.started == 0:
        clock.started = 1
        clock.now_ns = t_ns
        for k in range(T.checks.shape[0]):
            c = T.checks[k]
            if c.timeout_ns > 0:
                c.deadline_ns = t_ns + c.timeout_ns
                clock.deadline_ns = min(clock.deadline_ns, c.deadline_ns)
    if t_ns > clock.now_ns:
        if clock.deadline_ns <= t_ns:
            run_timers(T, t_ns)
        clock.now_ns = t_ns


@kernel
def run(tables: Tables, frames: Any, cells: Any, start: int, until_ns: int) -> int:
    """Walk a batch from frame ``start``; returns the first frame not handled yet.

    Args:
        tables: the tables.
        frames: batch, shape (n,) of FRAME.
        cells: the same batch as uint64, shape (n, 10): two of header, eight of payload.
        start: where to begin.
        until_ns: let time pass to here after the frames; NEVER: it ends with the last frame.
    """
    T = borrowed(tables)
    frames, cells = borrow(frames), borrow(cells)
    clock = T.clock[0]
    clock.stop = 0
    room = T.ring.shape[0] // 2
    outbox_room = T.outbox.shape[0] // 2
    i = start
    count = int(frames.shape[0])
    while True:
        if clock.fed < clock.sent:
            # What a monitor sends reaches the other monitors before anything later does.
            k = clock.fed
            clock.fed = k + 1
            frame, words, own = T.outbox[k], T.outbox_cells[k, 2:], 1
            if frame["rank"] == 0:
                if clock.fed == clock.sent and clock.sent >= outbox_room:
                    return i
                continue
        elif i < count:
            frame, words, own = frames[i], cells[i, 2:], 0
            if frame["t_ns"] < clock.now_ns:
                clock.late += 1
            else:
                advance(T, frame["t_ns"])
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
        decoded = clock.decoded
        dispatch(T, frame["t_ns"], frame["bus"], frame["can_id"], frame["length"], words)
        if own == 1:  # what we say ourselves is no traffic
            clock.decoded = decoded
        if clock.stop == 1:
            return i
        if clock.fed == clock.sent and (clock.events >= room or clock.sent >= outbox_room):
            return i

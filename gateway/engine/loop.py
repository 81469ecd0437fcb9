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

from math import isnan
from typing import Any

import numpy as np

from gateway.bus.conditions import LOSS
from gateway.bus.frames import ERROR, MORE, REMOTE, WOVEN
from gateway.engine.checks.activity import look_at_activity
from gateway.engine.checks.bus_health import (
    SILENT,
    UNKNOWN,
    WHOLE,
    await_anybody,
    heal_later,
    on_timer,
    tells_loss,
    watch_clock,
)
from gateway.engine.checks.bus_health_steps import (
    on_error_frame,
    on_sign_of_life,
    report_bus_results,
    skip_settled_windows,
)
from gateway.engine.checks.communication import ACCEPT, IN_PART, NOT_YET
from gateway.engine.checks.communication_steps import (
    check_message,
    restart_supervision,
    skip_settled_timeouts,
    take_timeout,
)
from gateway.engine.checks.silence import judge_silence
from gateway.engine.checks.sources_steps import is_used, watch_others
from gateway.engine.checks.strangers_steps import on_stranger
from gateway.engine.debounce import qualify_by_time
from gateway.engine.emission import emit
from gateway.engine.events import (
    CYCLE_BEGAN,
    CYCLE_ENDED,
    MISCOUNTED,
    MONITOR_OFF,
    NO_FAULT,
    NO_NUMBER,
    SHORT,
    TOO_MANY,
    TOO_SOON,
)
from gateway.engine.gate import LEFT, OPEN, closed, is_valid
from gateway.engine.results import announce, is_new, not_tested, push, report_result, report_verdict, store_evidence
from gateway.engine.samples import collect, wake_at_tick
from gateway.engine.tables import NEVER
from gateway.engine.timers import CHECK, DEBOUNCE, HANDLER, arm, next_due, put_right
from gateway.monitors.contract import FAILED, LEAST_SLEEP_NS, MAX_RESULTS, NOT_TESTED, TIMER
from gateway.signals.bits import needed_by
from gateway.signals.decode import (
    INVALID_VALUE,
    OK,
    TOO_SHORT,
    UNKNOWN_MUX,
    commit,
    decode,
    decode_whole,
    exact_key,
    find,
    invalid_value,
    lookup,
    void,
)
from gateway_fdi.jit import call_entry, kernel, read_ahead

#: With more messages than fit the processor's nearest cache, the data of the frame ``_AHEAD`` places on are fetched.
_MANY, _AHEAD = 100, 6


@kernel
def mark_not_tested(T: Any, t_ns: int, h: Any) -> None:
    """Skip a monitor whose inputs are stale or invalid: not tested, state held."""
    h.skipped += 1
    if h.tested == 1:
        h.tested = 0
        for k in range(h.faults):
            not_tested(T, t_ns, h.fault + k)


@kernel
def inputs_valid(T: Any, t_ns: int, h: Any, row: int) -> bool:
    """Return whether all that feeds a monitor has come: messages that are not overdue, pages of multiplexed ones.

    Args:
        T: the tables.
        t_ns: now.
        h: the monitor.
        row: of the message that has just come.
    """
    for k in range(h.first_source, h.first_source + h.sources):
        source = T.sources[np.uint64(k)]
        if source >= 0:
            if source != row and not is_valid(T, t_ns, source):
                return False
            if T.vectors[source].lacks == 1 and h.takes_nan == 0 and lacks_input(T, h, source):
                return False
        elif T.pages[-1 - source].came == 0:
            return False
    return True


@kernel
def turn_pages(T: Any, t_ns: int, row: int) -> None:
    """Note which multiplexed signals a frame has; after its message was away, those from before count no more."""
    page = T.vectors[row].page
    was_there = is_valid(T, t_ns, row)
    while page >= 0:
        p = T.pages[page]
        if T.present[p.place] == 1:
            p.came = 1
        elif not was_there:
            p.came = 0
        page = p.after


@kernel
def switch_off(T: Any, t_ns: int, h: Any, why: int) -> None:
    """Step a monitor no more, and tell it: its faults are not tested, all others go on.

    Args:
        T: the tables.
        t_ns: now.
        h: the monitor.
        why: not 0; result of :func:`gateway_fdi.jit.call_entry`.
    """
    h.off = why
    h.wake_ns = NEVER
    h.tested = 0
    h.skipped += 1
    for k in range(h.faults):
        not_tested(T, t_ns, h.fault + k)
    announce(T, t_ns, MONITOR_OFF, T.timers[h.timer].index, h.bus, 0.0, 0.0)


@kernel
def _enter(T: Any, t_ns: int, trigger: int, h: Any) -> bool:
    """Run a monitor's kernel on its inputs; returns whether it did as it may."""
    out = T.out[0]
    out.n = 0
    out.overflow = 0
    out.wake_ns = 0
    out.send = 0
    clock = T.clock[0]
    clock.stepping = h.timer + 1  # a watchdog sees it, should the step not return
    why = call_entry(h.entry, h.state, h.const, h.inputs_address, T.out_address[0])
    clock.stepping = 0
    if why != 0:
        switch_off(T, t_ns, h, why)
        return False
    if not 0 <= out.n <= MAX_RESULTS or out.overflow < 0:
        switch_off(T, t_ns, h, MISCOUNTED)  # neither can be by report(): the first would be read beyond its room
        return False
    h.steps += 1
    h.tested = 1
    if h.ticks == 1:
        return True
    wake_ns, before_ns = out.wake_ns if out.wake_ns > 0 else NEVER, h.wake_ns
    earliest_ns = t_ns + (LEAST_SLEEP_NS if trigger == TIMER else 1)
    if wake_ns < earliest_ns:
        wake_ns = earliest_ns
        clock.wakes_moved += 1
        h.slips |= TOO_SOON
    h.wake_ns = wake_ns
    if wake_ns < before_ns:
        arm(T, h.timer, wake_ns)
    return True


@kernel
def _take_results(T: Any, t_ns: int, h: Any) -> None:
    """Debounce what a step has reported, and send what it sends."""
    out, clock = T.out[0], T.clock[0]
    if out.overflow > 0:
        clock.results_lost += out.overflow
        h.slips |= TOO_MANY
    if out.send == 1 and h.emit >= 0:
        emit(T, t_ns, T.emits[h.emit])
    for k in range(out.n):
        r = out.results[k]
        if r.fault < 0 or r.fault >= h.faults:  # never another monitor's
            clock.results_unknown += 1
            h.slips |= NO_FAULT
            continue
        fault = h.fault + r.fault
        if isnan(r.value) or isnan(r.threshold):  # nothing was compared: it neither accuses nor heals
            clock.results_no_number += 1
            h.slips |= NO_NUMBER
            not_tested(T, t_ns, fault)
            continue
        place = report_result(T, t_ns, fault, r.result == FAILED, r.value, r.threshold)
        if place >= 0 or T.debounces[fault].timed == 1:
            for e in range(r.evidence.shape[0]):
                store_evidence(T, fault, place, e, r.evidence[e])


@kernel
def step(T: Any, t_ns: int, trigger: int, h: Any) -> None:
    """Step one monitor and debounce what it reports; one whose step failed once is not stepped again.

    One that steps once a sample is stepped if a sample is there, and as often as there are any.
    """
    if h.off != 0:
        h.skipped += 1
        return
    samples = h.sampled > 0 and (trigger != TIMER or h.ticks == 1)
    at = 0
    while True:
        if samples:
            at = collect(T, t_ns, trigger, h, at)
            if at < 0:
                break
        else:
            if h.sampled == 0:
                cell, slot = int(h.cells), int(h.first_slot)
                for k in range(h.slots):
                    T.pool[np.uint64(cell + k)] = T.mailbox[np.uint64(T.slots[np.uint64(slot + k)])]
            T.pool_ns[h.inputs] = t_ns
        T.pool_ns[h.inputs + 1] = trigger
        if _enter(T, t_ns, trigger, h):
            _take_results(T, t_ns, h)
        if not samples or h.off != 0:
            return
        if at >= h.sampled:
            break
    if h.ticks == 1 and (trigger == TIMER or h.wake_ns == NEVER):
        wake_at_tick(T, h)


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


@kernel
def watch(T: Any, t_ns: int, w: Any) -> None:
    """Begin or end an operation cycle by the value of a signal; one that was left open goes on, or is over."""
    value = T.mailbox[w.slot]
    w.lowest = min(w.lowest, value)
    state = T.cycles[w.cycle]
    if state == w.begins or not w.low <= value <= w.high:
        return
    if value - w.lowest < w.rise and state != LEFT:  # it rose before
        return
    T.cycles[w.cycle] = w.begins
    T.clock[0].gate_changes += 1
    w.lowest = value
    kind = CYCLE_BEGAN if w.begins == OPEN else CYCLE_ENDED
    announce(T, t_ns, kind, w.cycle, w.bus, value, w.low)


@kernel
def expect(T: Any, bus: int, can_id: int) -> None:
    """Have fetched what a frame that comes next will need of its message."""
    row = find(T.keys, T.rows, exact_key(bus, can_id))
    if row >= 0:
        read_ahead(T.messages[row])
        v = T.vectors[row]
        if v.check >= 0:
            read_ahead(T.checks[v.check])


@kernel
def leave_out(T: Any, t_ns: int, row: int, verdict: int) -> None:
    """Handle a frame whose data are not used, or in part: by monitors that take NaN for what has no value."""
    v = T.vectors[row]
    used = False
    for k in range(v.first, v.first + v.count):
        used = used or (verdict == IN_PART and T.handlers[T.triggers[k]].takes_nan == 1)
    if used:
        void(row, T.messages, T.signals, T.values, T.present)
        commit(row, T.messages, T.signals, T.values, T.present, T.mailbox)
    for k in range(v.first, v.first + v.count):
        h = T.handlers[T.triggers[k]]
        if used and h.takes_nan == 1:
            step(T, t_ns, row, h)
        else:
            mark_not_tested(T, t_ns, h)


@kernel
def accepted(T: Any, t_ns: int, row: int, length: int, words: Any) -> int:
    """Decode a frame and check it; returns ACCEPT, IN_PART or REJECT. A whole one is decoded if it is accepted."""
    v, m, clock = T.vectors[row], T.messages[row], T.clock[0]
    status = OK
    if m.whole == 0 or length < m.length:
        status = decode(words, length, row, T.messages, T.signals, T.mux_ids, T.values, T.present)
        if status == TOO_SHORT:
            clock.too_short += 1
        elif status == UNKNOWN_MUX:
            clock.unknown_mux += 1
    bad = -1  # place of a signal that carries no value
    if m.floats == 1:
        bad = invalid_value(row, T.messages, T.signals, T.values, T.present)
        if bad >= 0:
            clock.invalid_values += 1
            status = INVALID_VALUE
    verdict = IN_PART if status == INVALID_VALUE else ACCEPT
    if v.check >= 0:
        verdict = check_message(T, t_ns, T.checks[v.check], words, length, status, bad)
    if verdict != ACCEPT and status == INVALID_VALUE:
        v.arrived_ns = -1  # until it carries a value again, monitors that use it are not tested
    return int(verdict)


@kernel(inlined=False)
def take_short(T: Any, t_ns: int, row: int, length: int) -> None:
    """Take that a frame is shorter than its message: signals beyond its end have no value; told once.

    Args:
        T: the tables.
        t_ns: time of the frame.
        row: of the message.
        length: of the frame [byte].
    """
    v, m = T.vectors[row], T.messages[row]
    v.lacks = 0
    for j in range(m.count):
        s = T.signals[m.first + j]
        if s.slot >= 0 and needed_by(s) > length:
            T.mailbox[s.slot] = np.nan
            v.lacks = 1
    if v.told_short == 0:
        v.told_short = 1
        announce(T, t_ns, SHORT, row, m.bus, float(length), float(m.length))


@kernel(inlined=False)
def lacks_input(T: Any, h: Any, row: int) -> bool:
    """Return whether an input of a monitor is beyond the end of the last frame of a message, which was short."""
    m = T.messages[row]
    for j in range(m.count):
        slot = T.signals[m.first + j].slot
        if slot >= 0 and isnan(T.mailbox[slot]):
            for k in range(h.first_slot, h.first_slot + h.slots):
                if T.slots[k] == slot:
                    return True
    return False


@kernel
def dispatch(T: Any, t_ns: int, bus: int, can_id: int, length: int, words: Any, own: int) -> None:
    """Handle one frame, ``own``: a monitor sent it: vector table, decode, check, mailbox, monitors."""
    clock = T.clock[0]
    flags = can_id & WOVEN
    if flags == ERROR:
        on_error_frame(T, t_ns, bus, can_id, int(np.int64(words[0])))
        return
    if flags == REMOTE:
        clock.remote += 1
        return
    row = lookup(T.keys, T.rows, bus, can_id)
    if row < 0:
        clock.unknown += 1
        if own == 0:
            on_stranger(T, t_ns, bus, can_id, length, words)
        return
    if T.vectors[row].by_group == 1 and not is_used(T, t_ns, row, can_id & 0xFF):
        return
    verdict = accepted(T, t_ns, row, length, words)
    if verdict != ACCEPT:
        leave_out(T, t_ns, row, verdict)
        return
    v, m = T.vectors[row], T.messages[row]
    clock.decoded += 1
    v.lacks = 0
    if m.whole == 1 and length >= m.length:
        decode_whole(words, m, T.signals, T.mailbox)
    else:
        commit(row, T.messages, T.signals, T.values, T.present, T.mailbox)
        if length < m.length:
            take_short(T, t_ns, row, length)
    if v.page >= 0:
        turn_pages(T, t_ns, row)
    v.arrived_ns = t_ns
    for k in range(v.first_watch, v.first_watch + v.watches):
        watch(T, t_ns, T.watches[k])
    for k in range(v.first, v.first + v.count):
        h = T.handlers[T.triggers[k]]
        if inputs_valid(T, t_ns, h, row):
            step(T, t_ns, row, h)
        else:
            if h.sampled > 0 and h.off == 0:
                at = 0
                while at >= 0:
                    at = collect(T, t_ns, row, h, at)  # the first frames of the first sample
            mark_not_tested(T, t_ns, h)


@kernel(inlined=False)
def join_woven(T: Any, flags: int, length: int, words: Any) -> int:
    """Take a frame of a woven message; returns the length of the message that it ends, -1: it goes on [byte]."""
    clock, cells = T.clock[0], T.woven[0]
    parts = int(clock.parts)
    if parts == 0:
        for k in range(cells.shape[0]):
            cells[k] = 0
    first = min(2 + 8 * parts, cells.shape[0] - 8)  # a longer one is none of ours
    for k in range(8):
        cells[first + k] = words[k]
    clock.parts = parts + 1 if flags & MORE else 0
    return -1 if flags & MORE else 64 * parts + length


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
    if frame["can_id"] & WOVEN == ERROR and tells_loss(frame["can_id"], int(np.int64(words[0]))):
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

"""One frame in the loop: vector table, decode, communication check, mailbox, operation cycles, monitors."""

from __future__ import annotations

from typing import Any

import numpy as np

from gateway.bus.frames import ERROR, MORE, REMOTE, WOVEN
from gateway.engine.checks.bus_health_steps import on_error_frame
from gateway.engine.checks.communication import ACCEPT, IN_PART
from gateway.engine.checks.communication_steps import check_message
from gateway.engine.checks.sources_steps import is_used
from gateway.engine.checks.unknown_ids_steps import on_unknown_id
from gateway.engine.events import CYCLE_BEGAN, CYCLE_ENDED, SHORT
from gateway.engine.gate import LEFT, OPEN
from gateway.engine.handlers import inputs_valid, mark_not_tested, step, turn_pages
from gateway.engine.results import announce
from gateway.engine.samples import collect
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
from gateway_fdi.jit import kernel, read_ahead


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
            on_unknown_id(T, t_ns, bus, can_id, length, words)
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

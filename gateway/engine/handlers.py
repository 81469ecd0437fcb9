"""One monitor in the loop: whether its inputs are there, its step, and what it reports."""

from __future__ import annotations

from math import isnan
from typing import Any

import numpy as np

from gateway.engine.emission import emit
from gateway.engine.events import MISCOUNTED, MONITOR_OFF, NO_FAULT, NO_NUMBER, TOO_MANY, TOO_SOON
from gateway.engine.gate import is_valid
from gateway.engine.results import announce, not_tested, report_result, store_evidence
from gateway.engine.samples import collect, wake_at_tick
from gateway.engine.tables import NEVER
from gateway.engine.timers import arm
from gateway.monitors.contract import FAILED, LEAST_SLEEP_NS, MAX_RESULTS, TIMER
from gateway_fdi.jit import call_entry, kernel


@kernel
def mark_not_tested(T: Any, t_ns: int, h: Any) -> None:
    """Skip a monitor whose inputs are stale or invalid: not tested, state held."""
    h.skipped += 1
    if h.tested == 1:
        h.tested = 0
        for k in range(h.faults):
            not_tested(T, t_ns, h.fault + k)


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

"""When a sample is due, and which values it takes.

By sets: when each signal has come once more. By the clock: at each multiple of the period, of the values that there
are: **held**, the newest one of each signal, or **interpolated** between the one before the sample's time and the one
behind it, so that a sample waits until the slowest signal has come. No value may be too old, and no two between which
is interpolated too far apart; else the sample is left out, and the next one spans the gap. Behind too many that are
missing, or while the model did not hold, everything begins anew, and settles. What is no number is as good as lost.

What is interpolated is computed when a value comes, for all samples since the one before it: so it does not matter how
many frames of a fast signal come until the slowest one does.
"""

from __future__ import annotations

from math import isfinite, nan
from typing import Any

from gateway.jit import kernel
from gateway.monitors.rule.machine import run
from gateway.monitors.structural.records import KEPT, Const, State

#: What :func:`arrived` says: no sample; go on; begin anew; the very first.
NOTHING, GO, BEGIN, FIRST = range(4)


@kernel
def _draw_line(s: State, c: Const, k: int, t_ns: int, value: float) -> None:
    """Fill input k at the samples behind its last value and up to its new one, which lies at t_ns."""
    end = t_ns // c.period_ns
    first = max(s.came_ns[k] // c.period_ns + 1, s.tick_ns // c.period_ns, end - KEPT + 1)
    apart = t_ns - s.came_ns[k]
    for n in range(first, end + 1):
        at_ns = n * c.period_ns
        between = nan
        if at_ns == t_ns:
            between = value
        elif apart <= c.oldest_ns:
            between = s.last[k] + (at_ns - s.came_ns[k]) / apart * (value - s.last[k])
        s.between[k, n & (KEPT - 1)] = between


@kernel
def _take_arrivals(s: State, c: Const, u: Any) -> None:
    """Note what has come."""
    if u.trigger < 0:
        return
    for k in range(c.inputs):
        if c.message[k] == u.trigger:
            if c.interpolates == 1 and s.tick_ns > 0:
                _draw_line(s, c, k, u.t_ns, u.value[k])
            s.last[k] = u.value[k]
            s.came_ns[k] = u.t_ns
            s.fresh[k] = 3


@kernel
def _first_tick(s: State, c: Const, t_ns: int) -> bool:
    """Let the clock begin once each signal has come; tells whether it runs.

    Interpolated, the first sample lies behind what has come: before that there is no line.
    """
    if s.tick_ns == 0:
        for k in range(c.inputs):
            if c.wanted[k] == 1 and s.fresh[k] == 0:
                return False
        s.tick_ns = (t_ns + c.period_ns - 1 + c.interpolates) // c.period_ns * c.period_ns
    return True


@kernel
def _due(s: State, c: Const, t_ns: int, out: Any) -> bool:
    """Tell whether it is time for a sample of held values; by the clock it asks to be woken for the next."""
    if c.sets == 1:
        for k in range(c.inputs):
            if c.wanted[k] == 1 and s.fresh[k] & 1 == 0:
                return False
        return True
    if not _first_tick(s, c, t_ns):
        return False
    if t_ns < s.tick_ns:
        out.wake_ns = s.tick_ns
        return False
    s.tick_ns += ((t_ns - s.tick_ns) // c.period_ns + 1) * c.period_ns
    out.wake_ns = s.tick_ns
    return True


@kernel
def _held(s: State, c: Const, u: Any) -> bool:
    """Take the newest values; tells whether none is too old, and each a number."""
    for k in range(c.inputs):
        if c.wanted[k] == 1 and (u.t_ns - s.came_ns[k] > c.oldest_ns or not isfinite(u.value[k])):
            return False
        s.taken[k] = u.value[k]
    s.at_ns = u.t_ns
    return True


@kernel
def _interpolated(s: State, c: Const, t_ns: int) -> bool:
    """Take the values of the next sample for which all signals have come; tells whether there is one."""
    if not _first_tick(s, c, t_ns):
        return False
    late = (t_ns - c.oldest_ns - s.tick_ns) // c.period_ns
    if late > 0:  # a signal that is so late can no longer be interpolated
        s.missed += late
        s.tick_ns += late * c.period_ns
    while True:
        for k in range(c.inputs):
            if c.wanted[k] == 1 and s.came_ns[k] < s.tick_ns:
                return False
        s.at_ns = s.tick_ns
        place = s.tick_ns // c.period_ns & (KEPT - 1)
        s.tick_ns += c.period_ns
        whole = True
        for k in range(c.inputs):
            if c.wanted[k] == 1:
                s.taken[k] = s.between[k, place]
                whole = whole and isfinite(s.taken[k])
        if whole:
            return True
        s.missed += 1


@kernel
def arrived(s: State, c: Const, u: Any, out: Any) -> int:
    """Take a step's cause; returns what is to be done now, and leaves the time since the sample before in ``s.dt``."""
    _take_arrivals(s, c, u)
    if c.interpolates == 1:
        return again(s, c, u)
    if not _due(s, c, u.t_ns, out):
        return NOTHING
    if not _held(s, c, u):
        s.missed += 1
        return NOTHING
    for k in range(c.inputs):
        s.fresh[k] &= 2
    return _sample(s, c)


@kernel
def again(s: State, c: Const, u: Any) -> int:
    """Return what is to be done with a further sample of the same step: several are due when a slow signal comes."""
    if c.interpolates == 0:
        return NOTHING
    while _interpolated(s, c, u.t_ns):
        what = _sample(s, c)
        if what != NOTHING:
            return what
    return NOTHING


@kernel
def _sample(s: State, c: Const) -> int:
    """Return what a sample that is there is for the tests."""
    if c.active.length > 0:
        holds = run(s.active, c.active, s.at_ns, s.taken, 0.0)
        if s.active.unknown == 1 or holds == 0.0:
            s.running = 0
            return NOTHING
    apart = s.at_ns - s.last_ns
    if c.sets == 1:  # frames come a little early and late; the sender's samples do not
        whole = (2 * apart + c.period_ns) // (2 * c.period_ns)
        apart = whole * c.period_ns if whole > 0 else apart  # behind a late one, or period_ms is wrong
    what = GO if s.running == 1 and apart <= c.gap_ns else BEGIN if s.begun == 1 else FIRST
    s.dt = apart * 1e-9 if what == GO else 0.0
    if what != GO:
        s.since_ns = s.at_ns
        s.window = 0
    s.running, s.begun = 1, 1
    s.last_ns = s.at_ns
    s.samples += 1
    return what

"""Samples of several messages by the clock: at each multiple of a period, with any times of the frames.

A value is **held**: the newest one, none older than ``age_ms``, nor than some of its message's usual cycles; or it lies
**on the line** between the frame before the sample and the one after it, not more than ``age_ms`` apart, so that a
sample waits until the slowest message has come, and several follow one another then.

A sample without a message is left out as long as that message is waited for (:mod:`gateway.monitors.sampling`); then
samples go on without it, and its inputs are NaN. Where nothing comes any more the clock stops, and all starts again.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from gateway.monitors.sampling import KEPT, SAMPLE, WAITS, Const, is_awaited
from gateway_fdi.jit import kernel

#: Share of a new gap in a message's usual one; periods for which a value is held at least.
USUAL, LEAST_PERIODS = 0.05, 3


@kernel
def _runs(s: Any, c: Const, t_ns: int) -> bool:
    """Return whether the clock runs; it begins when each message has come, or is waited for no more.

    On the line the first sample lies after the frames that have come: before them there is no line.
    """
    if s.tick_ns == 0:
        have = 0
        for k in range(c.messages):
            if s.came_ns[k] > 0:
                have |= 1 << k
        if is_awaited(s, c, t_ns, have):
            return False
        s.tick_ns = (t_ns + c.period_ns - 1 + c.lines) // c.period_ns * c.period_ns
    return True


@kernel
def hear(s: Any, c: Const, t_ns: int) -> None:
    """Note that a frame came, or a tick; after a silence all starts again: each message is waited for."""
    if s.tick_ns > 0 and t_ns - s.heard_ns > c.window_ns:
        s.tick_ns = s.begun_ns = 0
        for k in range(c.messages):
            s.came_ns[k] = 0


@kernel
def _sample(s: Any, c: Const, have: int) -> int:
    """Take the sample at the tick; returns SAMPLE."""
    s.at_ns = s.tick_ns
    s.gap = 1
    if s.samples > 0 and s.at_ns - s.last_ns != c.period_ns:
        s.gap = max((s.at_ns - s.last_ns) // c.period_ns, 1)
    s.missing = c.every & ~have
    s.last_ns = s.at_ns
    s.tick_ns += c.period_ns
    s.samples += 1
    return SAMPLE


@kernel
def hold(s: Any, c: Const, message: int, t_ns: int) -> int:
    """Take a frame whose values are held; returns WAITS, or SAMPLE: the clock begins, at this very time.

    Args:
        s: record of State.
        c: record of Const.
        message: index of the frame's message, from 0.
        t_ns: when it came.
    """
    s.begun_ns = s.begun_ns if s.begun_ns > 0 else max(t_ns, 1)
    if c.cycles > 0.0 and s.came_ns[message] > 0:
        gap = min(t_ns - s.came_ns[message], c.age_ns)
        s.usual_ns[message] += (gap - s.usual_ns[message]) * (USUAL if s.usual_ns[message] > 0.0 else 1.0)
    s.came_ns[message] = s.heard_ns = max(t_ns, 1)
    begins = s.tick_ns == 0
    if _runs(s, c, t_ns) and begins and s.tick_ns == t_ns:
        return int(tick(s, c, t_ns))
    return WAITS


@kernel
def _oldest(s: Any, c: Const, message: int) -> int:
    """Return the age that a value of a message may have [ns]."""
    if c.cycles > 0.0 and s.usual_ns[message] > 0.0:
        return min(c.age_ns, max(int(c.cycles * s.usual_ns[message]), LEAST_PERIODS * c.period_ns))
    return int(c.age_ns)


@kernel
def tick(s: Any, c: Const, t_ns: int) -> int:
    """Take the held values at a tick of the clock, ``s.tick_ns``; returns SAMPLE, or WAITS: none is due."""
    hear(s, c, t_ns)
    if s.tick_ns == 0 or s.tick_ns != t_ns:
        return WAITS
    have = 0
    for k in range(c.messages):
        if s.came_ns[k] > 0 and t_ns - s.came_ns[k] <= _oldest(s, c, k):
            have |= 1 << k
    if is_awaited(s, c, t_ns, have):
        s.tick_ns += c.period_ns
        return WAITS
    return int(_sample(s, c, have))


@kernel
def draw(s: Any, c: Const, message: int, t_ns: int, cells: Any, at: int, value: float) -> None:
    """Put a value of a frame onto the line of its input; its message is noted after it (:func:`drawn`).

    Args:
        s: record of State.
        c: record of Const.
        message: index of the frame's message.
        t_ns: when it came.
        cells: of lines, float64.
        at: first of the input's KEPT + 1 cells: its values at the last samples, and the newest one of all.
        value: that has come.
    """
    came_ns = s.came_ns[message]
    apart = t_ns - came_ns
    if s.tick_ns > 0 and apart <= c.age_ns:
        end = t_ns // c.period_ns
        for n in range(max(came_ns // c.period_ns + 1, s.tick_ns // c.period_ns, end - KEPT + 1), end + 1):
            share = (n * c.period_ns - came_ns) / apart
            cells[at + (n & (KEPT - 1))] = cells[at + KEPT] + share * (value - cells[at + KEPT])
    elif s.tick_ns > 0 and t_ns % c.period_ns == 0:
        cells[at + (t_ns // c.period_ns & (KEPT - 1))] = value
    cells[at + KEPT] = value


@kernel
def drawn(s: Any, c: Const, message: int, t_ns: int) -> None:
    """Note a frame, and at which samples its values are known."""
    s.begun_ns = s.begun_ns if s.begun_ns > 0 else max(t_ns, 1)
    s.heard_ns, came_ns = t_ns, s.came_ns[message]
    if s.tick_ns > 0:
        end = t_ns // c.period_ns
        near = t_ns - came_ns <= c.age_ns
        for n in range(max(came_ns // c.period_ns + 1, s.tick_ns // c.period_ns, end - KEPT + 1), end + 1):
            bit = np.int64(1) << (n & (KEPT - 1))
            if near or n * c.period_ns == t_ns:
                s.known[message] |= bit
            else:
                s.known[message] &= ~bit
    s.came_ns[message] = max(t_ns, 1)


@kernel
def between(s: Any, c: Const, t_ns: int) -> int:
    """Take the next sample for which all messages have come; returns SAMPLE, or WAITS: there is none yet."""
    if not _runs(s, c, t_ns):
        return WAITS
    while True:
        have, lost = 0, False
        bit = np.int64(1) << (s.tick_ns // c.period_ns & (KEPT - 1))
        for k in range(c.messages):
            if s.came_ns[k] >= s.tick_ns:
                have |= 1 << k
                lost = lost or s.known[k] & bit == 0
        late = (t_ns - c.age_ns - s.tick_ns) // c.period_ns  # a value this late can no longer be on a line
        if have == 0 or (late <= 0 and is_awaited(s, c, t_ns, have)):
            return WAITS
        if not lost and not is_awaited(s, c, t_ns, have):
            return int(_sample(s, c, have))
        s.tick_ns += max(late, 1) * c.period_ns

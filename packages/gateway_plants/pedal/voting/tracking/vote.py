"""The decision of the tracking voter, sample by sample.

In order: readings that agree with each other are believed together, as the quantity's own course or, where the
track does not expect them but a foot can move so fast, as a change of its mind. Where readings disagree, the one
that the track expects is believed; where the track expects none, it coasts, and a channel that goes a smooth way
for three samples is followed. A channel that is rejected again and again, or frozen, is isolated; it is taken back
when it has followed the track for long.
"""

from __future__ import annotations

import numpy as np

from gateway_fdi.jit import f8s, kernel
from gateway_plants.pedal.voting.tracking import channel_activity, fusion, isolation, mismatch, motion, scale, track
from gateway_plants.pedal.voting.tracking.scale import GATE
from gateway_plants.pedal.voting.tracking.shape import (
    AGREED,
    LOST,
    NONE,
    REMEMBER,
    SINGLE,
    Const,
    State,
)


@kernel
def _start(s: State, c: Const, y: f8s) -> None:
    """Begin with the mean of the readings that are trusted; without any, wait.

    What they differ by within the tolerance is a mismatch that was there before.
    """
    n = c.channels
    track.expect(s, c, y)
    total, count, bits, low, high = 0.0, 0, 0, np.inf, -np.inf
    for i in range(n):
        if y[i] == y[i] and s.isolated & (1 << i) == 0:  # not NaN
            total += s.z[i]
            count += 1
            bits |= 1 << i
            low, high = min(low, s.z[i]), max(high, s.z[i])
    s.source = NONE
    s.used = 0
    if count == 0:
        for i in range(n):
            isolation.restore(s, i)  # rather all of them again than none for good
        return
    spread, mean = high - low, total / count
    agreed = spread <= c.tolerance
    if agreed and spread > s.scale.agree:
        for i in range(n):
            if bits & (1 << i):
                s.mismatch.level[i] += s.z[i] - mean
    motion.restart(
        s.motion,
        mean,
        0.0,
        s.scale.variance + (0.0 if agreed else spread * spread / 4.0),
        c.slew * c.slew / 9.0,
    )
    channel_activity.start(s.habits, n, y, s.raw)
    s.started = 1
    s.source = AGREED if agreed else SINGLE
    s.sure = 1 if agreed else 0
    s.used = bits
    s.anchor = s.motion.x
    s.value = min(max(s.motion.x, c.low), c.high)


@kernel
def _take(s: State, c: Const, y: f8s, dt: float) -> None:
    """Predict, judge, decide; a reading that there is not is NaN."""
    if s.started == 0 or dt >= LOST:
        s.started = 0
        _start(s, c, y)
        return
    n, m = c.channels, s.motion
    motion.predict(m, dt, c.bend, c.widest)
    mismatch.predict(s.mismatch, n, dt)
    if s.old_age > 0:
        motion.predict(s.old, dt, c.bend, c.widest)
        s.old_age = s.old_age + 1 if s.old_age < REMEMBER else 0
    s.gate = GATE * np.sqrt(m.p00 + s.scale.variance)
    track.expect(s, c, y)
    trusted = 0
    for i in range(n):
        if y[i] == y[i] and s.isolated & (1 << i) == 0:
            trusted |= 1 << i
    channel_activity.watch(s.habits, n, y, s.raw, trusted, s.absent, s.scale.straight, c.bend, c.slew, m.v, dt)
    for i in range(n):
        if s.habits.same[i] == 0:
            mismatch.mark(s.mismatch, n, i)
    s.used = 0
    trusted = isolation.freeze(s, c, y, trusted)
    if s.used == 0:
        fusion.decide(s, c, y, trusted, dt)
    if s.used:
        s.anchor = m.x
    elif s.isolated:
        isolation.reconcile(s, c)
    isolation.judge(s, c, trusted)
    isolation.drifting(s, c)
    if m.coasted >= LOST:
        s.source = NONE
    s.value = min(max(m.x, c.low), c.high)


@kernel
def vote_filtered(s: State, c: Const, y: f8s, raw: f8s, dt: float) -> None:
    """Take the readings of one sample that something has filtered: whether one repeats itself is told by the raw ones.

    Args:
        y: readings; what is not finite is none.
        raw: as they were read.
        dt: time since the last sample, in sample periods.
    """
    if s.scale.variance == 0.0:
        scale.measure(s.scale, c.noise, c.step, c.high - c.low, c.bend)
    for i in range(c.channels):
        s.y[i] = y[i] if -np.inf < y[i] < np.inf else np.nan
        s.raw[i] = raw[i]
    _take(s, c, s.y, dt)


@kernel
def vote(s: State, c: Const, y: f8s, dt: float) -> None:
    """Take the readings of one sample.

    Args:
        y: readings; what is not finite is none.
        dt: time since the last sample, in sample periods.
    """
    vote_filtered(s, c, y, y, dt)

"""The track: what is expected, what moves it, how it is given up and taken back."""

from __future__ import annotations

import numpy as np

from gateway_fdi.jit import f8s, kernel
from gateway_plants.pedal.voting.tracking import channel_activity, mismatch, motion
from gateway_plants.pedal.voting.tracking.scale import GATE
from gateway_plants.pedal.voting.tracking.shape import FOLLOWED, ISOLATE, REGRET, Const, State


@kernel
def expect(s: State, c: Const, y: f8s) -> None:
    """Take the mismatch off the readings, and compare them with the track."""
    centre = mismatch.centre(s.mismatch, c.channels)
    for i in range(c.channels):
        s.z[i] = y[i] - (s.mismatch.level[i] - centre)
        s.innovation[i] = s.z[i] - s.motion.x


@kernel
def accept(s: State, c: Const, bits: int, source: int) -> None:
    """Book the channels that were believed and those that were not."""
    s.used = bits
    s.source = source
    s.common = 0
    for i in range(c.channels):
        if bits & (1 << i):
            s.rejected[i] = max(s.rejected[i] - 1, 0)
        elif abs(s.innovation[i]) > s.gate + s.slack:
            s.rejected[i] = min(s.rejected[i] + 1, 2 * ISOLATE)


@kernel
def coast(s: State, dt: float, source: int) -> None:
    """Believe none."""
    s.used = 0
    s.source = source
    s.motion.coasted += dt


@kernel
def remember(s: State) -> None:
    """Keep the track that is given up."""
    motion.copy(s.old, s.motion)
    s.old_age = 1
    s.old_hits = 0


@kernel
def regret(s: State, c: Const, trusted: int) -> int:
    """Return the channel that has gone back to the track that was given up, for the second time; -1: none.

    Readings that agree by chance, an impulse of one channel and the offset of another, look like a change of
    slope; but then the first channel returns.
    """
    if s.old_age == 0:
        return -1
    gate = GATE * np.sqrt(s.old.p00 + s.scale.variance)
    for i in range(c.channels):
        back = abs(s.z[i] - s.old.x) <= gate < abs(s.z[i] - s.motion.x)
        if trusted & (1 << i) and back:
            s.old_hits += 1
            return i if s.old_hits >= REGRET else -1
    return -1


@kernel
def turn(s: State, c: Const, x: float, count: int, dt: float) -> None:
    """The quantity changed its slope: go on from the last level that was sure."""
    m = s.motion
    elapsed = m.coasted + dt
    v = (x - s.anchor) / elapsed
    sigma = 0.5 * abs(v) + 2.0 * np.sqrt(s.scale.variance)
    motion.restart(m, x, v, s.scale.variance / count, sigma * sigma)


@kernel
def follow(s: State, c: Const, i: int) -> None:
    """Begin a new track on the line that channel ``i`` goes."""
    v = channel_activity.slope(s.habits, i)
    motion.restart(s.motion, s.z[i], v, s.scale.variance, s.scale.variance / 2.0 + c.bend * c.bend + v * v / 16.0)
    accept(s, c, 1 << i, FOLLOWED)
    s.sure = 0

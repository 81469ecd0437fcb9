"""By how much a filter delays one channel behind another, and what they may differ by until that is known.

Each channel behind a filter of first order is compared with the others as they are, for several time constants; what
offset and gain make of a movement is taken out by regression. When the pedal has moved up and down enough, the constant
with the least error decides, between two of them a parabola. From then on the quicker channel is filtered as the
slower one is, and they are compared at one time.

What the alignment leaves is allowed for, in proportion to what it moves: a delay or a mean is no filter of first order.
Until the lag is known all that a lag of the largest size would make is allowed for. What is more than the largest lag
is not learned: it is a fault.
"""

from __future__ import annotations

import math
from typing import Annotated

from gateway.fdi.voting.simple import MOST_CHANNELS
from gateway.jit import Record, f8, f8s, i8, i8s, kernel

#: Time constants that are tried [ms], and so many with either sign and none.
TRIED_MS = (1.0, 2.0, 3.5, 5.5, 8.0, 11.5, 16.0)
BANK = len(TRIED_MS)
PLACES = 2 * BANK + 1
#: From this period of the samples on no lag is looked for [ms].
COARSE_MS = 5.0
#: What is slower is offset and mismatch, no lag [ms].
SLOW_MS = 60.0
#: Movement that tells lags apart: sum of squares of what a lag of this makes, over those of noise, either way.
TELLING_MS, TELLING = 0.5, 40.0
#: A lag must explain this share of what the channels differ by; less than this it is none [ms].
EXPLAINS, LEAST_MS = 0.5, 1.0
#: What is allowed for fades by this power of the filter's own: turns of the pedal go through no movement.
FADES = 0.33
#: A delay, or a mean, is most like a filter of first order with a time constant up to so many times as long.
LIKE = 1.6
#: What is allowed for until the lag is known, in units of what the largest makes; then, at least, at most, and in
#: units of the error that was left.
UNKNOWN, LEFT_LEAST, LEFT_MOST, LEFT = 1.5, 0.15, 2.0, 5.0


class Const(Record):
    """Constants.

    ``pole``: of the filters tried; ``tau``: their time constants, in periods, negative for those of the first channel
    of a pair; ``slow``: of offset and mismatch; ``most``: largest lag that is none, in periods; ``widest``: filter
    whose movement is allowed for until the lag is known; ``fade``: of what is allowed for,
    ``none``: so little of it is nothing.
    """

    pole: Annotated[f8s, BANK]
    tau: Annotated[f8s, PLACES]
    slow: f8
    most: f8
    widest: i8
    fade: f8
    none: f8
    least: f8
    telling: f8


class State(Record):
    """State.

    ``bank``: each channel behind each filter. Of each pair of the first channel with another, by place of the
    time constant: sums over time of the squares of their difference ``rr``, of the movement ``xx``, of both ``rx``,
    the slow parts taken off: ``slow_r``, ``slow_x``. ``up``, ``down``: movement so far. ``known``: 1: lags are known.
    ``tau``: lag of each channel behind the quickest [periods]. ``pole``, ``aligned``: filter that brings a channel to
    the slowest. ``left``: share of the movement that the alignment leaves; ``slack``: what is allowed for at present;
    ``swing``: what one channel may still move when another stands.
    ``before``, ``last``, ``older``: the readings before.
    """

    started: i8
    bank: Annotated[f8s, MOST_CHANNELS, BANK]
    rr: Annotated[f8s, MOST_CHANNELS, PLACES]
    rx: Annotated[f8s, MOST_CHANNELS, PLACES]
    xx: Annotated[f8s, MOST_CHANNELS, PLACES]
    slow_r: Annotated[f8s, MOST_CHANNELS, PLACES]
    slow_x: Annotated[f8s, MOST_CHANNELS, PLACES]
    taken: i8
    up: f8
    down: f8
    known: i8
    tau: Annotated[f8s, MOST_CHANNELS]
    pole: Annotated[f8s, MOST_CHANNELS]
    aligned: Annotated[f8s, MOST_CHANNELS]
    begun: Annotated[i8s, MOST_CHANNELS]
    before: Annotated[f8s, MOST_CHANNELS]
    last: Annotated[f8s, MOST_CHANNELS]
    older: Annotated[f8s, MOST_CHANNELS]
    left: f8
    slack: f8
    swing: f8


def prepare(c: Const, *, period_ms: float, most_ms: float) -> None:
    """Fill the constants.

    Args:
        c: record of Const.
        period_ms: of the samples [ms].
        most_ms: largest lag between channels that is no fault [ms]; 0: there is none.
    """
    for k, tau in enumerate(TRIED_MS):
        c.pole[k] = math.exp(-period_ms / tau)
        c.tau[BANK + 1 + k], c.tau[BANK - 1 - k] = tau / period_ms, -tau / period_ms
    c.slow = 1.0 - math.exp(-period_ms / SLOW_MS)
    # Between samples that are far from each other nobody sees a lag.
    c.most, c.least = most_ms / period_ms if period_ms <= COARSE_MS else 0.0, LEAST_MS / period_ms
    c.widest = min((k for k, tau in enumerate(TRIED_MS) if tau >= 1.2 * most_ms), default=BANK - 1)
    c.none = 1e-3
    c.fade = c.pole[c.widest] ** FADES
    c.telling = TELLING_MS / period_ms


@kernel
def _begin(s: State, n: int, y: f8s) -> None:
    """Begin, or go on behind a gap: filters start where the readings are."""
    s.started = 1
    for i in range(n):
        for k in range(BANK):
            s.bank[i, k] = y[i]
        for k in range(PLACES):
            s.slow_r[i, k] = y[0] - y[i]
            s.slow_x[i, k] = y[i]
        s.before[i] = y[i]


@kernel
def _compare(s: State, c: Const, n: int, y: f8s, moving: bool) -> None:
    """Follow what is slow; add a sample in which the pedal moves to the sums."""
    for i in range(1, n):
        for k in range(PLACES):
            first, other = y[0], y[i]
            if k > BANK:
                first = s.bank[0, k - BANK - 1]  # the other one lags: filter the first
            elif k < BANK:
                other = s.bank[i, BANK - 1 - k]
            s.slow_r[i, k] += c.slow * (first - other - s.slow_r[i, k])
            s.slow_x[i, k] += c.slow * (other - s.slow_x[i, k])
            if not moving:
                continue
            r, x = first - other - s.slow_r[i, k], other - s.slow_x[i, k]
            s.rr[i, k] += r * r
            s.rx[i, k] += r * x
            s.xx[i, k] += x * x


@kernel
def _error(s: State, i: int, k: int) -> float:
    """Return the sum of squares that neither gain nor the lag at place ``k`` explains."""
    if s.xx[i, k] <= 0.0:
        return float(s.rr[i, k])
    return float(s.rr[i, k] - s.rx[i, k] * s.rx[i, k] / s.xx[i, k])


@kernel
def _place(s: State, c: Const, i: int, variance: float) -> tuple[float, float]:
    """Return the lag of channel ``i`` behind the first [periods], and the share that it leaves unexplained."""
    best, least = BANK, _error(s, i, BANK)
    for k in range(PLACES):
        error = _error(s, i, k)
        if error < least:
            best, least = k, error
    noise = 2.0 * variance * s.taken
    without = max(_error(s, i, BANK) - noise, 0.0)
    left = max(least - noise, 0.0)
    if best == BANK or left > EXPLAINS * without:
        return 0.0, 0.0
    tau = c.tau[best]
    if 0 < best < PLACES - 1:
        # Squares of errors lie on a parabola over the lag.
        a, b = c.tau[best - 1] - tau, c.tau[best + 1] - tau
        before, behind = _error(s, i, best - 1) - least, _error(s, i, best + 1) - least
        bend = (before / a - behind / b) / (a - b)
        if bend > 0.0:
            slope = before / a - bend * a
            tau += min(max(-0.5 * slope / bend, 0.5 * a), 0.5 * b)
    return float(tau), float(math.sqrt(left / without))


@kernel
def _decide(s: State, c: Const, n: int, variance: float) -> None:
    """Find the lags, when the pedal has moved enough."""
    slowest, quickest, worst, most = 0.0, 0.0, 0.0, 0.0
    s.tau[0] = 0.0
    for i in range(1, n):
        tau, left = _place(s, c, i, variance)
        s.tau[i] = tau
        slowest, quickest, worst = max(slowest, tau), min(quickest, tau), max(worst, left)
    s.known = 1
    most = slowest - quickest
    if most < c.least or most > LIKE * c.most:
        for i in range(n):
            s.tau[i] = 0.0
        s.left = 0.0
        return
    s.left = min(max(LEFT * worst, LEFT_LEAST), LEFT_MOST)
    for i in range(n):
        ahead = slowest - s.tau[i]
        s.tau[i] -= quickest
        s.pole[i] = math.exp(-1.0 / ahead) if ahead > 0.3 * c.least else 0.0
        s.aligned[i] = s.bank[i, 0]
        for k in range(BANK):
            if c.tau[BANK + 1 + k] <= ahead:
                s.aligned[i] = s.bank[i, k]  # nearly so, and what was allowed for is still there
        s.begun[i] = 1


@kernel
def _move(s: State, c: Const, n: int, y: f8s, smooth: int, variance: float) -> None:
    """Look at the movement until the lag is known: how much it tells, and what is to be allowed for meanwhile."""
    quick = (s.bank[0, 0] - s.bank[0, 3]) / (c.tau[BANK + 4] - c.tau[BANK + 1])
    told = quick * c.telling
    moving = told * told > 0.25 * variance
    if moving:
        if quick > 0.0:
            s.up += told * told
        else:
            s.down += told * told
        s.taken += 1
    _compare(s, c, n, y, moving)
    s.slack *= c.fade
    for i in range(n):
        if smooth & (1 << i):
            moving = abs(s.bank[i, 0] - s.bank[i, c.widest])
            s.slack = max(s.slack, UNKNOWN * moving)


@kernel
def smooth(s: State, n: int, y: f8s, straight: float) -> int:
    """Return the bits of the channels that go on along a line, second differences up to ``straight``."""
    bits = 0
    for i in range(n):
        if abs(y[i] - 2.0 * s.last[i] + s.older[i]) <= straight:
            bits |= 1 << i
        s.older[i], s.last[i] = s.last[i], y[i]
    return bits


@kernel
def learn(s: State, c: Const, n: int, y: f8s, fine: int, smooth: int, dt: float, variance: float) -> None:
    """Take the readings of one sample; sets ``s.slack``, and ``s.known`` when it is.

    Args:
        s: record of State.
        c: record of Const.
        n: channels.
        y: readings.
        fine: bits of the channels whose reading is one.
        smooth: bits of the channels that do not jump.
        dt: time since the last sample, in periods.
        variance: of a reading.
    """
    if c.most == 0.0 or s.known == 1:
        return
    if fine != (1 << n) - 1 or dt > 1.0 or s.started == 0:
        s.started = 0
        s.slack = 0.0
        if fine == (1 << n) - 1:
            _begin(s, n, y)
        return
    for i in range(n):
        # What a channel jumps by is no movement.
        jump = 0.0 if smooth & (1 << i) else y[i] - s.before[i]
        for k in range(BANK):
            s.bank[i, k] = y[i] + c.pole[k] * (s.bank[i, k] + jump - y[i])
        s.before[i] = y[i]
    _move(s, c, n, y, smooth, variance)
    enough = TELLING * 2.0 * variance
    if min(s.up, s.down) > enough:
        _decide(s, c, n, variance)


@kernel
def align(s: State, c: Const, n: int, y: f8s, smooth: int, out: f8s) -> None:
    """Bring all channels to the time of the slowest.

    Args:
        s: record of State.
        c: record of Const.
        n: channels.
        y: readings, NaN: none.
        smooth: bits of the channels that do not jump.
        out: receives them, aligned.
    """
    if s.known == 0 or s.left == 0.0:
        if s.known == 1:
            s.slack = s.slack * c.fade if s.slack > c.none else 0.0
        s.swing = s.slack
        for i in range(n):
            out[i] = y[i]
        return
    moving = 0.0
    s.slack *= c.fade
    s.swing *= c.fade
    for i in range(n):
        if s.pole[i] == 0.0 or y[i] != y[i]:  # NaN
            out[i] = y[i]
            s.begun[i] = 0
            continue
        if s.begun[i] == 0:
            s.aligned[i] = y[i]
            s.begun[i] = 1
        if smooth & (1 << i) == 0:
            s.aligned[i] += y[i] - s.older[i]  # a jump is no movement: it shows as it is
        s.aligned[i] = y[i] + s.pole[i] * (s.aligned[i] - y[i])
        out[i] = s.aligned[i]
        if smooth & (1 << i):
            moving = max(moving, abs(y[i] - s.aligned[i]))
    s.slack = max(s.slack, s.left * moving)
    s.swing = max(s.swing, UNKNOWN * moving)

"""The clock of a sender, from the times at which its periodic message comes: phase, skew, a change of the skew.

After Cho and Shin, "Fingerprinting Electronic Control Units for Vehicle Intrusion Detection" (USENIX Security 2016):
recursive least squares give the skew, a CUSUM tells that it has changed. Four things are other than there, because
frames that queue and stamps of a host would accuse healthy senders:

- The offset is no mean over frames but a low quantile of them: a frame can only be late. Frame i of period T comes at

      a_i = t0 + n_i T + x(t) + w_i,   w_i >= 0 (queue, host),   n_i = round((a_i - t0 - x) / T)

  A window of W frames gives one y, the lower quartile of a_i - t0 - n_i T. Lost frames raise n by more than one, and
  shift nothing.
- The regression is y = x + v with x' = S, the skew S constant but for what is forgotten with the time constant tau. It
  is written with the origin at the latest window, h = (1, 0), dt since the one before, so that nothing grows:

      x <- x + S dt                P <- F P F' exp(dt / tau),  F = (1 dt; 0 1)
      e = y - x                    K = P h / (h P h + 1)
      (x, S) <- (x, S) + K e       P <- P - K h' P

  which is recursive least squares with the weights exp(-age / tau), P in units of the noise's variance.
- What moves all messages is the receiver's clock: m, the median of what each has walked, sum(e - r_before) with the
  residual r = e (1 - h K), less what is its own of it, which follows slowly. A window is of a_i - m; the regression
  gets m back.
- The CUSUM is not of innovations but of how far the phase has walked beyond its skew since the window before,

      d = y - m - x - (r - m at the window before)

  because two senders of nearly one period meet for minutes: a frame is late by the burst that it waits for at once, and
  comes back slowly, with the clock of that burst. Such a walk is as long as a burst at most; that of another clock has
  no end. To either side, with :func:`gateway_fdi.cusum.grown`:

      up <- max(0, up + d - kappa dt),  down <- max(0, down - d - kappa dt)      [s]

A jump, |d| beyond the fastest walk that is looked for and beyond STEP, is no sign of another sender: ECUs reset,
frames queue, and messages that are sent on change begin their period again. It only takes back what was walked the
other way, as the waits for bursts do again and again. The phase is found again, the skew is kept, and the test goes
on.
"""

from __future__ import annotations

from math import exp
from typing import Annotated, Any

import numpy as np

from gateway_fdi.cusum import grown
from gateway_fdi.jit import Record, f8, f8s, i8, kernel, means

#: Frames of a window, and the place of its lower quartile.
WINDOW, QUARTILE = 16, 3
#: Gaps that the period is learned of.
FIRST = 64
#: Fastest walk that is looked for, and least jump that counts as one, in units of the noise.
FASTEST, STEP = 1e-3, 5.0
#: Part of a period that a window may scatter over.
STEADY = 0.2
#: Standard deviation of a skew that is not known yet.
UNKNOWN_SKEW = 2e-3
#: A gap that is longer than this, and than this many periods, leaves the frames uncounted.
GAP_S, GAP_PERIODS = 2.0, 20.0
#: Time constant with which what a message has walked alone is taken to be its own.
BASE_S = 60.0
#: Windows before an innovation says anything.
SETTLED = 8


class Const(Record):
    """Limits of the clocks."""

    memory_s: f8 = means("time constant with which the past is forgotten", "s")
    learn_s: f8 = means("time that a message is only listened to", "s")
    noise_s: f8 = means("standard deviation of a window's offset", "s")
    kappa: f8 = means("drift of the CUSUM: a change of the skew that is borne for ever")
    limit_s: f8 = means("of the CUSUM: how far the phase may walk", "s")


class Clock(Record):
    """One message."""

    seen: i8 = means("frames that the period was learned of; more than FIRST: it is known")
    first_ns: i8 = means("time that its offsets are counted from", "ns")
    last_ns: i8 = means("its last frame", "ns")
    period: f8 = means(unit="s")
    offset: f8 = means("x, at the end of its last window", "s")
    skew: f8 = means("S, against the period that was learned")
    at_s: f8 = means("end of its last window", "s")
    p00: f8 = means("variance of the offset, in units of the noise")
    p01: f8 = means("covariance of both", "1/s")
    p11: f8 = means("variance of the skew", "1/s^2")
    filled: i8 = means("frames of this window")
    window: Annotated[f8s, WINDOW] = means("their offsets from the expected one", "s")
    windows: i8 = means("windows that were followed")
    jumps: i8 = means("windows that were not: the phase jumped, or they scatter")
    walked: f8 = means("d: from the window before to the last one, beyond its skew", "s")
    residual: f8 = means("r: what the regression left of the last window", "s")
    before: f8 = means("the same, less the receiver's clock then", "s")
    walk: f8 = means("sum of what it has walked, with the receiver's clock", "s")
    own: f8 = means("what of it is its own", "s")
    known_s: f8 = means("time that it has been followed for", "s")
    up: f8 = means("CUSUM of a clock that is slower", "s")
    down: f8 = means("CUSUM of a clock that is faster", "s")


@kernel
def learn_period(c: Clock, t_ns: int) -> None:
    """Take one of the first frames: the period is the mean of gaps without a hole."""
    if c.seen > 8:
        mean = (c.last_ns - c.first_ns) / (c.seen - 1)
        if t_ns - c.last_ns > 1.7 * mean or t_ns < c.last_ns:
            c.seen = 0
    if c.seen == 0:
        c.first_ns = t_ns
    c.last_ns = t_ns
    c.seen += 1
    if c.seen > FIRST:
        c.period = (t_ns - c.first_ns) * 1e-9 / FIRST
        c.first_ns = t_ns
        if c.period <= 0.0:
            c.seen = 0


@kernel
def begin(c: Clock, noise: float) -> None:
    """Begin to follow a message whose period is known."""
    c.offset = c.skew = c.at_s = c.p01 = 0.0
    c.p00 = unknown_phase(c, noise)
    c.p11 = (UNKNOWN_SKEW / noise) ** 2
    c.filled = 0


@kernel
def unknown_phase(c: Clock, noise: float) -> float:
    """Return the variance of a phase that is not known, in units of the noise."""
    return float((c.period / (8.0 * noise)) ** 2)


@kernel
def take(c: Clock, t_ns: int, noise: float, common: float) -> bool:
    """Take a frame's time; returns whether it ends a window.

    Args:
        c: the message.
        t_ns: when it came.
        noise: of a window [s].
        common: how far the receiver's clock has walked [s].
    """
    if c.seen <= FIRST:
        learn_period(c, t_ns)
        if c.seen > FIRST:
            begin(c, noise)
        return False
    gap = (t_ns - c.last_ns) * 1e-9
    c.last_ns = t_ns
    a = (t_ns - c.first_ns) * 1e-9
    expected = c.offset + c.skew * (a - c.at_s)
    late = a - expected
    late -= c.period * np.round(late / c.period)
    if gap < -c.period or gap > max(GAP_S, GAP_PERIODS * c.period):
        c.offset += late  # from here on, until the window says it better
        c.p00 += unknown_phase(c, noise)
        c.filled = 0
        late = common
    c.window[c.filled] = late - common
    c.filled += 1
    return bool(c.filled == WINDOW)


@kernel
def sort(values: Any, count: int) -> None:
    """Sort the first values, in place."""
    for k in range(1, count):
        value, j = values[k], k - 1
        while j >= 0 and values[j] > value:
            values[j + 1] = values[j]
            j -= 1
        values[j + 1] = value


@kernel
def close_window(c: Clock, const: Const, common: float) -> float:
    """Take a window into the regression; returns the time since the one before [s], 0 where it was not followed.

    Args:
        c: the message.
        const: limits.
        common: how far the receiver's clock has walked [s].
    """
    c.filled = 0
    sort(c.window, WINDOW)
    now_s = (c.last_ns - c.first_ns) * 1e-9
    dt, e = now_s - c.at_s, c.window[QUARTILE]
    c.at_s = now_s
    c.offset += c.skew * dt
    weight = exp(max(dt, 0.0) / const.memory_s)
    c.p00 = (c.p00 + dt * (2.0 * c.p01 + dt * c.p11)) * weight
    c.p01 = (c.p01 + dt * c.p11) * weight
    c.p11 *= weight
    walked = e - c.before
    most = min(max(STEP * const.noise_s, FASTEST * dt), 0.5 * const.limit_s)  # no window decides alone
    if c.window[WINDOW - 1 - QUARTILE] - e > STEADY * c.period or abs(walked) > most:
        c.jumps += 1
        c.up = max(0.0, c.up + min(walked, 0.0))
        c.down = max(0.0, c.down - max(walked, 0.0))
        c.offset += e + common
        c.p00 += unknown_phase(c, const.noise_s)
        c.residual = c.walked = 0.0
        c.before = -common
        c.own = c.walk - common
        return 0.0
    c.walked = walked
    e += common
    c.walk += e - c.residual
    if c.windows <= SETTLED:
        c.own = c.walk - common
    c.own += (c.walk - common - c.own) * min(max(dt, 0.0) / BASE_S, 1.0)
    share = 1.0 / (1.0 + c.p00)
    c.residual = share * e
    c.before = c.residual - common
    c.offset += c.p00 * share * e
    c.skew += c.p01 * share * e
    c.p11 -= c.p01 * share * c.p01
    c.p01 *= share
    c.p00 *= share
    c.windows += 1
    return float(max(dt, 0.0))


@kernel
def is_steady(c: Clock) -> bool:
    """Return whether a message is periodic enough to be judged."""
    return bool(c.windows > SETTLED and 50 * c.jumps <= c.windows)


@kernel
def judge(c: Clock, const: Const, dt: float) -> float:
    """Take how far the phase has walked into the CUSUM; returns it in units of its limit.

    Args:
        c: the message.
        const: limits.
        dt: since the window before [s].
    """
    if c.windows <= SETTLED:
        return 0.0
    c.known_s += dt
    if c.known_s < const.learn_s:
        return 0.0
    c.up = grown(c.up, c.walked - const.kappa * dt, 2.0 * const.limit_s)
    c.down = grown(c.down, -c.walked - const.kappa * dt, 2.0 * const.limit_s)
    return float(max(c.up, c.down) / const.limit_s)

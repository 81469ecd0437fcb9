"""The clock of a sender, from the times at which its periodic message comes: phase, skew, and whether either has changed.

After Cho and Shin, "Fingerprinting Electronic Control Units for Vehicle Intrusion Detection" (USENIX Security 2016): recursive
least squares give the skew, a CUSUM of their innovations tells that it has changed. Three things are other than there,
because stamps of a host and frames that queue would accuse healthy senders:

- The offset is not a mean over frames but a low quantile of them: a frame can only be late. Frame i of period T comes at

      a_i = t0 + n_i T + x(t) + w_i,   w_i >= 0 (queue, host),   n_i = round((a_i - t0 - x) / T)

  A window of W frames gives one y, the lower quartile of a_i - t0 - n_i T. Lost frames raise n by more than one, so they shift nothing.
- The regression is y = x + v with x' = S, the skew S constant but for what is forgotten with the time constant tau. It is written
  with the origin at the latest window, h = (1, 0), dt since the one before, so that nothing grows:

      x <- x + S dt                P <- F P F' exp(dt / tau),  F = (1 dt; 0 1)
      e = y - x                    K = P h / (h P h + 1)
      (x, S) <- (x, S) + K e       P <- P - K h' P

  which is recursive least squares with the weights exp(-age / tau), P in units of the noise's variance.
- The innovation counts less the median of the other messages' latest ones: what moves all of them is the receiver's clock.

The CUSUM is that of :mod:`gateway_fdi.cusum`, of z = (e - median) / (sigma sqrt(1 + h P h)), to either side, weighted with dt:

      up <- max(0, up + (z - kappa) dt),  down <- max(0, down - (z + kappa) dt)      [s]

A phase that jumps is no sign of another sender: ECUs that reset, and messages that are sent on change, jump. There the phase is
found again, the skew is kept, and the test goes on.
"""

from __future__ import annotations

from math import exp, sqrt
from typing import Annotated, Any

import numpy as np

from gateway_fdi.cusum import grown
from gateway_fdi.jit import Record, f8, f8s, i8, kernel, means

#: Frames of a window, and the place of its lower quartile.
WINDOW, QUARTILE = 16, 3
#: Gaps that the period is learned of.
FIRST = 64
#: Part of a period that a window may scatter over, or the phase jump by, and still be followed.
STEADY = 0.2
#: Standard deviation of a skew that is not known yet.
UNKNOWN_SKEW = 2e-3
#: A gap that is longer than this, and than this many periods, leaves the frames uncounted.
GAP_S, GAP_PERIODS = 2.0, 20.0
#: Windows before an innovation says anything.
SETTLED = 8


class Const(Record):
    """What the clocks are judged by."""

    memory_s: f8 = means("time constant with which the past is forgotten", "s")
    learn_s: f8 = means("time that a message is only listened to", "s")
    floor_s: f8 = means("least noise that is taken for granted", "s")
    kappa: f8 = means("drift of the CUSUM, in units of the noise")
    limit: f8 = means("of the CUSUM", "s")


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
    sigma: f8 = means("scale of the innovations", "s")
    innovation: f8 = means("of the last window", "s")
    tested_s: f8 = means("time that it has been tested for", "s")
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
def take(c: Clock, t_ns: int, noise: float) -> bool:
    """Take a frame's time; returns whether it ends a window.

    Args:
        c: the message.
        t_ns: when it came.
        noise: least noise [s].
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
        late = 0.0
    c.window[c.filled] = late
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
def close_window(c: Clock, const: Const) -> float:
    """Take a window into the regression; returns the time since the one before [s], 0 where it was not followed."""
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
    if c.window[WINDOW - 1 - QUARTILE] - e > STEADY * c.period or abs(e) > STEADY * c.period:
        c.jumps += 1
        c.offset += e
        c.p00 += unknown_phase(c, const.floor_s)
        return 0.0
    c.innovation = e / sqrt(1.0 + c.p00)
    share = 1.0 / (1.0 + c.p00)
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
    return bool(c.windows > SETTLED and c.jumps <= 2 + c.windows // 50)


@kernel
def judge(c: Clock, const: Const, common: float, dt: float) -> float:
    """Take an innovation less what is common to all into the CUSUM; returns it in units of its limit.

    Args:
        c: the message.
        const: limits.
        common: of the others' innovations [s].
        dt: time that it stands for [s].
    """
    d = c.innovation - common
    if c.windows <= SETTLED:
        return 0.0
    share = max(1.0 / (c.windows - SETTLED), min(dt / const.memory_s, 1.0))
    c.sigma += share * (min(abs(d), max(4.0 * c.sigma, const.floor_s)) - c.sigma)
    c.tested_s += dt
    if c.tested_s < const.learn_s:
        return 0.0
    z = d / max(1.25 * c.sigma, const.floor_s)  # of a normal noise 1.25 mean moduli are one standard deviation
    held = min(dt, 4.0)  # one late window is no proof
    c.up = grown(c.up, (z - const.kappa) * held, 2.0 * const.limit)
    c.down = grown(c.down, (-z - const.kappa) * held, 2.0 * const.limit)
    return float(max(c.up, c.down) / const.limit)

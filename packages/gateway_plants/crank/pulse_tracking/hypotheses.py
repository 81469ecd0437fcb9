"""Hypotheses about pulses: each pulse is the next tooth, a later one (teeth missed), or none (added).

A hypothesis branches at each pulse, and its cost, minus its log likelihood, grows. Those with the
same tooth at the same pulse merge, the more likely one stays; those much less likely than the best are pruned. So a
clear case is decided at once, and an unclear one is held open until a later pulse, at the latest the
wheel's gap, decides it - the paper's displaced gap is one such evidence. Hypotheses, missed detections, clutter,
merging and pruning are those of multiple hypothesis tracking (Reid 1979).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from gateway_fdi.jit import f8s, kernel
from gateway_plants.crank.pulse_tracking.branching import ADDED_COST, BRANCH, branch
from gateway_plants.crank.pulse_tracking.motion import LASTS, TORQUE, correct, spread, torque, travel
from gateway_plants.crank.pulse_tracking.reduction import prune
from gateway_plants.crank.pulse_tracking.tracker import LEAST_VARIANCE, MOST, MOST_VARIANCE, Tracker, best

#: Nothing fits: even the best explanation of one pulse costs more [nat].
HOPELESS = 45.0
#: Mean cost of a pulse [nat] below which it falls no more: numbers near 0 take the processor ten times as long.
LEAST_COST = 1e-9
#: Share of a new residual in the variance of the edges.
ADAPTATION = 0.03
#: Regular pulses in a row over pitches within this of one, after which the covariance is that of the steady state.
STEADY, EVEN = 4, 0.15
#: Residuals kept, of as many pulses: a power of two.
RING = 8
#: Gate of the short way [variances]: nothing that is likelier than noise lies within.
GATE = 6.0
#: Growth over a pitch up to which three terms of the series of sqrt(1 + z) are exact enough (error below z^4 / 25).
SMALL = 0.1


class Pulses(NamedTuple):
    """Pulses that follow each other.

    Attributes:
        us: shape (n,), time since the pulse before [us].
        first: of them, in ``us``.
        last: the one behind them.
    """

    us: f8s
    first: int
    last: int


class Limits(NamedTuple):
    """What keeps pulses from being regular.

    Attributes:
        longest: interval [us].
        slow: least pace [pitch/us].
        fast: greatest pace [pitch/us].
    """

    longest: float
    slow: float
    fast: float


@kernel
def _seen(beyond: float, span: float, z: float) -> tuple[float, float]:
    """Return a residual [pitch] and q by the series of :func:`short`; ``beyond`` is u - S, and abs(z) at most SMALL."""
    square = z * z
    q = (1.0 + 0.5 * z) + square * (0.0625 * z - 0.125)
    return beyond * q + span * z * (0.25 - 0.015625 * square), q


@kernel
def short(tr: Tracker, pulses: Pulses, limits: Limits, residuals: f8s, at: int) -> int:
    """Take regular pulses the short way: one prediction, one gate, gains of the steady state; returns how many.

    With one hypothesis, over equal pitches, the covariance of the filter has come to its limit: neither it nor the
    gains have to be computed. The state is the pace w = 1 / T, so that no division is left, and the motion a series of
    z = r S. With the way u that has passed since the last tooth [pitch], c = k2 e, and primes for the tooth before::

        q = 1 + z/2 - z^2/8 + z^3/16,      2 q / (1 + q) = q - z/4 + z^3/64,      1/q^2 = (1 - z) (1 + z^2)
        w = w' q' (1 - c' + c'^2/2),       u = (1 - c' + c'^2/2) ((1 - k1) e' + w' q' y),
        e = u q - 2 S q / (1 + q) = (u - S) q + S z (1/4 - z^2/64)

    as 1 - c + c^2/2 is the inverse of 1 + c + c^2/2 but for c^4/4. A tooth takes the time from one residual to the
    next, so sums are ordered for the shortest way between these, and the state is in variables.

    Args:
        tr: record of Tracker; its one hypothesis does not come to the end of the turn in these pulses.
        pulses: the pulses.
        limits: within which they are regular.
        residuals: of the last pulses [pitch], each at the pulse's number modulo :data:`RING`.
        at: number of the latest pulse.
    """
    if tr.steady < STEADY:
        return 0
    h = tr.banks[tr.bank * MOST]
    first, index, pace = pulses.first, int(h.index), 1.0 / h.period
    k2, k3, gate, half, left = tr.k2, tr.k3, tr.gate, 0.5 * tr.k2, 1.0 - tr.k1
    variance, share = tr.variance, tr.spread
    swing = ADAPTATION * 0.5 * share * share
    decayed, before, change, off = h.growth, pace, 0.0, h.elapsed * pace
    latest, e, pull = tr.last / share, tr.residual, 0.0
    taken = 0
    while first + taken < pulses.last:
        y, span = pulses.us[np.uint64(first + taken)], tr.pitches[np.uint64(index + taken)]
        z = decayed * span + span * k3 * pull
        if y > limits.longest or pace < limits.slow or pace > limits.fast:
            break
        if abs(span - 1.0) > EVEN or abs(z) > SMALL:
            break
        way = off + before * y
        residual, q = _seen((way - span) + change * way, span, z)
        if residual * residual >= gate * variance:
            break
        growth = decayed + k3 * pull
        e = pull = residual
        change = k2 * e * (half * e - 1.0)
        before = pace * q
        pace = before + before * change
        off = left * e
        decayed = growth * (1.0 - span * (1.0 / LASTS)) * ((1.0 - z) * (1.0 + z * z))
        variance = _adapted(variance, swing * (e - latest) * (e - latest))
        latest = e
        taken += 1
        residuals[(at + taken) & (RING - 1)] = e
    if taken > 0:
        h.index = index + taken
        h.elapsed, h.period, h.growth = off / before, 1.0 / pace, decayed + k3 * e
        h.associated = 1
        h.outlier = 0
        tr.residual, tr.last, tr.variance = e, e * share, variance
        _settle(tr, taken)
    return taken


@kernel
def plain(tr: Tracker, pulses: int, acceleration: float, y: float) -> float:
    """Take a pulse that the one hypothesis explains by noise, by its filter; -1: not taken, and nothing is changed.

    Args:
        tr: record of Tracker.
        pulses: of one turn.
        acceleration: that the engine can have [pitch/s^2].
        y: time since the last pulse [us].

    Returns:
        what the pulse cost [nat].
    """
    h = tr.banks[tr.bank * MOST]
    if tr.count != 1 or h.clutter != 0:
        return -1.0
    index = int(h.index)
    span = tr.pitches[index]
    if abs(h.growth * span) <= SMALL:
        e, q = _seen((h.elapsed + y) / h.period - span, span, h.growth * span)
    else:
        dt, q = travel(h, span)
        e = (h.elapsed + y - dt) * q / h.period
    scale = 1.0 / tr.variance
    v = tr.variance * (spread(h, span, scale) + 1.0)
    if not e * e < 2.0 * (ADDED_COST - BRANCH) * v:
        return -1.0
    tr.residual = e
    q3 = tr.wander + TORQUE * torque(h, acceleration)
    tr.k1, tr.k2, tr.k3 = correct(h, span, e, q, 1.0, 0.0, 0.0, scale, q3)
    tr.steady = tr.steady + 1 if abs(span - 1.0) <= EVEN else 0
    tr.spread = (tr.variance / v) ** 0.5
    tr.gate = GATE * v * scale
    h.index = 0 if index + 1 == pulses else index + 1
    h.associated = 1
    h.outlier = 0
    _adapt(tr, e * tr.spread)
    _settle(tr, 1)
    return float(0.5 * e * e / v)


@kernel
def _settle(tr: Tracker, number: int) -> None:
    """Take pulses that cost nothing beyond noise into the mean cost."""
    if tr.mean_cost > LEAST_COST:
        tr.mean_cost = max(tr.mean_cost * 0.9**number, LEAST_COST)


@kernel
def take(tr: Tracker, pulses: int, acceleration: float, ripple: float, y: float) -> float:
    """Take one pulse into all hypotheses.

    Args:
        tr: record of Tracker.
        pulses: of one turn.
        acceleration: that the engine can have [pitch/s^2].
        ripple: growth that torsional ripple can have [1/pitch].
        y: time since the last pulse [us].

    Returns:
        what the pulse cost the best hypothesis [nat]; above :data:`HOPELESS` where nothing explains it: then the
        hypotheses are those before it.
    """
    cost = plain(tr, pulses, acceleration, y)
    if cost >= 0.0:
        return cost
    first = tr.bank * MOST
    h = tr.banks[first]
    for k in range(tr.count):
        tr.banks[first + k].elapsed += y
    dt, q = travel(h, tr.pitches[h.index])
    e = (h.elapsed - dt) * q / h.period
    tr.residual = e
    scale = 1.0 / tr.variance
    tr.steady = 0
    made = 0
    for k in range(tr.count):
        made = branch(tr, tr.banks[first + k], pulses, acceleration, ripple, made)
    if made == 0:
        return 2.0 * HOPELESS  # more pulses in one interval than clutter can explain
    count = tr.count
    least = prune(tr, made)
    if least > HOPELESS:
        tr.bank, tr.count = 1 - tr.bank, count
        return least
    tr.mean_cost += 0.1 * (least - tr.mean_cost)
    chosen = best(tr)
    if chosen.associated == 1 and chosen.outlier == 0 and chosen.missed == 0 and chosen.added == 0:
        v = spread(chosen, 1.0, scale) + 1.0
        _adapt(tr, e / max(v, 1.0) ** 0.5)
    return least


@kernel
def _adapt(tr: Tracker, e: float) -> None:
    """Follow the variance of the edges by one more residual, in units of its deviation."""
    tr.variance = _adapted(tr.variance, ADAPTATION * 0.5 * (e - tr.last) * (e - tr.last))
    tr.last = e


@kernel
def _adapted(variance: float, step: float) -> float:
    """Return the variance of the edges as it is after one more change from residual to residual.

    Residuals that keep their sign are not edges that jitter but a speed that is wrong; they must not make a
    wrong speed credible. One large change counts no more than three deviations.

    Args:
        variance: before [pitch^2].
        step: half the square of the change, by :data:`ADAPTATION` [pitch^2].
    """
    most = (1.0 + 8.0 * ADAPTATION) * variance
    variance = min((1.0 - ADAPTATION) * variance + min(step, ADAPTATION * MOST_VARIANCE), most)
    return float(max(variance, LEAST_VARIANCE))

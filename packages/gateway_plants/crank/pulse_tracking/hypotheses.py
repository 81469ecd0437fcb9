"""Hypotheses about pulses: each pulse is the next tooth, a later one (teeth missed), or none (added).

A hypothesis branches at each pulse, and its cost, minus its log likelihood, grows. Those with the
same tooth at the same pulse merge, the more likely one stays; those much less likely than the best are pruned. So a
clear case is decided at once, and an unclear one is held open until a later pulse, at the latest the
wheel's gap, decides it - the paper's displaced gap is one such evidence. Hypotheses, missed detections, clutter,
merging and pruning are those of multiple hypothesis tracking (Reid 1979).
"""

from __future__ import annotations

from typing import NamedTuple

from gateway_fdi.jit import f8s, kernel
from gateway_plants.crank.pulse_tracking.branching import ADDED_COST, BRANCH, branch
from gateway_plants.crank.pulse_tracking.motion import LASTS, TORQUE, correct, spread, torque, travel
from gateway_plants.crank.pulse_tracking.reduction import prune
from gateway_plants.crank.pulse_tracking.tracker import LEAST_VARIANCE, MOST, MOST_VARIANCE, Tracker, best

#: Nothing fits: even the best explanation of one pulse costs more [nat].
HOPELESS = 45.0
#: Share of a new residual in the variance of the edges.
ADAPTATION = 0.03
#: Regular pulses in a row over pitches within this of one, after which the covariance is that of the steady state.
STEADY, EVEN = 4, 0.15
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
        slow: longest time of a pitch [us].
        fast: shortest time of a pitch [us].
    """

    longest: float
    slow: float
    fast: float


@kernel
def short(tr: Tracker, pulses: Pulses, limits: Limits, residuals: f8s, at: int) -> int:
    """Take regular pulses the short way: one prediction, one gate, gains of the steady state; returns how many.

    With one hypothesis, over equal pitches, the covariance of the filter has come to its limit: neither it nor the
    gains have to be computed. With z = r S the motion is a series, so that but one division is left::

        q = 1 + z/2 - z^2/8 + z^3/16,   dt = T S (1 - z/4 + z^2/8 - 5 z^3/64),   1/q = 1 - z/2 + 3 z^2/8 - 5 z^3/16

    The state is in variables while pulses follow each other: what one tooth costs is the time from one residual to the
    next.

    Args:
        tr: record of Tracker; its one hypothesis does not come to the end of the turn in these pulses.
        pulses: the pulses.
        limits: within which they are regular.
        residuals: ring of the last residuals [pitch].
        at: place of the latest one in it.
    """
    if tr.steady < STEADY:
        return 0
    h = tr.banks[tr.bank * MOST]
    index, elapsed, period, growth = int(h.index), h.elapsed, h.period, h.growth
    k1, k2, k3, gate, share = 1.0 - tr.k1, tr.k2, tr.k3, tr.gate, tr.spread
    variance, latest, cost = tr.variance, tr.last, tr.mean_cost
    taken, e = 0, tr.residual
    for k in range(pulses.first, pulses.last):
        y = pulses.us[k]
        span = tr.pitches[index + taken]
        z = growth * span
        if y > limits.longest or period > limits.slow or period < limits.fast:
            break
        if abs(span - 1.0) > EVEN or abs(z) > SMALL:
            break
        q = 1.0 + z * (0.5 - z * (0.125 - 0.0625 * z))
        residual = ((elapsed + y) / period - span * (1.0 - z * (0.25 - z * (0.125 - 0.078125 * z)))) * q
        if residual * residual >= gate * variance:
            break
        e = residual
        back = 1.0 - z * (0.5 - z * (0.375 - 0.3125 * z))
        change = k2 * e
        elapsed = e * (period * back) * k1
        period = period * back * (1.0 + change + 0.5 * change * change)
        growth = growth * back * back * (1.0 - span / LASTS) + k3 * e
        variance = _adapted(variance, e * share - latest)
        latest = e * share
        cost *= 0.9
        at = at + 1 if at + 1 < residuals.shape[0] else 0
        residuals[at] = e
        taken += 1
    if taken > 0:
        h.index = index + taken
        h.elapsed, h.period, h.growth = elapsed, period, growth
        h.associated = 1
        h.outlier = 0
        tr.residual, tr.last, tr.variance, tr.mean_cost = e, latest, variance, cost
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
    tr.mean_cost *= 0.9
    return float(0.5 * e * e / v)


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
    if chosen.associated == 1 and chosen.missed == 0 and chosen.added == 0:
        v = spread(chosen, 1.0, scale) + 1.0
        _adapt(tr, e / max(v, 1.0) ** 0.5)
    return least


@kernel
def _adapt(tr: Tracker, e: float) -> None:
    """Follow the variance of the edges by one more residual, in units of its deviation."""
    tr.variance = _adapted(tr.variance, e - tr.last)
    tr.last = e


@kernel
def _adapted(variance: float, change: float) -> float:
    """Return the variance of the edges, as it is after one more change from residual to residual.

    Residuals that keep their sign are not edges that jitter but a speed that is wrong; they must not make a
    wrong speed credible. One large change counts no more than three deviations.
    """
    most = min(9.0 * variance, MOST_VARIANCE)
    variance += ADAPTATION * (min(0.5 * change * change, most) - variance)
    return float(max(variance, LEAST_VARIANCE))

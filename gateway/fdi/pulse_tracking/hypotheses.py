"""Hypotheses about pulses: each pulse is the next tooth, a later one (teeth missed), or none (added).

A hypothesis branches at each pulse, and its cost, minus its log likelihood, grows. Those with the
same tooth at the same pulse merge, the more likely one stays; those much less likely than the best are pruned. So a
clear case is decided at once, and an unclear one is held open until a later pulse, at the latest the
wheel's gap, decides it - the paper's displaced gap is one such evidence. Hypotheses, missed detections, clutter,
merging and pruning are those of multiple hypothesis tracking (Reid 1979).
"""

from __future__ import annotations

from gateway.fdi.pulse_tracking.branching import ADDED_COST, BRANCH, branch
from gateway.fdi.pulse_tracking.motion import LASTS, TORQUE, correct, spread, torque, travel
from gateway.fdi.pulse_tracking.reduction import prune
from gateway.fdi.pulse_tracking.tracker import LEAST_VARIANCE, MOST, MOST_VARIANCE, Tracker, best
from gateway.jit import kernel

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


@kernel
def short(tr: Tracker, pulses: int, y: float) -> bool:
    """Take a regular pulse the short way: one prediction, one gate, gains of the steady state; False: not taken.

    With one hypothesis, over equal pitches, the covariance of the filter has come to its limit: neither it nor the
    gains have to be computed. With z = r S the motion is a series, so that but one division is left::

        q = 1 + z/2 - z^2/8 + z^3/16,   dt = T S (1 - z/4 + z^2/8 - 5 z^3/64),   1/q = 1 - z/2 + 3 z^2/8 - 5 z^3/16

    Args:
        tr: record of Tracker.
        pulses: of one turn.
        y: time since the last pulse [us].
    """
    if tr.steady < STEADY:
        return False
    h = tr.banks[tr.bank * MOST]
    index = int(h.index)
    span = tr.pitches[index]
    z = h.growth * span
    if abs(span - 1.0) > EVEN or abs(z) > SMALL:
        return False
    q = 1.0 + z * (0.5 - z * (0.125 - 0.0625 * z))
    back = 1.0 - z * (0.5 - z * (0.375 - 0.3125 * z))
    elapsed = h.elapsed + y
    e = (elapsed / h.period - span * (1.0 - z * (0.25 - z * (0.125 - 0.078125 * z)))) * q
    square = e * e
    if square >= tr.gate * tr.variance:
        return False
    period = h.period * back
    change = tr.k2 * e
    h.elapsed = e * period * (1.0 - tr.k1)
    h.period = period * (1.0 + change + 0.5 * change * change)
    h.growth = h.growth * back * back * (1.0 - span / LASTS) + tr.k3 * e
    h.index = 0 if index + 1 == pulses else index + 1
    h.associated = 1
    h.outlier = 0
    tr.residual = e
    _adapt(tr, e * tr.spread)
    tr.mean_cost *= 0.9
    return True


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
        what the pulse cost the best hypothesis [nat].
    """
    first = tr.bank * MOST
    h = tr.banks[first]
    for k in range(tr.count):
        tr.banks[first + k].elapsed += y
    index = int(h.index)
    span = tr.pitches[index]
    dt, q = travel(h, span)
    e = (h.elapsed - dt) * q / h.period
    tr.residual = e
    scale = 1.0 / tr.variance
    if tr.count == 1 and h.clutter == 0:
        v = tr.variance * (spread(h, span, scale) + 1.0)
        if e * e < 2.0 * (ADDED_COST - BRANCH) * v:
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
    tr.steady = 0
    made = 0
    for k in range(tr.count):
        made = branch(tr, tr.banks[first + k], pulses, acceleration, ripple, made)
    least = prune(tr, made)
    tr.mean_cost += 0.1 * (least - tr.mean_cost)
    chosen = best(tr)
    if chosen.associated == 1 and chosen.missed == 0 and chosen.added == 0:
        v = spread(chosen, 1.0, scale) + 1.0
        _adapt(tr, e / max(v, 1.0) ** 0.5)
    return least


@kernel
def _adapt(tr: Tracker, e: float) -> None:
    """Follow the variance of the edges by the change from residual to residual.

    Residuals that keep their sign are not edges that jitter but a speed that is wrong; they must not make a
    wrong speed credible. One large change counts no more than three deviations.
    """
    change = e - tr.last
    tr.last = e
    most = min(9.0 * tr.variance, MOST_VARIANCE)
    tr.variance += ADAPTATION * (min(0.5 * change * change, most) - tr.variance)
    tr.variance = max(tr.variance, LEAST_VARIANCE)

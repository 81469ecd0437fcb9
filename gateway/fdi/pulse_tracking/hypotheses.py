"""Hypotheses about pulses: each pulse is the next tooth, a later one (teeth missed), or none (added).

A hypothesis branches at each pulse, and its cost, minus its log likelihood, grows. Those with the
same tooth at the same pulse merge, the cheaper one stays; those much dearer than the best are dropped. So a
clear case is decided at once, and an unclear one is held open until a later pulse, at the latest the
wheel's gap, decides it - the paper's displaced gap is one such evidence.

A residual can have three causes besides the edge's usual noise: a jolt (the torque changed, up to the
acceleration an engine can have), an outlier of one edge, and pulses missed or added.
"""

from __future__ import annotations

from math import exp, log
from typing import Annotated

from gateway.fdi.pulse_tracking.motion import (
    LEAST_SQUARE,
    MOST_GROWTH,
    TORQUE,
    Hypothesis,
    correct,
    spread,
    torque,
    travel,
)
from gateway.fdi.wheel import MOST_TEETH
from gateway.jit import Record, f8, f8s, i4, i8, kernel

#: Hypotheses held at once.
MOST = 16
#: Teeth that can be missed in a row without loss of synchronisation.
MOST_MISSED = 8
#: Pulses in one interval that can be held for spurious.
MOST_PENDING = 6

#: Costs [nat]: a missed tooth and each further one with it, an added pulse and each further one in the
#: same interval, a jolt, an outlier.
MISS, MISS_MORE, ADD, ADD_MORE, JOLT, OUTLIER = 12.0, 2.0, 12.0, 10.5, 4.0, 8.0
#: A pulse held for spurious although a tooth is overdue: a tooth is missed as well.
OVERDUE = 20.0
#: A pulse has no explanation so much dearer than its best one. ``ADD - BRANCH`` is half the square of the
#: residual (in deviations) below which nothing else is considered.
BRANCH = 10.0
#: A hypothesis with events speaks when it is so much better than one without.
HESITATION = 4.0
#: A decision is made when those that disagree are so much dearer.
DECISION = 10.0
#: Hypotheses so much dearer than the best are dropped; what was decided can be taken back until then.
MARGIN = 16.0
#: Two hypotheses with the same tooth are one when lag and period differ by less than this [pitch].
ALIKE = 0.02
#: Variance of ln(period) that a jolt brings at once.
STEP = 0.03**2
#: Above this variance of an edge single pulses cannot be told from noise (identifiability): a pulse may also be
#: just the next tooth at any time, and every place on the wheel that is possible is kept until the gap tells.
COARSE = 0.065**2
COARSELY_ALIKE = 0.25
SLIP, SLIP_STEP, COARSE_MARGIN = 13.0, 0.3**2, 32.0
#: Deviation of an outlier [pitch].
OUTLIER_PITCH = 0.15
#: Nothing fits: even the best explanation of one pulse costs more.
HOPELESS = 45.0

#: Variance of ln(period) and of the growth when tracking begins.
FIRST_VARIANCE = 0.01**2
FIRST_PERIOD, FIRST_GROWTH = 0.04**2, 0.04**2
LEAST_VARIANCE, MOST_VARIANCE = 0.008**2, 0.3**2
ADAPTATION = 0.03


class Tracker(Record):
    """Tracker.

    ``banks`` holds the hypotheses and those being made of them; ``bank`` tells which half is which. ``variance``
    of an edge [pitch^2]; ``pitches`` as learned, ``slack`` their variance while they are not [pitch^2];
    ``residual`` of the best hypothesis if the latest pulse was its next tooth; ``stress`` what the pulses cost
    lately [nat].
    """

    bank: i4
    count: i4
    banks: Annotated[list[Hypothesis], 2 * MOST]
    spare: Annotated[list[Hypothesis], 1]
    variance: f8
    wander: f8
    residual: f8
    last: f8
    stress: f8
    open: i8
    pitches: Annotated[f8s, MOST_TEETH]
    slack: Annotated[f8s, MOST_TEETH]


@kernel
def best(tr: Tracker) -> Hypothesis:
    """Return the cheapest hypothesis; it is always the first."""
    return tr.banks[tr.bank * MOST]


@kernel
def speaker(tr: Tracker) -> Hypothesis:
    """Return the hypothesis whose tooth is told to others.

    The best, unless it has missed or added pulses that are not decided and one without is nearly as good:
    an edge that is far off for once must not move the angle back and forth.
    """
    first = tr.bank * MOST
    h = tr.banks[first]
    if h.missed != 0 or h.added != 0:
        for k in range(1, tr.count):
            other = tr.banks[first + k]
            if (
                other.cost < HESITATION
                and other.fresh == 1
                and other.missed == 0
                and other.added == 0
            ):
                return other
    return h


@kernel
def copy(a: Hypothesis, b: Hypothesis) -> None:
    """Copy hypothesis ``b`` to ``a``."""
    a.lag = b.lag
    a.period = b.period
    a.growth = b.growth
    a.p11 = b.p11
    a.p12 = b.p12
    a.p13 = b.p13
    a.p22 = b.p22
    a.p23 = b.p23
    a.p33 = b.p33
    a.cost = b.cost
    a.index = b.index
    a.missed = b.missed
    a.added = b.added
    a.pending = b.pending
    a.fresh = b.fresh
    a.outlier = b.outlier


@kernel
def _insert(tr: Tracker, made: int) -> int:
    """Put the spare hypothesis into the other bank; returns how many are there now.

    One that says the same as another - same tooth, nearly the same motion - merges with it.
    """
    first = (1 - tr.bank) * MOST
    new = tr.spare[0]
    alike = COARSELY_ALIKE if tr.variance > COARSE else ALIKE
    place, dearest = -1, new.cost
    for k in range(made):
        other = tr.banks[first + k]
        if (
            new.fresh == 1
            and other.fresh == 1
            and other.index == new.index
            and abs(other.period - new.period) < alike * new.period
            and abs(other.lag - new.lag) < alike * new.period
        ):
            if new.cost < other.cost:
                copy(other, new)
            return made
        if other.cost > dearest:
            place, dearest = k, other.cost
    if made < MOST:
        copy(tr.banks[first + made], new)
        return made + 1
    if place >= 0:
        copy(tr.banks[first + place], new)
    return made


@kernel
def _expand(
    tr: Tracker, h: Hypothesis, pulses: int, acceleration: float, ripple: float, made: int
) -> int:
    """Make the successors of one hypothesis in the other bank; returns how many there are now."""
    child = tr.spare[0]
    span = 0.0
    index = int(h.index)
    jolt = torque(h, acceleration)
    q3 = tr.wander + TORQUE * jolt
    jolt = max(jolt, ripple * ripple)
    first = 0.0
    cheapest = (ADD if h.pending == 0 else ADD_MORE) + OVERDUE
    scale = 1.0 / tr.variance
    usual = tr.variance * (spread(h, 1.0, scale) + 1.0)
    for j in range(MOST_MISSED + 1):
        span += tr.pitches[index]
        slack = tr.slack[index]
        index += 1
        if index == pulses:
            index = 0
        dt, q = travel(h, span)
        e = (h.lag - dt) * q / h.period
        if j == 0:
            first = e
        v = tr.variance * (spread(h, span, scale) + 1.0) + slack
        m = span * span * (STEP + jolt * span * span / 16)
        missing = 0.0 if j == 0 else MISS + MISS_MORE * (j - 1)
        plain = missing + 0.5 * e * e / v + 0.5 * log(v / usual)
        jolted = missing + JOLT + 0.5 * e * e / (v + m) + 0.5 * log((v + m) / usual)
        outlier = missing + (2.0 * OUTLIER if h.outlier == 1 else OUTLIER)
        outlier += 0.5 * e * e / (OUTLIER_PITCH * OUTLIER_PITCH)
        cheapest = min(cheapest, plain, jolted, outlier)
        kinds = 4 if j == 0 and tr.variance > COARSE else 3
        for kind in range(kinds):
            cost = plain if kind == 0 else (jolted if kind == 1 else outlier)
            if kind == 3:
                cost = SLIP
            if cost > cheapest + BRANCH or (kind > 0 and plain < cost):
                continue
            copy(child, h)
            child.cost += cost
            child.index = index
            child.missed += j
            child.pending = 0
            child.fresh = 1
            child.outlier = 1 if kind >= 2 else 0
            edge = 1.0 + slack / tr.variance
            if kind >= 2:
                edge = max(OUTLIER_PITCH * OUTLIER_PITCH / tr.variance, edge)
            shock = scale if kind == 1 else 0.0
            correct(child, span, e, q, edge, STEP * shock, jolt * shock, scale, q3)
            if kind == 3:
                child.lag = 0.0
                child.p11 = 1.0
                child.p22 += SLIP_STEP / tr.variance
            made = _insert(tr, made)
        if e < -0.5 * tr.pitches[index] and missing > cheapest:
            break
    cost = ADD if h.pending == 0 else ADD_MORE
    if first > 0.3 + 4.0 * tr.variance**0.5:
        cost += OVERDUE
    if h.pending < MOST_PENDING and cost < cheapest + BRANCH:
        copy(child, h)
        child.cost += cost
        child.added += 1
        child.pending += 1
        child.fresh = 0
        child.outlier = 0
        made = _insert(tr, made)
    return made


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
        tr.banks[first + k].lag += y
    index = int(h.index)
    span = tr.pitches[index]
    dt, q = travel(h, span)
    e = (h.lag - dt) * q / h.period
    tr.residual = e
    scale = 1.0 / tr.variance
    if tr.count == 1 and h.pending == 0:
        v = tr.variance * (spread(h, span, scale) + 1.0)
        if e * e < 2.0 * (ADD - BRANCH) * v:
            q3 = tr.wander + TORQUE * torque(h, acceleration)
            correct(h, span, e, q, 1.0, 0.0, 0.0, scale, q3)
            h.index = 0 if index + 1 == pulses else index + 1
            h.fresh = 1
            h.outlier = 0
            _adapt(tr, e * (tr.variance / v) ** 0.5)
            tr.stress *= 0.9
            return float(0.5 * e * e / v)
    made = 0
    for k in range(tr.count):
        made = _expand(tr, tr.banks[first + k], pulses, acceleration, ripple, made)
    least = _prune(tr, made)
    tr.stress += 0.1 * (least - tr.stress)
    chosen = best(tr)
    if chosen.fresh == 1 and chosen.missed == 0 and chosen.added == 0:
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


@kernel
def _prune(tr: Tracker, made: int) -> float:
    """Make the other bank current: the best first, those too dear dropped; returns the best's cost."""
    tr.bank = 1 - tr.bank
    first = tr.bank * MOST
    place = 0
    for k in range(1, made):
        if tr.banks[first + k].cost < tr.banks[first + place].cost:
            place = k
    spare = tr.spare[0]
    if place > 0:
        copy(spare, tr.banks[first])
        copy(tr.banks[first], tr.banks[first + place])
        copy(tr.banks[first + place], spare)
    least = tr.banks[first].cost
    margin = COARSE_MARGIN if tr.variance > COARSE else MARGIN
    kept = 0
    for k in range(made):
        h = tr.banks[first + k]
        if h.cost <= least + margin:
            if kept != k:
                copy(tr.banks[first + kept], h)
            tr.banks[first + kept].cost -= least
            kept += 1
    tr.count = kept
    tr.open = tr.open + 1 if kept > 1 else 0
    return float(least)


@kernel
def agreed(tr: Tracker) -> bool:
    """Tell whether all hypotheses that are credible have the same counts of missed and added pulses."""
    first = tr.bank * MOST
    h = tr.banks[first]
    for k in range(1, tr.count):
        other = tr.banks[first + k]
        if other.cost < DECISION and (other.missed != h.missed or other.added != h.added):
            return False
    return True


@kernel
def keep_best(tr: Tracker) -> None:
    """Drop all hypotheses but the best."""
    tr.count = 1
    tr.open = 0


@kernel
def settle(tr: Tracker) -> None:
    """Count missed and added pulses from the best hypothesis on.

    One that disagrees has counts below zero; should it win later, it takes the decision back.
    """
    first = tr.bank * MOST
    missed, added = tr.banks[first].missed, tr.banks[first].added
    for k in range(tr.count):
        tr.banks[first + k].missed -= missed
        tr.banks[first + k].added -= added


@kernel
def begin(tr: Tracker, index: int, period: float, growth: float, variance: float) -> None:
    """Begin with one hypothesis, its last tooth the latest pulse."""
    tr.bank = 0
    tr.count = 1
    tr.open = 0
    tr.stress = 0.0
    tr.last = 0.0
    tr.variance = min(max(variance, FIRST_VARIANCE), MOST_VARIANCE)
    h = tr.banks[0]
    h.lag = 0.0
    h.period = period
    h.growth = growth
    h.p11, h.p12, h.p13 = 1.0, 0.0, 0.0
    h.p22, h.p23, h.p33 = FIRST_PERIOD / tr.variance, 0.0, FIRST_GROWTH / tr.variance
    h.cost = 0.0
    h.index = index
    h.missed = 0
    h.added = 0
    h.pending = 0
    h.fresh = 1
    h.outlier = 0


@kernel
def jump(tr: Tracker, pulses: int, number: int) -> None:
    """Pass over pulses that the sensor gave but nobody told us the times of."""
    first = tr.bank * MOST
    for k in range(tr.count):
        h = tr.banks[first + k]
        span = 0.0
        index = int(h.index)
        for _ in range(min(number, 4 * pulses)):
            span += tr.pitches[index]
            index = index + 1 if index + 1 < pulses else 0
        h.index = (h.index + number) % pulses
        q2 = max(1.0 + h.growth * min(span, 6.0), LEAST_SQUARE)
        h.period /= q2**0.5
        h.growth = 0.0
        h.lag = 0.0
        h.p11, h.p12, h.p13 = 1.0, 0.0, 0.0
        h.p22, h.p23, h.p33 = 1.0 + min(span, 30.0) * 0.5, 0.0, 0.2
        h.pending = 0
        h.fresh = 1


@kernel
def shift(tr: Tracker, pulses: int, number: int) -> None:
    """Shift the index of every hypothesis."""
    first = tr.bank * MOST
    for k in range(tr.count):
        h = tr.banks[first + k]
        h.index = (h.index + number) % pulses


@kernel
def rebase(tr: Tracker, before: float, after: float) -> None:
    """Keep the motion right when ripple moves from it into the pitches, or back.

    Args:
        tr: record of Tracker.
        before: what ln(pitch) of the slot before the last tooth lost.
        after: what that of the slot behind it lost.
    """
    first = tr.bank * MOST
    factor = exp((before + after) / 2)
    growth = 2.0 * (before - after)
    for k in range(tr.count):
        h = tr.banks[first + k]
        h.period *= factor
        h.growth = min(max(h.growth + growth, -MOST_GROWTH), MOST_GROWTH)

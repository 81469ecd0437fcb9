"""Branching of a hypothesis at a pulse: it is the next tooth, a later one (teeth missed), or clutter (an added pulse).

A tooth's residual can have three causes: the edge's usual noise, a jolt (the torque changed, up to the acceleration an
engine can have), and an outlier of one edge. On a wheel whose edges are too noisy to count by, a fourth is that speed
and place slipped, and the pulse is the next tooth all the same.
"""

from __future__ import annotations

from math import log
from typing import NamedTuple

from gateway_fdi.jit import kernel
from gateway_plants.crank.pulse_tracking.motion import (
    TORQUE,
    Hypothesis,
    correct,
    spread,
    torque,
    travel,
)
from gateway_plants.crank.pulse_tracking.reduction import merge
from gateway_plants.crank.pulse_tracking.tracker import COARSE, Tracker

#: Teeth that can be missed in a row without loss of synchronisation.
MOST_MISSED = 8
#: Pulses in one interval that can be held for spurious.
MOST_CLUTTER = 6

#: Causes of a residual.
NOISE, JOLT, OUTLIER, SLIP = 0, 1, 2, 3

#: Costs [nat]: a missed tooth and each further one with it, an added pulse and each further one in the same interval.
MISSED_COST, MORE_MISSED_COST, ADDED_COST, MORE_ADDED_COST = 12.0, 2.0, 12.0, 10.5
#: Of one that came in the turns before as well.
AGAIN_COST = 2.0
#: Of causes other than noise.
JOLT_COST, OUTLIER_COST, SLIP_COST = 4.0, 8.0, 13.0
#: A pulse held for spurious although a tooth is overdue: a tooth is missed as well.
OVERDUE_COST = 20.0
#: A pulse has no explanation so much less likely than its best one. ``ADDED_COST - BRANCH`` is half the square of the
#: residual (in deviations) below which nothing else is considered.
BRANCH = 10.0

#: Variance of ln(period) that a jolt brings at once, and that a slip does.
JOLT_STEP, SLIP_STEP = 0.03**2, 0.3**2
#: Deviation of an outlier [pitch].
OUTLIER_PITCH = 0.15


class Parent(NamedTuple):
    """What all successors of a hypothesis share.

    Attributes:
        scale: 1 / variance of an edge [1/pitch^2].
        jolt: variance of the growth that a jolt brings [1/pitch^2].
        q3: process noise of the growth per pitch.
        usual: predicted variance of the next tooth's residual [pitch^2].
    """

    scale: float
    jolt: float
    q3: float
    usual: float


class Prediction(NamedTuple):
    """A tooth that the pulse may be.

    Attributes:
        tooth: its index.
        missed: teeth that are missed before it.
        cost: of these [nat].
        span: pitches from the last tooth.
        slack: variance of the pitch before it [pitch^2].
        q: of :func:`gateway_plants.crank.pulse_tracking.motion.travel`.
        e: residual of the pulse [pitch].
        variance: predicted, of the residual [pitch^2].
    """

    tooth: int
    missed: int
    cost: float
    span: float
    slack: float
    q: float
    e: float
    variance: float


@kernel
def _parent(tr: Tracker, h: Hypothesis, acceleration: float, ripple: float) -> Parent:
    """Return what all successors of a hypothesis share; arguments as of :func:`branch`."""
    jolt = torque(h, acceleration)
    scale = 1.0 / tr.variance
    return Parent(
        scale,
        max(jolt, ripple * ripple),
        tr.wander + TORQUE * jolt,
        tr.variance * (spread(h, 1.0, scale) + 1.0),
    )


@kernel
def _predict(
    tr: Tracker, h: Hypothesis, parent: Parent, pulses: int, slot: int, span: float, missed: int, cost: float
) -> Prediction:
    """Predict the tooth behind a slot.

    Args:
        tr: record of Tracker.
        h: hypothesis.
        parent: of it.
        pulses: of one turn.
        slot: before the tooth.
        span: from the last tooth up to the slot [pitch].
        missed: teeth that are missed before it.
        cost: of these [nat].
    """
    span += tr.pitches[slot]
    slack = tr.slack[slot]
    dt, q = travel(h, span)
    e = (h.elapsed - dt) * q / h.period
    variance = tr.variance * (spread(h, span, parent.scale) + 1.0) + slack
    return Prediction(slot + 1 if slot + 1 < pulses else 0, missed, cost, span, slack, q, e, variance)


@kernel
def _missed_cost(tr: Tracker, tooth: int, before: float) -> float:
    """Return what a missed tooth costs, behind missed ones of so much [nat]."""
    if tr.nets[tooth] > 0:
        return AGAIN_COST
    return MISSED_COST if before < MISSED_COST else MORE_MISSED_COST


@kernel
def _clutter_cost(tr: Tracker, h: Hypothesis) -> float:
    """Return what one more added pulse costs [nat]."""
    if h.clutter == 0:
        return AGAIN_COST if tr.nets[h.index] < 0 else ADDED_COST
    return MORE_ADDED_COST


@kernel
def _noise_cost(parent: Parent, p: Prediction) -> float:
    """Return the cost of a tooth's residual as noise of its edge [nat]."""
    v = p.variance
    return p.cost + 0.5 * p.e * p.e / v + 0.5 * log(v / parent.usual)


@kernel
def _jolt_cost(parent: Parent, p: Prediction) -> float:
    """Return its cost as a jolt of the torque [nat]."""
    v, span = p.variance, p.span
    m = span * span * (JOLT_STEP + parent.jolt * span * span / 16)
    cost = p.cost + JOLT_COST
    return cost + 0.5 * p.e * p.e / (v + m) + 0.5 * log((v + m) / parent.usual)


@kernel
def _outlier_cost(h: Hypothesis, p: Prediction) -> float:
    """Return its cost as an outlier of the edge [nat]; two in a row cost twice as much."""
    cost = p.cost + (2.0 * OUTLIER_COST if h.outlier == 1 else OUTLIER_COST)
    return cost + 0.5 * p.e * p.e / (OUTLIER_PITCH * OUTLIER_PITCH)


@kernel
def _associate(tr: Tracker, h: Hypothesis, parent: Parent, p: Prediction, pulses: int, cause: int, cost: float) -> None:
    """Make a spare hypothesis that takes the pulse for a tooth, its residual for a cause.

    Args:
        tr: record of Tracker.
        h: the hypothesis before the pulse.
        parent: of it.
        p: the tooth.
        pulses: of one turn.
        cause: NOISE, JOLT, OUTLIER or SLIP.
        cost: of that [nat].
    """
    tr.spare[0] = h
    child = tr.spare[0]
    child.cost += cost
    child.index = p.tooth
    if p.missed > 0:
        if h.missed <= 0:
            child.missed_at = h.index + 1 if h.index + 1 < pulses else 0
        child.missed += p.missed
    child.clutter = 0
    child.associated = 1
    child.outlier = 1 if cause in (OUTLIER, SLIP) else 0
    edge = 1.0 + p.slack / tr.variance
    if child.outlier == 1:
        edge = max(OUTLIER_PITCH * OUTLIER_PITCH / tr.variance, edge)
    shock = parent.scale if cause == JOLT else 0.0
    step, jolt = JOLT_STEP * shock, parent.jolt * shock
    correct(child, p.span, p.e, p.q, edge, step, jolt, parent.scale, parent.q3)
    if cause == SLIP:
        child.elapsed = 0.0
        child.p11 = 1.0
        child.p22 += SLIP_STEP / tr.variance


@kernel
def _hold_for_clutter(tr: Tracker, h: Hypothesis, cost: float) -> None:
    """Make a spare hypothesis that holds the pulse for spurious, at a cost [nat]."""
    tr.spare[0] = h
    child = tr.spare[0]
    child.cost += cost
    if h.added <= 0:
        child.added_at = h.index
    child.added += 1
    child.clutter += 1
    child.associated = 0
    child.outlier = 0


@kernel
def branch(tr: Tracker, h: Hypothesis, pulses: int, acceleration: float, ripple: float, made: int) -> int:
    """Make the successors of one hypothesis in the other bank.

    Args:
        tr: record of Tracker.
        h: the hypothesis.
        pulses: of one turn.
        acceleration: that the engine can have [pitch/s^2].
        ripple: growth that torsional ripple can have [1/pitch].
        made: how many hypotheses the other bank has.

    Returns:
        how many it has then.
    """
    parent = _parent(tr, h, acceleration, ripple)
    least = _clutter_cost(tr, h) + OVERDUE_COST
    first = 0.0
    slot, span, lacks = int(h.index), 0.0, 0.0
    for missed in range(MOST_MISSED + 1):
        p = _predict(tr, h, parent, pulses, slot, span, missed, lacks)
        slot, span = p.tooth, p.span
        lacks += _missed_cost(tr, p.tooth, lacks)
        if missed == 0:
            first = p.e
        noise, jolt = _noise_cost(parent, p), _jolt_cost(parent, p)
        costs = (noise, jolt, _outlier_cost(h, p), SLIP_COST)
        least = min(least, noise, jolt, costs[OUTLIER])
        for cause in range(4 if missed == 0 and tr.variance > COARSE else 3):
            cost = costs[cause]
            if cost > least + BRANCH or noise < cost:
                continue
            _associate(tr, h, parent, p, pulses, cause, cost)
            made = merge(tr, made)
        if p.e < -0.5 * tr.pitches[slot] and p.cost > least:
            break
    cost = _clutter_cost(tr, h)
    if first > 0.3 + 4.0 * tr.variance**0.5:
        cost += OVERDUE_COST
    if h.clutter < MOST_CLUTTER and cost < least + BRANCH:
        _hold_for_clutter(tr, h, cost)
        made = merge(tr, made)
    return made

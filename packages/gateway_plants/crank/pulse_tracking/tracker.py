"""The tracker: hypotheses about where on the wheel the latest pulse was, and what they agree on."""

from __future__ import annotations

from math import exp
from typing import Annotated

from gateway_fdi.jit import Record, f8, f8s, i4, i4s, i8, kernel, means
from gateway_plants.crank.pulse_tracking.motion import LEAST_SQUARE, MOST_GROWTH, Hypothesis
from gateway_plants.crank.wheel import MOST_TEETH

#: Hypotheses held at once.
MOST = 16
#: A hypothesis with missed or added pulses is reported when it is so much more likely than one without [nat].
HESITATION = 4.0
#: A decision is made when those that disagree are so much less likely [nat].
DECISION = 10.0
#: Above this variance of an edge [pitch^2] single pulses cannot be told from noise (identifiability): a pulse may also
#: be just the next tooth at any time, and every place on the wheel that is possible is kept until the gap tells.
COARSE = 0.065**2

#: Turns that a defect of each turn is expected in after it came last.
AGAIN = 4

#: Variance of ln(period) and of the growth when tracking begins.
FIRST_VARIANCE = 0.01**2
FIRST_PERIOD, FIRST_GROWTH = 0.04**2, 0.04**2
LEAST_VARIANCE, MOST_VARIANCE = 0.008**2, 0.3**2


class Tracker(Record):
    """Tracker.

    ``banks`` holds the hypotheses and those being made of them. From so many ``steady`` pulses on gains, ``spread`` and
    ``gate`` are those of the steady state.
    """

    bank: i4 = means("half of banks that has the hypotheses")
    count: i4 = means("hypotheses")
    banks: Annotated[list[Hypothesis], 2 * MOST] = means("hypotheses, in one half or the other")
    spare: Annotated[list[Hypothesis], 1] = means("room for one hypothesis")
    variance: f8 = means("variance of an edge", "pitch^2")
    wander: f8 = means("process noise of the growth")
    residual: f8 = means("residual of the best hypothesis, if the latest pulse was its next tooth", "pitch")
    last: f8 = means("that residual of the pulse before", "pitch")
    mean_cost: f8 = means("cost of a pulse lately", "nat")
    open: i8 = means("pulses since there was one hypothesis only")
    took: i8 = means("open without this pulse's pruning: so long has what is decided now been open")
    pitches: Annotated[f8s, MOST_TEETH] = means("pitches as learned", "pitch")
    slack: Annotated[f8s, MOST_TEETH] = means("variance of the pitches while they are not learned", "pitch^2")
    again: i4 = means("turns in which what came in each turn may come again")
    nets: Annotated[i4s, MOST_TEETH] = means("that: 1: the tooth is missed, -1: a pulse too many is behind it")
    steady: i4 = means("regular pulses over one pitch in a row")
    k1: f8 = means("gain of the position")
    k2: f8 = means("gain of ln T")
    k3: f8 = means("gain of the growth")
    spread: f8 = means("v / variance")
    gate: f8 = means("for e^2 / variance")


@kernel
def best(tr: Tracker) -> Hypothesis:
    """Return the most likely hypothesis; it is always the first."""
    return tr.banks[tr.bank * MOST]


@kernel
def slowest(tr: Tracker) -> float:
    """Return the longest time of a pitch that a hypothesis has [us]."""
    first = tr.bank * MOST
    period = 0.0
    for k in range(tr.count):
        period = max(period, tr.banks[first + k].period)
    return period


@kernel
def reported(tr: Tracker) -> Hypothesis:
    """Return the hypothesis whose tooth is reported.

    The best, unless it has missed or added pulses that are not decided and one without is nearly as good:
    an edge that is far off for once must not move the angle back and forth.
    """
    first = tr.bank * MOST
    h = tr.banks[first]
    if h.missed != 0 or h.added != 0:
        for k in range(1, tr.count):
            other = tr.banks[first + k]
            if other.cost < HESITATION and other.associated == 1 and other.missed == 0 and other.added == 0:
                return other
    return h


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
def unanimous(tr: Tracker) -> bool:
    """Tell whether all hypotheses that are credible have the same tooth for the latest pulse."""
    first = tr.bank * MOST
    h = tr.banks[first]
    for k in range(1, tr.count):
        other = tr.banks[first + k]
        if (other.cost < DECISION or tr.variance > 4 * COARSE) and other.index != h.index:
            return False
    return True


@kernel
def keep_best(tr: Tracker) -> None:
    """Drop all hypotheses but the best; what it holds for missed or added is not decided any more."""
    h = best(tr)
    h.cost = 0.0
    h.missed = 0
    h.added = 0
    tr.count = 1
    tr.open = 0


@kernel
def keep_reported(tr: Tracker) -> None:
    """Drop all hypotheses but one, where no pulse for long has told between them.

    Of two that are nearly as likely not that with missed or added pulses, which would accuse the sensor of nothing that
    was seen.
    """
    first = tr.bank * MOST
    for k in range(tr.count):
        other = tr.banks[first + k]
        if other.cost < HESITATION and other.associated == 1 and other.missed == 0 and other.added == 0:
            if k > 0:
                tr.banks[first] = other
            break
    keep_best(tr)


@kernel
def marginalise_decided(tr: Tracker) -> None:
    """Take the missed and added pulses of the best hypothesis for decided: all counts go on from there.

    A hypothesis that disagrees has counts below zero; should it win later, it takes the decision back.
    """
    first = tr.bank * MOST
    missed, added = tr.banks[first].missed, tr.banks[first].added
    for k in range(tr.count):
        tr.banks[first + k].missed -= missed
        tr.banks[first + k].added -= added


@kernel
def expect(tr: Tracker, pulses: int, tooth: int, net: int) -> None:
    """Expect pulses missed, less those added, at a tooth in the next turns as well."""
    tr.again = AGAIN
    for k in range(abs(net)):
        tr.nets[(tooth + k if net > 0 else tooth) % pulses] = 1 if net > 0 else -1


@kernel
def expect_less(tr: Tracker, turns: int) -> None:
    """Expect what came in each turn for so many turns less."""
    if 0 < tr.again <= turns:
        for k in range(MOST_TEETH):
            tr.nets[k] = 0
    tr.again = max(tr.again - turns, 0)


@kernel
def begin(tr: Tracker, index: int, period: float, growth: float, variance: float) -> None:
    """Begin with one hypothesis, its last tooth the latest pulse."""
    tr.bank = 0
    tr.count = 1
    tr.open = 0
    tr.took = 0
    tr.mean_cost = 0.0
    tr.last = 0.0
    tr.variance = min(max(variance, FIRST_VARIANCE), MOST_VARIANCE)
    h = tr.banks[0]
    h.elapsed = 0.0
    h.period = period
    h.growth = growth
    h.p11, h.p12, h.p13 = 1.0, 0.0, 0.0
    h.p22, h.p23, h.p33 = FIRST_PERIOD / tr.variance, 0.0, FIRST_GROWTH / tr.variance
    h.cost = 0.0
    h.index = index
    h.missed = 0
    h.added = 0
    h.missed_at = 0
    h.added_at = 0
    h.clutter = 0
    h.associated = 1
    h.outlier = 0
    tr.steady = 0


@kernel
def jump(tr: Tracker, pulses: int, number: int) -> None:
    """Pass over pulses that the sensor gave but nobody told us the times of."""
    first = tr.bank * MOST
    tr.steady = 0
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
        h.elapsed = 0.0
        h.p11, h.p12, h.p13 = 1.0, 0.0, 0.0
        h.p22, h.p23, h.p33 = 1.0 + min(span, 30.0) * 0.5, 0.0, 0.2
        h.clutter = 0
        h.associated = 1


@kernel
def shift(tr: Tracker, pulses: int, number: int) -> None:
    """Shift the index of every hypothesis."""
    expect_less(tr, AGAIN)
    first = tr.bank * MOST
    for k in range(tr.count):
        h = tr.banks[first + k]
        h.index = (h.index + number) % pulses
        h.missed_at = (h.missed_at + number) % pulses
        h.added_at = (h.added_at + number) % pulses


@kernel
def transfer_ripple(tr: Tracker, before: float, after: float, span: float) -> None:
    """Transfer ripple from the motion of every hypothesis into the learned pitches, or back: what is predicted stays.

    The motion follows a ripple that is not learned with a lag as large as the ripple, and the lag is not transferred
    with it: speed and growth are as uncertain as what they lose. Without this a filter that has just been told that
    the engine turns evenly takes the lag for a speed, and holds to it.

    Args:
        tr: record of Tracker.
        before: what ln(pitch) of the slot before the last tooth lost.
        after: what that of the slot behind it lost.
        span: pitches from the middle of the one slot to the middle of the other.
    """
    first = tr.bank * MOST
    change = (before + after) / 2
    growth = 2.0 * (before - after) / span
    factor, scale = exp(change), 1.0 / tr.variance
    for k in range(tr.count):
        h = tr.banks[first + k]
        h.period *= factor
        h.growth = min(max(h.growth + growth, -MOST_GROWTH), MOST_GROWTH)
        h.p22 += change * change * scale
        h.p33 += growth * growth * scale

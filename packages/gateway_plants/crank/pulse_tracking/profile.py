"""The wheel's pitches as the engine shows them: tooth errors, the gap's own error, torsional ripple.

Learned in open loop from the measured intervals of clean revolutions. The trend of the speed that is taken off
before comes from equal crank angles, this revolution against the last one; a line fitted inside one
revolution would take part of the ripple for a trend, and the loop would feed on itself.

Most of it is torsional ripple, the torque's part of the kinetic energy, whose share falls with the square of the
speed; teeth that are a few per cent out are learned again soon. A gap's error is its own at any speed:
there only the low orders fall.

What is learned is bounded: what is left of ln(pitch / nominal) without its low orders is the tooth's own, and no more
of it than :data:`MOST_OFF` of a pitch (at a gap :data:`MOST_GAP_OFF`) is believed. The angle by which a tooth is off
is the sum of the pitches' errors before it, the mean taken off.

A four-stroke's half orders (0.5, 1.5, ...: one or three cylinders, V-twins, a misfire) change sign from turn to turn.
What is learned is therefore the mean of two turns, in which they cancel; the motion has to follow them, and how large
they are is what a turn has beyond the profile. From the rms of the smoothed rest, a speed ripple of amplitude A at
order n on a wheel of S pitches changes the growth of the squared speed, r = 2 A (2 pi n / S) cos, by up to 2 A (2 pi
n / S)^2 a pitch: the process noise that the tracker needs.
"""

from __future__ import annotations

from math import exp, log
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from gateway_fdi.jit import Record, f8, f8s, i4, i8, kernel, means, u1, u1s
from gateway_plants.crank.wheel import MOST_TEETH

#: Share of a new revolution in the profile, once it is old.
SHARE = 0.15
#: Pairs of turns after which the profile is old; from then on so many turns are passed over between two pairs.
SETTLED, REST = 12, 6
#: None is passed over while the tooth that is off most differs by more than this from what was learned [pitch].
STILL = 0.05
#: A revolution whose squared speed changed by more than this share teaches nothing.
MOST_TREND = 0.25
#: Nor does one whose trend is not that of the revolution before, by so much: the torque changed inside.
MOST_CHANGE = 0.05
#: Orders of the revolution that count as ripple. The first may be the wheel's runout as well; it is as smooth.
MOST_ORDERS = 6
#: Most that a tooth's pitch, and a gap's, can be learned to be off by itself [pitch].
MOST_OFF, MOST_GAP_OFF = 0.35, 0.4
#: Share of the turn that a gap and its part in the first order have at most, so that its error can be told from that.
MOST_SHARE = 0.5
#: Slots that one interval is shared by, at most.
MOST_SHARED = 4
#: Pulses below which the first order is the teeth's own errors.
FEWEST = 6
#: Neighbouring pitches over which the edges' jitter is averaged.
SMOOTHED = 5
#: Order per turn that ripple which is not learned is taken for.
REST_ORDER = 2.5
#: The ripple's share is computed anew when the speed has changed by so much.
SPEED_STEP = 1.1


class LearnedWheel(Record):
    """What the profile has to know of the wheel; ``cosine`` and ``sine`` of order k + 1 begin at ``k * MOST_TEETH``."""

    pulses: i4 = means("pulses of a turn")
    orders: i4 = means("orders of ripple")
    lone: u1 = means("1: the last slot is the only gap")
    whole: f8 = means("pitches of a turn")
    nominal: Annotated[f8s, MOST_TEETH] = means("nominal pitches", "pitch")
    place: Annotated[f8s, MOST_TEETH] = means("their sum before each slot", "pitch")
    gap: Annotated[u1s, MOST_TEETH] = means("1: the slot is a gap, or follows one")
    cosine: Annotated[f8s, MOST_ORDERS * MOST_TEETH] = means("cosine of each order in the middle of each slot")
    sine: Annotated[f8s, MOST_ORDERS * MOST_TEETH] = means("sine likewise")


def harmonics(wh: LearnedWheel, middle: NDArray[np.float64]) -> None:
    """Fill the cosines and sines of all orders.

    Args:
        wh: record of LearnedWheel.
        middle: shape (P,), angle in the middle of each slot [rad].
    """
    even, odd = np.cos(middle), np.sin(middle)
    x, y = even, odd
    for k in range(MOST_ORDERS):
        at = k * MOST_TEETH
        wh.cosine[at : at + len(middle)], wh.sine[at : at + len(middle)] = x, y
        x, y = x * even - y * odd, x * odd + y * even


class Profile(Record):
    """Profile."""

    intervals: Annotated[f8s, MOST_TEETH] = means("intervals of this revolution", "us")
    before: Annotated[f8s, MOST_TEETH] = means("ln(pitch / nominal) of the last revolution")
    logs: Annotated[f8s, MOST_TEETH] = means("learned ln(pitch / nominal)")
    ripple: Annotated[f8s, MOST_TEETH] = means("low orders of logs")
    ahead: Annotated[f8s, MOST_TEETH] = means("intervals of this revolution while the one before is not decided", "us")
    part: f8 = means("time since the last tooth that no slot has yet", "us")
    turn_us: f8 = means("sum of the intervals of this revolution", "us")
    ended_us: f8 = means("that sum of the revolution before", "us")
    last_us: f8 = means("that sum of the last clean revolution; 0: none", "us")
    trend: f8 = means("relative change of the squared speed from turn to turn")
    period: f8 = means("time of a pitch at which the profile was learned", "us")
    slow: f8 = means("longest time of a pitch for which the pitches hold as they are", "us")
    fast: f8 = means("shortest time of a pitch for which the pitches hold as they are", "us")
    first: f8 = means("amplitude of the first order")
    even: f8 = means("even part of the first order in the last turn")
    odd: f8 = means("odd part of the first order in the last turn")
    rest: f8 = means("amplitude of the ripple that the last turn had and the profile did not expect")
    evens: Annotated[f8s, MOST_ORDERS] = means("even part of each order")
    odds: Annotated[f8s, MOST_ORDERS] = means("odd part of each order")
    share: f8 = means("share of the ripple applied")
    off: f8 = means("what the tooth ``bent`` is off", "pitch")
    scatter: f8 = means("standard deviation of the other teeth", "pitch")
    worst: i4 = means("slot whose pitch is farthest from nominal")
    bent: i4 = means("tooth that is off most")
    clean: u1 = means("1: this revolution is clean so far")
    ended: u1 = means("1: the revolution before has ended and is not decided")
    ended_clean: u1 = means("1: that revolution is clean so far")
    paired: u1 = means("1: before is known")
    resting: i4 = means("clean turns until one is learned from again")
    turns: i8 = means("pairs of turns learned from")


@kernel
def forget(pr: Profile, wh: LearnedWheel, pitches: f8s) -> None:
    """Forget what was learned: the pitches are the nominal ones again."""
    pr.turns = 0
    pr.clean = 0
    pr.ended = 0
    pr.paired = 0
    pr.resting = 0
    pr.part = 0.0
    pr.turn_us = 0.0
    pr.last_us = 0.0
    pr.trend = 0.0
    pr.first = 0.0
    pr.rest = 0.0
    for i in range(wh.pulses):
        pr.logs[i] = 0.0
        pr.ripple[i] = 0.0
        pitches[i] = wh.nominal[i]


@kernel
def note(pr: Profile, slot: int, y: float) -> None:
    """Note the interval of one slot [us]."""
    if pr.ended == 1:
        pr.ahead[slot] = y
    else:
        pr.intervals[slot] = y
    pr.turn_us += y


@kernel
def note_pulse(pr: Profile, pitches: f8s, pulses: int, before: int, index: int, tooth: bool, y: float) -> None:
    """Note the interval of a pulse [us], which need not be the next tooth.

    That of a pulse too many is part of the slot it is in; one over missing teeth is shared by their slots.

    Args:
        pr: record of Profile.
        pitches: as learned.
        pulses: of a turn.
        before: tooth of the pulse before.
        index: tooth of the pulse.
        tooth: whether the pulse is that tooth; else it is none.
        y: the interval.
    """
    pr.part += y
    last = index if index > 0 else pulses
    if index == before and not tooth:
        return
    if index == before and index > 0:
        last, before = index, index - 1  # the pulse before was none, and is taken back
        pr.part += pr.ahead[before] if pr.ended == 1 else pr.intervals[before]
        pr.turn_us -= pr.part - y
    elif not tooth or last <= before or last - before > MOST_SHARED:
        pr.clean = 0
        pr.part = 0.0
        return
    span = 0.0
    for slot in range(before, last):
        span += pitches[slot]
    share = pr.part / span
    for slot in range(before, last):
        note(pr, slot, share * pitches[slot])
    pr.part = 0.0


@kernel
def end(pr: Profile) -> None:
    """End a revolution. What follows is noted beside it, until it is decided and :func:`turn` takes it."""
    pr.ended = 1
    pr.ended_clean = pr.clean
    pr.ended_us = pr.turn_us
    pr.clean = 1
    pr.turn_us = 0.0


@kernel
def turn(pr: Profile, wh: LearnedWheel, pitches: f8s, index: int) -> bool:
    """Take the revolution that has ended; returns whether it was clean, which the pulses behind it have to be too.

    Args:
        pr: record of Profile.
        wh: record of LearnedWheel.
        pitches: takes the learned ones.
        index: of the latest tooth, in the revolution after it.
    """
    clean = pr.ended_clean == 1 and pr.clean == 1
    us, off = pr.ended_us, abs(pr.off)
    pr.ended = 0
    if clean and pr.last_us > 0.0:
        ratio = us / pr.last_us
        trend = 1.0 - ratio * ratio
        pr.resting = pr.resting - 1 if pr.resting > 0 else 0
        if abs(trend) < MOST_TREND and abs(trend - pr.trend) < MOST_CHANGE and pr.resting == 0:
            if _learn(pr, wh, us, trend / wh.whole):
                apply(pr, wh, us / wh.whole, pitches)
                if pr.turns >= SETTLED and abs(pr.off) - off < SHARE * STILL:
                    pr.resting = REST
                    pr.paired = 0
            elif pr.turns > 0:
                follow(pr, wh, us / wh.whole, pitches)
        else:
            pr.paired = 0
        pr.trend = trend
    else:
        pr.paired = 0
    pr.last_us = us if clean else 0.0
    for slot in range(index):
        pr.intervals[slot] = pr.ahead[slot]
    return bool(clean)


@kernel
def _learn(pr: Profile, wh: LearnedWheel, us: float, growth: float) -> bool:
    """Learn from the turn that has ended and the one before; returns whether there was one.

    Args:
        pr: record of Profile.
        wh: record of LearnedWheel.
        us: time of the turn [us].
        growth: of the squared speed per pitch, over the turn.
    """
    angle = -wh.whole / 2
    total = 0.0
    for i in range(wh.pulses):
        a = wh.nominal[i]
        y = pr.intervals[i] / a
        w = 0.5 * log(y * y * (1.0 + growth * (angle + a / 2)))
        angle += a
        pr.intervals[i] = w
        total += a * w
    mean = total / wh.whole
    paired = pr.paired == 1
    pr.paired = 1
    for i in range(wh.pulses):
        w = pr.intervals[i] - mean
        pr.intervals[i] = w
        middle = 0.5 * (w + pr.before[i])
        pr.before[i] = w
        if paired:
            pr.intervals[i] = middle
    if not paired:
        return False
    pr.turns += 1
    share = max(SHARE, 1.0 / pr.turns)
    period = us / wh.whole
    # What was learned at another speed is brought to this one first.
    fallen = min((period / pr.period) ** 2, 1.0) if pr.turns > 1 else 1.0
    pr.period = period
    for i in range(wh.pulses):
        pr.logs[i] += (fallen - 1.0) * (pr.ripple[i] if wh.gap[i] == 1 else pr.logs[i])
        pr.logs[i] += share * (pr.intervals[i] - pr.logs[i])
        pr.intervals[i] = pr.before[i] - pr.logs[i]
    _measure(pr, wh)
    _harmonics(pr, wh)
    for i in range(wh.pulses):
        most = (MOST_GAP_OFF if wh.gap[i] == 1 else MOST_OFF) / wh.nominal[i]
        pr.intervals[i] = min(max(pr.logs[i] - pr.ripple[i], -most), most)
        pr.logs[i] = pr.ripple[i] + pr.intervals[i]
    _inspect(pr, wh)
    return True


@kernel
def _measure(pr: Profile, wh: LearnedWheel) -> None:
    """Measure what this turn had beyond the profile: its first order, and the rms of what is smooth in it.

    ``intervals`` hold what is beyond, without the tooth that is off most: on a small wheel one bent tooth would count
    as ripple. A mean over :data:`SMOOTHED` neighbours takes the edges' jitter off, which changes its sign from one
    interval to the next.
    """
    tooth, off, _total = _farthest(wh, pr.intervals)
    pr.intervals[tooth - 1 if tooth > 0 else wh.pulses - 1] -= off
    pr.intervals[tooth] += off
    even, odd, square = 0.0, 0.0, 0.0
    width = min(SMOOTHED, wh.pulses // 4)
    total = 0.0
    for i in range(width):
        total += pr.intervals[i]
    for i in range(wh.pulses):
        even += wh.nominal[i] * wh.cosine[i] * pr.intervals[i]
        odd += wh.nominal[i] * wh.sine[i] * pr.intervals[i]
        if i + width <= wh.pulses:
            square += total * total
            if i + width < wh.pulses:
                total += pr.intervals[i + width] - pr.intervals[i]
    pr.even, pr.odd = even * 2.0 / wh.whole, odd * 2.0 / wh.whole
    pr.rest = (2.0 * square / (wh.pulses - width + 1)) ** 0.5 / width


@kernel
def _harmonics(pr: Profile, wh: LearnedWheel) -> None:
    """Project what is learned on its low orders: their sum is the ripple, the first one the runout's amplitude."""
    scale = 2.0 / wh.whole
    for i in range(wh.pulses):
        pr.ripple[i] = 0.0
    for k in range(wh.orders):
        at = k * MOST_TEETH
        even, odd = 0.0, 0.0
        for i in range(wh.pulses):
            weight = wh.nominal[i] * pr.logs[i]
            even += weight * wh.cosine[at + i]
            odd += weight * wh.sine[at + i]
        even *= scale
        odd *= scale
        pr.evens[k], pr.odds[k] = even, odd
        for i in range(wh.pulses):
            pr.ripple[i] += even * wh.cosine[at + i] + odd * wh.sine[at + i]
    even, odd = _without_gap(pr, wh, pr.evens[0], pr.odds[0])
    pr.even, pr.odd = pr.even + even, pr.odd + odd
    # Ripple of other orders and errors of teeth look like an error of the gap as well: runout is what is there by both.
    pr.first = min(even * even + odd * odd, pr.evens[0] * pr.evens[0] + pr.odds[0] * pr.odds[0]) ** 0.5


@kernel
def tells_runout(wh: LearnedWheel) -> bool:
    """Return whether runout can be told from an error of the wheel's only gap, and of a few teeth."""
    share = 3.0 * wh.nominal[wh.pulses - 1] / wh.whole if wh.lone == 1 else 0.0
    return bool(wh.pulses >= FEWEST and share <= MOST_SHARE)


@kernel
def _without_gap(pr: Profile, wh: LearnedWheel, even: float, odd: float) -> tuple[float, float]:
    """Take the error of the wheel's only gap off the first order, as its projection has it.

    A gap of ``a`` pitches of ``S`` that is off by g has a share w = 2 a / S of g in the projection, and half of that in
    the mean: what the gap's slot shows beyond the first order is g (1 - 3 w / 2).
    """
    last = wh.pulses - 1
    share = 2.0 * wh.nominal[last] / wh.whole
    if wh.lone == 0 or not tells_runout(wh):
        return even, odd
    cosine, sine = wh.cosine[last], wh.sine[last]
    off = (pr.logs[last] - even * cosine - odd * sine) / (1.0 - 1.5 * share)
    most = MOST_GAP_OFF / wh.nominal[last]
    off = min(max(off, -most), most)
    return even - share * off * cosine, odd - share * off * sine


@kernel
def apply(pr: Profile, wh: LearnedWheel, period: float, pitches: f8s) -> None:
    """Compute the pitches for a speed: the ripple's share falls with its square, and is not known below."""
    share = min((period / pr.period) ** 2, 1.0)
    pr.share = share
    total = 0.0
    for i in range(wh.pulses):
        falls = pr.ripple[i] if wh.gap[i] == 1 else pr.logs[i]
        pitches[i] = wh.nominal[i] * exp(pr.logs[i] + (share - 1.0) * falls)
        total += pitches[i]
    for i in range(wh.pulses):
        pitches[i] *= wh.whole / total
    pr.slow = period * SPEED_STEP
    pr.fast = period / SPEED_STEP


@kernel
def smooth(pr: Profile, slot: int) -> float:
    """Return the ripple that the pitch of a slot contains, as ln(pitch / nominal)."""
    return float(pr.share * pr.ripple[slot])


@kernel
def follow(pr: Profile, wh: LearnedWheel, period: float, pitches: f8s) -> None:
    """Keep the pitches those of the present speed."""
    if pr.turns > 0 and (period > pr.slow or period < pr.fast):
        apply(pr, wh, period, pitches)


@kernel
def _bend(wh: LearnedWheel, own: f8s, tooth: int) -> float:
    """Return how much later a tooth is than the middle of its neighbours says [pitch].

    A tooth late by d makes the pitch before it d longer and the one behind it d shorter: half the difference of the
    two. Zero beside a gap, whose own error would count.

    Args:
        wh: record of LearnedWheel.
        own: ln(pitch / nominal) without ripple.
        tooth: the tooth.
    """
    before = tooth - 1 if tooth > 0 else wh.pulses - 1
    if wh.gap[before] == 1 or wh.gap[tooth] == 1:
        return 0.0
    return float(0.5 * (wh.nominal[before] * own[before] - wh.nominal[tooth] * own[tooth]))


@kernel
def _farthest(wh: LearnedWheel, own: f8s) -> tuple[int, float, float]:
    """Return the tooth that is off most, what it is off, and the sum of what all are [pitch]; see :func:`_bend`."""
    tooth, most, total = 0, 0.0, 0.0
    for i in range(wh.pulses):
        off = _bend(wh, own, i)
        total += abs(off)
        if abs(off) > abs(most):
            tooth, most = i, off
    return tooth, most, total


@kernel
def _inspect(pr: Profile, wh: LearnedWheel) -> None:
    """Find the slot whose pitch is farthest from nominal, and the tooth that is off most, by its own ``intervals``."""
    most = 0.0
    pr.worst = 0
    for i in range(wh.pulses):
        error = abs(pr.logs[i])
        if error > most:
            pr.worst, most = i, error
    pr.bent, pr.off, total = _farthest(wh, pr.intervals)
    for i in range(pr.bent - 1, pr.bent + 2):
        total -= abs(_bend(wh, pr.intervals, i % wh.pulses))
    # Of a normal distribution the mean of the absolute value is 0.8 standard deviations.
    pr.scatter = 1.25 * total / max(wh.pulses - 3, 1)

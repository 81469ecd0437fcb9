"""The wheel's pitches as the engine shows them: tooth errors, the gap's own error, torsional ripple.

Learned in open loop from the measured intervals of clean revolutions. The trend of the speed that is taken off
before comes from equal crank angles, this revolution against the last one; a line fitted inside one
revolution would take part of the ripple for a trend, and the loop would feed on itself.

Most of it is torsional ripple, the torque's part of the kinetic energy, whose share falls with the square of the
speed; teeth that are a few per cent out are learned again soon. A gap's error is its own at any speed:
there only the low orders fall.
"""

from __future__ import annotations

from math import exp, log
from typing import Annotated

from gateway.fdi.wheel import MOST_TEETH
from gateway.jit import Record, f8, f8s, i4, i8, kernel, u1, u1s

#: Share of a new revolution in the profile, once it is old.
SHARE = 0.15
#: A revolution whose squared speed changed by more than this share teaches nothing.
MOST_TREND = 0.25
#: Nor does one whose trend is not that of the revolution before, by so much: the torque changed inside.
MOST_CHANGE = 0.05
#: Orders of the revolution that count as ripple: from the second on; the first is the wheel's runout.
MOST_ORDERS = 6
#: The ripple's share is computed anew when the speed has changed by so much.
SPEED_STEP = 1.1


class LearnedWheel(Record):
    """Wheel.

    What the profile has to know of the wheel: pulses, nominal pitches, their sum, orders of ripple, which slots
    are or follow a gap, and the first order's cosine and sine in the middle of each slot.
    """

    pulses: i4
    orders: i4
    whole: f8
    nominal: Annotated[f8s, MOST_TEETH]
    gap: Annotated[u1s, MOST_TEETH]
    cosine: Annotated[f8s, MOST_TEETH]
    sine: Annotated[f8s, MOST_TEETH]


class Profile(Record):
    """Profile.

    ``intervals`` of this revolution [us], ``logs`` the learned ln(pitch / nominal), ``ripple`` its low orders,
    ``clean`` this revolution so far, ``turns`` learned from, ``period`` [us] at which it was learned ``first``
    amplitude of the first order, ``share`` of the ripple applied, ``slow``, ``fast`` between which the pitches
    hold, as they are.
    """

    intervals: Annotated[f8s, MOST_TEETH]
    logs: Annotated[f8s, MOST_TEETH]
    ripple: Annotated[f8s, MOST_TEETH]
    turn_us: f8
    last_us: f8
    trend: f8
    period: f8
    slow: f8
    fast: f8
    first: f8
    share: f8
    clean: u1
    turns: i8


@kernel
def note(pr: Profile, slot: int, y: float) -> None:
    """Note the interval of one slot [us]."""
    pr.intervals[slot] = y
    pr.turn_us += y


@kernel
def turn(pr: Profile, wh: LearnedWheel, pitches: f8s) -> bool:
    """End a revolution; returns whether it was clean.

    Args:
        pr: record of Profile.
        wh: record of WHEEL.
        pitches: takes the learned ones.
    """
    clean = pr.clean == 1
    if clean and pr.last_us > 0.0:
        ratio = pr.turn_us / pr.last_us
        trend = 1.0 - ratio * ratio
        if abs(trend) < MOST_TREND and abs(trend - pr.trend) < MOST_CHANGE:
            _learn(pr, wh, trend / wh.whole)
            apply(pr, wh, pr.turn_us / wh.whole, pitches)
        pr.trend = trend
    pr.last_us = pr.turn_us if clean else 0.0
    pr.turn_us = 0.0
    pr.clean = 1
    return bool(clean)


@kernel
def _learn(pr: Profile, wh: LearnedWheel, growth: float) -> None:
    pr.turns += 1
    share = max(SHARE, 1.0 / pr.turns)
    angle = -wh.whole / 2
    total = 0.0
    for i in range(wh.pulses):
        a = wh.nominal[i]
        w = log(pr.intervals[i] / a) + 0.5 * log(1.0 + growth * (angle + a / 2))
        angle += a
        pr.intervals[i] = w
        total += a * w
    mean = total / wh.whole
    period = pr.turn_us / wh.whole
    # What was learned at another speed is brought to this one first.
    fallen = min((period / pr.period) ** 2, 1.0) if pr.turns > 1 else 1.0
    pr.period = period
    for i in range(wh.pulses):
        pr.logs[i] += (fallen - 1.0) * (pr.ripple[i] if wh.gap[i] == 1 else pr.logs[i])
        pr.logs[i] += share * (pr.intervals[i] - mean - pr.logs[i])
        pr.ripple[i] = 0.0
    for order in range(1, wh.orders + 1):
        even, odd = 0.0, 0.0
        for i in range(wh.pulses):
            re, im = _power(wh.cosine[i], wh.sine[i], order)
            even += wh.nominal[i] * re * pr.logs[i]
            odd += wh.nominal[i] * im * pr.logs[i]
        even *= 2.0 / wh.whole
        odd *= 2.0 / wh.whole
        if order == 1:
            pr.first = (even * even + odd * odd) ** 0.5
            continue
        for i in range(wh.pulses):
            re, im = _power(wh.cosine[i], wh.sine[i], order)
            pr.ripple[i] += even * re + odd * im


@kernel
def _power(re: float, im: float, order: int) -> tuple[float, float]:
    """Return cosine and sine of a multiple of an angle."""
    x, y = re, im
    for _ in range(order - 1):
        x, y = x * re - y * im, x * im + y * re
    return x, y


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
def worst(pr: Profile, wh: LearnedWheel) -> int:
    """Return the slot whose pitch is farthest from nominal."""
    place, most = 0, 0.0
    for i in range(wh.pulses):
        error = abs(pr.logs[i])
        if error > most:
            place, most = i, error
    return int(place)

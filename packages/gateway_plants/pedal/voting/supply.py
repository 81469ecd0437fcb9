"""A supply that is wrong for all channels, told from one channel that is wrong.

A sensor of the supply's voltage reads s (a + b x): s the supply's share of what it should be, a the reading at rest, b
the travel's. Channels whose a and b are not in proportion, as those of opposite slopes, give both s and x; that x goes
on from where the pedal was, and no channel's own does. If one channel is wrong, the other's own does.

That is decided in the first samples behind the disagreement, by where the pedal was going: later nobody could tell.
"""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np

from gateway_fdi.jit import Record, f8, f8s, i8, kernel, means
from gateway_plants.pedal.voting.simple import MOST_CHANNELS

#: Samples of agreement that a disagreement must follow, those in which it is decided what it is, and least periods.
AGREED, LEAST, MOST, SOONEST = 20, 3, 12, 6.0
#: Standard deviations by which one explanation must be better than the other.
CLEAR = 3.0
#: Shares of the supply that are believed; within this of 1 for so many samples it is right again.
LOWEST, HIGHEST, RIGHT, CALM = 0.4, 1.3, 0.01, 50
#: A supply does not jump to and fro: by so much in the samples that are looked at, by so much from its average [share].
STEADY, STRAYS = 0.02, 0.05
#: Share of a new sample in the average.
AVERAGE = 0.1
#: Sine of the angle between (a) and (b) from which on channels tell supply and travel apart.
APART = 0.2


class Const(Record):
    """Constants."""

    possible: i8 = means("1: channels tell")
    channels: i8 = means("channels, 2 or 3")
    rest: Annotated[f8s, MOST_CHANNELS] = means("a, in the unit of the signal")
    way: Annotated[f8s, MOST_CHANNELS] = means("b over the whole travel, in the unit of the signal")
    bend: f8 = means("standard deviation of the change of slope in a period", "%/period")


class State(Record):
    """State. From ``age`` on, but for ``agreed``, it is of the disagreement that is looked at."""

    share: f8 = means("supply, a share of what it should be")
    active: i8 = means("1: it is not what it should be")
    calm: i8 = means("samples for which it has been right again")
    age: i8 = means("samples of disagreement", "samples")
    elapsed: f8 = means("time of disagreement", "periods")
    agreed: i8 = means("samples of agreement before", "samples")
    level: f8 = means("the pedal before it", "%")
    slope: f8 = means("its change in a period", "%/period")
    variance: f8 = means("variance of level", "%^2")
    slack: f8 = means("slack of lags before the disagreement")
    common: f8 = means("sum of what the pedal is off by if the supply is wrong", "%")
    single: Annotated[f8s, MOST_CHANNELS] = means("sum of what the pedal is off by if this channel is right", "%")
    seen: f8 = means("share when it was looked at first")
    now: f8 = means("share of this sample")
    travel: f8 = means("travel of this sample", "%")


def tells(rest: list[float], way: list[float]) -> bool:
    """Tell whether channels with readings ``rest`` and their change ``way`` over the travel tell supply and travel."""
    a, b = np.asarray(rest), np.asarray(way)
    size = float(np.hypot.reduce(a) * np.hypot.reduce(b))
    cosine = abs(float(a @ b)) / size if size > 0.0 else 1.0
    return math.sqrt(max(1.0 - cosine * cosine, 0.0)) > APART


def prepare(s: State, c: Const, rest: list[float], way: list[float], *, possible: bool, bend: float) -> None:
    """Fill state and constants.

    Args:
        rest: reading of each channel at rest.
        way: its change over the travel.
        possible: readings are in proportion to a common supply, and tell (see :func:`tells`).
        bend: standard deviation of the change of slope in one sample [%].
    """
    n = len(rest)
    c.channels, c.bend = n, bend
    c.rest[:n], c.way[:n] = rest, way
    c.possible = possible
    s.share = 1.0


@kernel
def _solve(s: State, c: Const, reading: f8s) -> bool:
    """Find supply and travel from all readings, least squares of s a + (s x) b; tells whether there is a solution."""
    aa = ab = bb = ay = by = 0.0
    for i in range(c.channels):
        a, b, y = c.rest[i], c.way[i], reading[i]
        if math.isnan(y):
            return False
        aa += a * a
        ab += a * b
        bb += b * b
        ay += a * y
        by += b * y
    size = aa * bb - ab * ab
    s.now = (ay * bb - by * ab) / size
    if not LOWEST < s.now < HIGHEST:
        return False
    s.travel = 100.0 * (by * aa - ay * ab) / size / s.now
    return True


@kernel
def _end(s: State) -> None:
    s.age = 0
    s.common = 0.0
    for i in range(MOST_CHANNELS):
        s.single[i] = 0.0


@kernel
def _sums(s: State, c: Const, position: f8s) -> float:
    """Add a sample of the disagreement; returns the least of what single channels would be off by, on average."""
    expected = s.level + s.slope * s.elapsed
    s.common += s.travel - expected
    least = np.inf
    for i in range(c.channels):
        s.single[i] += position[i] - expected
        least = min(least, abs(s.single[i]) / s.age)
    return float(least)


@kernel
def _go_on(s: State, solved: bool) -> None:
    """Follow a supply that is wrong, until it is right again or does not explain the readings any more."""
    if solved and abs(s.now - s.share) <= STRAYS:
        s.share += AVERAGE * (s.now - s.share)
        s.calm = s.calm + 1 if abs(s.share - 1.0) < RIGHT else 0
        if s.calm < CALM:
            return
    s.active = 0
    s.share = 1.0


@kernel
def look(
    s: State,
    c: Const,
    reading: f8s,
    position: f8s,
    agree: float,
    level: float,
    slope: float,
    certainty: float,
    variance: float,
    slack: float,
    sure: bool,
    dt: float,
) -> bool:
    """Take the readings of one sample; tells whether the supply has just been found to be wrong.

    Args:
        reading: of each channel [unit of the signal].
        position: of each channel, mismatch taken off [%].
        agree: largest difference of positions that agree [%].
        level: of the pedal as of the last sample [%].
        slope: its change in a period [%].
        certainty: variance of ``level`` [%^2].
        variance: of a reading [%^2].
        slack: what a lag may make of the pedal's way [%].
        sure: the pedal's way is known and no channel is held for failed.
        dt: time since the last sample, in periods.
    """
    if c.possible == 0:
        return False
    solved = _solve(s, c, reading)
    if s.active == 1:
        _go_on(s, solved)
        return False
    low, high = np.inf, -np.inf
    for i in range(c.channels):
        low, high = min(low, position[i]), max(high, position[i])
    if high - low <= agree:
        s.agreed = min(s.agreed + 1, AGREED)
        _end(s)
        return False
    if s.age == 0:
        if s.agreed < AGREED or not sure:
            return False
        s.level, s.slope, s.variance, s.slack, s.elapsed = level, slope, certainty, slack, 0.0
    s.agreed = 0
    s.age += 1
    s.elapsed += dt
    if s.age == 2:  # the first one may lie on the edge
        s.seen = s.now
    if not solved or s.age > MOST or (s.age > 2 and abs(s.now - s.seen) > STEADY):
        s.age = MOST
        return False
    single, common = _sums(s, c, position), abs(s.common) / s.age
    unsure = math.sqrt(s.variance + variance / s.age) + c.bend * math.sqrt(s.elapsed**3 / 3.0)
    unsure += 0.5 * s.slack
    if s.age >= LEAST and s.elapsed >= SOONEST and common <= CLEAR * unsure and single - common > CLEAR * unsure:
        s.active = 1
        s.calm = 0
        s.share = s.now
        _end(s)
        return True
    return False

"""Limits of many cars: the tail of all of them, the centre and the spread of each.

One car shows an hour or ten; a limit is to be exceeded once in 10,000. So the tail comes from the block maxima of all
cars together: above the highest √n of n blocks, at most :data:`MOST`, the law is a generalised Pareto one. Fewer blocks
say less of it; more blocks are nearer to the middle, where tails have not yet their shape.

The interval of the rate is that of its profile likelihood (Coles 2001, 4.3.3), which is not symmetric, as few excesses
have it. Blocks of one car, and of one day, are alike: the likelihood is scaled by how much less they say than as many
independent ones would (Chandler and Bate 2007), with the variance between cars and between days as it is found
(Cameron, Gelbach and Miller 2011; a t law with as many degrees of freedom as there are cars, or days, but one). The
limit is where the upper end is the rate that was asked for; there the tail is no lighter than an exponential one.

With few cars the middle of the fleet is not known: below :data:`OWN` each car is taken from its own centre (median) in
units of its own spread, which is drawn to that of the fleet as far as few blocks say little of it (empirical Bayes).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

#: Below this number of cars a limit is told from the car's own centre; cars, and blocks of one, at least.
OWN, LEAST_CARS, LEAST_BLOCKS = 100, 10, 20
#: Blocks of which the tail is made at most: by then its shape is known to a tenth.
MOST = 200
#: Confidence of the interval of a rate.
CONFIDENCE = 0.9
#: Deviation of the logarithm of an interquartile range of n blocks, times the root of n.
_SCATTER = 1.17

Values = NDArray[np.float64]
Numbers = NDArray[np.int64]

#: Laws that are looked at: shape; logarithm of the scale in units of the mean excess. None has the shape 0.
_SHAPE, _LOG_SCALE = np.meshgrid(np.linspace(-0.499, 1.001, 61), np.linspace(-1.2, 0.9, 43), indexing="ij")


@dataclass(frozen=True)
class Shown:
    """Block maxima of a test in one car, towards its limit.

    Attributes:
        values: representative ones, in order.
        weights: blocks that each stands for.
        days: on which each was seen.
    """

    values: Values
    weights: Values
    days: Numbers

    @property
    def blocks(self) -> int:
        """How many there are."""
        return int(self.weights.sum())

    def quantile(self, shares: Values) -> Values:
        """Return quantiles, linear between the middles of the blocks that values stand for."""
        middle = (np.cumsum(self.weights) - 0.5 * self.weights) / self.blocks
        return np.interp(shares, middle, self.values)

    def one_by_one(self) -> Values:
        """Return a value for each block: those of a digest lie between its neighbours, not all at one place."""
        return self.quantile((np.arange(self.blocks) + 0.5) / self.blocks)


@dataclass(frozen=True)
class Pooled:
    """A limit of many cars.

    Attributes:
        limit: towards it values grow; from the car's own centre, if ``own``.
        own: whether it is told from the car's own centre, in units of its own spread.
        per_hour: false alarms of this test in an hour of a car, as expected, and the ends of its interval [1/h].
        cars, blocks: that were seen.
        each: limit of each car of :func:`pool`, if ``own``; NaN for one that showed too little.
    """

    limit: float
    own: bool
    per_hour: tuple[float, float, float]
    cars: int
    blocks: int
    each: tuple[float, ...] = ()


def shown(drives: Sequence[tuple[Sequence[float], Sequence[float], int]]) -> Shown:
    """Return the block maxima of a car's drives: values, their weights, the day of each drive."""
    values, weights = (np.concatenate([np.asarray(one[k], np.float64) for one in drives]) for k in (0, 1))
    days = np.repeat([day for *_, day in drives], [len(one[0]) for one in drives])
    order = np.argsort(values, kind="stable")
    return Shown(values[order], weights[order], days[order])


def centres_of(cars: Sequence[Shown]) -> tuple[Values, Values]:
    """Return the centre of each car, and its spread as far as its blocks prove that it has one of its own."""
    low, centres, high = np.array([car.quantile(np.array([0.25, 0.5, 0.75])) for car in cars]).T
    spreads = high - low
    least = max(float(np.median(spreads)), float(np.abs(centres).max()) * 1e-9, 1e-300)
    logs = np.log(np.maximum(spreads, 1e-3 * least))
    noise = _SCATTER**2 * float(np.mean([1.0 / car.blocks for car in cars]))
    own = max(float(logs.var()) - noise, 0.0)
    return centres, np.exp(logs.mean() + own / (own + noise) * (logs - logs.mean()))


def pool(cars: Sequence[Shown], block_s: float, per_hour: float) -> Pooled | None:
    """Return the limit that healthy cars exceed no more often than asked; None: too little was seen for one.

    Args:
        cars: block maxima of each.
        block_s: length of a block [s].
        per_hour: false alarms of this test that a car may have in an hour [1/h].
    """
    enough = [car.blocks >= LEAST_BLOCKS for car in cars]
    cars = [car for car, is_enough in zip(cars, enough, strict=True) if is_enough]
    if len(cars) < LEAST_CARS:
        return None
    own, sizes = len(cars) < OWN, [car.blocks for car in cars]
    centres, spreads = centres_of(cars) if own else (np.zeros(len(cars)), np.ones(len(cars)))
    of = zip(cars, centres, spreads, strict=True)
    values = np.concatenate([(car.one_by_one() - centre) / spread for car, centre, spread in of])
    days = np.concatenate([np.repeat(car.days, car.weights.astype(np.int64)) for car in cars])
    alike = np.repeat(np.arange(len(cars)), sizes), np.unique(days, return_inverse=True)[1]
    tail = _tail(values, alike, per_hour * block_s / 3600.0)
    if tail is None:
        return None
    limit, expected, low = tail
    made = iter(centres + spreads * limit)
    each = tuple(float(next(made)) if is_enough else math.nan for is_enough in enough) if own else ()
    rates = (expected * 3600.0 / block_s, low * 3600.0 / block_s, per_hour)
    return Pooled(limit, own, rates, len(cars), len(values), each)


def _tail(values: Values, alike: tuple[Numbers, Numbers], wanted: float) -> tuple[float, float, float] | None:
    """Return the level whose rate has its upper end at the one that is wanted; its rate as expected, and the lower end.

    Args:
        values: of blocks, shape (blocks,).
        alike: of each the number of its car, and of its day.
        wanted: share of the blocks.

    Returns:
        None, where nothing moves.
    """
    count = int(min(math.sqrt(len(values)), MOST))
    order = np.argpartition(values, len(values) - count - 1)[-count - 1 :]
    high, threshold = order[1:], float(values[order[0]])
    excess = values[high] - threshold
    if not (mean := float(excess.mean())) > 0.0:
        return None
    share, farther = count / len(values), math.log(count / len(values) / wanted)
    apart = _SHAPE[..., None] / np.exp(_LOG_SCALE)[..., None] * (excess / mean)
    logs = np.log1p(np.maximum(apart, -1.0 + 1e-12)).sum(-1)
    likely = np.where((apart > -1.0).all(-1), -count * _LOG_SCALE - (1.0 + 1.0 / _SHAPE) * logs, -np.inf)
    likely = likely + _unbiased(*_highest(likely), count)
    shape, log_scale = _highest(likely)
    room = _room(excess / mean / math.exp(log_scale), high, alike, (shape, share, farther))

    def more(likely: Values) -> Values:
        """Return by how much the logarithm of the share may differ with each law, NaN: the law is too unlikely."""
        left = room - 2.0 * (likely.max() - likely)
        return np.sqrt(np.where(left >= 0.0, left, np.nan) * (1.0 - share) / count)

    def rate(shape: Values, log_scale: Values, level: float) -> Values:
        """Return the logarithm of the share of blocks above a level."""
        return math.log(share) - np.log(np.maximum(1.0 + shape * level / np.exp(log_scale), 1e-300)) / shape

    heavy = np.where(_SHAPE > 0.0, likely, -np.inf)
    level = float(np.nanmax(np.exp(_LOG_SCALE) * np.expm1(_SHAPE * (farther + more(heavy))) / _SHAPE))
    lowest = float(np.exp(np.nanmin(rate(_SHAPE, _LOG_SCALE, level) - more(likely))))
    expected = float(np.exp(rate(np.array(shape), np.array(log_scale), level)))
    return threshold + mean * level, expected, lowest


def _highest(likely: Values) -> tuple[float, float]:
    """Return shape and scale that are most likely, of those that are no lighter than an exponential law."""
    at = np.where(_SHAPE > 0.0, likely, -np.inf).argmax()
    return float(_SHAPE.flat[at]), float(_LOG_SCALE.flat[at])


def _unbiased(shape: float, log_scale: float, count: int) -> Values:
    """Return what the logarithm of the likelihood of each law lacks for its highest place to be without bias.

    That of the first order in the number of excesses (Cox and Snell 1968; Giles, Feng and Godwin 2016).
    """
    one, three = 1.0 + shape, count * (1.0 + 3.0 * shape)
    bias = -one * (3.0 + shape) / three, (3.0 + 5.0 * shape + 4.0 * shape**2) / three - one / count
    known = count / (1.0 + 2.0 * shape) / one * np.array([[2.0, 1.0], [1.0, one]])
    by = known @ bias
    found: Values = -by[0] * (_SHAPE - shape) - by[1] * (_LOG_SCALE - log_scale)
    return found


def _room(excess: Values, high: Numbers, alike: tuple[Numbers, Numbers], law: tuple[float, float, float]) -> float:
    """Return the deviance up to which a law may be that of the fleet, as far as the level that is wanted is concerned.

    Args:
        excess: above the threshold, in units of the scale.
        high: which blocks these are.
        alike: of each block the number of its car, and of its day.
        law: shape; share of the blocks above the threshold; logarithm of that share over the one that is wanted.
    """
    from scipy.stats import t  # noqa: PLC0415 - slow to load

    shape, share, farther = law
    one, grown = 1.0 + shape, math.exp(shape * farther)
    # Level by shape, logarithm of scale, and of share; the covariance of these three, were all blocks independent.
    slope = np.array([(farther * grown - (grown - 1.0) / shape) / shape, (grown - 1.0) / shape, grown])
    covariance = np.array([[one**2, -one, 0.0], [-one, 2.0 * one, 0.0], [0.0, 0.0, 1.0 - share]]) / len(high)
    by = covariance @ slope
    inner = excess / (1.0 + shape * excess)
    scores = [np.log1p(shape * excess) / shape**2 - (1.0 + 1.0 / shape) * inner, one * inner - 1.0, 1.0 / (1.0 - share)]
    moved = by[0] * scores[0] + by[1] * scores[1] + by[2] * scores[2]  # the level, by a block above the threshold

    def variance(number: Numbers) -> tuple[float, int]:
        blocks = np.bincount(number)
        sums = np.bincount(number[high], moved, len(blocks)) - by[2] * share / (1.0 - share) * blocks
        groups = int(np.count_nonzero(blocks))
        return float((sums**2).sum()) * groups / max(groups - 1, 1), groups - 1

    cars, days = alike
    (by_car, free), (by_day, free_days) = variance(cars), variance(days)
    if free_days:  # of a single day nothing is known
        both = np.unique(cars * (int(days.max()) + 1) + days, return_inverse=True)[1]
        by_car, free = max(by_car, by_car + by_day - variance(both)[0]), min(free, free_days)
    return float(t.ppf(0.5 + 0.5 * CONFIDENCE, free) ** 2 * max(by_car / (slope @ by), 1.0))

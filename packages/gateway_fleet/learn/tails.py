"""Limits from the tail of healthy values (:mod:`gateway_fdi.tails`), exceeded as seldom as is asked for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gateway_fdi.tails import exceeded_once

#: Parts whose means are the level of a course, and the share of them over which the means follow each other; standard
#: errors by which the level of the second half leaves that of the first one, if it is shown to move.
PARTS, FOLLOW, MOVED = 50, 0.08, 2.0
#: False codes that all tests of a configuration together may set, unless another rate is asked for [1/h].
FALSE_PER_HOUR = 1e-3


@dataclass(frozen=True)
class Rate:
    """How often healthy parts may set a code.

    Attributes:
        per_hour: of all tests of a configuration together [1/h].
        tests: that share it.
    """

    per_hour: float = FALSE_PER_HOUR
    tests: int = 100

    @property
    def hours(self) -> float:
        """Time in which one test may set one false code [h]."""
        return max(self.tests, 1) / self.per_hour


def limit_above(maxima: NDArray[np.float64], block_s: float, floor: float, rate: Rate, *, heavy: bool = False) -> float:
    """Return what the maxima of healthy blocks exceed as seldom as one test of a configuration may.

    Args:
        maxima: of each block.
        block_s: length of a block [s].
        floor: mean excess at least: the resolution of what is measured.
        rate: that is asked for.
        heavy: the tail may be heavier than an exponential one.
    """
    return exceeded_once(maxima, rate.hours * 3600.0 / block_s, floor, heavy=heavy)


def wandering(values: NDArray[np.float64]) -> float:
    """Return how far the level of a course wanders in a time as long as the course; 0: it is not shown to move.

    The level is taken for a random walk under noise that comes back (local level model, Muth 1960): after a time t it
    lies s sqrt(t) off (one standard deviation), and leaves that distance in t with a probability of 1 - 1/e, as what is
    exceeded once in t does. The means of both halves of a course of length T differ by D, E[D^2] = s^2 T / 3 + 4 v / T.
    The second term is that of the noise, v its long-run variance (Newey and West 1987). Where D is no larger than MOVED
    roots of it the noise alone explains D; else s sqrt(T) = D sqrt(3), and in t it is s sqrt(T) sqrt(t / T).

    Args:
        values: of a signal, at equal distances in time, shape (rows,).
    """
    parts = min(PARTS, len(values))
    if parts < 2:
        return 0.0
    means = values[: len(values) // parts * parts].reshape(parts, -1).mean(axis=1)
    off, lags = means - means.mean(), round(FOLLOW * parts)
    weights = 1.0 - np.arange(1, lags + 1) / (lags + 1.0)
    follow = sum(weight * float(off[k:] @ off[:-k]) for k, weight in enumerate(weights.tolist(), 1))
    noise = max(float(off @ off) + 2.0 * follow, 0.0) / parts
    apart = abs(float(means[: parts // 2].mean() - means[parts // 2 :].mean()))
    return apart * float(np.sqrt(3.0)) if apart > MOVED * np.sqrt(4.0 * noise / parts) else 0.0


def sustained(off: NDArray[np.float64], rows: int) -> NDArray[np.float64]:
    """Return how far a deviation stays on one side of zero for ``rows`` rows at least, shape (len(off) - rows + 1,)."""
    windows = np.lib.stride_tricks.sliding_window_view(off, min(rows, len(off)))
    return np.asarray(np.maximum(np.maximum(windows.min(axis=1), -windows.max(axis=1)), 0.0), np.float64)


def block_maxima(values: NDArray[np.float64], rows: int) -> NDArray[np.float64]:
    """Return the largest value of each block of ``rows`` rows; the rest at the end is a block of its own."""
    return np.maximum.reduceat(values, np.arange(0, len(values), max(rows, 1)))

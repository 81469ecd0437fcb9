"""Limits from the tail of healthy values (:mod:`gateway_fdi.tails`), exceeded as seldom as is asked for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gateway_fdi.tails import exceeded_once

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


def sustained(off: NDArray[np.float64], rows: int) -> NDArray[np.float64]:
    """Return how far a deviation stays on one side of zero for ``rows`` rows at least, shape (len(off) - rows + 1,)."""
    windows = np.lib.stride_tricks.sliding_window_view(off, min(rows, len(off)))
    return np.asarray(np.maximum(np.maximum(windows.min(axis=1), -windows.max(axis=1)), 0.0), np.float64)


def block_maxima(values: NDArray[np.float64], rows: int) -> NDArray[np.float64]:
    """Return the largest value of each block of ``rows`` rows; the rest at the end is a block of its own."""
    return np.maximum.reduceat(values, np.arange(0, len(values), max(rows, 1)))

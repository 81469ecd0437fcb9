"""Limits from the tail of healthy values (:mod:`gateway_fdi.tails`): they are exceeded once in ``HOURS`` hours."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gateway_fdi.tails import exceeded_once

#: Time in which a configuration may set one false code [h], and limits of one configuration that share it.
HOURS, SHARERS = 100.0, 100.0


def limit_above(maxima: NDArray[np.float64], block_s: float, floor: float) -> float:
    """Return what the maxima of healthy blocks exceed once in HOURS, in one of SHARERS limits.

    Args:
        maxima: of each block.
        block_s: length of a block [s].
        floor: mean excess at least: the resolution of what is measured.
    """
    return exceeded_once(maxima, HOURS * SHARERS * 3600.0 / block_s, floor)


def sustained(off: NDArray[np.float64], rows: int) -> NDArray[np.float64]:
    """Return how far a deviation stays on one side of zero for ``rows`` rows at least, shape (len(off) - rows + 1,)."""
    windows = np.lib.stride_tricks.sliding_window_view(off, min(rows, len(off)))
    return np.asarray(np.maximum(np.maximum(windows.min(axis=1), -windows.max(axis=1)), 0.0), np.float64)


def block_maxima(values: NDArray[np.float64], rows: int) -> NDArray[np.float64]:
    """Return the largest value of each block of ``rows`` rows; the rest at the end is a block of its own."""
    return np.maximum.reduceat(values, np.arange(0, len(values), max(rows, 1)))

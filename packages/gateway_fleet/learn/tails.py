"""How far healthy values go beyond those that were seen: the tail of the values seen, at a given rate of false alarms.

Above a high quantile of block maxima the excess is taken for exponential (peaks over threshold): its mean excess
says how much farther the next ones go. The limit is exceeded once in ``HOURS`` hours.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

#: Time in which a configuration may set one false code [h], and limits of one configuration that share it.
HOURS, SHARERS = 100.0, 100.0
#: Share of the blocks whose excess is taken for the tail, and how many they are at least.
SHARE, LEAST = 0.1, 5


def limit_above(maxima: NDArray[np.float64], block_s: float, floor: float) -> float:
    """Return what the maxima of healthy blocks exceed once in HOURS, in one of SHARERS limits.

    Args:
        maxima: of each block.
        block_s: length of a block [s].
        floor: mean excess at least: the resolution of what is measured.
    """
    count = max(LEAST, int(SHARE * len(maxima)))
    ordered = np.sort(maxima)
    threshold = float(ordered[max(len(ordered) - count - 1, 0)])
    excess = ordered[max(len(ordered) - count, 0) :] - threshold
    mean = max(float(excess.mean()), floor)
    blocks = HOURS * SHARERS * 3600.0 / block_s
    return threshold + mean * float(np.log(max(count / len(ordered) * blocks, 1.0)))


def sustained(off: NDArray[np.float64], rows: int) -> NDArray[np.float64]:
    """Return how far a deviation stays on one side of zero for ``rows`` rows at least, shape (len(off) - rows + 1,)."""
    windows = np.lib.stride_tricks.sliding_window_view(off, min(rows, len(off)))
    return np.asarray(np.maximum(np.maximum(windows.min(axis=1), -windows.max(axis=1)), 0.0), np.float64)


def block_maxima(values: NDArray[np.float64], rows: int) -> NDArray[np.float64]:
    """Return the largest value of each block of ``rows`` rows; the rest at the end is a block of its own."""
    return np.maximum.reduceat(values, np.arange(0, len(values), max(rows, 1)))

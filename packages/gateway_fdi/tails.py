"""Tail of healthy values: how far the next ones go beyond those that were seen.

Above a high quantile of block maxima the excess is taken for exponential (peaks over threshold): its mean excess says
how much farther the next ones go.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

#: Share of the blocks whose excess is taken for the tail, and how many they are at least.
SHARE, LEAST = 0.1, 5


def exceeded_once(maxima: NDArray[np.float64], blocks: float, floor: float = 0.0) -> float:
    """Return the level that the maxima of healthy blocks exceed once in a number of blocks.

    Args:
        maxima: of each block, shape (at least 1,).
        blocks: that number; it may be above that of the maxima.
        floor: mean excess at least: the resolution of what is measured.
    """
    count = max(LEAST, int(SHARE * len(maxima)))
    ordered = np.sort(maxima)
    threshold = float(ordered[max(len(ordered) - count - 1, 0)])
    excess = ordered[max(len(ordered) - count, 0) :] - threshold
    mean = max(float(excess.mean()), floor)
    return threshold + mean * float(np.log(max(count / len(ordered) * blocks, 1.0)))

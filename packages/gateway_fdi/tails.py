"""Tail of healthy values: how far the next ones go beyond those that were seen.

Above a high quantile of block maxima the excess is taken for exponential (peaks over threshold): its mean excess says
how much farther the next ones go. Where asked for, and where the excesses prove it, its law is a generalised Pareto
with a heavier tail (probability-weighted moments, Hosking and Wallis 1987).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

#: Share of the blocks whose excess is taken for the tail, and how many they are at least.
SHARE, LEAST = 0.1, 5
#: A tail is heavier than an exponential one if its shape is above zero by this many standard errors; largest shape.
PROVEN, HEAVIEST = 2.0, 0.5


def exceeded_once(maxima: NDArray[np.float64], blocks: float, floor: float = 0.0, *, heavy: bool = False) -> float:
    """Return the level that the maxima of healthy blocks exceed once in a number of blocks.

    Args:
        maxima: of each block, shape (at least 1,).
        blocks: that number; it may be above that of the maxima.
        floor: mean excess above the tail's threshold at least: the resolution of what is measured.
        heavy: the tail may be heavier than an exponential one.
    """
    count = max(LEAST, int(SHARE * len(maxima)))
    ordered = np.sort(maxima)
    threshold = float(ordered[max(len(ordered) - count - 1, 0)])
    excess = ordered[max(len(ordered) - count, 0) :] - threshold
    mean, shape = max(float(excess.mean()), floor), shape_of(excess) if heavy else 0.0
    farther = float(np.log(max(count / len(ordered) * blocks, 1.0)))
    if shape > 0.0:
        return threshold + mean * (1.0 - shape) * float(np.expm1(shape * farther)) / shape
    return threshold + mean * farther


def shape_of(excess: NDArray[np.float64]) -> float:
    """Return the shape of the generalised Pareto law of excesses in order, 0 (exponential) unless it is proven."""
    mean, count = float(excess.mean()), len(excess)
    weighted = float((excess * (1.0 - (np.arange(count) + 0.65) / count)).mean())
    if mean <= 2.0 * weighted or weighted <= 0.0:
        return 0.0
    shape = 2.0 - mean / (mean - 2.0 * weighted)
    return min(shape, HEAVIEST) if shape > PROVEN / float(np.sqrt(count)) else 0.0

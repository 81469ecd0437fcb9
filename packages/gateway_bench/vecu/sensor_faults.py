"""Faults of redundant analogue sensors, put into their readings before they are digitised."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Readings = NDArray[np.float64]


def impulses(shape: int | tuple[int, ...], rate: float, size: float, rng: np.random.Generator) -> Readings:
    """Return transient and intermittent faults to be added (paper 002, Fig. 7).

    Args:
        shape: of the readings.
        rate: probability that a sample is concerned, each on its own.
        size: largest amplitude; each is uniform between -size and size.
        rng: source of all randomness.
    """
    return np.where(rng.random(shape) < rate, rng.uniform(-size, size, shape), 0.0)


def offset(n: int, begin: int, end: int, size: float) -> Readings:
    """Return an offset from sample ``begin`` to ``end``, to be added."""
    k = np.arange(n)
    return np.where((k >= begin) & (k < end), size, 0.0)


def drift(n: int, begin: int, end: int, rate: float) -> Readings:
    """Return a drift from sample ``begin`` to ``end``, ``rate`` more each sample, to be added."""
    k = np.arange(n)
    return np.where((k >= begin) & (k < end), (k - begin + 1) * rate, 0.0)


def stuck(readings: Readings, begin: int, end: int) -> Readings:
    """Return readings that repeat that of sample ``begin`` until ``end``."""
    held = readings.copy()
    held[begin:end] = readings[begin]
    return held


def at_rail(readings: Readings, begin: int, end: int, level: float) -> Readings:
    """Return readings that lie at a supply rail from sample ``begin`` to ``end``."""
    held = readings.copy()
    held[begin:end] = level
    return held


def digitised(readings: Readings, span: float, bits: int) -> Readings:
    """Return what an ADC of 0 to ``span`` makes of readings; ``bits`` 0: they are clipped alone."""
    if bits == 0:
        return np.clip(readings, 0.0, span)
    step = span / (1 << bits)
    return np.clip(np.rint(readings / step), 0, (1 << bits) - 1) * step

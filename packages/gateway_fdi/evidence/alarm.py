"""Threshold of the likelihood ratio, from theory and healthy records, and how often it is exceeded in health.

Without a fault the doubled logarithm of the likelihood ratio of one fault at one onset is chi-square distributed, with
one degree of freedom. The largest one of all faults and onsets is that of many looks, of which only some are
independent, and a model that is a little wrong makes all of them larger. So

    rate(J) = looks * P(chi-square > J / scale)     maxima of a time h: P(max <= J) = exp(-h rate(J))

with looks an hour and a scale of at least 1 that are the likeliest ones for healthy maxima. No record says more of a
rate than that it is below 3 over its hours (with 95 %): :func:`supported`.
"""

from __future__ import annotations

from math import erfc, log, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from gateway_fdi.errors import InputError

#: Scales that are tried, and the largest J that is.
_SCALES, _MOST = np.geomspace(1.0, 30.0, 120), 1e5


class Law(NamedTuple):
    """Law of the largest ratio in health.

    Attributes:
        looks: independent ones an hour.
        scale: of the ratio, 1 where the model is right.
    """

    looks: float
    scale: float

    def rate(self, threshold: float) -> float:
        """Return how often a threshold is exceeded in an hour."""
        return self.looks * erfc(sqrt(0.5 * threshold / self.scale))

    def threshold(self, per_h: float) -> float:
        """Return the threshold that is exceeded this number of times in an hour.

        Raises:
            InputError: no number above 0.
        """
        if not per_h > 0.0:
            raise InputError("a number above 0", key="per_h", value=f"{per_h:g}")
        low, high = 0.0, _MOST
        while high - low > 1e-9 * high:
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self.rate(middle) > per_h else (low, middle)
        return high


def fit(maxima: ArrayLike, hours: float) -> Law:
    """Return the likeliest law of the maxima of healthy times.

    Args:
        maxima: largest ratio of each time, shape (at least 5,).
        hours: length of each [h].

    Raises:
        InputError: too few maxima, none above 0, or no hours.
    """
    values = np.asarray(maxima, np.float64)
    if values.ndim != 1 or len(values) < 5 or not np.isfinite(values).all() or not values.max() > 0.0:
        raise InputError("the maxima of five healthy times at least, numbers above 0", key="maxima")
    if not hours > 0.0:
        raise InputError("a number above 0", key="hours", value=f"{hours:g}")
    values = np.maximum(values, 1e-3)
    best, found = -np.inf, Law(0.0, 1.0)
    for scale in _SCALES:
        tails = np.array([erfc(sqrt(0.5 * value / scale)) for value in values])
        looks = len(values) / (hours * tails.sum())
        slopes = -0.5 * values / scale - 0.5 * np.log(2.0 * np.pi * values * scale)
        likelihood = float(len(values) * log(looks * hours) + slopes.sum() - looks * hours * tails.sum())
        if likelihood > best:
            best, found = likelihood, Law(float(looks), float(scale))
    return found


def supported(hours: float, confidence: float = 0.95) -> float:
    """Return the lowest rate of false alarms that healthy hours without one can show [1/h]."""
    return -log(1.0 - confidence) / hours

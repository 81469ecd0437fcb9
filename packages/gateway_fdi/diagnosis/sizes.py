"""One size of a component's error has to fit all residuals that depend on it.

Residuals are r = G s + n: gains, sizes, noise. Sizes are those of weighted least squares; the weighted sum of squares
that is left has a chi-square distribution with as many degrees of freedom as there are residuals more than sizes. So
a residual has to lie in the direction of the component's gains, as directional residuals do (Gertler, "Fault detection
and diagnosis in engineering systems", 1998). Gains are known to a share only: its error is noise, too, of a size that
the first fit gives.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from gateway_fdi.diagnosis.system import Floats

#: A misfit speaks no more than so much against a cause: its gains may be wrong altogether.
LEAST_CHANCE = 1e-9


class Fit(NamedTuple):
    """Sizes that fit best.

    Attributes:
        sizes: shape (components,).
        misfit: chi-square.
        degrees: of freedom.
    """

    sizes: Floats
    misfit: float
    degrees: int

    @property
    def chance(self) -> float:
        """Probability of as large a misfit by noise alone, :data:`LEAST_CHANCE` at least."""
        return max(chi2_beyond(self.misfit, self.degrees), LEAST_CHANCE)


def fit(residuals: Floats, gains: Floats, noise: Floats, gain_error: Floats) -> Fit:
    """Return the sizes that fit residuals best.

    Args:
        residuals: shape (tests,).
        gains: shape (tests, components); each has one that is not 0.
        noise: standard deviations, shape (tests,).
        gain_error: shares, shape (tests,).
    """
    expected = residuals
    for _ in range(2):  # the first time by what came, then by what the sizes say should have come
        spread = np.hypot(noise, gain_error * np.maximum(np.abs(residuals), np.abs(expected)))
        scaled = gains / spread[:, None]
        inverse = np.linalg.pinv(scaled)
        sizes = inverse @ (residuals / spread)
        expected = gains @ sizes
    rank = round(float(np.trace(scaled @ inverse)))
    left = (residuals - expected) / spread
    return Fit(sizes, float(left @ left), len(residuals) - rank)


def chi2_beyond(value: float, degrees: int) -> float:
    """Return the probability that chi-square with so many degrees of freedom is beyond a value; 1 for none.

    By the finite sums for whole degrees (Abramowitz and Stegun 26.4.4 and 26.4.5).
    """
    if degrees <= 0 or value <= 0.0:
        return 1.0
    half = 0.5 * value
    if degrees % 2:
        total, term, k = math.erfc(math.sqrt(half)), math.exp(-half) * math.sqrt(half) / math.gamma(1.5), 1.5
    else:
        total, term, k = 0.0, math.exp(-half), 1.0
    for _ in range(degrees // 2):
        total += term
        term *= half / k
        k += 1.0
    return min(total, 1.0)

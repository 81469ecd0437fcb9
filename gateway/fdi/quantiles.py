"""Quantiles of the distributions that thresholds come from, by scipy's special functions.

scipy.stats has them too, but takes half a second to load: as long as everything else of a start.
"""

from __future__ import annotations

from typing import Any

from scipy.special import gammainccinv, ndtri


def normal_above(share: Any) -> Any:
    """Return the value that a standard normal variable exceeds with a probability; also of arrays."""
    return -ndtri(share)


def chi2_above(share: Any, degrees: Any) -> Any:
    """Return the value that chi-square with so many degrees of freedom exceeds with a probability; also of arrays."""
    return 2.0 * gammainccinv(0.5 * degrees, share)

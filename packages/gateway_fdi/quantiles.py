"""Quantiles of the distributions that thresholds come from, by scipy's special functions.

scipy.stats has them too, but takes half a second to load. Even the special functions wait for the first who asks: most
monitors have no threshold that comes from a distribution.
"""

from __future__ import annotations

from typing import Any

from gateway_fdi.jit import f8s, i8s


def normal_above(share: float | f8s) -> Any:
    """Return the value that a standard normal variable exceeds with a probability; also of arrays."""
    from scipy.special import ndtri  # noqa: PLC0415 - slow to load

    return -ndtri(share)


def chi2_above(share: float | f8s, degrees: float | f8s | i8s) -> Any:
    """Return the value that chi-square with given degrees of freedom exceeds with a probability; also of arrays."""
    from scipy.special import gammainccinv  # noqa: PLC0415 - slow to load

    return 2.0 * gammainccinv(0.5 * degrees, share)

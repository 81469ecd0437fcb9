"""Test quantities: the CUSUM of a residual, paper 004, (26), normalised, (46).

    T := max(0, T + |r| - nu)          fires above J

nu is a healthy residual's mean and standard deviation; J is the largest healthy T over the margin Phi, and at least 25 nu
over it: (46) as printed divides by a largest T that may be zero. Beyond a limit T does not grow, so that it comes down
again when a fault is gone.
"""

from __future__ import annotations

from typing import Any

from gateway.jit import f8, kernel, record

CONST = record(nu=f8, threshold=f8, most=f8)
#: For calibration: ``peak``, the largest T_norm; ``samples``, ``total`` and ``squares`` of |r|.
STATE = record(value=f8, peak=f8, samples=f8, total=f8, squares=f8)

#: Limit of T in units of J.
MOST = 5.0


def prepare(c: Any, nu: float, threshold: float, most: float = MOST) -> None:
    """Fill a record of CONST."""
    c["nu"], c["threshold"], c["most"] = nu, threshold, most * threshold


@kernel
def update(s: Any, c: Any, residual: float) -> None:
    """Take a residual."""
    s.samples += 1.0
    s.total += abs(residual)
    s.squares += residual * residual
    s.value = min(max(0.0, s.value + abs(residual) - c.nu), c.most)
    s.peak = max(s.peak, s.value / c.threshold)


@kernel
def normalised(s: Any, c: Any) -> float:
    """Return T_norm: above 1 the test has fired."""
    return float(s.value / c.threshold)

"""CUSUM of a residual, paper 004, (26), normalised, (46), and nu and J from healthy residuals.

    T := max(0, T + |r| - nu)          fires above J

nu is a healthy residual's mean and standard deviation; J is the largest healthy T over the margin Phi, and at least 25
nu over it: (46) as printed divides by a largest T that may be zero, or a few nu by chance. Beyond a limit T does not
grow, so that it comes down again when a fault is gone.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import inf, sqrt

import numpy as np

from gateway_fdi.jit import Record, f8, f8s, kernel, means


class Const(Record):
    """Constants."""

    nu: f8 = means("drift")
    threshold: f8 = means("J")
    most: f8 = means("largest T")


class State(Record):
    """State; all but ``value`` is for calibration."""

    value: f8 = means("T")
    peak: f8 = means("largest T_norm")
    samples: f8 = means("residuals so far")
    total: f8 = means("sum of abs(r)")
    squares: f8 = means("sum of r^2")


#: Limit of T in units of J.
MOST = 5.0
#: Margin Phi of (46), and the least largest T in units of nu.
MARGIN, FLOOR = 0.5, 25.0
#: J that nothing reaches, in units of nu: in calibration T grows on, and its largest value is seen.
NEVER = 1e9
#: Healthy residuals that a nu takes.
LEAST = 100


def prepare(c: Const, nu: float, threshold: float, most: float = MOST) -> None:
    """Fill a record of Const."""
    c.nu, c.threshold, c.most = nu, threshold, most * threshold


@kernel
def grown(value: float, excess: float, most: float) -> float:
    """Return a sum that has taken what is beyond its drift, between 0 and the most it may be."""
    return min(max(0.0, value + excess), most)


@kernel
def observe(s: State, residual: float) -> None:
    """Take a residual into the sums that nu is found from."""
    s.samples += 1.0
    s.total += abs(residual)
    s.squares += residual * residual


@kernel
def update(s: State, c: Const, residual: float) -> float:
    """Take a residual; returns T_norm: above 1 the test has fired."""
    observe(s, residual)
    s.value = grown(s.value, abs(residual) - c.nu, c.most)
    norm = s.value / c.threshold
    s.peak = max(s.peak, norm)
    return float(norm)


def nus(residuals: Sequence[str], sums: f8s) -> dict[str, float]:
    """Return nu by residual: the largest of its quantities'; none of a residual with less than :data:`LEAST` samples.

    Args:
        residuals: residual of each quantity; empty: a quantity that has no nu.
        sums: samples, totals and squares of the quantities' moduli, shape (3, quantities).
    """
    found: dict[str, float] = {}
    for residual, (samples, total, squares) in zip(residuals, np.transpose(sums), strict=True):
        if residual and samples >= LEAST:
            found[residual] = max(found.get(residual, 0.0), typical(samples, total, squares))
    return found


def typical(samples: float, total: float, squares: float) -> float:
    """Return nu of healthy residuals: mean and one standard deviation of their moduli, from their sums."""
    mean = total / samples
    if not squares < inf:
        return inf
    return float(mean + sqrt(max(squares / samples - mean**2, 0.0)))


def threshold(largest: float, margin: float = MARGIN, floor: float = FLOOR) -> float:
    """Return J from the largest healthy T, both in units of nu, (46) with a floor."""
    return max(largest, floor) / margin

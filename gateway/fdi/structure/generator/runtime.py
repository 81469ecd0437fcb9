"""What generated residual generators call."""

from __future__ import annotations

import math

from gateway.jit import f8s, kernel


@kernel
def interpolate(x: f8s, y: f8s, at: float) -> float:
    """Return the function through points at ``at``: linear between them, constant beyond.

    Args:
        x: abscissas, rising, shape (points,).
        y: values, shape (points,).
        at: where.
    """
    last = len(x) - 1
    if not at > x[0]:
        return float(y[0]) if at <= x[0] else math.nan
    if at >= x[last]:
        return float(y[last])
    low, high = 0, last
    while high - low > 1:
        middle = (low + high) // 2
        if x[middle] <= at:
            low = middle
        else:
            high = middle
    return float(y[low] + (y[high] - y[low]) * (at - x[low]) / (x[high] - x[low]))


@kernel
def sign(value: float) -> float:
    """Return the sign of a value: -1, 0 or 1."""
    if value > 0.0:
        return 1.0
    return -1.0 if value < 0.0 else 0.0


@kernel
def root(value: float) -> float:
    """Return the square root of a value, NaN if there is none."""
    return math.sqrt(value) if value >= 0.0 else math.nan

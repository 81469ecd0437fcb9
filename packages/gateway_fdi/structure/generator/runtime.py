"""Functions that generated residual generators call."""

from __future__ import annotations

import math

from gateway_fdi.jit import f8s, kernel

#: Terms of the series after the first one, for a matrix of norm 1/2 to the last bit; most doublings of it.
_TERMS, _DOUBLINGS = 13, 64


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


@kernel
def incline(x: f8s, y: f8s, at: float) -> float:
    """Return the slope of :func:`interpolate` at ``at``: zero beyond the points.

    Args:
        x: abscissas, rising, shape (points,).
        y: values, shape (points,).
        at: where.
    """
    for k in range(len(x) - 1):
        if x[k] <= at < x[k + 1]:
            return float((y[k + 1] - y[k]) / (x[k + 1] - x[k]))
    return 0.0


@kernel
def _multiply(a: f8s, b: f8s, to: f8s, n: int) -> None:
    """Write the product of two matrices of n rows, each row by row."""
    for i in range(n):
        for j in range(n):
            total = 0.0
            for k in range(n):
                total += a[i * n + k] * b[k * n + j]
            to[i * n + j] = total


@kernel
def exponentials(z: f8s, phi: f8s, space: f8s, n: int) -> None:
    """Write phi0, phi1, phi2 of a matrix: Taylor's series of what is scaled to 1/2, then doubled again.

        phi2(2 z) = (phi0 phi2 + phi1 + phi2) / 4,   phi1(2 z) = (phi0 phi1 + phi1) / 2,   phi0(2 z) = phi0 phi0

    Args:
        z: the matrix, row by row, shape (n n,).
        phi: written, one after the other, shape (3 n n,).
        space: scratch, shape (2 n n,).
        n: rows.
    """
    size = n * n
    phi0, phi1, phi2, a, b = phi[:size], phi[size : 2 * size], phi[2 * size :], space[:size], space[size:]
    largest = 0.0
    for i in range(n):
        row = 0.0
        for j in range(n):
            row += abs(z[i * n + j])
        largest = max(largest, row)
    doublings, scale = 0, 1.0
    while largest * scale > 0.5 and doublings < _DOUBLINGS:
        scale *= 0.5
        doublings += 1
    factor = 1.0
    for k in range(2, _TERMS + 3):
        factor /= k
    for i in range(size):
        a[i] = z[i] * scale
        phi2[i] = factor if i % (n + 1) == 0 else 0.0
    for k in range(_TERMS + 2, 2, -1):
        factor *= k
        _multiply(a, phi2, b, n)
        for i in range(size):
            phi2[i] = b[i] + (factor if i % (n + 1) == 0 else 0.0)
    _multiply(a, phi2, phi1, n)
    for i in range(n):
        phi1[i * n + i] += 1.0
    _multiply(a, phi1, phi0, n)
    for i in range(n):
        phi0[i * n + i] += 1.0
    for _ in range(doublings):
        _multiply(phi0, phi2, a, n)
        _multiply(phi0, phi1, b, n)
        for i in range(size):
            phi2[i] = 0.25 * (a[i] + phi1[i] + phi2[i])
            phi1[i] = 0.5 * (b[i] + phi1[i])
        _multiply(phi0, phi0, a, n)
        for i in range(size):
            phi0[i] = a[i]


@kernel
def advance(jacobian: f8s, slopes: f8s, hold: f8s, dt: float) -> None:
    """Write what states move in a step, h phi1(h J) f + h phi2(h J) c (:mod:`.propagation`).

    The functions of h J are kept until it changes: a linear generator computes them once.

    Args:
        jacobian: J, row by row, shape (n n,) [1/s].
        slopes: f; c; what they move, which is written, 0 where it is no number; shape (3 n,).
        hold: kept: h J, phi0, phi1, phi2, and scratch, shape (6 n n,).
        dt: h [s].
    """
    n = len(slopes) // 3
    size = n * n
    same = hold[2 * size] != 0.0
    for i in range(size):
        z = jacobian[i] * dt
        if hold[i] != z:
            hold[i] = z
            same = False
    if not same:
        exponentials(hold[:size], hold[size : 4 * size], hold[4 * size :], n)
    for i in range(n):
        moved = 0.0
        for j in range(n):
            moved += hold[2 * size + i * n + j] * slopes[j] + hold[3 * size + i * n + j] * slopes[n + j]
        moved *= dt
        slopes[2 * n + i] = moved if math.isfinite(moved) else 0.0

"""Covariances of Kalman filters with up to five states, of which the first two are measured (paper 001, (43) to (45)).

Matrices are flat, row by row, ``p[i * n + j]``. Correction: (42) evaluates g at the predicted state x(k|k-1).
"""

from __future__ import annotations

from gateway_fdi.jit import f8s, kernel

#: Largest number of states, and of entries of a covariance.
STATES, ENTRIES = 5, 25


@kernel
def propagate(p: f8s, f: f8s, q: f8s, w: f8s, n: int) -> None:
    """P = F P F^T + Q, (45), in place.

    Args:
        p: covariance, n x n.
        f: Jacobian, n x n.
        q: process noise, n x n.
        w: room for n x n.
        n: states.
    """
    for i in range(n):
        for j in range(n):
            total = 0.0
            for k in range(n):
                total += f[i * n + k] * p[k * n + j]
            w[i * n + j] = total
    for i in range(n):
        for j in range(i + 1):
            total = q[i * n + j]
            for k in range(n):
                total += w[i * n + k] * f[j * n + k]
            p[i * n + j] = total
            p[j * n + i] = total


@kernel
def correct(x: f8s, p: f8s, w: f8s, y_1: float, y_2: float, r: float, n: int) -> float:
    """Correct state and covariance by measurements of states 0 and 1, (42) to (44), in place.

    Args:
        x: state, n.
        p: covariance, n x n.
        w: room for n x n.
        y_1: measured state 0.
        y_2: measured state 1.
        r: variance of each, independent.
        n: states.

    Returns:
        the normalised innovation squared: chi-square with two degrees of freedom if the model holds.
    """
    v_1, v_2 = y_1 - x[0], y_2 - x[1]
    a, b, d = p[0] + r, p[1], p[n + 1] + r
    inverse = 1.0 / (a * d - b * b)
    nis = (d * v_1 * v_1 - 2.0 * b * v_1 * v_2 + a * v_2 * v_2) * inverse
    for i in range(n):
        k_1 = (p[i * n] * d - p[i * n + 1] * b) * inverse
        k_2 = (p[i * n + 1] * a - p[i * n] * b) * inverse
        x[i] += k_1 * v_1 + k_2 * v_2
        for j in range(n):
            w[i * n + j] = p[i * n + j] - k_1 * p[j] - k_2 * p[n + j]
    for i in range(n):
        for j in range(n):
            p[i * n + j] = 0.5 * (w[i * n + j] + w[j * n + i])
    return float(nis)


@kernel
def anchor(x: f8s, p: f8s, w: f8s, state: int, innovation: float, r: float, n: int) -> None:
    """Correct by a measurement of one state; its innovation comes from the caller, which knows how to wrap it."""
    s = 1.0 / (p[state * n + state] + r)
    for i in range(n):
        gain = p[i * n + state] * s
        x[i] += gain * innovation
        for j in range(n):
            w[i * n + j] = p[i * n + j] - gain * p[state * n + j]
    for i in range(n):
        for j in range(n):
            p[i * n + j] = 0.5 * (w[i * n + j] + w[j * n + i])

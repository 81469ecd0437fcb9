"""A motor's extended Kalman filters: up to five states, of which the first two are measured (paper 001, (43) to (45)).

Within a step they run in Euler sub-steps. Matrices are flat, row by row, ``p[i * n + j]``. Correction: (42) evaluates g
at the predicted state x(k|k-1).
"""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from gateway_fdi.filters import motor
from gateway_fdi.jit import Record, f8, f8s, i8, kernel, means

#: Largest number of states, and of entries of a covariance.
STATES, ENTRIES = 5, 25


class Const(Record):
    """Constants."""

    motor: motor.Const = means("the motor")
    n: i8 = means("states in use")
    steps: i8 = means("Euler sub-steps in a period")
    h: f8 = means("length of a sub-step", "s")
    q: Annotated[f8s, ENTRIES] = means("process noise of a sub-step")
    r: f8 = means("variance of a current", "A^2")
    start: Annotated[f8s, STATES] = means("variances at the start")


class State(Record):
    """State."""

    x: Annotated[f8s, STATES] = means("states: two currents [A], and what the filter says")
    p: Annotated[f8s, ENTRIES] = means("covariance of x")
    f: Annotated[f8s, ENTRIES] = means("Jacobian F")
    w: Annotated[f8s, ENTRIES] = means("room for products")
    nis: f8 = means("normalised innovation squared")
    started: i8 = means("1: it has begun")


def prepare(
    c: Any, m: motor.Motor, a: NDArray[np.float64], noise: list[float], period: float, steps: int, current: float
) -> NDArray[np.float64]:
    """Fill a record of Const but for ``q`` and ``start``; returns the process noise of a sub-step, shape (n, n).

    Args:
        a: slopes of the states by the states, around rest, shape (n, n).
        noise: of each slope, density.
        period: of a step [s].
        steps: Euler sub-steps.
        current: standard deviation of a measured current [A].
    """
    from filterpy.common import van_loan_discretization  # noqa: PLC0415 - slow to load

    motor.prepare(c.motor, m)
    c.n, c.steps, c.h, c.r = len(a), steps, period / steps, current**2
    return np.asarray(van_loan_discretization(a, np.diag(noise), period / steps)[1])


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

"""Luenberger observer of the speed (paper 001, equations (19) to (24)).

States (I_q, omega), input U_q, output I_q. (19) is used with the torque constant 3/2 c_M (see :mod:`.motor`). It is
discretised exactly with the input held (its mean over the step, as it comes over CAN) and the gain placed there:

    x(k+1|k) = A_d x(k) + B_d u(k),   x(k) = x(k|k-1) + K (I_q(k) - x_1(k|k-1))

so that the error runs with (I - K C) A_d. An unknown load M leaves a speed error; in continuous time it is
-(M/J) (p_1 + p_2 - b/J) / (p_1 p_2), at poles -p_1, -p_2. The Park transform uses the sensor that is monitored: the
paper's own rule, that a filter uses only signals independent of what it checks, is broken by this method.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np

from gateway_fdi.filters.motor import Motor
from gateway_fdi.jit import Record, f8, f8s, kernel, means


class Const(Record):
    """Constants."""

    a: Annotated[f8s, 4] = means("A_d")
    b: Annotated[f8s, 2] = means("B_d")
    k: Annotated[f8s, 2] = means("K")
    period: f8 = means("time between measurements", "s")


class State(Record):
    """State."""

    current: f8 = means("I_q", "A")
    omega: f8 = means("speed", "rad/s")
    theta: f8 = means("mechanical angle, the integral of the speed", "rad")


def design(
    motor: Motor, period: float, poles: tuple[float, float] = (-700.0, -800.0)
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return A_d, B_d and K for continuous poles [1/s] at a period [s]."""
    from filterpy.common import van_loan_discretization  # noqa: PLC0415 - slow to load
    from scipy.signal import cont2discrete, place_poles  # noqa: PLC0415 - slow to load

    a, b, c = motor.linear
    # Without noise van Loan's method gives the transition matrix alone; the input's comes from scipy.
    a_d, _ = van_loan_discretization(a, np.zeros((2, 1)), period)
    b_d = cont2discrete((a, b, c, np.zeros((1, 1))), period)[1]
    gain = place_poles(a_d.T, (c @ a_d).T, np.exp(np.array(poles) * period)).gain_matrix.T
    return np.asarray(a_d), np.asarray(b_d), np.asarray(gain)


def prepare(c: Const, motor: Motor, period: float, poles: tuple[float, float] = (-700.0, -800.0)) -> None:
    """Fill a record of Const; period [s], continuous poles [1/s]."""
    a, b, k = design(motor, period, poles)
    c.a, c.b, c.k, c.period = a.ravel(), b.ravel(), k.ravel(), period


@kernel
def step(s: State, c: Const, u_q: float, i_q: float) -> None:
    """Take one step.

    Args:
        u_q: mean voltage over the step that ends now [V].
        i_q: current now [A].
    """
    current = c.a[0] * s.current + c.a[1] * s.omega + c.b[0] * u_q
    omega = c.a[2] * s.current + c.a[3] * s.omega + c.b[1] * u_q
    residual = i_q - current
    before = s.omega
    s.current = current + c.k[0] * residual
    s.omega = omega + c.k[1] * residual
    s.theta += 0.5 * (before + s.omega) * c.period

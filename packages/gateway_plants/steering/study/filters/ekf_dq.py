"""Extended Kalman filter in rotor co-ordinates (paper 001, equations (34) to (45)), with or without the load.

States (I_d, I_q, omega) and, as the paper's "extra state", the load torque M, a random walk. The model is that of
:mod:`.motor`; within a step it runs in Euler sub-steps h, of which the Jacobian is::

    F = [ 1 - h R/L_d            h z_p omega L_q/L_d      h z_p L_q I_q/L_d              0
          -h z_p omega L_d/L_q   1 - h R/L_q              -h z_p (psi + L_d I_d)/L_q     0
          3/2 h z_p (L_d-L_q) I_q/J   3/2 h z_p (psi + (L_d-L_q) I_d)/J   1 - h b/J   -h/J
          0                      0                        0                              1 ]     (40), corrected

Correction: row 3 of the printed (40) has T c_M/J in the column of I_d and 0 in that of I_q: swapped, and without
3/2 and reluctance. In one step of 1 ms 1 - T R/L is 0.4, at 3.3 ms it is unstable: hence the sub-steps.

The Park transform uses the sensor that is monitored, or, with ``own``, the filter's own angle.
"""

from __future__ import annotations

import numpy as np

from gateway_fdi.filters import gaussian, motor
from gateway_fdi.filters.motor import Motor
from gateway_fdi.jit import f8, kernel, means


class Const(gaussian.Const):
    """Constants; 3 states are in use, or 4 with the load."""


class State(gaussian.State):
    """State; ``x``: I_d, I_q [A], omega [rad/s], M [N m]."""

    theta: f8 = means("angle of its own, mechanical", "rad")


def prepare(
    c: Const,
    m: Motor,
    period: float,
    *,
    load: bool,
    steps: int = 8,
    voltage: float = 0.06,
    torque: float = 0.1,
    wander: float = 2.0,
    current: float = 0.13,
) -> None:
    """Fill a record of Const.

    Args:
        period: of a step [s].
        load: with the load torque as fourth state.
        steps: Euler sub-steps.
        voltage: standard deviation of the voltages' mean over a step [V].
        torque: of what torque the model does not know, over a step [N m].
        wander: of the load's change in a second [N m]; unused without it.
        current: of a measured current [A].
    """
    n = 4 if load else 3
    a = np.zeros((n, n))
    a[0, 0], a[1, 1], a[1, 2] = -m.resistance / m.ld, -m.resistance / m.lq, -m.emf / m.lq
    a[2, 1], a[2, 2] = m.torque / m.inertia, -m.friction / m.inertia
    if load:
        a[2, 3] = -1.0 / m.inertia
    intensity = np.sqrt(period)  # a mean over a step, as white noise
    noise = [x * intensity for x in (voltage / m.ld, voltage / m.lq, torque / m.inertia)] + [wander] * load
    c.q[: n * n] = gaussian.prepare(c, m, a, noise, period, steps, current).ravel()
    c.start[:n] = [1.0, 1.0, 100.0, 1.0][:n]


@kernel
def _advance(s: State, c: Const, u_d: float, u_q: float) -> None:
    """Take an Euler sub-step of state and covariance."""
    m, x, f, n, h = c.motor, s.x, s.f, c.n, c.h
    i_d, i_q, omega = x[0], x[1], x[2]
    electrical = m.pole_pairs * omega
    for k in range(n * n):
        f[k] = 0.0
    f[0] = 1.0 - h * m.resistance / m.ld
    f[1] = h * electrical * m.lq / m.ld
    f[2] = h * m.pole_pairs * m.lq * i_q / m.ld
    f[n] = -h * electrical * m.ld / m.lq
    f[n + 1] = 1.0 - h * m.resistance / m.lq
    f[n + 2] = -h * m.pole_pairs * (m.flux + m.ld * i_d) / m.lq
    share = 1.5 * h * m.pole_pairs / m.inertia
    f[2 * n] = share * (m.ld - m.lq) * i_q
    f[2 * n + 1] = share * (m.flux + (m.ld - m.lq) * i_d)
    f[2 * n + 2] = 1.0 - h * m.friction / m.inertia
    load = 0.0
    if n == 4:
        f[2 * n + 3] = -h / m.inertia
        f[3 * n + 3] = 1.0
        load = x[3]
    x[0] = i_d + h * (u_d - m.resistance * i_d + electrical * m.lq * i_q) / m.ld
    x[1] = i_q + h * (u_q - m.resistance * i_q - electrical * (m.ld * i_d + m.flux)) / m.lq
    x[2] = omega + h * (motor.torque(m, i_d, i_q) - m.friction * omega - load) / m.inertia
    s.theta += h * 0.5 * (omega + x[2])
    gaussian.propagate(s.p, f, c.q, s.w, n)


@kernel
def predict(s: State, c: Const, u_d: float, u_q: float) -> None:
    """Predict over a step, (41), (45); voltages: means over it [V]."""
    n = c.n
    if s.started == 0:
        s.started = 1
        for k in range(n):
            s.p[k * n + k] = c.start[k]
    for _ in range(c.steps):
        _advance(s, c, u_d, u_q)


@kernel
def correct(s: State, c: Const, i_d: float, i_q: float) -> None:
    """Correct by the currents, (42) to (44) [A]; ``s.nis`` is the normalised innovation squared."""
    s.nis = gaussian.correct(s.x, s.p, s.w, i_d, i_q, c.r, c.n)


@kernel
def step(s: State, c: Const, u_d: float, u_q: float, i_d: float, i_q: float) -> None:
    """Take one step: predict with the voltages, correct by the currents."""
    predict(s, c, u_d, u_q)
    correct(s, c, i_d, i_q)

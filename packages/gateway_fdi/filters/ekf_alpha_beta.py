"""Extended Kalman filter in stator co-ordinates with the angle as a state, and optionally the load.

The paper's remark after Fig. 7, "an extra state for the EKF", carried out: (17), (18) with the electrical angle and
L = (L_d + L_q)/2, and the torque of (14) corrected (see :mod:`.motor`)::

    L dI_alpha/dt = U_alpha - R I_alpha + psi z_p omega sin(z_p theta)
    L dI_beta/dt  = U_beta  - R I_beta  - psi z_p omega cos(z_p theta)
    J domega/dt = 3/2 z_p psi (I_beta cos(z_p theta) - I_alpha sin(z_p theta)) - b omega - M
    dtheta/dt = omega,   dM/dt = 0

States (I_alpha, I_beta, omega, theta, M). It uses no angle sensor while the motor turns. At standstill the EMF says
nothing of the angle, and a wrong resistance under load makes the filter believe in a motion: :func:`hold` anchors
the angle there at the sensor. The voltages come in the frame in which the controller made them, with that frame's
turn during the step, so that a turning frame costs nothing.
"""

from __future__ import annotations

from math import cos, pi, sin

import numpy as np

from gateway_fdi.filters import gaussian
from gateway_fdi.filters.gaussian import STATES
from gateway_fdi.filters.motor import Motor
from gateway_fdi.filters.transforms import inverse_park, wrap
from gateway_fdi.jit import f8, i8, kernel, means


class Const(gaussian.Const):
    """Constants; 4 states are in use, or 5 with the load."""

    inductance: f8 = means("L", "H")
    slow: f8 = means("speed below which the angle is anchored; 0: never", "rad/s")
    sensor: f8 = means("variance of the angle it is anchored at", "rad^2")


class State(gaussian.State):
    """State; ``x``: I_alpha, I_beta [A], omega [rad/s], theta [rad], M [N m]."""

    resistance: f8 = means("R, as warm as it is; may be set between steps", "Ohm")
    held: i8 = means("1: anchored in the last step")


def prepare(
    c: Const,
    m: Motor,
    period: float,
    *,
    load: bool = True,
    steps: int = 8,
    voltage: float = 0.0073,
    torque: float = 0.026,
    wander: float = 1.0,
    current: float = 0.35,
    slow: float = 15.0,
    sensor: float = 0.01,
) -> None:
    """Fill a record of Const.

    Args:
        period: of a step [s].
        load: with the load torque as fifth state.
        steps: Euler sub-steps.
        voltage: standard deviation of the voltages' mean over a step [V].
        torque: of what torque the model does not know, over a step [N m].
        wander: of the load's change in a second [N m]; unused without it.
        current: of a measured current [A].
        slow: below this speed :func:`hold` anchors the angle [rad/s]; 0: never.
        sensor: standard deviation of the angle it is anchored at [rad].
    """
    inductance = 0.5 * (m.ld + m.lq)
    n = 5 if load else 4
    c.inductance, c.slow, c.sensor = inductance, slow, sensor**2
    a = np.zeros((n, n))
    a[0, 0] = a[1, 1] = -m.resistance / inductance
    a[1, 2] = -m.emf / inductance
    a[2, 1], a[2, 2], a[3, 2] = m.torque / m.inertia, -m.friction / m.inertia, 1.0
    intensity = np.sqrt(period)  # a mean over a step, as white noise
    noise = [voltage / inductance * intensity] * 2 + [torque / m.inertia * intensity, 0.0]
    if load:
        a[2, 4] = -1.0 / m.inertia
    q = gaussian.prepare(c, m, a, noise + [wander] * load, period, steps, current)
    q[0, 0] = q[1, 1] = 0.5 * (q[0, 0] + q[1, 1])  # the frame of the linearisation is no direction
    q[:2, 2:] = q[2:, :2] = 0.0
    q[0, 1] = q[1, 0] = 0.0
    c.q[: n * n] = q.ravel()
    c.start[:n] = [1.0, 1.0, 1.0, 1e-4, 0.1][:n]


@kernel
def begin(s: State, c: Const, theta: float) -> None:
    """Start at rest at a mechanical angle [rad]."""
    n = c.n
    s.started = 1
    s.resistance = c.motor.resistance
    for k in range(n * n):
        s.p[k] = 0.0
    for k in range(n):
        s.x[k] = 0.0
        s.p[k * n + k] = c.start[k]
    s.x[3] = theta


@kernel
def _advance(s: State, c: Const, u_alpha: float, u_beta: float) -> None:
    """Take an Euler sub-step of state and covariance."""
    m, x, f, n, h = c.motor, s.x, s.f, c.n, c.h
    resistance, inductance = s.resistance, c.inductance
    z = m.pole_pairs
    i_alpha, i_beta, omega = x[0], x[1], x[2]
    cosine, sine = cos(z * x[3]), sin(z * x[3])
    flux = m.flux * z
    pull = 1.5 * flux / m.inertia
    for k in range(n * n):
        f[k] = 0.0
    f[0] = f[n + 1] = 1.0 - h * resistance / inductance
    f[2] = h * flux * sine / inductance
    f[3] = h * flux * omega * z * cosine / inductance
    f[n + 2] = -h * flux * cosine / inductance
    f[n + 3] = h * flux * omega * z * sine / inductance
    f[2 * n] = -h * pull * sine
    f[2 * n + 1] = h * pull * cosine
    f[2 * n + 2] = 1.0 - h * m.friction / m.inertia
    f[2 * n + 3] = -h * pull * z * (i_beta * sine + i_alpha * cosine)
    f[3 * n + 2] = h
    f[3 * n + 3] = 1.0
    load = 0.0
    if n == STATES:
        f[2 * n + 4] = -h / m.inertia
        f[4 * n + 4] = 1.0
        load = x[4]
    x[0] = i_alpha + h * (u_alpha - resistance * i_alpha + flux * omega * sine) / inductance
    x[1] = i_beta + h * (u_beta - resistance * i_beta - flux * omega * cosine) / inductance
    pulled = pull * (i_beta * cosine - i_alpha * sine)
    x[2] = omega + h * (pulled - (m.friction * omega + load) / m.inertia)
    x[3] += h * omega
    gaussian.propagate(s.p, f, c.q, s.w, n)


@kernel
def predict(s: State, c: Const, u_d: float, u_q: float, frame: float, turned: float) -> None:
    """Predict over a step, (41), (45).

    Args:
        u_d: mean voltage over the step, in the controller's frame [V].
        u_q: likewise.
        frame: electrical angle of that frame at the begin of the step [rad].
        turned: by which it turned during the step [rad].
    """
    if s.started == 0:
        begin(s, c, 0.0)
    for k in range(c.steps):
        angle = frame + turned * (k + 0.5) / c.steps
        u_alpha, u_beta = inverse_park(u_d, u_q, angle)
        _advance(s, c, u_alpha, u_beta)


@kernel
def correct(s: State, c: Const, i_alpha: float, i_beta: float) -> None:
    """Correct by the currents, (42) to (44) [A]; ``s.nis`` is the normalised innovation squared."""
    s.nis = gaussian.correct(s.x, s.p, s.w, i_alpha, i_beta, c.r, c.n)


@kernel
def hold(s: State, c: Const, theta: float, doubt: float) -> None:
    """Anchor the angle at the sensor's while the motor is slow.

    Args:
        theta: the sensor's angle [rad, mechanical].
        doubt: factor of the sensor's standard deviation, 1 if nothing is known against it.
    """
    s.held = 0
    if abs(s.x[2]) < c.slow:
        s.held = 1
        innovation = wrap(theta - s.x[3], 2.0 * pi / c.motor.pole_pairs)
        gaussian.anchor(s.x, s.p, s.w, 3, innovation, c.sensor * doubt * doubt, c.n)


@kernel
def step(
    s: State,
    c: Const,
    u_d: float,
    u_q: float,
    frame: float,
    turned: float,
    i_alpha: float,
    i_beta: float,
) -> None:
    """Take one step: predict with the voltages, correct by the currents; arguments as above."""
    predict(s, c, u_d, u_q, frame, turned)
    correct(s, c, i_alpha, i_beta)

"""T7: an observer of the vehicle's motion that also estimates what a road, a load, an engine and brakes make wrong.

The paper's T3 and T4 take their model's torque as true: an engine 2 % too strong or an unknown slope of 0.3 % moves
them like a fault. Here these are states beside the wheels' speed, and so are the errors of the machine's torque
as motor and as generator. With p the errors and h what each does to the wheels' acceleration (:func:`_sensitivities`),

    d omega_w / dt = T_net / J + h' p                 (e30 of paper 004, corrected)
    omega_gb       = u_f omega_w + noise              (e32, e37)
    d slope / dx   = curve - slope / L                (x is the way: a road changes while one drives)
    d curve / dx   = -curve / l + white noise
    d p_k / dt     = -p_k / tau_k + white noise       (the others; the machine's: noise only, and only while it is used)

a Kalman filter whose prediction is the residual generator T7 and whose innovation is that generator's residual (36):
the observer feeds it back. Between two windows in which the model holds, p goes on as above.

The test is Wald's: w = a' (P_a + Sigma_0)^-1 a, a the machine's two errors, P_a their covariance, Sigma_0 what the
model's own error may make of them. It fires above a threshold.
"""

from __future__ import annotations

from math import isfinite
from typing import Annotated

import numpy as np

from gateway_fdi.jit import Record, f8, f8s, kernel, means
from gateway_plants.truck.monitor.generated import t7

#: Errors by their place: torque of the machine as motor, as generator, of the engine, slope [rad], mass, torque of the
#: brakes, curve of the road [rad/m].
MOTOR, GENERATOR, ENGINE, SLOPE, MASS, BRAKE, CURVE = range(7)
ERRORS = 7
_STATES = ERRORS + 1
#: What the statistic reaches without a fault at least: chi-square of two numbers, one sample in five hundred.
FLOOR = 12.5


class Const(Record):
    """Constants; errors are in the order of MOTOR to CURVE."""

    start: f8 = means("variance of the first speed", "(rad/s)^2")
    torque: f8 = means("noise of the acceleration", "rad^2/s^3")
    noise: f8 = means("noise of the measured speed", "(rad/s)^2")
    prior: Annotated[f8s, ERRORS] = means("variance of the errors")
    drift: Annotated[f8s, ERRORS] = means("variance that errors take on [1/s], the curve [rad^2/m^3]")
    forget: Annotated[f8s, ERRORS] = means("what errors lose [1/s], slope and curve [1/m]")
    own: f8 = means("diagonal of Sigma_0")
    least: f8 = means("torque of a machine that is used", "Nm")
    threshold: f8 = means("threshold of the statistic")


class State(Record):
    """State; errors are in the order of MOTOR to CURVE."""

    error: Annotated[f8s, ERRORS] = means("p, what is found of each error")
    does: Annotated[f8s, ERRORS] = means("h, what each error does to the wheels' acceleration", "rad/s^2")
    P: Annotated[f8s, _STATES, _STATES] = means("covariance of the wheels' speed and the errors")
    gain: Annotated[f8s, _STATES] = means("Kalman gain")
    norm: f8 = means("the statistic over its threshold")
    peak: f8 = means("largest norm, for calibration")
    samples: f8 = means("statistics so far, for calibration")


def prepare(s: State, c: Const) -> None:
    """Let the covariance begin at the prior."""
    s.P = np.diag([c.start, *c.prior])


def curve(slope: float, way: float, curve_way: float) -> float:
    """Return the variance of the curve that keeps a slope's at ``slope``, with L and l [m]; [rad2/m2]."""
    return slope * (way + curve_way) / (way * way * curve_way)


@kernel
def restart(s: State, c: Const) -> None:
    """Begin a window: the speed is new, the errors are what they were."""
    s.P[0, :] = 0.0
    s.P[:, 0] = 0.0
    s.P[0, 0] = c.start
    s.does[:] = 0.0


@kernel
def _drive_on(s: State, c: Const, dt: float, way: float) -> None:
    """Take the errors and their covariance on in time and way."""
    for k in range(ENGINE, ERRORS):
        on_road = k in (SLOPE, CURVE)
        keep = 1.0 - c.forget[k] * (way if on_road else dt)
        turn = way if k == SLOPE else 0.0
        # The curve stands behind the slope, so that it is still the one before.
        s.error[k] = keep * s.error[k] + turn * s.error[CURVE]
        for j in range(_STATES):
            s.P[k + 1, j] = keep * s.P[k + 1, j] + turn * s.P[CURVE + 1, j]
        for j in range(_STATES):
            s.P[j, k + 1] = keep * s.P[j, k + 1] + turn * s.P[j, CURVE + 1]
        s.P[k + 1, k + 1] += c.drift[k] * (way if on_road else dt)
    for k in range(ENGINE):
        if s.does[k] != 0.0:
            s.P[k + 1, k + 1] += dt * c.drift[k]


@kernel
def age(s: State, c: Const, dt: float, way: float) -> None:
    """Drive on while nothing is known of the motion; a machine that is not used stays as it was."""
    s.does[MOTOR], s.does[GENERATOR] = 0.0, 0.0
    _drive_on(s, c, dt, way)


@kernel
def _sensitivities(s: State, g: t7.State, q: t7.Const, brake: float, least: float) -> None:
    """Compute what each error does to the acceleration of the wheels [rad/s2]; g, q are state and constants of T7."""
    inertia = g.shown_J_tot * q.u_f**2 + g.shown_m_v * q.r_w**2
    through = g.shown_eta_gb * g.shown_u_gb * q.u_f / inertia
    omega_em = q.u_em * g.shown_u_gb * q.u_f * g.omega_w
    torque = (g.shown_T_em + q.c_em_f * omega_em) * q.u_em
    # What is less than the noise of its current is not excited.
    s.does[MOTOR] = through * torque if torque > least else 0.0
    s.does[GENERATOR] = through * torque if torque < -least else 0.0
    s.does[ENGINE] = through * g.shown_T_c
    weight = g.shown_m_v * q.g * q.r_w
    s.does[SLOPE] = -weight / inertia
    s.does[MASS] = -(g.shown_m_v * q.r_w**2 * g.d_omega_w + weight * q.C_r) / inertia
    s.does[BRAKE] = -brake / inertia
    s.does[CURVE] = 0.0


@kernel
def _predict(s: State, c: Const, dt: float, way: float) -> None:
    """Take the covariance a step on, P := F P F' + Q; the speed's row of F is (1, dt h')."""
    for j in range(1, _STATES):
        row = 0.0
        for k in range(ERRORS):
            row += s.does[k] * s.P[k + 1, j]
        s.P[0, j] += dt * row
    own = 0.0
    for k in range(ERRORS):
        own += s.does[k] * (s.P[k + 1, 0] + s.P[0, k + 1])
    s.P[0, 0] += dt * own + dt * c.torque
    for j in range(1, _STATES):
        s.P[j, 0] = s.P[0, j]
    _drive_on(s, c, dt, way)


@kernel
def update(s: State, c: Const, g: t7.State, q: t7.Const, innovation: float, brake: float, dt: float) -> None:
    """Take a sample.

    Args:
        g: state of the residual generator T7; its speed and acceleration are corrected.
        innovation: its residual [rad/s].
        brake: torque asked for [Nm].
        dt: since the sample before [s]; 0 is the first of a window.
    """
    if not isfinite(innovation):
        return
    if dt > 0.0:
        _predict(s, c, dt, dt * g.omega_w * q.r_w)
    size = q.u_f * q.u_f * s.P[0, 0] + c.noise
    for j in range(_STATES):
        s.gain[j] = q.u_f * s.P[j, 0] / size
    for j in range(_STATES):
        for k in range(j, _STATES):
            s.P[j, k] -= s.gain[j] * s.gain[k] * size
            s.P[k, j] = s.P[j, k]
    g.omega_w += s.gain[0] * innovation
    for k in range(ERRORS):
        s.error[k] += s.gain[k + 1] * innovation
    _sensitivities(s, g, q, brake, c.least)
    for k in range(ERRORS):
        g.d_omega_w += s.does[k] * s.error[k]
    s.samples += 1.0
    s.norm = wald(s, c) / c.threshold
    s.peak = max(s.peak, s.norm)


@kernel
def wald(s: State, c: Const) -> float:
    """Return the statistic of the machine's two errors."""
    a, b = s.error[MOTOR], s.error[GENERATOR]
    aa, bb, ab = s.P[1, 1] + c.own, s.P[2, 2] + c.own, s.P[1, 2]
    return float((a * a * bb - 2.0 * a * b * ab + b * b * aa) / (aa * bb - ab * ab))

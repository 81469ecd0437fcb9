"""Reduced Luenberger observer of the speed (paper 001, equations (25) to (33)).

With x_B = omega_hat - K_r I_q, and dI_q/dt and domega/dt from (19) put into (31)::

    dx_B/dt = a x_B + (a K_r + k_t/J + K_r R/L) I_q - K_r/L U_q,   a = -b/J + K_r c_M/L      (32), corrected
    omega_hat = x_B + K_r I_q                                                                (33), corrected

Corrections: the printed (32) lacks K_r beside c_M/L (twice), has z_p R/L where K_r R/L belongs, and the wrong sign
before U_q; the printed (33) has a dot on omega_hat. As printed, the pole lies at -b/J + c_M/L, +296 1/s with the
default motor: unstable. The pole is at a = -p for K_r = (b/J - p) L / c_M. A load M leaves the error -M/(J p).
"""

from __future__ import annotations

from math import exp

from gateway_fdi.filters.motor import Motor
from gateway_fdi.jit import Record, f8, kernel, means


class Const(Record):
    """Constants."""

    a: f8 = means("transition of x_B over a period")
    current: f8 = means("share of a mean current in x_B", "rad/s/A")
    voltage: f8 = means("share of a mean voltage in x_B", "rad/s/V")
    gain: f8 = means("K_r", "rad/s/A")
    period: f8 = means("time between measurements", "s")


class State(Record):
    """State."""

    x: f8 = means("x_B", "rad/s")
    omega: f8 = means("speed", "rad/s")
    theta: f8 = means("mechanical angle, the integral of the speed", "rad")
    current: f8 = means("I_q of the last step", "A")


def prepare(c: Const, motor: Motor, period: float, pole: float = -700.0) -> None:
    """Fill a record of Const for a continuous pole [1/s], discretised exactly; period [s]."""
    gain = (motor.friction / motor.inertia + pole) * motor.lq / motor.emf
    a = pole
    c.a = exp(a * period)
    held = (c.a - 1.0) / a
    c.current = held * (a * gain + motor.torque / motor.inertia + gain * motor.resistance / motor.lq)
    c.voltage = -held * gain / motor.lq
    c.gain, c.period = gain, period


@kernel
def step(s: State, c: Const, u_q: float, i_q: float) -> None:
    """Take one step; the current in between is taken for the mean of both ends.

    Args:
        u_q: mean voltage over the step that ends now [V].
        i_q: current now [A].
    """
    s.x = c.a * s.x + c.current * 0.5 * (s.current + i_q) + c.voltage * u_q
    s.current = i_q
    before = s.omega
    s.omega = s.x + c.gain * i_q
    s.theta += 0.5 * (before + s.omega) * c.period

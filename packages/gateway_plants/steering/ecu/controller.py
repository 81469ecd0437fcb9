"""Field oriented control of the steering's motor at 10 kHz: position, speed and current loops in cascade.

It believes its sensors: what a sensor reads wrong, the motor does.
"""

from __future__ import annotations

import numpy as np

from gateway_fdi.filters import motor
from gateway_fdi.jit import Record, f8, kernel, means

#: Period [s].
CONTROL = 1e-4
#: Bandwidths: current loop, speed loop and its integral, estimator of the measured speed [rad/s]; position gain [1/s].
CURRENT_LOOP, SPEED_LOOP, SPEED_INTEGRAL, TRACKER, POSITION = 1900.0, 190.0, 40.0, 500.0, 25.0


class Const(Record):
    """What the controller knows."""

    believed: motor.Const = means("the motor as it believes it to be")
    voltage: f8 = means("largest voltage", "V")
    current: f8 = means("largest current asked for", "A")


class State(Record):
    """State."""

    seen: f8 = means("angle of the loop that tracks the measured angle", "rad")
    speed: f8 = means("speed of that loop", "rad/s")
    wound: f8 = means("integral of the speed loop", "rad/s")
    held_d: f8 = means("integral of the current loop, d", "V")
    held_q: f8 = means("integral of the current loop, q", "V")


@kernel
def _track(s: State, angle: float) -> None:
    """Measure the speed by a tracking loop on the measured angle [rad]."""
    error = angle - s.seen
    s.speed += TRACKER * TRACKER * error * CONTROL
    s.seen += (s.speed + 2.0 * TRACKER * error) * CONTROL


@kernel
def _current(c: Const, s: State, demand: float, asked: float, angle: float) -> float:
    """Return the current [A] that position and speed loop ask for; arguments as of :func:`control`."""
    b = c.believed
    emf = b.flux * b.pole_pairs
    gain = b.inertia * SPEED_LOOP / (1.5 * emf)
    lag = asked + POSITION * (demand - angle) - s.speed
    wanted = gain * (lag + s.wound)
    if abs(wanted) < c.current:
        s.wound += SPEED_INTEGRAL * lag * CONTROL
    return min(max(wanted, -c.current), c.current)


@kernel
def _voltages(c: Const, s: State, wanted: float, i_d: float, i_q: float) -> tuple[float, float]:
    """Return the voltages that the current loops ask for, with decoupling, d and q [V].

    Args:
        wanted: current that makes torque [A].
        i_d: measured [A].
        i_q: measured [A].
    """
    b = c.believed
    s.held_d += CURRENT_LOOP * b.resistance * -i_d * CONTROL
    s.held_q += CURRENT_LOOP * b.resistance * (wanted - i_q) * CONTROL
    turning = b.pole_pairs * s.speed
    u_d = -CURRENT_LOOP * b.ld * i_d + s.held_d - turning * b.lq * i_q
    u_q = CURRENT_LOOP * b.lq * (wanted - i_q) + s.held_q + turning * (b.ld * i_d + b.flux)
    size = np.sqrt(u_d * u_d + u_q * u_q)
    if size > c.voltage:
        u_d, u_q = u_d * c.voltage / size, u_q * c.voltage / size
        s.held_d *= 0.99
        s.held_q = min(max(s.held_q, -c.voltage), c.voltage)
    return u_d, u_q


@kernel
def control(
    c: Const, s: State, demand: float, asked: float, angle: float, i_d: float, i_q: float
) -> tuple[float, float]:
    """Compute the voltages of one period, d and q [V].

    Args:
        demand: angle asked for [rad].
        asked: its rate [rad/s].
        angle: measured [rad].
        i_d: measured [A].
        i_q: measured [A].
    """
    _track(s, angle)
    return _voltages(c, s, _current(c, s, demand, asked, angle), i_d, i_q)


@kernel
def advanced(c: Const, s: State, angle: float) -> float:
    """Return the electrical angle in the middle of the period that begins with a measured angle [rad]."""
    b = c.believed
    turning = b.pole_pairs * s.speed
    return float(b.pole_pairs * angle + 0.5 * turning * CONTROL)

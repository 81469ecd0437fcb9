"""What an active front steering is asked for: motor angle, load, steering wheel and speed over time."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

import numpy as np
from numpy.typing import NDArray

from gateway_plants.steering.ecu.controller import CONTROL

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Course:
    """What is asked for at each of the controller's samples.

    Attributes:
        motor: its angle [rad].
        load: torque that pushes against it [N m].
        wheel: angle of the steering wheel [deg].
        speed: of the car [km/h].
    """

    motor: Array
    load: Array
    wheel: Array
    speed: Array


def times(duration: float) -> Array:
    """Return the controller's samples of a run [s]."""
    return np.arange(0.0, duration + CONTROL / 2, CONTROL)


def _soft(t: Array, begin: float, end: float, edge: float = 0.3) -> Array:
    """Rise from 0 to 1 behind ``begin``, fall to 0 before ``end``, without a jump of the slope."""
    s = np.clip(np.minimum(t - begin, end - t) / edge, 0.0, 1.0)
    return np.asarray(s * s * (3.0 - 2.0 * s))


def sweep(t: Array, load_scale: float = 1.0) -> Course:
    """Return the study's 24 s: rests, 12 rad at 0.5 Hz, 20 rad at 0.7 Hz, creep, chirp to 2.4 Hz; steering beside it.

    0.5 N m push in the first rest between motions, -0.6 N m in the second. The wheel turns 60 and 120 deg with a
    rhythm of its own.
    """
    motor = _soft(t, 2.0, 6.0) * 12.0 * np.sin(2.0 * pi * 0.5 * (t - 2.0))
    end = 8.0 + 3.0 / 0.7
    motor += _soft(t, 8.0, end) * 20.0 * np.sin(2.0 * pi * 0.7 * (t - 8.0))
    motor += np.clip(t - 13.6, 0.0, 3.7)
    s = t - 18.5
    motor += _soft(t, 18.5, 22.5) * 5.0 * np.sin(2.0 * pi * (0.3 * s + (2.4 - 0.3) / 8.0 * s * s))
    load = np.zeros_like(t)
    for begin, end, size in ((6.26, 8.0, 0.5), (12.3, 13.3, -0.6)):
        load += load_scale * size * np.clip(np.minimum(t - begin, end - t) / 0.02, 0.0, 1.0)
    wheel = np.zeros_like(t)
    for begin, end, size, hertz in (
        (1.0, 5.0, 60.0, 0.25),
        (7.2, 10.2, 120.0, 1.0 / 3.0),
        (13.0, 19.0, 40.0, 0.5),
        (20.5, 23.0, 90.0, 0.4),
    ):
        wheel += _soft(t, begin, end) * size * np.sin(2.0 * pi * hertz * (t - begin))
    return Course(motor, load, wheel, np.full_like(t, 60.0))


def driving(
    t: Array,
    speed: tuple[tuple[float, float], ...],
    ratios: tuple[tuple[float, float], ...],
    gear: float,
    cubic: float,
    motor_ratio: float,
    wheel_ratio: float,
    rng: np.random.Generator,
) -> Course:
    """Return a drive: turns and rests of the wheel, and the motor that makes the overall ratio of them.

    (3), (2) and (1) of paper 001: road wheel = wheel / i_V(v), pinion = F_SG(road wheel), and the motor adds what is
    missing: i_M (pinion - wheel / i_D).

    Args:
        t: times [s].
        speed: points (time [s], speed [km/h]).
        ratios: points (speed [km/h], i_V).
        gear: pinion over road wheel, straight ahead.
        cubic: F_SG(x) = gear x (1 + cubic x^2) [1/rad^2].
        motor_ratio: i_M.
        wheel_ratio: i_D.
        rng: source of the turns.
    """
    v = np.interp(t, *np.array(speed).T)
    wheel = np.zeros_like(t)
    begin = 0.6
    while begin < t[-1]:
        hertz = rng.uniform(0.35, 0.7)
        end = begin + 1.0 / hertz
        size = rng.uniform(60.0, 160.0) * rng.choice((-1.0, 1.0)) / (1.0 + np.interp(begin, t, v) / 100.0)
        wheel += (
            _soft(t, begin, end, 0.25 / hertz)
            * size
            * np.sin(2.0 * pi * hertz * (t - begin))
            * ((t >= begin) & (t < end))
        )
        begin = end + rng.uniform(0.2, 0.8)
    ratio = np.interp(v, *np.array(ratios).T)
    road = np.radians(wheel / ratio)
    pinion = np.degrees(gear * road * (1.0 + cubic * road * road))
    motor = np.radians(motor_ratio * (pinion - wheel / wheel_ratio))
    # Tyres push back, the more the faster the car: through the gear, on the motor.
    load = 0.35 * np.tanh(wheel / 60.0) * np.clip(v / 60.0, 0.2, 1.0)
    return Course(motor, load, wheel, v)

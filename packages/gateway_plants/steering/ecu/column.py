"""Sensors around an active front steering's motor: steering wheel, pinion, their sampling (paper 001, (1)).

pinion = motor / i_M + wheel / i_D, with lash. The angle frame carries motor and pinion at one time; the steering
wheel's sensor has a time of its own, and tells its angle as it was a while ago.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway_fdi.jit import kernel
from gateway_plants.steering.ecu.controller import CONTROL

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Column:
    """Ratios, sensors, and their periods.

    Attributes:
        motor_ratio: i_M, motor over pinion.
        wheel_ratio: i_D, steering wheel over pinion.
        lash: of the gear, whole width at the pinion [deg].
        pinion_lsb: of the pinion's sensor [deg].
        wheel_lsb: of the steering wheel's [deg].
        rate_lsb: of its rate [deg/s].
        angle_period: of the frame with motor and pinion [s].
        wheel_period: of the steering wheel's frame [s].
        wheel_delay: age of its angle when it is sent [s].
    """

    motor_ratio: float = 20.0
    wheel_ratio: float = 1.0
    lash: float = 0.05
    pinion_lsb: float = 0.05
    wheel_lsb: float = 0.1
    rate_lsb: float = 1.0
    angle_period: float = 2e-3
    wheel_period: float = 10e-3
    wheel_delay: float = 5e-3


@kernel
def play(angle: Any, width: float, out: Any) -> None:
    """Follow an angle through a lash of a width."""
    at = angle[0]
    for k in range(angle.shape[0]):
        at = min(max(at, angle[k] - 0.5 * width), angle[k] + 0.5 * width)
        out[k] = at


def pinion(column: Column, theta: Array, wheel: Array) -> Array:
    """Return the pinion's angle [deg] for motor [rad] and wheel [deg] at the same times, (1)."""
    ideal = np.degrees(theta) / column.motor_ratio + wheel / column.wheel_ratio
    out = np.empty_like(ideal)
    play(ideal, column.lash, out)
    return out


def sampled(angle: Array, period: float, lsb: float, delay: float = 0.0) -> Array:
    """Return an angle given at the controller's samples as a sensor tells it at each period from one period on."""
    per, late = round(period / CONTROL), round(delay / CONTROL)
    at = np.arange(per, len(angle), per) - late
    return np.asarray(np.rint(angle[np.maximum(at, 0)] / lsb) * lsb)

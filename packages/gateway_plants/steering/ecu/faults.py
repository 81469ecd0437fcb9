"""Faults of a steering's sensors and of its inverter, put into the drive's samples."""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from gateway_bench.vecu.contract import TimedFault
from gateway_bench.vecu.sensor_faults import drift, offset, stuck
from gateway_plants.steering.ecu.controller import CONTROL

Kind = Literal[
    "motor_angle_offset",
    "motor_angle_drift",
    "motor_angle_stuck",
    "motor_angle_scale",
    "motor_angle_noise",
    "motor_angle_intermittent",
    "wheel_angle_offset",
    "wheel_angle_drift",
    "wheel_angle_stuck",
    "pinion_angle_offset",
    "pinion_angle_drift",
    "pinion_angle_stuck",
    "current_offset",
    "current_gain",
    "current_frozen",
    "voltage_offset",
    "voltage_gain",
]
KINDS: tuple[Kind, ...] = get_args(Kind)

#: An intermittent contact: so long off [s], on average so often [1/s].
BURST, BURSTS = 5e-3, 20.0

Array = NDArray[np.float64]


class SteeringFault(TimedFault):
    """A fault of a steering."""

    kind: Kind
    ecu: str = Field("steering", description="name of the ECU")
    size: float = Field(
        description="angles: [rad] at the motor, [deg] at wheel and pinion; drift: per second; scale, gain: "
        "share more or less; noise: standard deviation; currents [A]; voltages [V]; unused: stuck, frozen",
        default=0.1,
    )

    def span(self, n: int) -> tuple[int, int]:
        """Return the first of n controller's samples concerned, and the first one behind."""
        end = n if self.to_s is None else min(round(self.to_s / CONTROL), n)
        return min(round(self.from_s / CONTROL), n), end


def bursts(n: int, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Return which of n samples an intermittent contact is off in; the first is."""
    hit = np.zeros(n, bool)
    k = 0
    length = round(BURST / CONTROL)
    while k < n:
        hit[k : k + length] = True
        k += length + round(rng.uniform(0.4, 1.6) / BURSTS / CONTROL)
    return hit


def disturb(wrong: NDArray[np.void], fault: SteeringFault, rng: np.random.Generator) -> None:
    """Put a fault of motor angle, currents or voltages into the drive's disturbances; others change nothing.

    Args:
        wrong: shape (n,) of DISTURBANCE, in place.
        fault: what.
        rng: for noise and bursts.
    """
    n = len(wrong)
    begin, end = fault.span(n)
    if begin >= end:
        return
    span = slice(begin, end)
    size = fault.size
    if fault.kind == "motor_angle_offset":
        wrong["angle"] += offset(n, begin, end, size)
    elif fault.kind == "motor_angle_drift":
        wrong["angle"] += drift(n, begin, end, size * CONTROL)
    elif fault.kind == "motor_angle_stuck":
        wrong["stuck"][span] = 1.0
    elif fault.kind == "motor_angle_scale":
        wrong["scale"][span] = 1.0 + size
    elif fault.kind == "motor_angle_noise":
        wrong["angle"][span] += rng.normal(0.0, size, end - begin)
    elif fault.kind == "motor_angle_intermittent":
        wrong["angle"][span] += size * bursts(end - begin, rng)
    elif fault.kind == "current_offset":
        wrong["current"][span] = size
    elif fault.kind == "current_gain":
        wrong["gain"][span] = 1.0 + size
    elif fault.kind == "current_frozen":
        wrong["frozen"][span] = 1.0
    elif fault.kind == "voltage_offset":
        wrong["volts"][span] = size
    elif fault.kind == "voltage_gain":
        wrong["supply"][span] = 1.0 + size


def falsify(angle: Array, fault: SteeringFault, sensor: Literal["wheel", "pinion"]) -> Array:
    """Return what a sensor beside the motor reads of an angle [deg] at the controller's samples."""
    n = len(angle)
    begin, end = fault.span(n)
    if not fault.kind.startswith(sensor) or begin >= end:
        return angle
    if fault.kind.endswith("offset"):
        return angle + offset(n, begin, end, fault.size)
    if fault.kind.endswith("drift"):
        return angle + drift(n, begin, end, fault.size * CONTROL)
    return stuck(angle, begin, end)

"""What the sensors of a steering tell in one run, each at its own period."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gateway_plants.steering.ecu.column import Column, pinion, sampled
from gateway_plants.steering.ecu.controller import CONTROL
from gateway_plants.steering.ecu.course import Course
from gateway_plants.steering.ecu.faults import SteeringFault, disturb, falsify
from gateway_plants.steering.ecu.plant import Plant, drive, undisturbed

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Signals:
    """The k-th entry of each is of the time (k + 1) periods.

    Attributes:
        samples: shape (n,) of SAMPLE, motor frames.
        motor: motor angle of the angle frames [deg].
        pinion: pinion angle of these [deg].
        wheel: steering wheel's angle of its frames, as old as they are [deg].
        rate: its rate [deg/s].
    """

    samples: NDArray[np.void]
    motor: Array
    pinion: Array
    wheel: Array
    rate: Array


def sense(
    plant: Plant,
    column: Column,
    course: Course,
    faults: tuple[SteeringFault, ...],
    period: float,
    rng: np.random.Generator,
) -> Signals:
    """Drive a course and return what is measured.

    Args:
        plant: motor and drive.
        column: gear and sensors around it.
        course: what is asked for.
        faults: of sensors and inverter.
        period: of the motor's frames [s].
        rng: source of all randomness.
    """
    wrong = undisturbed(len(course.motor))
    (own,) = rng.spawn(1)  # a fault does not change the noise of the rest
    for fault in faults:
        disturb(wrong, fault, own)
    samples = drive(plant, course.motor, course.load, wrong, rng, period)
    per = round(period / CONTROL)
    at = np.arange(1, len(samples) + 1) * per
    # What turns slowly is known at the frames; in between it is straight.
    theta = np.interp(np.arange(len(course.motor)), at, samples["theta"])
    told_pinion, told_wheel = pinion(column, theta, course.wheel), course.wheel
    for fault in faults:
        told_pinion = falsify(told_pinion, fault, "pinion")
        told_wheel = falsify(told_wheel, fault, "wheel")
    every = max(column.angle_period, period)
    stride = round(every / period)
    late = column.wheel_delay
    return Signals(
        samples,
        np.degrees(samples["sensor"][stride - 1 :: stride]),
        sampled(told_pinion, every, column.pinion_lsb),
        sampled(told_wheel, column.wheel_period, column.wheel_lsb, late),
        sampled(np.gradient(course.wheel, CONTROL), column.wheel_period, column.rate_lsb, late),
    )

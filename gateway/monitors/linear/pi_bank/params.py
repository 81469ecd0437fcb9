"""Parameters of a bank of PI observers."""

from __future__ import annotations

from cmath import exp
from functools import cached_property
from typing import Literal, Self

import numpy as np
from pydantic import Field, model_validator

from gateway.fdi.pi_bank.design import Noise, Observer, check, design
from gateway.monitors.linear.plant import PlantParams


class Params(PlantParams):
    """A linear plant whose actuators and sensors are watched."""

    poles: tuple[float | tuple[float, float], ...] | None = Field(
        None,
        description="of each observer, n + m, continuous: -1.2, or [-1.0, 2.0] for one of a pair [1/s]; "
        "default: Kalman's, from the noise",
    )
    logic: Literal["jumps", "products"] = Field(
        "jumps",
        description="jumps: likelihood ratio on the innovations, latched; products: (15) and (16) of the paper",
    )
    start_s: float = Field(5.0, gt=0, description="at the start nothing is judged for so long [s]")
    hold_s: float = Field(2.0, gt=0, description="a sensor is well when it has been for so long [s]")

    @model_validator(mode="after")
    def _bank_can_be_built(self) -> Self:
        check(self.plant, self.sensor_names, self.states)
        _ = self.observers
        return self

    @property
    def noise(self) -> Noise:
        """What is not exact."""
        drifts = [0.1 * part.threshold if part.drift is None else part.drift for part in self.input]
        outputs = [part.noise for part in self.output]
        return Noise(np.array(outputs), np.array(self.disturbance), np.array(drifts))

    @cached_property
    def observers(self) -> tuple[Observer, ...]:
        """The bank."""
        poles = None
        if self.poles is not None:
            given = [complex(*pole) if isinstance(pole, tuple) else complex(pole) for pole in self.poles]
            poles = tuple(exp(pole * self.sample_ms * 1e-3) for pole in given)
        return design(self.plant, self.noise, poles)

    @property
    def actuator_limits(self) -> np.ndarray:
        """Th_a."""
        return np.array([part.threshold for part in self.input])

    @property
    def sensor_limits(self) -> np.ndarray:
        """Th_s."""
        return np.array([part.limit for part in self.output])

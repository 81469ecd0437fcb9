"""Parameters of a bank of PI observers."""

from __future__ import annotations

from cmath import exp
from functools import cached_property
from typing import Literal, Self

import numpy as np
from pydantic import Field, model_validator

from gateway.common.tomlfile import StrictModel
from gateway.fdi.linear.plant import unobservable
from gateway.fdi.linear.uncertainty import Entries, entries
from gateway.fdi.model_set.design import Told, isolable
from gateway.fdi.model_set.matrices import MOST_ENTRIES
from gateway.fdi.pi_bank.design import Noise, Observer, check, design
from gateway.monitors.linear.plant import Matrix, PlantParams

Logic = Literal["jumps", "products", "models"]


class ModelError(StrictModel):
    """How far the plant may be from its matrices."""

    a: float | Matrix = Field(
        0.05, description="relative, of each entry of a but 0 and +-1; or the bound of each entry, in its unit"
    )
    b: float | Matrix = Field(0.05, description="likewise of b")


class Params(PlantParams):
    """A linear plant whose actuators and sensors are watched."""

    poles: tuple[float | tuple[float, float], ...] | None = Field(
        None,
        description="of each observer, n + m, continuous: -1.2, or [-1.0, 2.0] for one of a pair [1/s]; "
        "default: Kalman's, from the noise",
    )
    logic: Logic | None = Field(
        None,
        description="jumps: likelihood ratio on the innovations of the bank, latched; products: (15) and (16) of the "
        "paper; models: a filter for each fault, with the plant's own errors as slow states. Default: models where "
        "model_error is given or a sensor cannot be left out, else jumps",
    )
    model_error: float | ModelError | None = Field(
        None,
        description="how far the plant may be from a and b: 0.05, of each entry but 0 and +-1, or { a = .., b = .. }",
    )
    patience_s: float | None = Field(
        None, gt=0, description="with models: time in which a fault has to be isolated [s]; default: 200 samples"
    )
    learning: bool = Field(
        False,
        description="with models: nothing is judged, the errors of a and b are learned; gateway calibrate sets it",
    )
    calibrated: str = Field("", description="where a, b and model_error come from")
    start_s: float = Field(5.0, gt=0, description="at the start nothing is judged for so long [s]")
    hold_s: float = Field(2.0, gt=0, description="a sensor is well when it has been for so long [s]")

    @model_validator(mode="after")
    def _bank_can_be_built(self) -> Self:
        if self.decided_by == "models":
            self._check_models()
        else:
            check(self.plant, self.sensor_names, self.states)
            _ = self.observers
        return self

    def _check_models(self) -> None:
        """Raise ValueError if there can be no filters."""
        plant = self.plant
        hidden = unobservable(plant.phi, plant.c, self.states)
        if hidden:
            raise ValueError(f"the sensors do not show {hidden}")
        if self.poles is not None:
            raise ValueError('poles: logic = "models" has Kalman\'s gains only')
        if len(self.entries) > MOST_ENTRIES:
            raise ValueError(
                f"model_error: {len(self.entries)} uncertain entries of a and b; at most {MOST_ENTRIES}: "
                "give it by entry"
            )

    @property
    def decided_by(self) -> Logic:
        """The logic, own or default."""
        if self.logic is not None:
            if self.model_error is not None and self.logic != "models":
                raise ValueError(
                    f'model_error: logic = "{self.logic}" takes the matrices as exact; logic = "models" does not'
                )
            return self.logic
        plant = self.plant
        if self.model_error is not None or any(
            unobservable(plant.phi, plant.without(j)) for j in range(plant.outputs if plant.outputs > 1 else 0)
        ):
            return "models"
        return "jumps"

    @cached_property
    def entries(self) -> Entries:
        """Uncertain entries of the matrices."""
        error = self.model_error
        if isinstance(error, ModelError):
            return entries(self.a, self.b, error.a, error.b)
        return entries(self.a, self.b, error or 0.0, error or 0.0)

    @cached_property
    def told(self) -> Told:
        """What is told of the plant, for ``logic = "models"``."""
        return Told(
            self.plant,
            np.array(self.a),
            np.array(self.b),
            self.discrete,
            self.noise,
            self.entries,
            self.actuator_limits,
            self.sensor_limits,
            isolable(self.plant),
        )

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

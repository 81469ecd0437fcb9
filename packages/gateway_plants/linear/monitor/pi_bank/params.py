"""Parameters of a bank of PI observers."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from gateway_plants.linear.mathematics.plant import unobservable
from gateway_plants.linear.monitor.pi_bank.window import Windows, windows_of
from gateway_plants.linear.monitor.uncertain import UncertainPlantParams
from gateway_plants.linear.pi_bank.design import Observer, check, design

Logic = Literal["jumps", "models"]


class Params(UncertainPlantParams):
    """A linear plant whose actuators and sensors are watched."""

    moved: ClassVar[Mapping[str, str]] = {
        **UncertainPlantParams.moved,
        "logic = products": "the paper's own decision is in the study (gateway evaluate linear); use jumps",
    }

    logic: Logic | None = Field(
        None,
        description="jumps: likelihood ratio on the innovations of the bank, latched; models: a filter for each fault, "
        "with the plant's own errors as slow states. Default: models where model_error is given or a sensor cannot be "
        "left out, else jumps",
    )
    patience_s: float | None = Field(
        None, gt=0, description="with models: time in which a fault has to be isolated [s]; default: 200 samples"
    )
    start_s: float = Field(5.0, gt=0, description="at the start nothing is judged for so long [s]")
    hold_s: float = Field(2.0, gt=0, description="a sensor is well when it has been for so long [s]")

    @model_validator(mode="after")
    def _bank_can_be_built(self) -> Self:
        if self.decided_by == "models":
            self.check_filters()
        else:
            check(self.plant, self.sensor_names, self.states)
            _ = self.observers
            try:
                _ = self.windows
            except np.linalg.LinAlgError as error:
                text = "with these matrices and noises the tests of two parts cannot be computed"
                raise ValueError(f"{text}: {error}") from error
        return self

    @property
    def decided_by(self) -> Logic:
        """The logic, own or default."""
        if self.logic is not None:
            if self.logic != "models" and (self.model_error is not None or self.lags.any()):
                key = "accuracy.lag" if self.model_error is None else "model_error"
                what = "sensors as of one time" if self.model_error is None else "the matrices as exact"
                raise ValueError(f'{key}: logic = "{self.logic}" takes {what}; logic = "models" does not')
            return self.logic
        plant = self.plant
        if (
            self.model_error is not None
            or self.lags.any()
            or any(unobservable(plant.phi, plant.without(j)) for j in range(plant.outputs if plant.outputs > 1 else 0))
        ):
            return "models"
        return "jumps"

    @cached_property
    def observers(self) -> tuple[Observer, ...]:
        """The bank."""
        return design(self.plant, self.noise)

    @cached_property
    def windows(self) -> Windows | None:
        """Tests of each two parts; None: the matrices are not taken as exact."""
        if self.decided_by == "models":
            return None
        noise = np.array([part.noise for part in self.output])
        return windows_of(self.plant, noise, np.diag(np.array(self.disturbance) ** 2 * self.plant.period))

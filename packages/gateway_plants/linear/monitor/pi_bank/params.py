"""Parameters of a bank of PI observers."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import ClassVar, Self

import numpy as np
from pydantic import Field, model_validator

from gateway_plants.linear.mathematics.plant import unobservable
from gateway_plants.linear.monitor.pi_bank.window import Windows, windows_of
from gateway_plants.linear.monitor.uncertain import UncertainPlantParams
from gateway_plants.linear.pi_bank.design import check


class Params(UncertainPlantParams):
    """A linear plant whose actuators and sensors are watched."""

    moved: ClassVar[Mapping[str, str]] = {
        **UncertainPlantParams.moved,
        "logic": "one logic decides, with model_error or without; leave the key out",
    }

    patience_s: float | None = Field(
        None,
        gt=0,
        description="in which a fault has to be isolated [s]; default: 200 samples, without model_error 60",
    )
    start_s: float = Field(5.0, gt=0, description="at the start nothing is judged for so long [s]")
    hold_s: float = Field(2.0, gt=0, description="a sensor is well when it has been for so long [s]")

    @model_validator(mode="after")
    def _bank_can_be_built(self) -> Self:
        if not self.exact:
            self.check_filters()
            return self
        check(self.plant, self.sensor_names, self.states)
        try:
            _ = self.windows
        except np.linalg.LinAlgError as error:
            text = "with these matrices and noises the tests of two parts cannot be computed"
            raise ValueError(f"{text}: {error}") from error
        return self

    @property
    def exact(self) -> bool:
        """Whether matrices and times are exact, and the plant shows without any one of its sensors."""
        plant = self.plant
        parts = range(plant.outputs if plant.outputs > 1 else 0)
        hidden = any(unobservable(plant.phi, plant.without(j)) for j in parts)
        return self.model_error is None and not self.lags.any() and not hidden

    @cached_property
    def windows(self) -> Windows | None:
        """Tests of each two parts; None: the matrices are not taken as exact."""
        if not self.exact:
            return None
        noise = np.array([part.noise for part in self.output])
        return windows_of(self.plant, noise, np.diag(np.array(self.disturbance) ** 2 * self.plant.period))

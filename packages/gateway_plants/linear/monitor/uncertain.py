"""A plant whose matrices are not known exactly, by configuration: what monitors that run filters for it share."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import ClassVar

import numpy as np
from pydantic import Field

from gateway_fdi.common.tomlfile import StrictModel
from gateway_plants.linear.mathematics.plant import unobservable
from gateway_plants.linear.mathematics.uncertainty import Entries, entries
from gateway_plants.linear.model_set.alignment import MOST as MOST_LAG
from gateway_plants.linear.model_set.design import EXACT_OFFSET, OFFSET_SIZE, Told, isolable
from gateway_plants.linear.model_set.matrices import MOST_ENTRIES
from gateway_plants.linear.monitor.plant import Matrix, Output, PlantParams
from gateway_plants.linear.pi_bank.design import Noise


class ModelError(StrictModel):
    """How far the plant may be from its matrices."""

    a: float | Matrix = Field(
        0.05, description="relative, of each entry of a but 0 and +-1; or the bound of each entry, in its unit"
    )
    b: float | Matrix = Field(0.05, description="likewise of b")


class UncertainPlantParams(PlantParams):
    """A linear plant, and how well it is known."""

    moved: ClassVar[Mapping[str, str]] = {"poles": "gains are Kalman's, from noise and state_noise; leave the key out"}

    model_error: float | ModelError | None = Field(
        None,
        description="how far the plant may be from a and b: 0.05, of each entry but 0 and +-1, or { a = .., b = .. }",
    )
    learning: bool = Field(
        False,
        description="with model_error: nothing is judged, the errors of a and b are learned; gateway calibrate sets it",
    )
    calibrated: str = Field("", description="where a, b and model_error come from")

    @cached_property
    def entries(self) -> Entries:
        """Uncertain entries of the matrices."""
        error = self.model_error
        if isinstance(error, ModelError):
            return entries(self.a, self.b, error.a, error.b)
        return entries(self.a, self.b, error or 0.0, error or 0.0)

    @cached_property
    def told(self) -> Told:
        """What is told of the plant to its filters (:mod:`gateway_plants.linear.model_set`)."""
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
            np.array([0.0 if part.accuracy is None else part.accuracy.gain or 0.0 for part in self.output]),
            np.array([self._bias(part) for part in self.output]),
            self.usual_offset * self.actuator_limits,
            self.lags,
            self.counted,
        )

    @property
    def usual_offset(self) -> float:
        """Offset of a healthy sensor or actuator of which nothing is told, in its threshold."""
        return EXACT_OFFSET if self.model_error is None else OFFSET_SIZE

    def _bias(self, part: Output) -> float:
        """Return the bias that a sensor may have, in its unit."""
        told = None if part.accuracy is None else part.accuracy.bias
        return self.usual_offset * part.limit if told is None else told.value

    @property
    def counted(self) -> bool:
        """Whether commands have counters."""
        return any(part.counter for part in self.input)

    @property
    def lags(self) -> np.ndarray:
        """By how many periods each sensor may be late or early."""
        told = [None if part.accuracy is None else part.accuracy.lag for part in self.output]
        return np.array([0.0 if lag is None else lag.value / self.sample_ms for lag in told])

    @property
    def noise(self) -> Noise:
        """What is not exact."""
        drifts = [0.1 * part.threshold if part.drift is None else part.drift for part in self.input]
        outputs = [part.noise for part in self.output]
        return Noise(np.array(outputs), np.array(self.disturbance), np.array(drifts))

    @property
    def actuator_limits(self) -> np.ndarray:
        """Th_a."""
        return np.array([part.threshold for part in self.input])

    @property
    def sensor_limits(self) -> np.ndarray:
        """Th_s."""
        return np.array([part.limit for part in self.output])

    def check_filters(self) -> None:
        """Raise ValueError if there can be no filters with the plant's errors as slow states."""
        hidden = unobservable(self.plant.phi, self.plant.c, self.states)
        if hidden:
            raise ValueError(f"the sensors do not show {hidden}")
        if self.lags.max() > MOST_LAG:
            raise ValueError(f"accuracy.lag: at most {MOST_LAG} samples, {MOST_LAG * self.sample_ms:g} ms")
        if len(self.entries) > MOST_ENTRIES:
            raise ValueError(
                f"model_error: {len(self.entries)} uncertain entries of a and b; at most {MOST_ENTRIES}: "
                "give it by entry"
            )

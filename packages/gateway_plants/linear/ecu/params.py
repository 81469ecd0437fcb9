"""Parameters of the ECU of a linear plant, and of its faults."""

from __future__ import annotations

from pathlib import Path
from typing import Literal, Self

from pydantic import Field, model_validator

from gateway_bench.vecu.contract import EcuParams, TimedFault
from gateway_fdi.common.tomlfile import StrictModel
from gateway_plants.linear.mathematics.plant import LinearPlant, discretised

Matrix = tuple[tuple[float, ...], ...]


class Swing(StrictModel):
    """What is asked of an actuator: offset + amplitude sin(2 pi t / period)."""

    offset: float = Field(0.0, description="[the signal's unit]")
    amplitude: float = Field(0.0, description="[the signal's unit]")
    period_s: float = Field(10.0, gt=0, description="[s]")


class LinearParams(EcuParams):
    """A linear plant with its controller: u = asked for - feedback x, held from sample to sample."""

    type: Literal["linear"]
    name: str = "plant"
    bus: str | None = Field(None, description="name of its bus; may be left out when there is one")
    database: Path | None = Field(
        None,
        description="of its messages: relative to the scenario, or one of the shipped;"
        " default: what its bus has in the configuration",
    )
    sensors: str = Field(description="message with the outputs, in their order")
    commands: str = Field(description="message with the inputs, in their order")
    sample_ms: float = Field(gt=0, le=60_000, description="between two samples [ms]")
    a: Matrix = Field(description="A of the plant [1/s]")
    b: Matrix = Field(description="B of the plant")
    c: Matrix = Field(description="C of the plant")
    feedback: Matrix | None = Field(
        None,
        description="K, one list an input: keeps a plant stable that is not; of the true state",
    )
    swing: tuple[Swing, ...] = Field((), description="what is asked of each input; default: nothing")
    noise: tuple[float, ...] = Field((), description="of each sensor, standard deviation")
    state_noise: float = Field(0.0, ge=0, description="on each state, per root of a second")
    jitter_us: float = Field(20.0, ge=0, description="of a frame's arrival, standard deviation [us]")

    @property
    def plant(self) -> LinearPlant:
        """The plant from sample to sample."""
        return discretised(self.a, self.b, self.c, self.sample_ms * 1e-3)

    @property
    def summary(self) -> str:
        """What it is, for people."""
        plant = self.plant
        return f"linear plant; states: {plant.states}, inputs: {plant.inputs}, outputs: {plant.outputs}"

    @model_validator(mode="after")
    def _shapes_fit(self) -> Self:
        plant = self.plant
        for what, count, wanted in (
            ("swing", len(self.swing), plant.inputs),
            ("noise", len(self.noise), plant.outputs),
        ):
            if count not in (0, wanted):
                raise ValueError(f"{what} has {count} entries, the plant needs {wanted}")
        if self.feedback is not None and (
            len(self.feedback) != plant.inputs or any(len(row) != plant.states for row in self.feedback)
        ):
            raise ValueError(f"feedback is {plant.inputs} x {plant.states}: one list an input")
        return self


class LinearFault(TimedFault):
    """A fault of an actuator or of a sensor."""

    kind: Literal["actuator_offset", "actuator_drift", "output_offset", "output_drift", "output_stuck"]
    ecu: str = Field("plant", description="name of the ECU")
    place: int = Field(1, ge=1, description="which input or output, from 1")
    size: float = Field(0.0, description="offset: its size; drift: per second [the signal's unit]")

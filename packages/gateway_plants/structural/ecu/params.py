"""What a scenario says of a simulated model: inputs, where it begins, messages, noise, faults."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from gateway.signals.protection.params import ProtectionParams
from gateway_bench.vecu.contract import EcuParams, TimedFault
from gateway_fdi.common.tomlfile import StrictModel

Finite = Annotated[float, Field(allow_inf_nan=False)]
Points = Annotated[tuple[tuple[Finite, Finite], ...], Field(min_length=1)]


class Repeated(StrictModel):
    """A course that begins anew again and again."""

    points: Points = Field(description="[[time s, value], ...], linear between them; the same time twice is a jump")
    repeat_s: float = Field(gt=0, allow_inf_nan=False, description="[s]")

    @model_validator(mode="after")
    def _inside(self) -> Self:
        if self.points[-1][0] > self.repeat_s:
            raise ValueError("the last point lies behind repeat_s")
        return self


#: A constant, breakpoints, or breakpoints that are repeated.
Input = Finite | Points | Repeated


def points_of(course: Input) -> tuple[tuple[float, float], ...]:
    """Return the breakpoints of an input."""
    if isinstance(course, Repeated):
        return course.points
    return course if isinstance(course, tuple) else ((0.0, course),)


class ModelMessage(ProtectionParams):
    """A message: its period, what its signals are, how it is protected."""

    name: str = Field(description="of the message in the bus's database")
    period_ms: float = Field(gt=0, le=3.6e6, description="[ms]")
    signals: dict[str, str | Finite] = Field(
        default_factory=dict, description="signal -> known variable or unknown of the model, or a number; others: 0"
    )


class StructuralParams(EcuParams):
    """A plant by its equations."""

    type: Literal["structural"]
    name: str = "plant"
    model: Path = Field(description="the model; relative to the scenario, or of those that come with the gateway")
    inputs: dict[str, Input] = Field(
        default_factory=dict,
        description="variable that the plant is given (a command, a load) -> value, [[time s, value], ...], or"
        " { points = [...], repeat_s = ... }; the other known variables are computed",
    )
    parameters: dict[str, Finite] = Field(default_factory=dict, description="values instead of the model's")
    start: dict[str, Finite] = Field(default_factory=dict, description="where states begin; default: the model's start")
    rest: bool = Field(False, description="states without a start value begin where they stay; else at 0")
    noise: dict[str, Annotated[float, Field(ge=0, allow_inf_nan=False)]] = Field(
        default_factory=dict, description="variable -> standard deviation as it is sent, its unit"
    )
    longest_ms: float = Field(1000.0, gt=0, le=3.6e6, description="longest step of the solver [ms]")
    message: tuple[ModelMessage, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _courses(self) -> Self:
        for name, course in self.inputs.items():
            if any(b[0] < a[0] for a, b in pairwise(points_of(course))):
                raise ValueError(f"inputs.{name}: the times of the points must not fall")
        return self

    @property
    def summary(self) -> str:
        """What it is, for people."""
        return f"the equations of {self.model.name}"


class StructuralFault(TimedFault):
    """A fault of the model, or a value that is not sent anew."""

    kind: Literal["value", "ramp", "freeze"]
    ecu: str = Field("plant", description="name of the ECU")
    name: str = Field(description="value, ramp: a fault of the model; freeze: a variable that is sent")
    from_s: float = Field(ge=0, description="[s]")
    to_s: float | None = Field(None, gt=0, description="[s]; default: the end")
    size: float = Field(0.0, allow_inf_nan=False, description="value of the fault, as its equation has it")
    ramp_s: float = Field(0.0, ge=0, description="ramp: it grows to its size for so long [s]")

    @model_validator(mode="after")
    def _fits_its_kind(self) -> Self:
        if (self.kind == "ramp") != (self.ramp_s > 0):
            raise ValueError('ramp_s goes with kind = "ramp"')
        if self.kind != "freeze" and self.size == 0.0:
            raise ValueError("size: 0 is no fault")
        return self

"""Messages with their signals over time, and their faults."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from gateway.signals.protection.params import ProtectionParams
from gateway_bench.vecu.contract import EcuParams, TimedFault

#: A constant, or breakpoints [time s, value], linear in between.
Course = Annotated[float, Field(allow_inf_nan=False)] | tuple[tuple[float, float], ...]


class TableMessage(ProtectionParams):
    """A message: its period, its signals, how it is protected."""

    name: str = Field(description="of the message in the bus's database")
    period_ms: float = Field(gt=0, le=3.6e6, description="[ms]")
    signals: dict[str, Course] = Field(
        default_factory=dict, description="signal -> value, or [[time s, value], ...]; others: 0, or what is nearest"
    )
    turns: dict[str, tuple[float, ...]] = Field(
        default_factory=dict, description="signal -> its values in turn, one a frame: of a multiplexer"
    )
    noise: dict[str, float] = Field(default_factory=dict, description="signal -> standard deviation, signal's unit")

    @model_validator(mode="after")
    def _courses(self) -> Self:
        for name, values in self.turns.items():
            if not values:
                raise ValueError(f"turns.{name}: at least one value")
            if name in self.signals:
                raise ValueError(f"turns.{name}: it is among signals, too")
        for name, course in self.signals.items():
            if isinstance(course, tuple):
                if not course:
                    raise ValueError(f"signals.{name}: at least one breakpoint")
                if any(b[0] <= a[0] for a, b in pairwise(course)):
                    raise ValueError(f"signals.{name}: the times of the breakpoints must rise")
        return self


class TableParams(EcuParams):
    """An ECU that sends messages by tables."""

    type: Literal["table"]
    name: str = "table"
    message: tuple[TableMessage, ...] = Field(min_length=1)

    @property
    def summary(self) -> str:
        """Its kind, for people."""
        return f"{len(self.message)} message(s) by tables"


class TableFault(TimedFault):
    """A fault of one signal."""

    kind: Literal["value", "offset", "freeze", "noise"]
    ecu: str = Field("table", description="name of the ECU")
    signal: str = Field(description='"Message.Signal"')
    from_s: float = Field(ge=0, description="[s]")
    to_s: float | None = Field(None, gt=0, description="[s]; default: the end")
    size: float = Field(
        0.0, allow_inf_nan=False, description="value, offset, or standard deviation of the noise, signal's unit"
    )

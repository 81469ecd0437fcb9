"""Settings of the rest of a bus: its messages, their cycles, their signals."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator

from gateway.signals.protection.params import KEYS, ProtectionParams
from gateway_bench.vecu.contract import EcuParams
from gateway_bench.vecu.restbus.courses import Short, rising


class RestbusMessage(ProtectionParams):
    """Differing settings of one message; without a protection it has that of the ECU."""

    name: str = Field(description="of the message in the bus's database")
    period_ms: float | None = Field(
        None, gt=0, le=3.6e6, allow_inf_nan=False, description="[ms]; default: that of the database"
    )

    @property
    def protected(self) -> bool:
        """Whether it says how it is protected."""
        return any(getattr(self, name) is not None for name in KEYS)


class RestbusParams(EcuParams):
    """Nodes of a database, or messages of it, without an ECU that sends them."""

    type: Literal["restbus"]
    name: str = "restbus"
    nodes: tuple[str, ...] = Field((), description="all messages of these nodes")
    messages: tuple[str, ...] = Field((), description="these messages; with neither: all of the database")
    without: tuple[str, ...] = Field((), description="but not these messages")
    cycle_ms: float | None = Field(
        None, gt=0, le=3.6e6, allow_inf_nan=False, description="of messages whose database gives none [ms]"
    )
    jitter_ms: float = Field(0.0, ge=0, allow_inf_nan=False, description="of each frame, standard deviation [ms]")
    protection: Literal["auto", "none"] = Field(
        "auto", description="auto: as names and attributes in the database say, as of a check"
    )
    message: tuple[RestbusMessage, ...] = Field((), description="differing settings of single messages")
    signals: dict[str, Short] = Field(
        default_factory=dict,
        description='"Message.Signal" -> value, [[time s, value], ...], "expression", or a table; '
        "others: their start value, or what is nearest to 0",
    )

    @property
    def summary(self) -> str:
        """Its kind, for people."""
        of = f"nodes {', '.join(self.nodes)}" if self.nodes else "all messages"
        return "rest of the bus: " + (f"{len(self.messages)} messages" if self.messages and not self.nodes else of)

    @model_validator(mode="after")
    def _once(self) -> Self:
        names = [message.name for message in self.message]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"two tables of message {name}")
        for name, course in self.signals.items():
            if isinstance(course, tuple):
                rising(f"signals.{name}", course)
        return self

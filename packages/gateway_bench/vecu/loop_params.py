"""Settings of a plant or controller that closes a loop: its inputs and outputs as signals, its messages."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator

from gateway_bench.vecu.contract import WHEN, EcuFault, EcuParams
from gateway_bench.vecu.message_faults import begins
from gateway_bench.vecu.restbus.params import RestbusMessage


class LoopMessage(RestbusMessage):
    """Differing settings of one message that it sends."""

    at_ms: float = Field(0.0, ge=0, le=3.6e6, allow_inf_nan=False, description="when the first one is sent [ms]")


class LoopParams(EcuParams):
    """A model with inputs and outputs, stepped at a fixed rate; it reads signals and sends messages."""

    step_ms: float = Field(1.0, ge=0.1, le=10_000, allow_inf_nan=False, description="between two steps [ms]")
    inputs: dict[str, str] = Field(default_factory=dict, description='input -> "Message.Signal" that it follows')
    start: dict[str, float] = Field(
        default_factory=dict, description="input -> its value before its first frame, or for ever; others: 0"
    )
    outputs: dict[str, str] = Field(default_factory=dict, description='"Message.Signal" -> output that it carries')
    constants: dict[str, float] = Field(
        default_factory=dict, description='"Message.Signal" -> value; others: their start value'
    )
    parameters: dict[str, bool | int | float | str] = Field(
        default_factory=dict, description="of the model: arguments of the class, parameters of the FMU"
    )
    message: tuple[LoopMessage, ...] = Field((), description="differing settings of single messages")
    cycle_ms: float | None = Field(
        None, gt=0, le=3.6e6, allow_inf_nan=False, description="of messages whose database gives none [ms]"
    )
    jitter_ms: float = Field(0.0, ge=0, allow_inf_nan=False, description="of each frame, mean lateness [ms]")
    protection: Literal["auto", "none"] = Field("auto", description="of its messages, as of a rest bus")

    @property
    def sent(self) -> tuple[str, ...]:
        """Names of the messages that it sends."""
        names = [name.rpartition(".")[0] for name in (*self.outputs, *self.constants)]
        return tuple(dict.fromkeys([*names, *(message.name for message in self.message)]))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its inputs: those that follow signals, and those that have a value only."""
        return tuple(dict.fromkeys([*self.inputs, *self.start]))

    @model_validator(mode="after")
    def _something(self) -> Self:
        if not self.outputs:
            raise ValueError('outputs: at least one "Message.Signal" = "output", or it sends nothing')
        return self


#: Kinds of faults of an actuator, and their names among the faults of signals.
ACTUATOR = {
    "actuator_stuck": "stuck",
    "actuator_offset": "offset",
    "actuator_gain": "gain",
    "actuator_drift": "drift",
    "actuator_noise": "noise",
    "actuator_value": "value",
}


class LoopFault(EcuFault):
    """A fault of an actuator: the model gets another input than the bus says."""

    kind: Literal[
        "actuator_stuck", "actuator_offset", "actuator_gain", "actuator_drift", "actuator_noise", "actuator_value"
    ]
    input: str = Field(description="of the model")
    from_s: float | None = Field(None, ge=0, description="[s]; may be left out where there is a condition")
    to_s: float | None = Field(None, gt=0, description="[s]; default: the end")
    when: str | None = Field(None, min_length=1, description=WHEN)
    size: float | None = Field(None, allow_inf_nan=False, description="as of a signal's fault, the input's unit")

    @model_validator(mode="after")
    def _whole(self) -> Self:
        begins(self)
        if self.kind != "actuator_stuck" and self.size is None:
            raise ValueError(f"{self.kind} wants a size")
        return self


def fits(params: LoopParams, fault: LoopFault) -> None:
    """Refuse a fault of what is no input.

    Raises:
        ValueError: there is no such input.
    """
    if fault.input not in params.names:
        raise ValueError(f"ECU {params.name!r} has no input {fault.input!r}; it has {', '.join(params.names)}")

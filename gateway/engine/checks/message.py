"""Settings of the checks of one message, as configurations have them."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from gateway.engine.checks.senders import Most
from gateway.monitors.contract import MonitorParams
from gateway.signals.protection.params import ProtectionParams

#: Base codes of the DTCs of checks that give none, on a bus whose messages have none of their own.
LOST, INVALID = "U0100", "U0401"

#: Base code of a DTC in TOML: a network code without its failure type.
BaseCode = Annotated[str, Field(pattern=r"^U[0-3][0-9A-F]{3}$")]


class Params(MonitorParams, ProtectionParams):
    """Checks of one message."""

    message: str = Field(description="name of the message in the bus's database")
    timeout_ms: float | None = Field(None, gt=0, le=3.6e6, description="longest silence [ms]; none: not watched")
    wake_ms: float | None = Field(
        None,
        ge=0,
        le=3.6e6,
        description="time that it has to come after the bus was silent, or asleep, and at a start [ms], its timeout at"
        " least; default: that of the bus",
    )
    most: Most | None = Field(
        None, description="how often it may come: `early`, and where its counter runs twice `second_sender`"
    )
    length: bool | int = Field(
        True,
        ge=0,
        le=64,
        description="judge frames shorter than the message; a number: frames of any other length [byte]",
    )
    value: bool = Field(
        True,
        description="judge floating-point signals that are used: NaN, infinite, far outside of their range",
    )
    lost: BaseCode = Field(LOST, description="base code of the timeout's DTC: lost communication, U01xx")
    invalid: BaseCode = Field(INVALID, description="base code of the other checks' DTCs: invalid data received, U04xx")

    @property
    def cycle_ms(self) -> float | None:
        """How often E2E's state machine is run where no frame comes [ms]."""
        window = None if self.e2e is None else self.e2e.window
        return None if window is None else window.cycle_ms or self.timeout_ms

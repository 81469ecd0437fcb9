"""Settings of relations between signals."""

from __future__ import annotations

from typing import Self

from pydantic import ConfigDict, Field, model_validator

from gateway.monitors.contract import MonitorParams
from gateway_checks.rule.program import Program
from gateway_fdi.common.tomlfile import StrictModel


class Rule(StrictModel):
    """A relation that must hold."""

    name: str = Field(pattern=r"^[A-Za-z0-9_-]+$", description="of its fault: <monitor>.<name>")
    holds: str = Field(min_length=1, description='e.g. "abs(Wheels.FL - Wheels.FR) < 3 + 0.1 * Vehicle.Speed"')
    when: str | None = Field(None, min_length=1, description="it is tested only while this holds")
    tolerance: float = Field(0.0, ge=0, allow_inf_nan=False, description="of its comparisons")
    failed_ms: float = Field(500.0, gt=0, le=3.6e6, description="it must not hold for this time [ms]")
    passed_ms: float = Field(1000.0, gt=0, le=3.6e6, description="and hold for this time to heal [ms]")
    code: str | None = Field(
        None, pattern=r"^[PCBU][0-3][0-9A-F]{3}$", description="base code of its DTC; default: its own, U1xxx, U2xxx"
    )
    description: str | None = Field(None, description="one line for people")


class Params(MonitorParams):
    """Relations."""

    rule: tuple[Rule, ...] = Field(min_length=1, max_length=10_000)

    @model_validator(mode="after")
    def _names(self) -> Self:
        names = [rule.name for rule in self.rule]
        for k, name in enumerate(names):
            if name in names[:k]:
                raise ValueError(f"two rules are called {name}")
        return self


class PartParams(MonitorParams):
    """One relation, with its programs.

    Attributes:
        rule: as configured.
        code: base code of its DTC.
        holds: its program.
        when: program of its condition, None: always.
        signals: that both need.
        units: of the signals.
    """

    model_config = ConfigDict(arbitrary_types_allowed=True)

    rule: Rule
    code: str
    holds: Program
    when: Program | None
    signals: tuple[str, ...]
    units: tuple[str, ...]

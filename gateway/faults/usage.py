"""How far and how long the vehicle was driven since a clear, and with the MIL on (J1939 DM21, PIDs 21, 31, 4D, 4E).

By SAE J1979: counters with the MIL on begin at 0 when it is lit again, and stay while it is out; a clear of all, or
of all that is emission related, sets all four to 0.
"""

from __future__ import annotations

from typing import NamedTuple, Self

from pydantic import Field, model_validator

from gateway.faults.dtc import ALL_DTCS, EMISSION_DTCS
from gateway.faults.ledger import Ledger
from gateway.faults.settings import POWER, ConditionSettings
from gateway_fdi.common.tomlfile import StrictModel

#: Most that is kept in this process before it is written: a kill loses no more [s, m].
KEPT_S, KEPT_M = 60.0, 1000.0
_LIT = "usage.lit"


class TimedCondition(ConditionSettings):
    """A signal in a range for some time."""

    seconds: float = Field(0.0, ge=0, le=1e5, allow_inf_nan=False, description="for this time in the cycle [s]")
    at_a_stretch: bool = Field(False, description="and without a break, rather than in all")


class UsageParams(StrictModel):
    """Signals of the vehicle's use."""

    running: tuple[ConditionSettings, ...] = Field((), description="the engine runs while all of these are met")
    speed: str | None = Field(None, description="signal of the vehicle's speed [km/h], for distances")
    odometer: str | None = Field(None, description="signal of the distance driven [km], instead of the speed")
    cycle: str = Field(POWER, description="operation cycle of the monitors' performance ratios")
    denominator: tuple[TimedCondition, ...] = Field(
        (),
        description="conditions for a cycle to count for the general denominator of these ratios, e.g. 600 s of running"
        "; none: no ratios",
    )

    @model_validator(mode="after")
    def _one_distance(self) -> Self:
        if self.speed is not None and self.odometer is not None:
            raise ValueError("give speed or odometer, not both")
        if any(condition.rise for condition in (*self.running, *self.denominator)):
            raise ValueError("rise is for operation cycles, not for conditions of usage")
        return self

    @property
    def counted_cycle(self) -> str | None:
        """The operation cycle of the performance ratios; None: there are none."""
        return self.cycle if self.denominator else None


class Driven(NamedTuple):
    """Distances [m] and engine running times [s], since the clear and with the MIL on; None: not known."""

    lit_m: float | None
    cleared_m: float | None
    lit_s: float | None
    cleared_s: float | None


class Usage:
    """Counts distance and engine running time.

    Args:
        held: the numbers, with what is to be written.
        distances: whether distances are known.
        times: whether running times are.
    """

    def __init__(self, held: Ledger, *, distances: bool = False, times: bool = False) -> None:
        self._held, self._distances, self._times = held, distances, times
        self._waiting = dict.fromkeys(Driven._fields, 0.0)

    def succeed(self, old: Usage) -> None:
        """Go on with what another one has counted."""
        self._waiting = old._waiting

    def add(self, metres: float, seconds: float, *, lit: bool) -> None:
        """Add what was driven since the last call.

        Args:
            metres: distance.
            seconds: time that the engine ran.
            lit: whether the MIL is on.
        """
        if lit != bool(self._held.fact(_LIT)):
            self.flush()
            self._held.set_fact(_LIT, int(lit))
            if lit:
                self._reset("lit_m", "lit_s")
        self._waiting["cleared_m"] += metres
        self._waiting["cleared_s"] += seconds
        if lit:
            self._waiting["lit_m"] += metres
            self._waiting["lit_s"] += seconds
        if self._waiting["cleared_m"] >= KEPT_M or self._waiting["cleared_s"] >= KEPT_S:
            self.flush()

    def flush(self) -> None:
        """Have all that is counted written with the next commit; parts of one stay here."""
        for name, more in self._waiting.items():
            whole = int(more)
            if whole:
                self._held.set_fact(f"usage.{name}", self._held.fact(f"usage.{name}") + whole)
                self._waiting[name] = more - whole

    def on_clear(self, group: int) -> None:
        """Start again at 0 if all DTCs that count are cleared; all is written first (see :meth:`flush`)."""
        if group in (ALL_DTCS, EMISSION_DTCS):
            self._reset(*Driven._fields)

    def _reset(self, *names: str) -> None:
        for name in names:
            self._waiting[name] = 0.0
            if self._held.fact(f"usage.{name}"):
                self._held.set_fact(f"usage.{name}", 0)

    def driven(self) -> Driven:
        """Return what was driven by now."""
        known = {"m": self._distances, "s": self._times}
        return Driven(
            **{
                name: self._held.fact(f"usage.{name}") + waiting if known[name[-1]] else None
                for name, waiting in self._waiting.items()
            }
        )

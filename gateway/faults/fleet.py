"""Settings of a car of a fleet, and its queue of events: what a fault memory keeps for the fleet."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from pydantic import Field

from gateway.common.jsonlines import line
from gateway.faults.ledger import Ledger
from gateway.faults.outgoing import Outgoing
from gateway.faults.settings import ConditionSettings
from gateway_fdi.common.tomlfile import StrictModel

#: Number in the store, with a fault's id after it: serial number of the campaign whose limits it failed by last.
LIMITS = "limits."
#: Form of a name that is a part of a topic and of a file's name.
NAME = r"^[A-Za-z0-9_-]{1,64}$"


class FleetCondition(ConditionSettings):
    """A condition by which statistics are kept apart."""

    name: str = Field(pattern=NAME, description="of it, in statistics")


class FleetParams(StrictModel):
    """A car of a fleet: what it is called, and how much waits for the fleet while there is no link."""

    name: str = Field(pattern=NAME, description="the fleet; campaigns of another one are refused")
    car: str = Field(pattern=NAME, description="this car, as gateway fleet id makes it of its VIN; not the VIN")
    model: str = Field("", max_length=64, description="model line, for rates by model")
    software: str = Field("", max_length=64, description="version of the car's software, for rates by software")
    bytes: int = Field(
        4_000_000, ge=10_000, le=10**9, description="of events that wait; beyond, the oldest details go first"
    )
    condition: tuple[FleetCondition, ...] = Field(
        (), max_length=8, description="statistics are kept apart by the first of these that is met, and by none"
    )
    limits: Path | None = Field(
        None,
        description="file of the limits of a campaign, which gateway fleet join writes and the next start, or reload,"
        " reads; relative to the work folder",
    )
    serial: int = Field(
        0, ge=0, lt=2**53, description="number of the campaign whose limits judge; 0: those of this file"
    )
    most_change: float = Field(
        4.0, gt=1, le=1000, allow_inf_nan=False, description="a campaign makes no range wider or narrower by more"
    )


class FleetQueue:
    """Events that wait for the fleet; none where the car is in no fleet.

    Args:
        held: the fault memory's contents.
        params: the car; None: it is in no fleet.
    """

    def __init__(self, held: Ledger, params: FleetParams | None) -> None:
        self._held, self._params = held, params

    @property
    def offered(self) -> bool:
        """Whether the car is in a fleet."""
        return self._params is not None

    def judged(self, fault: str) -> None:
        """Note by which limits a fault has failed."""
        name = f"{LIMITS}{fault}"
        if self._params is not None and self._held.fact(name) != self._params.serial:
            self._held.set_fact(name, self._params.serial)

    def post(self, event: Mapping[str, Any], *, detail: bool = False) -> None:
        """Have an event of the JSON contract wait; it is written with the next commit."""
        if self._params is None:
            return
        t_ns = event.get("t_ns")
        new = Outgoing(t_ns if isinstance(t_ns, int) else 0, detail, self._params.serial, line(event))
        self._held.note_outgoing([new], (), self._params.bytes)

    def arrived(self, numbers: Iterable[int]) -> None:
        """Note the rows that have arrived at the fleet; they go with the next commit."""
        if self._params is not None:
            self._held.note_outgoing((), numbers, self._params.bytes)

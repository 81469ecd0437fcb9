"""Health of the gateway itself: its wall clock, which stamps what people read, was set while it ran.

Time in the engine goes on evenly if the wall clock is set; but stamps before and after the step cannot be compared, so
the step is reported. U3000 is the control module; failure type 62 (SAE J2012: signal compare failure), because two
clocks that must agree, the wall clock and the monotonic one, do not.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from pydantic import Field, field_validator

from gateway.common.times import NEVER, zone_of
from gateway.engine.checks.own_health import OWNER
from gateway.engine.events import NO_BUS
from gateway.engine.instances import FaultSlot
from gateway.monitors.contract import Debounce, Fault, MonitorParams
from gateway_fdi.errors import InputError

OWN_FAULTS = (
    Fault(
        "clock_stepped",
        "U3000-62",
        "wall clock was set while the gateway ran",
        ("step [s]", "steps since the start"),
        Debounce(failed_after=1, passed_after=1, jump_down=True),
        tested="step [s]",
    ),
)


class ClockParams(MonitorParams):
    """How the wall clock is watched."""

    watched: bool = Field(True, description="false: a step is reported, but is no fault")
    tolerance_ms: float = Field(
        10.0,
        ge=1,
        le=1e6,
        allow_inf_nan=False,
        description="change against the monotonic clock that is a step [ms]",
    )
    heals_after_s: float = Field(
        10.0,
        gt=0,
        le=3.6e6,
        allow_inf_nan=False,
        description="each time of this length without a step is a passed test [s]",
    )
    zone: str = Field(
        "UTC", description="time zone of logs whose header has a date without one (ASC, BLF, TRC), e.g. Europe/Berlin"
    )

    @field_validator("zone")
    @classmethod
    def _zone_is_known(cls, zone: str) -> str:
        try:
            zone_of(zone)
        except InputError as error:
            raise ValueError(error.message) from error
        return zone


def fill(row: Any, params: ClockParams | None, first_fault: int) -> list[FaultSlot]:
    """Fill the health of the gateway itself; returns the faults it can report, in order."""
    row["deadline_ns"] = NEVER
    row["until"] = NEVER
    row["fault"] = -1
    if params is None or not params.watched:
        return []
    row["most"], row["window_ns"] = (
        round(params.tolerance_ms * 1e3),
        round(params.heals_after_s * 1e9),
    )
    row["fault"][-len(OWN_FAULTS) :] = first_fault + np.arange(len(OWN_FAULTS))
    return [FaultSlot(f"{OWNER}.{fault.name}", fault, NO_BUS) for fault in OWN_FAULTS]

"""Faults whose test results come from other processes: the table ``[report]`` of a configuration.

AUTOSAR DEM takes them by Dem_SetEventStatus; here they come by a unix socket (docs/report.md).
"""

from __future__ import annotations

import re
from typing import Annotated, Self

from pydantic import Field, field_validator, model_validator

from gateway.faults.settings import DebounceOverride, DtcText
from gateway.host import process
from gateway.monitors.contract import EVIDENCE, Debounce, Fault
from gateway_fdi.common.tomlfile import StrictModel

#: Modes that the socket can have.
MODES = (0o600, 0o660, 0o666)
_NAME = r"^[A-Za-z0-9_-]+$"
_UNIT = re.compile(r" *\[[^\]]*\]$")


#: A user or a group in TOML, by name or number.
UserOrGroup = str | Annotated[int, Field(ge=0)]


class ExternalFault(StrictModel):
    """A fault that another process tests. Other settings of a fault are in ``[fault."reporter.name"]``."""

    name: str = Field(pattern=_NAME, description="second part of its id")
    dtc: DtcText = Field(description='e.g. "P0A7E-98"')
    description: str = Field(min_length=1, description="one line for people")
    data: tuple[str, ...] = Field(
        (), max_length=EVIDENCE, description='names of numbers that its reports may carry, e.g. "temperature [degC]"'
    )
    debounce: DebounceOverride = Field(
        DebounceOverride(), description="of the results prepassed and prefailed; default: each qualifies"
    )
    remedy: str = Field("", description="what to do about it, for people; default: by its failure type")

    @field_validator("data")
    @classmethod
    def _one_of_each(cls, data: tuple[str, ...]) -> tuple[str, ...]:
        keys = [key_of(name) for name in data]
        if "" in keys or len(set(keys)) < len(keys):
            raise ValueError("each name once, and none empty; the unit stands in brackets")
        return data

    @property
    def fault(self) -> Fault:
        """The fault as the engine knows it."""
        debounce = Debounce(jump_down=True).changed(self.debounce.asked)
        return Fault(self.name, self.dtc, self.description, self.data, debounce, self.remedy)


class ReporterParams(StrictModel):
    """A process, or several, that report test results: its faults, and the users who may report them."""

    name: str = Field(pattern=_NAME, description="first part of its fault ids")
    users: tuple[UserOrGroup, ...] = Field((), description="users that may report, beside the gateway's and root")
    groups: tuple[UserOrGroup, ...] = Field((), description="groups whose members may report")
    events_per_s: float = Field(
        100.0, gt=0, le=10_000, allow_inf_nan=False,
        description="reports that are taken in a second, and at once; more are refused",
    )  # fmt: skip
    alive_ms: float | None = Field(
        None, ge=10, le=3.6e6, allow_inf_nan=False,
        description="a report is due within this time of the last one, and of the start [ms]; none: whenever it likes",
    )  # fmt: skip
    fault: tuple[ExternalFault, ...] = Field(min_length=1, description="what it tests")

    def uids(self) -> set[int]:
        """Return the users of this machine that may report, by number; one that it does not have is left out."""
        return {uid for uid in map(_uid, self.users) if uid is not None}

    def gids(self) -> set[int]:
        """Return the groups of this machine whose members may report, by number."""
        return {gid for gid in map(_gid, self.groups) if gid is not None}

    def strangers(self) -> list[str]:
        """Return the users and groups that this machine does not have."""
        lacking = [f'user "{name}"' for name in self.users if _uid(name) is None]
        return lacking + [f'group "{name}"' for name in self.groups if _gid(name) is None]


class ReportParams(StrictModel):
    """The socket on which other processes report test results."""

    socket: str = Field(min_length=1, max_length=100, description="unix socket; relative to the work folder")
    mode: int | None = Field(
        None,
        description="its mode, e.g. 0o660; default 0o600, or 0o666 where a reporter names users or groups: each who"
        " comes is judged by its user and groups in any case",
    )
    connections: int = Field(64, ge=1, le=1024, description="most connections at a time")
    reporter: tuple[ReporterParams, ...] = Field(min_length=1, description="those who may report")

    @model_validator(mode="after")
    def _mode_lets_them_in(self) -> Self:
        if self.mode is not None and self.mode not in MODES:
            raise ValueError(f"mode is one of {', '.join(f'0o{mode:o}' for mode in MODES)}")
        if self.mode == 0o600 and any(reporter.users or reporter.groups for reporter in self.reporter):
            raise ValueError("mode 0o600 keeps everybody out whom users and groups would let in")
        return self

    @property
    def mode_of_socket(self) -> int:
        """Mode of the socket."""
        if self.mode is not None:
            return self.mode
        return 0o666 if any(reporter.users or reporter.groups for reporter in self.reporter) else 0o600


def key_of(name: str) -> str:
    """Return the key by which reports carry a number: its name without its unit."""
    return _UNIT.sub("", name)


def _uid(name: str | int) -> int | None:
    return name if isinstance(name, int) else process.user_named(name)


def _gid(name: str | int) -> int | None:
    return name if isinstance(name, int) else process.group_named(name)

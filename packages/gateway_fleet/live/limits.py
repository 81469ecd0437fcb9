"""Limits of a campaign, put in place of a configuration's own: numbers of tests that there are, and nothing else."""

from __future__ import annotations

import copy
import math
from pathlib import Path
from typing import Any

from pydantic import Field

from gateway_fdi.common.log import get_logger
from gateway_fdi.common.tomlfile import StrictModel, load
from gateway_fdi.errors import GatewayError, InputError

#: Last part of a test's id -> key of the signal's limits, place in it.
_ENDS = {"low": ("plausible", 0), "high": ("plausible", 1), "gradient": ("gradient", None)}

log = get_logger(__name__)


class Limit(StrictModel):
    """A limit of a test of a signal."""

    test: str = Field(max_length=256, description='id of the fault, e.g. "voltage.Value.high"')
    limit: float = Field(allow_inf_nan=False, description="signal's unit, or unit/s for a gradient")
    car: str = Field("", max_length=64, description="of this car only; none: of all")


class LimitsFile(StrictModel):
    """A file of limits, as ``gateway fleet join`` writes it."""

    serial: int = Field(ge=1, lt=2**53, description="number of the campaign")
    limit: tuple[Limit, ...] = Field(max_length=10_000, description="limits")


def with_limits(data: dict[str, Any]) -> dict[str, Any]:
    """Return a configuration's tables with the limits of the file that it names; those of a wrong file are left out.

    A car must not be without diagnosis because of a campaign: that is logged, and its own limits judge.
    """
    fleet = data.get("fleet")
    file = fleet.get("limits") if isinstance(fleet, dict) else None
    if not isinstance(file, str) or not Path(file).is_file():
        return data
    try:
        found = load(Path(file), LimitsFile)
        return applied(data, found, _most(fleet))
    except GatewayError as error:
        log.error("limits of a campaign are not taken; those of the configuration judge", file=file, reason=str(error))
        return data


def _most(fleet: Any) -> float:
    most = fleet.get("most_change", 4.0)
    return float(most) if isinstance(most, int | float) else 4.0


def applied(data: dict[str, Any], limits: LimitsFile, most_change: float) -> dict[str, Any]:
    """Return a configuration's tables with limits put in.

    Args:
        data: the tables of its file.
        limits: to put in.
        most_change: a range becomes no more than this wider or narrower, a gradient no more larger or smaller.

    Raises:
        InputError: a test that there is not, or a change that is too large.
    """
    made = copy.deepcopy(data)
    before: dict[int, Any] = {}
    for one in limits.limit:
        if one.car not in ("", made["fleet"].get("car")):
            continue
        entry = _entry(made, one.test)
        key, place = _ENDS[one.test.rpartition(".")[2]]
        before.setdefault(id(entry), dict(entry))
        entry[key] = one.limit if place is None else [one.limit if k == place else v for k, v in enumerate(entry[key])]
    for entry in (e for m in made.get("monitor", []) for e in m.get("signal", []) if id(e) in before):
        _refuse_wild(before[id(entry)], entry, most_change)
    made["fleet"] = {**made["fleet"], "serial": limits.serial}
    return made


def _entry(data: dict[str, Any], test: str) -> Any:
    """Return the table of a signal that a test is of."""
    parts = test.split(".")
    if len(parts) == 3 and parts[2] in _ENDS:
        for monitor in data.get("monitor", []):
            for entry in monitor.get("signal", []) if monitor.get("name") == parts[0] else ():
                name = entry.get("name") or str(entry.get("signal", "")).rpartition(".")[2]
                if name == parts[1] and _ENDS[parts[2]][0] in entry:
                    return entry
    raise InputError("no test of a signal with a limit of this kind here", key="test", value=test)


def _refuse_wild(before: Any, now: Any, most: float) -> None:
    for key in ("plausible", "gradient"):
        if before.get(key) == now.get(key):
            continue
        old, new = (_width(each[key]) for each in (before, now))
        if not (math.isfinite(new) and new > 0.0 and old / most <= new <= old * most):
            text = f"from {before[key]}: a range or gradient changes by no more than {most:g} times"
            raise InputError(text, key=f"{now.get('signal')}.{key}", value=now[key])


def _width(value: Any) -> float:
    return float(value[1]) - float(value[0]) if isinstance(value, list | tuple) else float(value)

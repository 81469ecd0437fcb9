"""Models of plants refined by healthy logs (:class:`gateway.monitors.contract.Refinement`)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tomlkit
from pydantic import BaseModel

from gateway.config.model import Config
from gateway.config.monitor_types import monitor_of
from gateway.monitors.contract import Refinement
from gateway_calibration.file import put, rounded
from gateway_calibration.logs import Chosen, Reading, Replay, of_kind
from gateway_calibration.part import Part, Parts

#: Keys that a replay for learning sets and a configuration is not to hold.
_REPLAY = ("learning",)


@dataclass(frozen=True)
class Plant:
    """Findings of the logs for a monitor's plant.

    Attributes:
        monitor: its name.
        seconds: of the logs.
        fit: of each log, see :class:`gateway.monitors.contract.Refined`.
        rows: name, configured value, value found in the end, how sure.
        keys: of its table, with new values.
    """

    monitor: str
    seconds: float
    fit: tuple[float, ...]
    rows: tuple[tuple[str, float, float, float], ...]
    keys: Mapping[str, Any]


def _plain(value: Any) -> Any:
    """Return a value as TOML has it."""
    if isinstance(value, BaseModel):
        return value.model_dump(exclude_none=True)
    return [_plain(v) for v in value] if isinstance(value, (list, tuple)) else value


def _changed(config: Config, place: int, keys: Mapping[str, Any]) -> Config:
    """Return a configuration with one monitor, and other keys in its table."""
    entry = config.monitor[place]
    extra = {**(entry.model_extra or {}), **{key: _plain(value) for key, value in keys.items()}}
    extra = {key: value for key, value in extra.items() if value is not None}
    bare = entry.model_copy()
    object.__setattr__(bare, "__pydantic_extra__", extra)
    return config.model_copy(update={"monitor": (bare,)})


def _replayed(config: Config, log: Path, how: Reading) -> tuple[float, Any]:
    """Replay a log; returns its seconds, and the only monitor's state at its end."""
    with Replay(config, how) as replay:
        for frames in replay.frames(log):
            replay.gateway.feed(frames)
        return replay.seconds, replay.gateway.engine.state_of(0)[0].copy()


def of_log(config: Config, chosen: Chosen[Refinement], keys: Mapping[str, Any], log: Path, how: Reading) -> Part:
    """Refine a plant by a log.

    Args:
        config: the configuration.
        chosen: the monitor.
        keys: of its table, as the log before has left them (fact ``keys``).
        log: a recording without a fault.
        how: it is read.

    Returns:
        the facts ``keys``, ``fit`` and ``rows`` (:class:`gateway.monitors.contract.Refined`).

    Raises:
        InputError: the log cannot be read.
    """
    asked = _changed(config, chosen.place, {**chosen.calibration.wanted(chosen.params), **keys})
    _, params = monitor_of(asked.monitor[0])
    seconds, state = _replayed(asked, log, how)
    refined = chosen.calibration.found(params, state)
    new = {key: _plain(value) for key, value in refined.keys.items()}
    return Part(seconds, facts={"keys": {**keys, **new}, "fit": refined.fit, "rows": [list(r) for r in refined.rows]})


def merged(chosen: Chosen[Refinement], said: Parts) -> Plant | None:
    """Put together what :func:`of_log` found, log after log; None without a log."""
    if not said:
        return None
    told: dict[str, float] = {}
    for part in said.values():
        for name, before, _, _ in part.facts["rows"]:
            told.setdefault(name, before)
    last = list(said.values())[-1]
    rows = tuple((name, told[name], now, sure) for name, _, now, sure in last.facts["rows"])
    fits = tuple(part.facts["fit"] for part in said.values())
    return Plant(chosen.name, sum(part.seconds for part in said.values()), fits, rows, last.facts["keys"])


def learn(config: Config, logs: Sequence[Path], how: Reading) -> list[Plant]:
    """Refine the plants of all monitors that have one by logs, one after the other."""
    plants = []
    for chosen in of_kind(config, Refinement):
        said: dict[Path, Part] = {}
        keys: Mapping[str, Any] = {}
        for log in logs:
            said[log] = of_log(config, chosen, keys, log, how)
            keys = said[log].facts["keys"]
        if (plant := merged(chosen, said)) is not None:
            plants.append(plant)
    return plants


def write(path: Path, plants: Sequence[Plant], source: str) -> None:
    """Put matrices, bounds and noise into the tables of a configuration's monitors; all else stays as it is."""
    document = tomlkit.parse(path.read_text())
    by_name = {plant.monitor: plant for plant in plants}
    for entry in document.get("monitor", []):
        plant = by_name.get(str(entry.get("name")))
        if plant is None:
            continue
        for key, value in plant.keys.items():
            if key in _REPLAY:
                continue
            if value is None:
                entry.pop(key, None)
                continue
            if key == "output":
                for table, part in zip(entry["output"], value, strict=True):
                    table["noise"] = float(f"{part['noise']:.4g}")
                continue
            put(entry, key, rounded(_plain(value)))
        put(entry, "calibrated", source)
    path.write_text(tomlkit.dumps(document))

"""CUSUM tests: nu and J (:mod:`gateway.fdi.cusum`) from healthy logs.

A first replay gives each residual's nu, a second, with these nu and thresholds out of reach, each quantity's largest T.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np

from gateway.calibration.logs import Chosen, Progress, batches, of_kind, refuse, watch
from gateway.config.model import Config
from gateway.errors import InputError
from gateway.fdi.cusum import FLOOR, MARGIN, nus, threshold
from gateway.monitors.contract import CusumCalibration
from gateway.runtime.app import Gateway

#: A threshold that nothing reaches, in units of nu: T grows on, and its largest value is seen.
_NEVER = 1e9


@dataclass(frozen=True)
class Quantity:
    """What logs say of one test quantity.

    Attributes:
        monitor: name of the monitor.
        name: of the quantity, key in ``thresholds``.
        residual: key in ``nu``; none if the quantity has a unit of its own.
        samples: residuals that updated it.
        nu_now: of the configuration; None without a residual, or where nothing has set it yet.
        nu: found; that of the configuration where there were too few samples.
        now: threshold of the configuration, in units of nu; None: nothing has set it yet.
        largest: healthy T, in units of the nu found.
        threshold: found, in units of nu.
        floored: the floor decides.
        digest: of what it is, empty: it never changes.
    """

    monitor: str
    name: str
    residual: str
    samples: int
    nu_now: float | None
    nu: float | None
    now: float | None
    largest: float
    threshold: float
    floored: bool
    digest: str = ""

    @property
    def margin(self) -> float:
        """Largest healthy T over the threshold."""
        return self.largest / self.threshold


@dataclass(frozen=True)
class Found:
    """What logs say.

    Attributes:
        seconds: of the logs.
        rows: of all quantities.
        failed: DTCs that the logs set with the configuration as it is.
    """

    seconds: float
    rows: tuple[Quantity, ...]
    failed: tuple[str, ...]

    @property
    def tables(self) -> dict[str, dict[str, dict[str, float | str]]]:
        """What a configuration is to hold: monitor -> ``nu``, ``thresholds``, and ``digests`` where there are any."""
        tables: dict[str, dict[str, dict[str, float | str]]] = {}
        for row in self.rows:
            mine = tables.setdefault(row.monitor, {"nu": {}, "thresholds": {}})
            if row.residual and row.nu is None:
                continue  # nothing is known of it: it stays silent
            mine["thresholds"][row.name] = row.threshold
            if row.nu is not None:
                mine["nu"][row.residual] = row.nu
            if row.digest:
                mine.setdefault("digests", {})[row.name] = row.digest
        return tables


_Monitors = list[Chosen[CusumCalibration]]


def _now(table: Any, name: str) -> float | None:
    """Return what a table of a monitor's parameters has now: a model of them, or a dictionary; None if nothing."""
    found = table.get(name) if isinstance(table, Mapping) else getattr(table, name)
    return None if found is None else float(found)


def _replay(
    config: Config,
    logs: Sequence[Path],
    chosen: _Monitors,
    failed: set[str],
    *,
    file: Path | None,
    maps: Sequence[str],
    progress: Progress,
) -> tuple[float, dict[str, list[Any]]]:
    """Replay logs; returns their seconds, and each monitor's state at the end of each."""
    states: dict[str, list[Any]] = {name: [] for name in (c.name for c in chosen)}
    seconds = 0.0
    for path in logs:
        gateway = Gateway(config, None, file=file)
        watch(gateway, failed)
        begun = last = 0
        try:
            for frames in batches(config, path, progress, maps):
                if not begun:
                    begun = int(frames[0]["t_ns"])
                    gateway.start(begun)
                gateway.feed(gateway.without_own(frames))
                last = int(frames[-1]["t_ns"])
            for each in chosen:
                place = gateway.engine.place_of(each.name)
                states[each.name].append(gateway.engine.state_of(place)[0].copy())
        finally:
            gateway.close()
        seconds += (last - begun) * 1e-9
    return seconds, states


def _rows(
    chosen: Chosen[CusumCalibration],
    states: list[Any],
    nus: Mapping[str, float],
    margin: float,
    floor: float,
) -> list[Quantity]:
    """Say what logs did to a monitor's quantities when its thresholds were out of reach."""
    rows = []
    calibration, now = chosen.calibration, cast(Any, chosen.params)
    digests = {} if calibration.digests is None else calibration.digests(chosen.params)
    peaks = np.max([calibration.peaks(s) for s in states], axis=0) * _NEVER
    samples = sum(calibration.sums(s)["samples"] for s in states)
    for place, (quantity, residual) in enumerate(calibration.quantities):
        largest = float(peaks[place])
        least = calibration.floors.get(quantity, floor)
        rows.append(
            Quantity(
                monitor=chosen.name,
                name=quantity,
                residual=residual,
                samples=int(samples[place]),
                nu_now=_now(now.nu, residual) if residual else None,
                nu=nus.get(residual),
                now=_now(now.thresholds, quantity),
                largest=largest,
                threshold=threshold(largest, margin, least),
                floored=largest < least,
                digest=digests.get(quantity, ""),
            )
        )
    return rows


def _typical(chosen: Chosen[CusumCalibration], states: list[Any]) -> dict[str, float]:
    """Return nu of each residual: the largest of its quantities', or the parameters' where samples are too few.

    One that has neither is not among them.
    """
    calibration, now = chosen.calibration, cast(Any, chosen.params)
    keys = ("samples", "total", "squares")
    sums = np.sum([[calibration.sums(s)[key] for key in keys] for s in states], axis=0)
    residuals = [residual for _, residual in calibration.quantities]
    found = nus(residuals, sums)
    asked = {r: found.get(r, _now(now.nu, r)) for r in residuals if r}
    return {r: nu for r, nu in asked.items() if nu is not None}


def learn(
    config: Config,
    logs: Sequence[Path],
    *,
    margin: float = MARGIN,
    floor: float = FLOOR,
    file: Path | None = None,
    maps: Sequence[str] = (),
    progress: Progress = lambda _: None,
) -> Found:
    """Find nu and thresholds of all CUSUM tests.

    Args:
        config: the configuration.
        logs: recordings without a fault.
        margin: Phi of (46), largest healthy T over the threshold, in ]0, 1].
        floor: least largest T, in units of nu.
        file: of the configuration, for errors.
        maps: channels of the logs taken as buses, ``"channel=bus"`` each.
        progress: called with the number of frames of each batch; each log is read twice.

    Raises:
        InputError: no monitor of the configuration has CUSUM tests, or a log cannot be read or holds no step of them.
    """
    chosen = of_kind(config, CusumCalibration)
    if not chosen:
        raise refuse("CUSUM tests", file)
    failed: set[str] = set()
    seconds, states = _replay(config, logs, chosen, failed, file=file, maps=maps, progress=progress)
    typical = {}
    for each in chosen:
        if not any(each.calibration.sums(s)["samples"].any() for s in states[each.name]):
            raise InputError(
                f'the logs hold nothing that monitor "{each.name}" tests',
                file=logs[0] if logs else None,
            )
        typical[each.name] = _typical(each, states[each.name])
    entries = list(config.monitor)
    for each in chosen:
        never = {quantity: _NEVER for quantity, _ in each.calibration.quantities}
        changes = {"nu": typical[each.name], "thresholds": never}
        entries[each.place] = entries[each.place].model_copy(update=changes)
    opened = config.model_copy(update={"monitor": tuple(entries)})
    _, states = _replay(opened, logs, chosen, set(), file=file, maps=maps, progress=progress)
    rows: list[Quantity] = []
    for each in chosen:
        rows += _rows(each, states[each.name], typical[each.name], margin, floor)
    return Found(seconds, tuple(rows), tuple(sorted(failed)))

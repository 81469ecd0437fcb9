"""CUSUM tests: nu and J (:mod:`gateway_fdi.cusum`) from healthy logs.

A first replay gives each residual's nu, a second, with these nu and thresholds out of reach, each quantity's largest T.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from gateway.config.model import Config
from gateway.monitors.contract import CusumCalibration
from gateway_calibration.logs import Chosen, Reading, Replay, of_kind, refuse
from gateway_calibration.part import Part, Parts, failed_in
from gateway_fdi.cusum import FLOOR, MARGIN, NEVER, nus, threshold
from gateway_fdi.errors import InputError


@dataclass(frozen=True)
class Quantity:
    """Findings of the logs for one test quantity.

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
    """Findings of the logs.

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
        """Values for a configuration: monitor -> ``nu``, ``thresholds``, and ``digests`` where there are any."""
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


#: A nu, and a J in units of nu, beyond which a residual is not noise: it diverges, drifts, or the log has a fault.
MOST_NU, MOST_J = 1e12, 1e5

#: Monitor -> residual -> nu.
Typical = Mapping[str, Mapping[str, float]]
#: Sums of each quantity, in this order.
_SUMS = ("samples", "total", "squares")


def _now(table: Any, name: str) -> float | None:
    """Return what a table of a monitor's parameters has now: a model of them, or a dictionary; None if nothing."""
    found = table.get(name) if isinstance(table, Mapping) else getattr(table, name)
    return None if found is None else float(found)


def _of_log(config: Config, log: Path, taken: Callable[[CusumCalibration, Any], Any], how: Reading) -> Part:
    """Replay a log; returns what is taken of each monitor's state at its end."""
    with Replay(config, how) as replay:
        for frames in replay.frames(log):
            replay.gateway.feed(frames)
        engine, arrays = replay.gateway.engine, {}
        for each in of_kind(config, CusumCalibration):
            state = engine.state_of(engine.place_of(each.name))[0]
            arrays[each.name] = np.array(taken(each.calibration, state), np.float64)
    return Part(replay.seconds, tuple(sorted(replay.failed)), arrays)


def sums_of_log(config: Config, log: Path, how: Reading) -> Part:
    """Replay a log; returns each monitor's sums, shape (3, quantities): samples, total and squares of the moduli."""

    def taken(calibration: CusumCalibration, state: Any) -> Any:
        sums = calibration.sums(state)
        return [sums[key] for key in _SUMS]

    return _of_log(config, log, taken, how)


def peaks_of_log(config: Config, typical: Typical, log: Path, how: Reading) -> Part:
    """Replay a log with nu found and thresholds out of reach; returns samples and largest T, shape (2, quantities)."""

    def taken(calibration: CusumCalibration, state: Any) -> Any:
        return [calibration.sums(state)["samples"], calibration.peaks(state)]

    return _of_log(_opened(config, typical), log, taken, how)


def typical_of(config: Config, said: Parts) -> Typical:
    """Return nu of each monitor's residuals, of the sums of all logs.

    Raises:
        InputError: the logs hold nothing that a monitor tests.
    """
    found = {}
    for each in of_kind(config, CusumCalibration):
        mine = [part.arrays[each.name] for part in said.values()]
        if not any(sums[0].any() for sums in mine):
            raise InputError(f'the logs hold nothing that monitor "{each.name}" tests', file=next(iter(said), None))
        with np.errstate(all="ignore"):
            found[each.name] = _typical(each, mine)
        for residual, nu in found[each.name].items():
            _refuse_nu(each.name, residual, nu)
    return found


def _refuse_nu(monitor: str, residual: str, nu: float) -> None:
    """Refuse what cannot be the size of a healthy residual.

    Raises:
        InputError: it is zero, infinite, no number, or beyond all noise.
    """
    what = f'monitor "{monitor}": the healthy residual of {residual} has a nu of {nu:.4g}'
    if nu == 0.0:
        raise InputError(f"{what}, nothing moves it in these logs: take logs in which its signals move, or other tests")
    if not nu <= MOST_NU:
        raise InputError(f"{what}, far from any noise: it diverges; gateway check shows its modes against the period")


def _refuse_threshold(row: Quantity) -> None:
    """Refuse a threshold that would keep a test silent for ever.

    Raises:
        InputError: it is infinite, no number, or so large in nu that the residual is no noise around zero.
    """
    if row.residual and row.nu is not None and not row.threshold <= MOST_J:
        raise InputError(
            f'monitor "{row.monitor}": {row.name} would need a threshold of {row.threshold:.4g} nu (nu = {row.nu:.4g}),'
            " far from the noise: its residual drifts or diverges, or the logs have a fault; gateway replay --plot"
            " shows it, gateway check its modes"
        )


def _opened(config: Config, typical: Typical) -> Config:
    """Return the configuration with nu found and thresholds that nothing reaches."""
    entries = list(config.monitor)
    for each in of_kind(config, CusumCalibration):
        never = {quantity: NEVER for quantity, _ in each.calibration.quantities}
        changes = {"nu": dict(typical[each.name]), "thresholds": never}
        entries[each.place] = entries[each.place].model_copy(update=changes)
    return config.model_copy(update={"monitor": tuple(entries)})


def merged(
    config: Config, said: Parts, typical: Typical, peaks: Parts, *, margin: float = MARGIN, floor: float = FLOOR
) -> Found:
    """Put together what :func:`sums_of_log` and :func:`peaks_of_log` found.

    Args:
        config: the configuration.
        said: sums of the logs.
        typical: nu of all of them (:func:`typical_of`).
        peaks: largest T, with these nu.
        margin: Phi of (46), largest healthy T over the threshold, in ]0, 1].
        floor: least largest T, in units of nu.
    """
    rows: list[Quantity] = []
    for each in of_kind(config, CusumCalibration):
        mine = [part.arrays[each.name] for part in peaks.values()]
        rows += _rows(each, mine, typical[each.name], margin, floor)
    for row in rows:
        _refuse_threshold(row)
    return Found(sum(part.seconds for part in said.values()), tuple(rows), failed_in(said))


def _rows(
    chosen: Chosen[CusumCalibration],
    peaks_of: list[NDArray[np.float64]],
    nus: Mapping[str, float],
    margin: float,
    floor: float,
) -> list[Quantity]:
    """Say what logs did to a monitor's quantities when its thresholds were out of reach."""
    rows = []
    calibration, now = chosen.calibration, cast(Any, chosen.params)
    digests = {} if calibration.digests is None else calibration.digests(chosen.params)
    peaks = np.max([each[1] for each in peaks_of], axis=0) * NEVER
    samples = np.sum([each[0] for each in peaks_of], axis=0)
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


def _typical(chosen: Chosen[CusumCalibration], said: list[NDArray[np.float64]]) -> dict[str, float]:
    """Return nu of each residual: the largest of its quantities', or the parameters' where samples are too few.

    One that has neither is not among them.
    """
    calibration, now = chosen.calibration, cast(Any, chosen.params)
    sums = np.sum(said, axis=0)
    residuals = [residual for _, residual in calibration.quantities]
    found = nus(residuals, sums)
    asked = {r: found.get(r, _now(now.nu, r)) for r in residuals if r}
    return {r: nu for r, nu in asked.items() if nu is not None}


def learn(config: Config, logs: Sequence[Path], how: Reading, *, margin: float = MARGIN, floor: float = FLOOR) -> Found:
    """Find nu and thresholds of all CUSUM tests.

    Args:
        config: the configuration.
        logs: recordings without a fault; each is read twice.
        how: they are read.
        margin: Phi of (46), largest healthy T over the threshold, in ]0, 1].
        floor: least largest T, in units of nu.

    Raises:
        InputError: no monitor of the configuration has CUSUM tests, or a log cannot be read or holds no step of them.
    """
    if not of_kind(config, CusumCalibration):
        raise refuse("CUSUM tests", how.file)
    said = {log: sums_of_log(config, log, how) for log in logs}
    typical = typical_of(config, said)
    peaks = {log: peaks_of_log(config, typical, log, how) for log in logs}
    return merged(config, said, typical, peaks, margin=margin, floor=floor)

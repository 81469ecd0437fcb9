"""Findings of healthy logs for redundant sensors (:class:`gateway.monitors.contract.SensorCalibration`)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit
from numpy.typing import NDArray

from gateway.bus.frames import Frames, have_data
from gateway.config.model import Config
from gateway.config.resolve import resolve
from gateway.engine.wiring import wire
from gateway.monitors.contract import SensorCalibration
from gateway.monitors.sampling import Const, Numbers, Sampling, number_all, prepare
from gateway.signals.decode import lookup
from gateway.signals.payloads import are_last, columns
from gateway.signals.reassembly import woven_of
from gateway.signals.tables import SignalRef, compile_plan
from gateway_calibration.file import put, rounded
from gateway_calibration.logs import Chosen, Reading, Replay, of_kind
from gateway_calibration.part import Part, Parts, failed_in
from gateway_fdi.errors import InputError
from gateway_fdi.jit import zeros

#: Samples further from each other than this number of periods are not of one record.
_GAP = 16

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Sensors:
    """Findings of the logs for a monitor's sensors.

    Attributes:
        monitor: its name.
        seconds: of the logs.
        rows: name, configured value, value found, standard deviation; NaN: not configured, not known.
        keys: of its table, with new values.
        failed: DTCs that the logs set with the configuration as it is.
    """

    monitor: str
    seconds: float
    rows: tuple[tuple[str, float, float, float], ...]
    keys: Mapping[str, Any]
    failed: tuple[str, ...]


class _Reader:
    """Reads the signals of one monitor off the frames."""

    def __init__(
        self,
        config: Config,
        places: Sequence[SignalRef],
        counters: Sequence[SignalRef],
        databases: Mapping[int, Any],
    ) -> None:
        self._sensors = len(places)
        places = [*places, *(counter for counter in counters if counter[:2] == places[-1][:2])]
        self._plan = compile_plan(list(databases.items()), set(places))
        self._columns = [
            (self._plan.message(place.bus, place.message), self._plan.position(*place)) for place in places
        ]
        self._woven = woven_of(self._plan)
        self._rows: dict[int, int] = {}
        self._values: list[list[tuple[NDArray[np.int64], Array]]] = [[] for _ in places]

    def take(self, frames: Frames) -> None:
        """Take a batch."""
        frames = frames if self._woven is None else self._woven.hear(frames)
        frames = frames[have_data(frames)]
        keys = frames["bus"].astype(np.int64) << 32 | frames["can_id"]
        for key in np.unique(keys):
            if int(key) not in self._rows:
                self._rows[int(key)] = int(
                    lookup(self._plan.keys, self._plan.rows, int(key) >> 32, int(key) & 0xFFFFFFFF)
                )
            row = self._rows[int(key)]
            if row < 0:
                continue
            mine = frames[keys == key]
            values = columns(mine, self._plan, row)
            mine = mine[are_last(mine)]
            for k, (message, position) in enumerate(self._columns):
                if message == row:
                    self._values[k].append((mine["t_ns"].astype(np.int64), values[:, position]))

    def records(self, sampling: Sampling) -> Iterator[Array]:
        """Yield samples, shape (samples, signals): one a frame of the last signal; of the others the newest.

        Which sample a frame carries its counter says, if it has one; those that were lost are NaN.
        """
        if not all(self._values):
            return
        told = [(np.concatenate([t for t, _ in v]), np.concatenate([y for _, y in v])) for v in self._values]
        t_ns = told[self._sensors - 1][0]
        table = np.full((len(t_ns), self._sensors), np.nan)
        for k, (times, values) in enumerate(told[: self._sensors]):
            at = np.searchsorted(times, t_ns, side="right") - 1
            table[at >= 0, k] = values[at[at >= 0]]
        c, numbers = zeros(1, Const)[0], np.empty(len(t_ns), np.int64)
        prepare(c, sampling, 1)
        counters = told[-1][1] if len(told) > self._sensors else np.full(len(t_ns), np.nan)
        number_all(zeros(1, Numbers)[0], c, t_ns, counters, numbers)
        taken = numbers >= 0
        for rows in np.split(np.flatnonzero(taken), np.flatnonzero(np.diff(numbers[taken]) > _GAP) + 1):
            at = numbers[rows] - numbers[rows[0]]
            record = np.full((at[-1] + 1, self._sensors), np.nan)
            record[at] = table[rows]
            yield record


def of_log(config: Config, chosen: Chosen[SensorCalibration], log: Path, how: Reading) -> Part:
    """Replay a log; returns the readings of one monitor.

    They are one array of shape (samples, inputs); the fact ``rows`` says how many of these are of one record.

    Raises:
        InputError: the log cannot be read.
    """
    alone = config.model_copy(update={"monitor": (config.monitor[chosen.place],), "fault": {}})
    found = resolve(alone)
    databases = dict(enumerate(found.databases))
    wired = wire(found.monitors[0], databases, {bus.name: k for k, bus in enumerate(config.bus)})
    places = wired.inputs[: chosen.calibration.sensors(chosen.params)]
    reader = _Reader(alone, [place for place in places if place is not None], wired.counters, databases)
    with Replay(alone, how) as replay:
        for frames in replay.frames(log):
            reader.take(frames)
            replay.gateway.feed(frames)
    records = list(reader.records(wired.samplings[0]))
    readings = {chosen.name: np.concatenate(records)} if records else {}
    rows = [len(record) for record in records]
    return Part(replay.seconds, tuple(sorted(replay.failed)), readings, {"rows": rows})


def _records(part: Part) -> list[Array]:
    """Return the records of a log."""
    ends = np.cumsum(part.facts["rows"], dtype=np.int64)[:-1]
    return [record for array in part.arrays.values() for record in np.split(array, ends)]


def merged(chosen: Chosen[SensorCalibration], said: Parts, *, file: Path | None = None) -> Sensors:
    """Put together what :func:`of_log` found.

    Raises:
        InputError: logs that do not tell, because the sensors are not moved enough or are not healthy.
    """
    records = [record for part in said.values() for record in _records(part)]
    try:
        found = chosen.calibration.found(chosen.params, records)
    except InputError as error:
        key = f"monitor[{chosen.place}]" + (f".{error.key}" if error.key else "")
        raise InputError(f'of "{chosen.name}": {error.message}', file=file, key=key, value=error.value) from error
    seconds = sum(part.seconds for part in said.values())
    return Sensors(chosen.name, seconds, found.rows, found.keys, failed_in(said))


def learn(config: Config, logs: Sequence[Path], how: Reading) -> list[Sensors]:
    """Measure the sensors of all monitors that have redundant ones.

    Raises:
        InputError: logs that do not tell, because the sensors are not moved enough or are not healthy.
    """
    measured = []
    for chosen in of_kind(config, SensorCalibration):
        said = {log: of_log(config, chosen, log, how) for log in logs}
        measured.append(merged(chosen, said, file=how.file))
    return measured


def write(path: Path, measured: Sequence[Sensors], source: str) -> None:
    """Put what was found into the tables of a configuration's monitors; all else stays as it is.

    One number for all channels gives way to a number for each.
    """
    document = tomlkit.parse(path.read_text())
    by_name = {one.monitor: one for one in measured}
    for entry in document.get("monitor", []):
        one = by_name.get(str(entry.get("name")))
        if one is None:
            continue
        for key, value in rounded(dict(one.keys), 4).items():
            if isinstance(value, list) and key in entry:
                for table, numbers in zip(entry[key], value, strict=True):
                    table.update(numbers)
            else:
                put(entry, key, value)
        for key in ("noise_mV", "resolution_mV"):
            entry.pop(key, None)
        put(entry, "calibrated", source)
    path.write_text(tomlkit.dumps(document))

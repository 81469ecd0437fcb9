"""Vehicles of a folder: their databases, the drive that is learned of, and the drives that it is judged on."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gateway.bus.frames import Frames, empty
from gateway.bus.logs import LogReader, open_writer
from gateway.config.model import Config
from gateway.signals.database import SUFFIXES
from gateway_fdi.common import log
from gateway_fdi.errors import InputError, InputErrors
from gateway_fleet.learn.car import Asking, asked_for, learned
from gateway_fleet.learn.learn import of_log
from gateway_fleet.learn.tails import FALSE_PER_HOUR
from gateway_fleet.study.drives.tables import Columns, is_table, read, written
from gateway_logs.corpus import Recording, find
from gateway_replay.log import Log


@dataclass(frozen=True)
class Vehicle:
    """A vehicle of a folder.

    Attributes:
        name: of its folder.
        databases: in its folder.
        learned: drive that is learned of.
        judged: others, in order of their names; the second half of the first one, if there is no other.
        columns: of a table of values; None: it is a log of frames.
    """

    name: str
    databases: tuple[Path, ...]
    learned: Path
    judged: tuple[Path, ...]
    columns: Columns | None = None


@dataclass(frozen=True)
class Learned:
    """A vehicle with its configuration.

    Attributes:
        vehicle: it.
        config: file that was written; None: nothing could be learned.
        judged: drives.
        seconds: of the drive that was learned of.
        error: why nothing could be learned; "": something was.
        truth: times [ns] of the rows that are judged, and whether something is wrong there; None: nobody says.
    """

    vehicle: str
    config: Path | None
    judged: tuple[Path, ...]
    seconds: float = 0.0
    error: str = ""
    truth: tuple[NDArray[np.int64], NDArray[np.bool_]] | None = None


def vehicles(folder: Path, columns: Columns | None = None) -> list[Vehicle]:
    """Return the vehicles of a folder, by name: a folder each, or the folder itself; and its tables, each one alone.

    The largest log of a vehicle is the drive that is learned of. ``columns``: of tables.

    Raises:
        InputError: the folder is not there, or has no log.
    """
    logs: dict[str, list[Recording]] = {}
    for recording in find([folder]):
        logs.setdefault(recording.device, []).append(recording)
    found = []
    for name, some in sorted(logs.items()):
        tables = [one.path for one in some if is_table(one.path)]
        recordings = [one for one in some if one.path not in tables]
        columns = columns or Columns()
        found += [Vehicle(f"{name}/{path.stem}", (), path, (), columns) for path in sorted(tables)]
        if not recordings:
            continue
        home = folder / name if (folder / name).is_dir() else folder
        files = sorted(path for path in home.rglob("*") if path.suffix.lower() in SUFFIXES)
        first = max(recordings, key=lambda one: sum(file.stat().st_size for file in one.files))
        others = tuple(one.path for one in recordings if one is not first)
        found.append(Vehicle(name, tuple(files), first.path, others))
    return found


class Learning:
    """Learns of vehicles (:class:`gateway_replay.pool.Work`).

    Args:
        work: folder of the configurations.
        seed: of the faults that ``learn`` itself puts in.
        per_hour: false codes that are accepted [1/h].
    """

    def __init__(self, work: Path, seed: int, per_hour: float = FALSE_PER_HOUR) -> None:
        self._work, self._seed, self._per_hour = work, seed, per_hour

    def do(self, task: Vehicle) -> list[Learned]:
        """Learn of a vehicle's first drive; a vehicle of which nothing can be learned says why."""
        log.to_stderr(logging.ERROR)
        home, drive, others = self._work / task.name, task.learned, task.judged
        databases, truth, how = task.databases, None, Asking(seed=self._seed, force=True, per_hour=self._per_hour)
        try:
            home.mkdir(parents=True, exist_ok=True)
            if task.columns is not None:
                table = read(task.learned, task.columns)
                database, drive, rest = written(table, home, task.columns)
                databases, others, how = (database,), (rest,), replace(how, hold_out=0.0)
                truth = None if table.truth is None else (table.t_ns, table.truth)
            elif not others:
                drive, rest = _halves(task.learned, home)
                others = (rest,)
            asked = asked_for(databases, [drive], home / "car.toml", how)
            result = learned(asked, lambda *_: None)
        except (InputError, InputErrors, OSError) as error:
            return self.failed(task, " ".join(str(error).split()))
        seconds = sum(one.seconds for one in result.observation.logs)
        return [Learned(task.name, asked.out, others, seconds, truth=truth)]

    def failed(self, task: Vehicle, text: str) -> list[Learned]:
        """Refuse a vehicle."""
        return [Learned(task.name, None, task.judged, error=text)]

    def killed(self, task: Vehicle) -> tuple[list[Learned], Vehicle | None]:
        """Refuse a vehicle that ended its worker."""
        return self.failed(task, "its worker died of it, alone"), None


def _halves(source: Path, home: Path) -> tuple[Path, Path]:
    """Write both halves of a drive, and return their files."""
    named = LogReader(source)
    if not sum(map(len, named)):
        raise InputError("no frame to learn from", file=source)
    channels = {name: k for k, name in enumerate(named.seen)}
    frames = _joined(list(LogReader(source, channels)))
    middle = (int(frames["t_ns"][0]) + int(frames["t_ns"][-1])) // 2
    paths = home / "first.log", home / "second.log"
    for path, half in zip(paths, np.split(frames, np.searchsorted(frames["t_ns"], [middle])), strict=True):
        path.unlink(missing_ok=True)
        with open_writer(path, interfaces={k: name for name, k in channels.items()}) as writer:
            writer.write(half)
    return paths


def drive_of(path: Path, config: Config) -> Frames:
    """Return the frames of a drive on the buses of a configuration, in order of time.

    Raises:
        InputError: it cannot be read at all; what follows damage is left out.
    """
    return _joined(list(Log(path, config)))


def _joined(batches: Sequence[Frames]) -> Frames:
    frames = np.concatenate(batches) if batches else empty(0)
    return frames[np.argsort(frames["t_ns"], kind="stable")]


def is_of_car(fault: str, config: Config) -> bool:
    """Return whether a fault is one of the vehicle, and not of the recording."""
    return not of_log(fault, [bus.name for bus in config.bus])

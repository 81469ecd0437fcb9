"""Healthy logs of a fleet: the findings of each for thresholds, found once by workers, put together here.

The result is that of ``gateway calibrate`` in one process: the same parts
(:mod:`gateway_calibration.part`) in the same order of logs. Parts are kept by the log's contents, the configuration,
and their question, so that a second run finds only what is new. A log of which nothing is to be learnt (damaged, cut
off, foreign, ...), or that kills its worker, is left out and told.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from gateway.bus.log_source import CutOffError
from gateway.config.model import Config
from gateway.monitors.contract import Calibration, CusumCalibration, Refinement, SensorCalibration
from gateway.runtime.app import Gateway
from gateway_api.thresholds import Targets
from gateway_calibration import cusum, plants, sensors, stopping
from gateway_calibration.configuration import Found
from gateway_calibration.earlier import load_afresh
from gateway_calibration.logs import Chosen, NothingToLearnError, Progress, Reading, of_kind
from gateway_calibration.part import Part, load, save
from gateway_fdi.errors import GatewayError, InputError
from gateway_fleet.fleet.task import Setup, digest_of, unreadable
from gateway_fleet.fleet.verdicts import TABLES, Done, Manifest, Row, error_rows, signature, write_table
from gateway_logs.corpus import DIGITS, Recording
from gateway_replay.pool import Pool, Workers

#: Kinds of parts. LEVELS and SUMS and SENSORS are asked of each log alone, PEAKS with the sums of all, PLANT with what
#: the log before has left.
LEVELS, SUMS, PEAKS, SENSORS, PLANT = "levels", "sums", "peaks", "sensors", "plant"
#: States of logs that may fare better another time.
FAILED = ("failed", "killed", "unreadable")
_STATE, _TEXT = "state", "text"


@dataclass(frozen=True)
class Ask:
    """A question to a log.

    Attributes:
        setup: configuration, and the folder of the parts.
        recording: the log.
        kind: of the part.
        monitor: whose; "": all that have this kind.
        given: arguments of the question.
    """

    setup: Setup
    recording: Recording
    kind: str
    monitor: str = ""
    given: Mapping[str, Any] = field(default_factory=dict)

    def path(self, log: str) -> Path:
        """Return where the part of a log with these contents is kept."""
        asked = json.dumps([self.setup.digest, self.monitor, self.given], sort_keys=True)
        digest = hashlib.sha256(asked.encode()).hexdigest()[:DIGITS]
        return self.setup.out / self.kind / f"{log}-{digest}.npz"


@dataclass(frozen=True)
class Answer:
    """Answer to a question.

    Attributes:
        ask: it.
        log: digest of the log's contents.
        state: "whole"; else why nothing is to be learnt, as in the table ``errors``.
        text: of that.
        frames: that were read for it; 0: it was known.
    """

    ask: Ask
    log: str
    state: str = "whole"
    text: str = ""
    frames: int = 0


def _chosen(config: Config, kind: Any, monitor: str) -> Chosen[Any]:
    return next(one for one in of_kind(config, kind) if one.name == monitor)


def _part(ask: Ask, config: Config, progress: Progress) -> Part:
    """Return what a log says."""
    log = ask.recording.path
    how = Reading(ask.setup.config, ask.setup.maps, progress)
    if ask.kind == LEVELS:
        return stopping.of_log(config, log, how)
    if ask.kind == SUMS:
        return cusum.sums_of_log(config, log, how)
    if ask.kind == PEAKS:
        return cusum.peaks_of_log(config, ask.given, log, how)
    if ask.kind == SENSORS:
        return sensors.of_log(config, _chosen(config, SensorCalibration, ask.monitor), log, how)
    return plants.of_log(config, _chosen(config, Refinement, ask.monitor), ask.given, log, how)


def answer(ask: Ask) -> Answer:
    """Find a part, unless it is there already: the work of a worker.

    Raises:
        InputError: the worker has another configuration.
    """
    config = load_afresh(ask.setup.config)
    if digest_of(config, ask.setup.maps) != ask.setup.digest:
        raise InputError("this worker has another configuration, databases or version", file=ask.setup.config)
    try:
        log = ask.recording.digest()
    except InputError as error:
        return Answer(ask, unreadable(ask.recording), "unreadable", str(error))
    path = ask.path(log)
    if (known := load(path)) is not None:
        return Answer(ask, log, known.facts.get(_STATE, "whole"), known.facts.get(_TEXT, ""))
    frames = 0

    def progress(count: int) -> None:
        nonlocal frames
        frames += count

    try:
        part = _part(ask, config, progress)
    except Exception as error:  # any error is this log's
        state, text = _why(error)
        if state not in FAILED:
            save(path, Part(0.0, facts={_STATE: state, _TEXT: text}))
        return Answer(ask, log, state, text, frames)
    save(path, part)
    return Answer(ask, log, frames=frames)


def _why(error: Exception) -> tuple[str, str]:
    """Return the state of a log that raised something, and the text of it."""
    text = " ".join(str(error).split())
    if isinstance(error, NothingToLearnError):
        return error.state, text
    if isinstance(error, CutOffError):
        return "cut off", text
    if isinstance(error, InputError):
        return "damaged", text
    return "failed", text if isinstance(error, GatewayError) else f"{type(error).__name__}: {text}"


class _Asking:
    """The work of a calibration (:class:`gateway_replay.pool.Work`)."""

    def do(self, task: Ask) -> list[Answer]:
        """Find a part."""
        return [answer(task)]

    def failed(self, task: Ask, text: str) -> list[Answer]:
        """Return that a part cannot be found."""
        return [Answer(task, unreadable(task.recording), "failed", text)]

    def killed(self, task: Ask) -> tuple[list[Answer], Ask | None]:
        """Return that a log kills its worker."""
        return [Answer(task, unreadable(task.recording), "killed", "its worker died of it, alone")], None


#: Takes each answer, and how many are still to come of those that are asked for now.
Told = Callable[[Answer, int], None]


class _Survey:
    """Asks logs, and keeps who answered what."""

    def __init__(self, setup: Setup, recordings: Sequence[Recording], pool: Pool[Ask, Answer], told: Told) -> None:
        self._setup, self._pool, self._told = setup, pool, told
        self._manifest = Manifest(setup.out)
        self._files = {}
        self.recordings = [Recording(one.path.absolute(), one.device) for one in recordings]
        for one in self.recordings:
            try:
                self._files[one.path] = signature(one)
            except InputError:
                self._files[one.path] = ()
        self.wrong: dict[Path, Answer] = {}
        self.read: set[Path] = set()

    @property
    def good(self) -> list[Recording]:
        """The logs that have answered all questions so far."""
        return [one for one in self.recordings if one.path not in self.wrong]

    def log(self, recording: Recording) -> str:
        """Return what names a recording's contents, "" if they were not read yet, or have changed."""
        done = self._manifest.done.get(str(recording.path))
        return done.log if done is not None and done.files == self._files[recording.path] != () else ""

    def ask(self, kind: str, monitor: str = "", given: Mapping[str, Any] | None = None) -> dict[Path, Part]:
        """Return what all logs say, in their order; each contents once."""
        self._answered([Ask(self._setup, one, kind, monitor, given or {}) for one in self.good])
        found: dict[Path, Part] = {}
        known: dict[str, Path] = {}
        for one in self.good:
            log = self.log(one)
            if self._is_copy(one, log, known):
                continue
            part = load(Ask(self._setup, one, kind, monitor, given or {}).path(log))
            if part is None:
                raise InputError("a worker has written no part here: the folder is another one there", file=one.path)
            found[one.path] = part
        return found

    def chain(self, monitor: str) -> dict[Path, Part]:
        """Return what all logs say of a plant, each asked with what the one before has left."""
        found: dict[Path, Part] = {}
        keys: Mapping[str, Any] = {}
        known: dict[str, Path] = {}
        for one in self.good:
            ask = Ask(self._setup, one, PLANT, monitor, keys)
            self._answered([ask])
            if self._is_copy(one, self.log(one), known):
                continue
            part = load(ask.path(self.log(one))) if one.path not in self.wrong else None
            if part is not None:
                found[one.path] = part
                keys = part.facts["keys"]
        return found

    def _is_copy(self, recording: Recording, log: str, known: dict[str, Path]) -> bool:
        """Leave out a recording whose contents another one before it has."""
        first = known.setdefault(log, recording.path)
        if recording.path in self.wrong or first == recording.path:
            return False
        text = f"the same contents as {first}: counted once"
        self.wrong[recording.path] = Answer(Ask(self._setup, recording, ""), log, "copy", text)
        return True

    def _answered(self, asks: Sequence[Ask]) -> None:
        """Have what is not known found."""
        new = []
        for ask in asks:
            log = self.log(ask.recording)
            part = load(ask.path(log)) if log else None
            if part is None:
                new.append(ask)
            elif _STATE in part.facts:
                self.wrong[ask.recording.path] = Answer(ask, log, part.facts[_STATE], part.facts[_TEXT])
        left = len(new)
        for found in self._pool.run(new):
            left -= 1
            path = found.ask.recording.path
            if found.state not in FAILED:
                self._manifest.add(path, Done(self._files[path], found.log, found.state), {"kind": found.ask.kind})
            if found.state != "whole":
                self.wrong[path] = found
            if found.frames:
                self.read.add(path)
            self._told(found, left)


def learn(
    config_path: Path,
    recordings: Sequence[Recording],
    out: Path,
    workers: Workers,
    targets: Targets,
    maps: tuple[str, ...] = (),
    told: Told = lambda answer, left: None,
) -> Found:
    """Learn thresholds, models and sensors from a fleet's healthy logs.

    Args:
        config_path: the configuration.
        recordings: the logs, in the order in which plants are refined by them.
        out: folder of the parts.
        workers: read the logs.
        targets: that thresholds are to hold.
        maps: channels of the logs taken as buses.
        told: takes each answer.

    Raises:
        InputError, InputErrors: the configuration is wrong; of no log anything is to be learnt; the logs do not tell.
    """
    path = config_path.absolute()
    config = load_afresh(path)
    Gateway(config, None, file=path).close()  # an error of the configuration is no log's fault
    setup = Setup(path, digest_of(config, maps), maps, carried=False, out=out.absolute())
    (setup.out / "errors").mkdir(parents=True, exist_ok=True)
    with ExitStack() as stack:
        survey = _Survey(setup, recordings, Pool(_Asking(), workers, stack), told)
        parts = dict(_parts(config, survey))
        left_out = _left_out(survey)
        write_table(setup.out / "errors" / "errors.parquet", TABLES["errors"], left_out)
        if not survey.good:
            first = left_out[0]
            raise InputError(f"of no log anything is to be learnt; {first['kind']}: {first['text']}", file=path)
    # A log that failed in a later question has no say in the earlier ones.
    kept = {one.path for one in survey.good}
    sifted = {key: {log: part for log, part in one.items() if log in kept} for key, one in parts.items()}
    levels = tests = None
    if of_kind(config, Calibration):
        levels = stopping.merged(config, sifted[LEVELS, ""])
    if of_kind(config, CusumCalibration):
        sums, peaks = sifted[SUMS, ""], sifted[PEAKS, ""]
        typical = cusum.typical_of(config, sums)
        tests = cusum.merged(config, sums, typical, peaks, margin=targets.margin, floor=targets.floor)
    refined = (plants.merged(plant, sifted[PLANT, plant.name]) for plant in of_kind(config, Refinement))
    return Found(
        levels,
        stopping.calibrate(config, levels, targets.mtfa_s) if levels else [],
        tests,
        [plant for plant in refined if plant is not None],
        [sensors.merged(one, sifted[SENSORS, one.name], file=path) for one in of_kind(config, SensorCalibration)],
        hashlib.sha256(" ".join(survey.log(one) for one in survey.good).encode()).hexdigest()[:12],
        len(kept),
        left_out,
        len(survey.read),
    )


def _parts(config: Config, survey: _Survey) -> Iterator[tuple[tuple[str, str], dict[Path, Part]]]:
    """Yield the logs' findings, by kind and monitor; those of all logs come when the answering logs are known."""
    if of_kind(config, Calibration):
        yield (LEVELS, ""), survey.ask(LEVELS)
    for sensor in of_kind(config, SensorCalibration):
        yield (SENSORS, sensor.name), survey.ask(SENSORS, sensor.name)
    if of_kind(config, CusumCalibration):
        while True:
            sums = survey.ask(SUMS)
            yield (SUMS, ""), sums
            if not sums:
                break
            typical = {name: dict(nus) for name, nus in cusum.typical_of(config, sums).items()}
            yield (PEAKS, ""), survey.ask(PEAKS, given=typical)
            if len(survey.good) == len(sums):
                break  # else a log failed only now, and has had its say in nu
    for plant in of_kind(config, Refinement):
        yield (PLANT, plant.name), survey.chain(plant.name)


def _left_out(survey: _Survey) -> list[Row]:
    rows = []
    for one in survey.recordings:
        if (wrong := survey.wrong.get(one.path)) is not None:
            rows += error_rows(wrong.log, one, wrong.state, [wrong.text])
    return rows

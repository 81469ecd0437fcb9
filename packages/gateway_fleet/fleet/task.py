"""One recording judged, or those of a device one after the other: the work of a worker.

A gateway of its own for each, from a configuration that lies at the same path on every worker. With a memory that is
carried, the fault memory that one log ends with is the next one's: it ages, heals and confirms over operation cycles
as in the car. It is a file named by the log after which it stands, put there before the log's verdict is: a worker
that dies in between leaves nothing that counts twice.
"""

from __future__ import annotations

import hashlib
import json
import math
import shutil
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gateway import __version__
from gateway.bus.frames import Frames
from gateway.bus.logs import LogReader
from gateway.common.jsonlines import line
from gateway.common.trust import file_of
from gateway.config.load import load_config
from gateway.config.model import Config
from gateway.faults.dtc import Dtc
from gateway.faults.explanation import Cause
from gateway.faults.fault_groups import named
from gateway.faults.records import Record
from gateway.faults.status import Status
from gateway.runtime.app import Gateway
from gateway.runtime.assemble import prepare
from gateway.signals.database import file_and_bus
from gateway_fdi.common.tomlfile import texts_in
from gateway_fdi.errors import GatewayError, InputError
from gateway_fleet.fleet.verdicts import Row, Verdict, Verdicts, error_rows
from gateway_logs.corpus import DIGITS, Recording
from gateway_replay.log import Log
from gateway_replay.log_contents import Contents
from gateway_replay.replay import replay

#: Changes of status that are kept of a log; more are reported.
MOST_EVENTS = 10_000
#: Characters of a parameter that may be the name of a file.
_LONGEST_NAME = 1000


@dataclass(frozen=True)
class Setup:
    """With what logs are judged.

    Attributes:
        config: file of the configuration.
        digest: of the configuration, its databases, and the gateway's version.
        maps: further channels, ``channel=bus`` each.
        carried: whether a device's logs share a fault memory.
        out: folder of the verdicts.
    """

    config: Path
    digest: str
    maps: tuple[str, ...]
    carried: bool
    out: Path


@dataclass(frozen=True)
class Task:
    """Request to a worker.

    Attributes:
        setup: with what.
        recordings: in order; the memory is carried along them, if it is.
        before: the log after which the first one's memory stands, "": a new memory.
    """

    setup: Setup
    recordings: tuple[Recording, ...]
    before: str = ""


@dataclass(frozen=True)
class Outcome:
    """Outcome of a recording.

    Attributes:
        recording: it.
        log: digest of its contents.
        state: as in table ``logs``.
        frames: of it.
        dtcs: that failed in it.
        seconds: that it took.
        fresh: whether it was judged now, and not before.
    """

    recording: Recording
    log: str
    state: str
    frames: int
    dtcs: int
    seconds: float
    fresh: bool = True


def digest_of(config: Config, maps: tuple[str, ...]) -> str:
    """Return what names a configuration with all files that it consists of, and the version that runs it.

    Raises:
        InputError: a file cannot be read.
    """
    total = hashlib.sha256(f"{__version__} {maps}".encode())
    total.update(json.dumps(config.model_dump(mode="json"), sort_keys=True).encode())
    databases = [
        *(file_and_bus(path)[0] for bus in config.bus for path in bus.database),
        *(p for ecu in config.ecu for p in ecu.signals),
    ]
    for path in (*databases, *_files_of_monitors(config)):
        try:
            total.update(path.read_bytes())
        except OSError as error:
            raise InputError(error.strerror or str(error), file=path) from error
    return total.hexdigest()[:DIGITS]


def _files_of_monitors(config: Config) -> Iterator[Path]:
    """Yield the files that monitors are made of: models, tables that their parameters name, modules of own types."""
    for entry in config.monitor:
        for value in texts_in(entry.model_dump(mode="json")):
            path = entry.folder / value
            if len(value) < _LONGEST_NAME and "\0" not in value and path.is_file():
                yield path
        module, colon, _ = entry.type.partition(":")
        found = file_of(module) if colon else None
        if found is not None:
            yield found


def judge(task: Task) -> list[Outcome]:
    """Judge recordings, and write what comes out.

    Raises:
        InputError, InputErrors: the configuration is wrong, or another one than the asker's.
    """
    config = load_config(task.setup.config)
    if digest_of(config, task.setup.maps) != task.setup.digest:
        raise InputError("this worker has another configuration, databases or version", file=task.setup.config)
    before, outcomes = task.before, []
    for recording in task.recordings:
        outcome = _one(task.setup, config, recording, before)
        outcomes.append(outcome)
        if _memory(task.setup, outcome.log).exists() and _is_next(task.setup, outcome):
            before = outcome.log
    return outcomes


def _is_next(setup: Setup, outcome: Outcome) -> bool:
    """Return whether a memory goes on from a recording: not from a copy, whose memory stands where the first one is."""
    if outcome.fresh:
        return True
    rows = Verdicts(setup.out).rows("logs", outcome.log)
    path = str(outcome.recording.path)
    return all(row["path"] == path or not Path(row["path"]).exists() for row in rows)


def _memory(setup: Setup, log: str) -> Path:
    """Return the fault memory as it stands after a log."""
    return setup.out / "memory" / f"{log}.sqlite"


def unreadable(recording: Recording) -> str:
    """Return what names a recording whose contents cannot be read."""
    return hashlib.sha256(str(recording.path).encode()).hexdigest()[:DIGITS]


def log_of(setup: Setup, recording: Recording) -> str:
    """Return what names a recording: its contents; with a memory that is carried, also whose it is.

    Raises:
        InputError: it cannot be read.
    """
    contents_of = recording.digest()
    if not setup.carried:
        return contents_of
    return hashlib.sha256(f"{recording.device} {contents_of}".encode()).hexdigest()[:DIGITS]


def _one(setup: Setup, config: Config, recording: Recording, before: str) -> Outcome:
    begun = time.monotonic()
    verdicts = Verdicts(setup.out)
    try:
        log = log_of(setup, recording)
    except InputError as error:
        log = unreadable(recording)
        return refuse(verdicts, recording, log, "unreadable", str(error))
    if verdicts.has(log):
        (row,) = verdicts.rows("logs", log)
        return Outcome(recording, log, row["state"], row["frames"], row["dtcs"], time.monotonic() - begun, fresh=False)
    try:
        verdict = _judged(setup, config, recording, log, before)
    except Exception as error:  # any error is this log's, and must not need a reader that can unpickle it
        told = " ".join(str(error).split())
        text = told if isinstance(error, GatewayError) else f"{type(error).__name__}: {told}"
        return refuse(verdicts, recording, log, "failed", text)
    verdicts.write(log, verdict)
    (row,) = verdict.logs
    return Outcome(recording, log, row["state"], row["frames"], row["dtcs"], time.monotonic() - begun)


def refuse(verdicts: Verdicts, recording: Recording, log: str, kind: str, text: str) -> Outcome:
    """Write that a recording could not be judged, and why."""
    row = dict.fromkeys(("begin", "end", "km")) | {
        "log": log, "device": recording.device, "path": str(recording.path), "state": kind,
        "seconds": 0.0, "frames": 0, "decoded": 0, "left_out": 0, "dtcs": 0,
    }  # fmt: skip
    verdicts.write(log, Verdict(logs=[row], errors=error_rows(log, recording, kind, [text])))
    return Outcome(recording, log, kind, 0, 0, 0.0)


class _Watch:
    """Collects what a replay tells.

    Attributes:
        events: changes of status, as rows.
        first: first failure of each fault [ns].
        lost: changes beyond what is kept.
    """

    def __init__(self) -> None:
        self.events: list[Row] = []
        self.first: dict[str, int] = {}
        self.lost = 0

    def __call__(self, event: Mapping[str, Any]) -> None:
        """Take one event."""
        if event["event"] != "dtc":
            return
        if event["status"] & Status.TEST_FAILED:
            self.first.setdefault(event["fault"], event["t_ns"])
        if len(self.events) >= MOST_EVENTS:
            self.lost += 1
            return
        row = {name: event[name] for name in ("dtc", "fault", "status", "occurrence")}
        self.events.append({"n": len(self.events), "t": event["t_ns"], **row})


class _Span:
    """When a log begins and ends, by its stamps."""

    def __init__(self) -> None:
        self.begin: int | None = None
        self.end: int | None = None

    def __call__(self, frames: Frames) -> None:
        """Take a batch."""
        if not len(frames):
            return
        low, high = int(frames["t_ns"].min()), int(frames["t_ns"].max())
        self.begin = low if self.begin is None else min(self.begin, low)
        self.end = high if self.end is None else max(self.end, high)


def _judged(setup: Setup, config: Config, recording: Recording, log: str, before: str) -> Verdict:
    """Replay a recording; returns its rows. A memory that is carried stands beside the verdicts afterwards."""
    recorded = Log(recording.path, config, setup.maps)
    watch, span = _Watch(), _Span()
    with ExitStack() as stack:
        memory = _begin_memory(setup, log, before)
        parts = prepare(config, setup.config)
        recorded.refuse_foreign(parts.databases)
        gateway = Gateway(config, memory, file=setup.config, parts=parts, lasting=True)
        stack.callback(gateway.close)
        old = {record.id: record for record in gateway.store.load()}
        gateway.listen(watch)
        replay(gateway, recorded, progress=span, whole=lambda: recorded.whole)
        verdict = _rows(gateway, recording, log, recorded.reader, recorded.contents(named=False), watch, span, old)
    if memory is not None:
        _keep_memory(memory, _memory(setup, log))
    return verdict


def _begin_memory(setup: Setup, log: str, before: str) -> Path | None:
    """Return the file of a carried memory for a log, None if none is carried."""
    if not setup.carried:
        return None
    path = setup.out / "memory" / f".{log}.sqlite"
    path.parent.mkdir(parents=True, exist_ok=True)
    for old in path.parent.glob(f"{path.name}*"):
        old.unlink()
    if before:
        shutil.copyfile(_memory(setup, before), path)
    return path


def _keep_memory(memory: Path, place: Path) -> None:
    memory.replace(place)
    for rest in memory.parent.glob(f"{memory.name}*"):
        rest.unlink()


def _rows(
    gateway: Gateway,
    recording: Recording,
    log: str,
    reader: LogReader,
    found: Contents,
    watch: _Watch,
    span: _Span,
    old: Mapping[str, Record],
) -> Verdict:
    """Return the rows of a log, in wall time."""
    origin = reader.origin_ns
    who: Row = {"log": log, "device": recording.device}

    def wall(t_ns: int | None) -> int | None:
        return None if t_ns is None else t_ns + origin

    records = {record.id: record for record in gateway.store.load()}
    failed = [record for record in records.values() if record.id in watch.first]
    metres = gateway.memory.usage.driven().cleared_m
    counters = gateway.engine.counters()
    verdict = Verdict()
    verdict.dtcs = [
        who
        | {
            "dtc": str(Dtc(r.dtc)), "fault": r.id, "status": r.status, "first": wall(watch.first[r.id]),
            "last": wall(r.last_ns), "occurrence": r.occurrence, "failed_cycles": r.failed_cycles,
            "evidence": line(r.evidence), **_cause(r.cause),
        }
        for r in sorted(failed, key=lambda r: (watch.first[r.id], r.id))
    ]  # fmt: skip
    verdict.tests = [who | row | {"worst_t": wall(row["worst_t"])} for row in _tests(gateway, records, old)]
    verdict.events = [who | event | {"t": wall(event["t"])} for event in watch.events]
    kind = found.state if found.state != "whole" else "wrong"
    verdict.errors = error_rows(log, recording, kind, [str(error) for error in found.wrong])
    if watch.lost:
        text = f"{watch.lost} changes of status more than the {MOST_EVENTS} that are kept"
        verdict.errors += error_rows(log, recording, "too many events", [text])
    seconds = (span.end - span.begin) * 1e-9 if span.begin is not None and span.end is not None else 0.0
    verdict.logs = [
        who
        | {
            "path": str(recording.path), "state": found.state, "begin": wall(span.begin), "end": wall(span.end),
            "seconds": seconds, "frames": found.frames, "decoded": counters["decoded"], "left_out": found.left_out,
            "km": None if metres is None else metres / 1e3, "dtcs": len(verdict.dtcs),
        }
    ]  # fmt: skip
    return verdict


def _cause(cause: Cause | None) -> Row:
    """Return what explained a DTC last: null where nothing is proven, ``role`` is null where nothing is known."""
    proven = cause is not None and cause.proven
    return {
        "cause": named(cause.components) if cause is not None and proven else None,
        "probability": cause.probability if cause is not None and proven else None,
        "role": None if cause is None else cause.role,
    }


def _tests(gateway: Gateway, records: Mapping[str, Record], old: Mapping[str, Record]) -> Iterator[Row]:
    """Yield what each test that had results came to."""
    buckets = gateway.engine.take_buckets()
    monitors = {entry.name for entry in gateway.config.monitor}
    for definition, bucket in zip(gateway.catalogue, buckets, strict=False):
        record, was = records.get(definition.id), old.get(definition.id)
        near = 0 if record is None else record.near_misses - (0 if was is None else was.near_misses)
        if not bucket["count"] and not near:
            continue
        numbers = bool(bucket["count"] and bucket["numbers"])

        def value(name: str, bucket: np.void = bucket, numbers: bool = numbers) -> float | None:
            found = float(bucket[name])
            return found if numbers and math.isfinite(found) else None

        yield {
            "dtc": str(definition.dtc), "fault": definition.id, "results": int(bucket["count"]),
            "failed": int(bucket["failed"]) if bucket["count"] else 0,
            "ratio": value("ratio"), "worst": value("worst"), "limit": value("limit"),
            "worst_t": int(bucket["worst_ns"]) if numbers else None, "low": value("low"), "high": value("high"),
            "near_misses": near, "peak_fdc": 0 if record is None else record.peak_fdc,
            "monitor": name if (name := definition.id.split(".")[0]) in monitors else None, "tested": definition.tested,
        }  # fmt: skip

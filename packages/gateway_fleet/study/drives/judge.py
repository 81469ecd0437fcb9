"""Codes and causes that the gateway tells of a drive, healthy and with faults, beside the truth."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from gateway.bus.frames import Frames
from gateway.config.load import load_config
from gateway.config.model import Config
from gateway.engine.checks.bus_health import ACTIVITIES, ASLEEP
from gateway.engine.checks.software import FIRST_NS
from gateway.faults.status import Status
from gateway.runtime.app import Gateway
from gateway.runtime.assemble import prepare
from gateway_fdi.common.log import to_stderr
from gateway_fdi.errors import GatewayError
from gateway_fleet.learn.everyday import KINDS, Drive, Fault
from gateway_fleet.study.cause.drive import events_of
from gateway_fleet.study.drives.vehicles import Learned, drive_of, is_of_car
from gateway_replay.log import Log

#: Longest part of a drive that a fault is put into [s], and the shortest.
LONGEST_S, SHORTEST_S = 60.0, 6.0
#: How often it is looked whether a bus runs [ns].
_LOOK_NS = 250_000_000
#: Whether a database names them.
SENDERS = ("named", "unknown")
#: Events of a frame that nobody of the car sends.
_UNKNOWN = ("unknown", "wrong_bus")


class Findings(NamedTuple):
    """Codes and causes of a run.

    Attributes:
        codes: fault that failed -> when first [ns], of the vehicle's own.
        events: likewise what is no code of the vehicle: unknown identifiers, a bus that is silent or at fault.
        causes: components that were told as a proven cause -> when first [ns].
    """

    codes: dict[str, int]
    events: dict[str, int]
    causes: dict[tuple[str, ...], int]


Name = TypeVar("Name", str, tuple[str, ...])


class Counts:
    """Counts that can be added up."""

    def add(self, other: Self) -> None:
        """Add another's counts."""
        for name, count in vars(other).items():
            setattr(self, name, getattr(self, name) + count)


@dataclass
class Row(Counts):
    """Results of one kind of fault, or of one fault.

    Attributes:
        tried: faults.
        beyond: of these, those that nothing can judge there: over while the bus still wakes, or no limit watches.
        beyond_found: of those, all the same told.
        found: of the others, those that a code, or a security event, told.
        right: of the others, a component that is at fault was told as the cause, and none that is well.
        wrong: a component that is well was told as the cause, of any.
        accused: a code was set that sees nothing of what is at fault, of any.
    """

    tried: int = 0
    beyond: int = 0
    beyond_found: int = 0
    found: int = 0
    right: int = 0
    wrong: int = 0
    accused: int = 0

    @property
    def judged(self) -> int:
        """Number of faults that can be judged."""
        return self.tried - self.beyond


@dataclass
class Points(Counts):
    """Rows of a table: at which of them a code was there.

    Attributes:
        wrong, found: rows where something is wrong, and those of them with a code.
        healthy, false: the others.
    """

    wrong: int = 0
    found: int = 0
    healthy: int = 0
    false: int = 0


@dataclass
class Judged:
    """Results of one drive.

    Attributes:
        vehicle: of the drive.
        drive: file.
        seconds: of it.
        codes: false ones, of the healthy drive.
        causes: false ones, likewise.
        faults: kind -> what came of its faults.
        senders: of SENDERS.
        lines: of faults that were silent, or blamed what is well: kind, what, what was told.
        points: rows of a table with a truth, told or not.
        error: why it could not be judged; "": it was.
    """

    vehicle: str
    drive: Path
    seconds: float = 0.0
    codes: list[str] = field(default_factory=list)
    causes: list[str] = field(default_factory=list)
    faults: dict[str, Row] = field(default_factory=dict)
    senders: str = SENDERS[-1]
    lines: list[tuple[str, str, str]] = field(default_factory=list)
    points: Points | None = None
    error: str = ""


@dataclass(frozen=True)
class Task:
    """A drive to be judged.

    Attributes:
        learned: its vehicle.
        drive: file.
        seed: of faults, one of each kind; None: the drive is judged as it is.
    """

    learned: Learned
    drive: Path
    seed: int | None = None


class Judging:
    """The work of a run (:class:`gateway_replay.pool.Work`)."""

    def do(self, task: Task) -> list[Judged]:
        """Judge a drive; a drive that cannot be read says why."""
        to_stderr(logging.ERROR)  # what a gateway says of each event is counted here
        judged = Judged(task.learned.vehicle, task.drive)
        try:
            _judge(task, judged)
        except GatewayError as error:
            judged.error = " ".join(str(error).split())
        return [judged]

    def failed(self, task: Task, text: str) -> list[Judged]:
        """Refuse a drive."""
        return [Judged(task.learned.vehicle, task.drive, error=text)]

    def killed(self, task: Task) -> tuple[list[Judged], Task | None]:
        """Refuse a drive that ended its worker."""
        return self.failed(task, "its worker died of it, alone"), None


def _judge(task: Task, judged: Judged) -> None:
    assert task.learned.config is not None
    config = load_config(task.learned.config)
    parts, log = prepare(config, task.learned.config), Log(task.drive, config)
    log.refuse_foreign(parts.databases)
    if log.foreign:
        judged.error = f"of another vehicle: {log.foreign} of its identifiers are known"
        return
    frames = drive_of(task.drive, config)
    if not len(frames):
        judged.error = "no frame on a bus of the vehicle"
        return
    stamps = frames["t_ns"]
    judged.seconds = float(stamps[-1] - stamps[0]) * 1e-9
    if task.learned.truth is not None:
        judged.points = _points(config, frames, *task.learned.truth)
        return
    if task.seed is None:
        whole = findings_of(config, frames)
        judged.codes = sorted(whole.codes)
        judged.causes = sorted(" and ".join(cause) for cause in whole.causes)
        return
    part = frames[: int(np.searchsorted(stamps, stamps[0] + round(LONGEST_S * 1e9)))]
    healthy, runs_ns = findings_of(config, part), _runs_ns(config, part)
    sees = {fault: {one.component.name for one in some} for fault, some in parts.depends.items()}
    for number, (kind, make) in enumerate(KINDS.items()):
        drive = Drive(config, parts, part, np.random.default_rng([task.seed, number]))
        judged.senders = SENDERS[not any(one.senders for one in drive.sent)]
        fault = make(drive)
        if fault is not None:
            row, text = _of_fault(fault, findings_of(config, fault.frames), healthy, sees, runs_ns)
            judged.faults.setdefault(kind, Row()).add(row)
            if row.right < row.judged or row.wrong or row.accused:
                judged.lines.append((kind, fault.about, text))


def _points(config: Config, frames: Frames, t_ns: NDArray[np.int64], wrong: NDArray[np.bool_]) -> Points:
    """Return at which rows of a table a code was there."""
    failing: set[str] = set()
    changes: list[tuple[int, bool]] = [(0, False)]
    for event in events_of(config, frames):
        if event["event"] == "dtc" and is_of_car(event["fault"], config):
            (failing.add if event["status"] & Status.TEST_FAILED else failing.discard)(event["fault"])
            changes.append((int(event["t_ns"]), bool(failing)))
    judged = t_ns >= int(frames["t_ns"][0])
    last = np.searchsorted([at for at, _ in changes], t_ns[judged], side="right") - 1
    told, wrong = np.array([is_there for _, is_there in changes])[last], wrong[judged]
    return Points(int(wrong.sum()), int((told & wrong).sum()), int((~wrong).sum()), int((told & ~wrong).sum()))


def findings_of(config: Config, frames: Frames) -> Findings:
    """Return what is told of frames."""
    codes: dict[str, int] = {}
    causes: dict[tuple[str, ...], int] = {}
    others: dict[str, int] = {}
    for event in events_of(config, frames):
        t_ns, kind = int(event.get("t_ns", 0)), event["event"]
        if kind == "dtc" and event["status"] & Status.TEST_FAILED:
            of_car = is_of_car(event["fault"], config)
            (codes if of_car else others).setdefault(event["fault"], t_ns)
        elif kind == "security" and event["kind"] in _UNKNOWN:
            others.setdefault(event["sensor"], t_ns)
        elif kind == "activity" and event["activity"] == ACTIVITIES[ASLEEP]:
            others.setdefault(f"{event['bus']} asleep", t_ns)
        elif kind == "diagnosis":
            for cause in _proven(event["groups"]):
                causes.setdefault(cause, t_ns)
    return Findings(codes, others, causes)


def _proven(groups: Iterable[Mapping[str, Any]]) -> Iterable[tuple[str, ...]]:
    return (tuple(sorted(group["cause"])) for group in groups if group["cause"])


def _runs_ns(config: Config, frames: Frames) -> int:
    """Return when all buses run that are heard: until then each start has its time."""
    gateway, at = Gateway(config), 0
    start_ns, end_ns = int(frames["t_ns"][0]), int(frames["t_ns"][-1])
    gateway.start(start_ns)
    heard = np.unique(frames["bus"])
    for now_ns in range(start_ns + _LOOK_NS, end_ns, _LOOK_NS):
        until = int(np.searchsorted(frames["t_ns"], now_ns))
        gateway.feed(frames[at:until])
        gateway.advance(now_ns)
        at = until
        health = gateway.engine.tables.health[heard]
        if health["begun"].all() and now_ns >= health["joined_ns"].max() + FIRST_NS:
            end_ns = now_ns
            break
    gateway.close()
    return end_ns


def _of_fault(
    fault: Fault, told: Findings, healthy: Findings, sees: Mapping[str, set[str]], runs_ns: int = 0
) -> tuple[Row, str]:
    """Return what came of a fault, and what was told of it, for people; ``runs_ns``: since when the buses run."""

    def new(now: Mapping[Name, int], before: Mapping[Name, int]) -> list[Name]:
        return [one for one, t_ns in now.items() if one not in before and t_ns >= fault.begin_ns]

    codes, events = new(told.codes, healthy.codes), new(told.events, healthy.events)
    causes = new(told.causes, healthy.causes)
    concerned = fault.concerned

    def well(name: str) -> bool:
        return name not in concerned and not any(name.startswith(one) for one in concerned if one.endswith("."))

    named = {name for cause in causes for name in cause}
    accused = [name for name in codes if all(well(one) for one in sees.get(name, ()))]
    found = bool(codes) or (bool(events) and not fault.of_message)
    judged = fault.end_ns - max(fault.begin_ns, runs_ns) > fault.needs_s * 1e9
    row = Row(
        tried=1,
        beyond=not judged,
        beyond_found=found and not judged,
        found=found and judged,
        right=judged and bool(named & fault.right) and not any(well(name) for name in named),
        wrong=any(well(name) for name in named),
        accused=bool(accused),
    )
    first, more = (codes + events)[:3], len(codes + events) - 3
    set_ = ", ".join(first) + (f" and {more} more" if more > 0 else "") or "silent"
    text = "; ".join([set_, *(f"cause {' and '.join(cause)}" for cause in causes[:2])])
    return row, text

"""The learned configuration, replayed: it must be silent on the whole log, above all on what it did not see."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from gateway.bus.frames import Frames, empty
from gateway.config.load import load_config
from gateway.config.model import Config
from gateway.engine.adopt import adopt
from gateway.engine.core import Engine
from gateway.engine.events import QUALIFIED_FAILED, Events
from gateway.runtime.assemble import Parts, prepare
from gateway_calibration.logs import read_answered
from gateway_fleet.learn.observe import LogSeen

#: Frames and time [ns] of each part of what was held out that is kept to put faults into; and when such a part begins,
#: counted in these times from the cut: a signal that is seen at one moment may not be at another.
WINDOW_FRAMES, WINDOW_NS, BEGINS = 60_000, 8_000_000_000, (0, 1, 3, 7)
#: A part that the log ends in must have this much of it [ns].
LEAST_NS = 4_000_000_000


@dataclass
class Alarm:
    """A fault that a healthy log set.

    Attributes:
        count, held_out: how often in all, and in what was not learned from.
        value, threshold: of the first time.
    """

    count: int = 0
    held_out: int = 0
    value: float = np.nan
    threshold: float = np.nan


@dataclass
class Replayed:
    """Results of a replay of the logs.

    Attributes:
        alarms: fault id -> what it was.
        frames, seconds: of what was held out.
        windows: parts of each log after its cut, in even time, to put faults into.
        before: engine as it was at the begin of each.
        strangers: (bus, identifier with its flags) that came and that nothing knows.
        config: that was replayed.
        parts: built of it.
        hours: length of all that was replayed [h].
    """

    config: Config
    parts: Parts
    alarms: dict[str, Alarm] = field(default_factory=dict)
    frames: int = 0
    seconds: float = 0.0
    windows: list[Frames] = field(default_factory=list)
    before: list[Engine] = field(default_factory=list)
    strangers: set[tuple[int, int]] = field(default_factory=set)
    hours: float = 0.0


def replayed(
    path: Path, logs: Sequence[LogSeen], maps: Sequence[str], progress: Callable[[Path, int, float], None]
) -> Replayed:
    """Replay logs with a configuration, from its file.

    Raises:
        InputError, InputErrors: a log that cannot be read to its end, a configuration that is wrong.
    """
    config = load_config(path)
    result = Replayed(config, prepare(config, path))
    for log in logs:
        engine = prepare(config, path).engine
        _replay(result, engine, log, maps, progress)
    return result


def _replay(
    result: Replayed,
    engine: Engine,
    log: LogSeen,
    maps: Sequence[str],
    progress: Callable[[Path, int, float], None],
) -> None:
    cut = log.cut_ns
    held = False

    def hear(events: Events) -> None:
        for event in events[events["kind"] == QUALIFIED_FAILED]:
            alarm = result.alarms.setdefault(engine.faults[int(event["fault"])].id, Alarm())
            if not alarm.count:
                alarm.value, alarm.threshold = float(event["value"]), float(event["threshold"])
            alarm.held_out += held
            alarm.count += 1

    windows: list[list[Frames]] = []
    last_ns = 0
    first_ns: int | None = None
    for frames, done in read_answered(result.config, result.parts.answers, engine.plan, log.path, maps):
        begins = [] if cut is None else [cut + WINDOW_NS * k for k in BEGINS[len(windows) :]]
        reached = [int(np.argmax(frames["t_ns"] >= at)) for at in begins if int(frames["t_ns"].max()) >= at]
        for k, part in enumerate(np.split(frames, reached)):
            if k > 0:
                held = True
                result.before.append(_copied(result, engine, log.path))
                windows.append([])
            engine.process(part, hear)
            if held and cut is not None and len(part):
                result.frames += len(part)
                last_ns = max(last_ns, int(part["t_ns"].max()))
                until_ns = cut + WINDOW_NS * (BEGINS[len(windows) - 1] + 1)
                windows[-1].append(part[part["t_ns"] < until_ns][: WINDOW_FRAMES - sum(map(len, windows[-1]))])
        progress(log.path, len(frames), done)
        first_ns = int(frames["t_ns"][0]) if first_ns is None and len(frames) else first_ns
        if first_ns is not None and len(frames):
            result.hours += max(int(frames["t_ns"][-1]) - first_ns, 0) / 3.6e12
            first_ns = int(frames["t_ns"][-1])
    rows = engine.tables.strangers
    result.strangers |= {(int(row["bus"]), int(row["can_id"])) for row in rows[rows["count"] > 0]}
    if held and cut is not None:
        result.seconds += max(0, last_ns - cut) * 1e-9
        for k, parts in enumerate(windows):
            window = np.concatenate(parts) if parts else empty(0)
            if k > 0 and last_ns < cut + WINDOW_NS * BEGINS[k] + LEAST_NS:
                del result.before[len(result.windows)]
            else:
                result.windows.append(window)


def _copied(result: Replayed, engine: Engine, path: Path) -> Engine:
    """Return another engine in the same state."""
    other = prepare(result.config, path).engine
    restore(other, engine, result.config)
    return other


def restore(engine: Engine, saved: Engine, config: Config) -> None:
    """Give an engine the state of another of the same configuration."""
    adopt(engine, saved, {k: k for k in range(len(config.bus))}, {k: k for k in range(len(config.cycle) + 1)})

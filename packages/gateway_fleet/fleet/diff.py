"""Two runs over the same logs: whose verdict changed, and the first event that differs."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import zip_longest
from pathlib import Path
from typing import Any

from gateway_fleet.fleet.verdicts import Row, Verdicts

#: Fields by which an event is the same one.
_SAME = ("t", "dtc", "fault", "status")


@dataclass(frozen=True)
class Changed:
    """A log whose verdict differs.

    Attributes:
        log: digest of its contents.
        path: of it, as the second run had it.
        device: whose it is.
        states: of the log in both runs.
        gone: DTCs that only the first run has, as "code fault".
        new: DTCs that only the second run has.
        at_s: time of the first event that differs, from the log's begin [s]; None: no event differs.
        before, after: that event in both runs, None: there is none.
    """

    log: str
    path: str
    device: str
    states: tuple[str, str]
    gone: tuple[str, ...]
    new: tuple[str, ...]
    at_s: float | None
    before: Row | None
    after: Row | None


@dataclass(frozen=True)
class Difference:
    """Differences between two runs.

    Attributes:
        same: logs with the same verdict.
        changed: logs with another one.
        only_first, only_second: paths of logs that the other run does not have.
    """

    same: int
    changed: list[Changed] = field(default_factory=list)
    only_first: list[str] = field(default_factory=list)
    only_second: list[str] = field(default_factory=list)


@dataclass
class _Run:
    logs: dict[str, Row]
    dtcs: Mapping[str, dict[str, Row]]
    events: Mapping[str, list[Row]]


def _read(folder: Path) -> _Run:
    verdicts = Verdicts(folder)
    logs = {row["log"]: row for row in verdicts.rows("logs")}
    dtcs: defaultdict[str, dict[str, Row]] = defaultdict(dict)
    for row in verdicts.rows("dtcs"):
        dtcs[row["log"]][f"{row['dtc']} {row['fault']}"] = row
    events: defaultdict[str, list[Row]] = defaultdict(list)
    for row in verdicts.rows("events"):
        events[row["log"]].append(row)
    for rows in events.values():
        rows.sort(key=lambda row: int(row["n"]))
    return _Run(logs, dtcs, events)


def _key(event: Row | None) -> Any:
    return None if event is None else tuple(event[name] for name in _SAME)


def _first(before: Sequence[Row], after: Sequence[Row]) -> tuple[Row | None, Row | None]:
    """Return the first events that differ; both None: none does."""
    for one, other in zip_longest(before, after):
        if _key(one) != _key(other):
            return one, other
    return None, None


def diff(first: Path, second: Path) -> Difference:
    """Compare the verdicts of two runs, log by log.

    Raises:
        InputError: a folder has none.
    """
    a, b = _read(first), _read(second)
    made = Difference(0)
    same = 0
    for log, row in sorted(b.logs.items(), key=lambda item: str(item[1]["path"])):
        if log not in a.logs:
            made.only_second.append(row["path"])
            continue
        before, after = _first(a.events[log], b.events[log])
        gone, new = sorted(a.dtcs[log].keys() - b.dtcs[log].keys()), sorted(b.dtcs[log].keys() - a.dtcs[log].keys())
        states = (a.logs[log]["state"], row["state"])
        if before is None and after is None and not gone and not new and states[0] == states[1]:
            same += 1
            continue
        times = [int(event["t"]) for event in (before, after) if event is not None]
        at_s = (min(times) - int(row["begin"])) * 1e-9 if times and row["begin"] is not None else None
        made.changed.append(
            Changed(log, row["path"], row["device"], states, tuple(gone), tuple(new), at_s, before, after)
        )
    made.only_first.extend(row["path"] for log, row in a.logs.items() if log not in b.logs)
    return Difference(same, made.changed, sorted(made.only_first), made.only_second)

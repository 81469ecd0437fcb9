"""The answer of a fleet's tables: which car has what, since when, and which log to open.

A car's DTCs with one proven cause are one finding, its symptoms a count; a value far from those of all other cars is
one (:mod:`gateway_fleet.fleet.peers`), and so is a log that could not be judged to its end.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any

from gateway_fleet.fleet.peers import Unusual, unusual
from gateway_fleet.fleet.verdicts import Row, Verdicts

#: Kinds of findings, in their order.
CAUSE, OPEN, UNUSUAL, LOG = "cause", "not isolated", "unusual", "log"
#: Tables that findings are made of.
_TABLES = ("logs", "dtcs", "tests", "errors")


@dataclass(frozen=True)
class Finding:
    """A finding about a car.

    Attributes:
        kind: one of the four above.
        device: the car.
        text: the finding, for people.
        since_ns: of it, in wall time [ns]; None: not known.
        dtcs: codes with their faults that belong to it.
        logs: how many logs of the car have it.
        log: path of the first one, to be opened.
    """

    kind: str
    device: str
    text: str
    since_ns: int | None
    dtcs: tuple[str, ...]
    logs: int
    log: str

    def row(self) -> dict[str, Any]:
        """Return it as a row of a table."""
        return {
            "car": self.device, "kind": self.kind, "finding": self.text, "since": clock(self.since_ns),
            "DTCs": len(self.dtcs), "logs": self.logs, "log": self.log,
        }  # fmt: skip


@dataclass(frozen=True)
class Answer:
    """The answer of a fleet's tables.

    Attributes:
        logs: rows of the table ``logs``, by car and time.
        findings: all of them, causes first, then by time.
        tests: rows of the table ``tests``.
        unusual: values that are unusual, the furthest first.
    """

    logs: list[Row]
    findings: list[Finding]
    tests: list[Row]
    unusual: list[Unusual] = field(default_factory=list)

    @property
    def cars(self) -> list[str]:
        """All cars."""
        return sorted({row["device"] for row in self.logs})

    def verdict(self) -> str:
        """Return all of it in one line."""
        of = {kind: {one.device for one in self.findings if one.kind == kind} for kind in (CAUSE, OPEN, UNUSUAL)}
        faulty = of[CAUSE] | of[OPEN]
        left = sum(one.logs for one in self.findings if one.kind == LOG)
        said = [f"{len(faulty)} of {len(self.cars)} cars with faults"]
        if odd := of[UNUSUAL] - faulty:
            said.append(f"{len(odd)} unusual without a fault")
        if left:
            said.append(f"{left} logs not judged whole")
        return ", ".join(said)


def clock(t_ns: int | None) -> str:
    """Return a time as people write it, UTC; a log without dates: its seconds; "": not known."""
    if t_ns is None:
        return ""
    if t_ns < 10**17:
        return f"{t_ns / 1e9:.3f} s"
    return datetime.fromtimestamp(t_ns // 10**9, UTC).strftime("%Y-%m-%d %H:%M:%S")


def answer(verdicts: Verdicts) -> Answer:
    """Return what the tables of a run say.

    Raises:
        InputError: there are none.
    """
    logs, dtcs, tests, errors = (verdicts.rows(table) for table in _TABLES)
    logs.sort(key=lambda row: (row["device"], row["begin"] or 0, row["path"]))
    path_of = {row["log"]: row["path"] for row in logs}
    failed = {(row["device"], row["fault"]) for row in dtcs}
    odd = [one for one in unusual(tests) if (one.device, one.fault) not in failed]
    found = [*_faults(dtcs, path_of), *(_of_unusual(one, path_of) for one in odd), *_of_logs(logs, errors)]
    order = (CAUSE, OPEN, UNUSUAL, LOG)
    found.sort(key=lambda one: (order.index(one.kind), one.since_ns or 0, one.device, one.text))
    return Answer(logs, found, tests, odd)


def _faults(dtcs: Iterable[Row], path_of: Mapping[str, str]) -> Iterable[Finding]:
    """Yield a finding a cause of a car; of DTCs without a proven one a finding each."""
    by_cause = defaultdict[tuple[str, str, str], list[Row]](list)
    for row in dtcs:
        what = ("cause", row["cause"]) if row["cause"] else ("fault", f"{row['dtc']} {row['fault']}")
        by_cause[row["device"], *what].append(row)
    for (device, kind, text), rows in by_cause.items():
        first = min(rows, key=lambda row: (row["first"] is None, row["first"] or 0))
        sure = f" ({max(row['probability'] or 0.0 for row in rows):.0%})" if kind == "cause" else ""
        yield Finding(
            CAUSE if kind == "cause" else OPEN,
            device,
            f"{text}{sure}",
            first["first"],
            tuple(sorted({f"{row['dtc']} {row['fault']}" for row in rows})),
            len({row["log"] for row in rows}),
            path_of.get(first["log"], ""),
        )


def _of_unusual(one: Unusual, path_of: Mapping[str, str]) -> Finding:
    name, _, unit = one.tested.partition(" [")
    unit = f" {unit.removesuffix(']')}" if unit else ""
    told = f"{one.value:.4g}{unit}; {one.cars} other cars {one.low:.4g} to {one.high:.4g}{unit}"
    text = f"{one.fault}: {name or 'value'} {told}"
    return Finding(UNUSUAL, one.device, text, one.at_ns, (), 1, path_of.get(one.log, ""))


def _of_logs(logs: Iterable[Row], errors: Iterable[Row]) -> Iterable[Finding]:
    why = {row["path"]: row["text"] for row in errors if row["kind"] != "copy"}
    for row in logs:
        if row["state"] != "whole":
            told = why.get(row["path"], "").removeprefix(f"{row['path']}: ")
            text = f"{row['state']}: {told}" if told else row["state"]
            yield Finding(LOG, row["device"], text, row["begin"], (), 1, row["path"])

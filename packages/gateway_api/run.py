"""Results of a run: events, DTCs, verdicts, diagnoses, series."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from html import escape
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from gateway.faults.fault_groups import cases_of
from gateway.faults.service import as_dict
from gateway.faults.status import Status
from gateway.runtime.app import Gateway
from gateway_api.table import Table
from gateway_fdi.errors import GatewayError, MissingError, named
from gateway_replay.series.files import COLUMNS
from gateway_replay.series.rows import RESULTS, Rows
from gateway_replay.series.rows import Series as Which

_DTCS = {"dtc": str, "fault": str, "failing": bool, "confirmed": bool, "occurrence": int}
_DTCS |= {"first_s": float, "last_s": float, "description": str, "cause": str}
_VERDICTS = {"fault": str, "dtc": str, "verdict": str}
_DIAGNOSES = {"components": str, "probability": float, "proven": bool, "failing": int, "text": str}

#: An event of the JSON contract (docs/diagnostics.md); ``event["event"]`` says which one.
Event: TypeAlias = Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class Series:
    """Values of one quantity over time; a row where something changed, till the next one it holds.

    Attributes:
        name: of it.
        kind: ``fault``, ``quantity``, ``signal`` or ``dtc``.
        unit: where it is known.
        t_s: from the first frame on, shape (n,) [s].
        value: in the unit, shape (n,).
        limit: what it is held against, NaN: nothing, shape (n,).
        failed: whether the test failed, shape (n,).
    """

    name: str
    kind: str
    unit: str
    t_s: NDArray[np.float64]
    value: NDArray[np.float64]
    limit: NDArray[np.float64]
    failed: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.t_s)

    def __repr__(self) -> str:
        unit = f" [{self.unit}]" if self.unit else ""
        return f"Series({self.name}{unit}, {self.kind}, {len(self)} values)"


class SeriesSet(Mapping[str, Series]):
    """Series by name, ``monitor.name``, of a signal its own; a table in Arrow as a whole."""

    def __init__(self, rows: Sequence[Rows], known: Sequence[Which], begin_ns: int) -> None:
        names = ("t_ns", "series", "value", "limit", "result")
        columns = [np.concatenate([getattr(part, name) for part in rows]) if rows else np.zeros(0) for name in names]
        self._t, self._which, self._value, self._limit, self._result = columns
        self._known, self._begin_ns = known, begin_ns
        self._places: dict[str, int] = {}
        for place, one in enumerate(known):
            name = f"{one.monitor}.{one.name}" if one.monitor else one.name
            self._places[f"{name} ({one.kind})" if name in self._places else name] = place

    def __getitem__(self, name: str) -> Series:
        if name not in self._places:
            raise MissingError(named("the series are", name, self._places), value=name)
        place = self._places[name]
        one, at = self._known[place], np.flatnonzero(self._which == place)
        t_s = (self._t[at].astype(np.int64) - self._begin_ns) / 1e9
        failed = self._result[at] == RESULTS.index("failed")
        return Series(name, one.kind, one.unit, t_s, self._value[at], self._limit[at], failed)

    def __iter__(self) -> Iterator[str]:
        return iter(self._places)

    def __len__(self) -> int:
        return len(self._places)

    def __repr__(self) -> str:
        return f"SeriesSet({len(self)} series, {len(self._t)} rows)"

    @cached_property
    def table(self) -> Table:
        """All rows in order of time, with the columns of ``gateway replay --signals`` (docs/series.md)."""
        which = self._which.astype(np.int64)
        words = {
            name: np.array([getattr(one, name) for one in self._known], object)[which]
            for name in ("monitor", "kind", "name", "unit")
        }
        results = np.array(RESULTS, object)[self._result.astype(np.int64)]
        each = words | {"t_ns": self._t, "value": self._value, "limit": self._limit, "result": results}
        return Table({name: each[name] for name in COLUMNS})

    def __arrow_c_stream__(self, requested_schema: object = None) -> object:
        """Return the table by Arrow's PyCapsule protocol."""
        return self.table.__arrow_c_stream__(requested_schema)


@dataclass(frozen=True, eq=False, repr=False)
class Run:
    """Results of frames that a gateway was fed.

    Attributes:
        name: of the configuration.
        begin_ns: stamp of the first frame [ns].
        frames: that were fed.
        events: all that was told, in order.
        summary: the last event: counters, buses, what each monitor says of itself.
        dtcs: what is in the fault memory, times from the first frame on.
        verdicts: each fault: ``failed`` if it did once, ``passed``, or ``not tested``.
        diagnoses: what explains the DTCs, the most important first.
        notes: remarks for people.
        expectations: of a scenario: what it expects, and whether that came.
        injected: of a scenario: its faults as they were injected.
    """

    name: str
    begin_ns: int
    frames: int
    events: Sequence[Event]
    summary: Event
    dtcs: Table
    verdicts: Table
    diagnoses: Table
    notes: Sequence[str] = ()
    expectations: Table = field(default_factory=lambda: Table({}))
    injected: Table = field(default_factory=lambda: Table({}))
    kept: SeriesSet | None = None

    @property
    def series(self) -> SeriesSet:
        """Values of monitors over time.

        Raises:
            GatewayError: they were not asked for.
        """
        if self.kept is None:
            raise GatewayError("no series were kept: ask for them, series=True")
        return self.kept

    @property
    def good(self) -> bool:
        """Whether no DTC failed, or a scenario went as expected."""
        if self.expectations.rows:
            return bool(self.expectations["met"].all())
        return not any(e["event"] == "dtc" and e["status"] & Status.TEST_FAILED for e in self.events)

    def __repr__(self) -> str:
        return f"Run({self.name}: {self.frames} frames, {len(self.events)} events)\n{self.dtcs}"

    def _repr_html_(self) -> str:
        parts = [f"<p><b>{escape(self.name)}</b>: {self.frames} frames, {self.dtcs.rows} DTCs</p>"]
        parts += [each._repr_html_() for each in (self.dtcs, self.diagnoses, self.expectations) if each.rows]
        return "".join(parts)


def tables_of(gateway: Gateway, begin_ns: int) -> tuple[Table, Table, Table]:
    """Return DTCs, verdicts and diagnoses of a gateway as they are now.

    Args:
        gateway: that was fed.
        begin_ns: stamp of the first frame [ns].
    """
    entries = [as_dict(entry) for entry in gateway.memory.entries()]
    cases = cases_of(entries)
    why = {entry["fault"]: case.text for case in cases for entry in case.entries}
    what = {definition.id: definition.description for definition in gateway.catalogue}

    def seconds(t_ns: int | None) -> float | None:
        return None if t_ns is None else (t_ns - begin_ns) / 1e9

    dtcs = [
        (
            *(e["dtc"], e["fault"], bool(e["status"] & Status.TEST_FAILED), e["confirmed"], e["occurrence"]),
            *(seconds(e["first_ns"]), seconds(e["last_ns"]), what.get(e["fault"], ""), why.get(e["fault"], "")),
        )
        for e in entries
    ]
    verdicts = [(d.id, str(d.dtc), _verdict(gateway.memory.status_now(d.id))) for d in gateway.catalogue]
    diagnoses = [(" and ".join(one.components), one.probability, one.proven, one.failing, one.text) for one in cases]
    return Table.of(_DTCS, dtcs), Table.of(_VERDICTS, verdicts), Table.of(_DIAGNOSES, diagnoses)


def _verdict(status: Status) -> str:
    if status & Status.TEST_FAILED_THIS_CYCLE:
        return "failed"
    return "not tested" if status & Status.NOT_COMPLETED_THIS_CYCLE else "passed"

"""Records of the fault memory as rows of its file."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Mapping, Sequence
from dataclasses import astuple, fields
from operator import attrgetter
from typing import Any, NamedTuple

from gateway.faults import outgoing
from gateway.faults.explanation import HOLDS, Cause
from gateway.faults.interventions import Intervention
from gateway.faults.records import Changes, FreezeFrame, Record
from gateway.faults.vehicle import EcuDtc

#: Columns of the table of faults, named as in :class:`Record`; the others have tables. These two hold JSON.
COLUMNS = tuple(f.name for f in fields(Record) if f.name not in ("freeze_frames", "cause", "hold"))
JSON = ("evidence", "inputs")

_MARKS = ", ".join("?" * len(COLUMNS))
_UPDATE = ", ".join(f"{name} = excluded.{name}" for name in COLUMNS[1:])
_SAVE_RECORD = (
    f"INSERT INTO fault ({', '.join(COLUMNS)}) VALUES ({_MARKS})"  # noqa: S608 - our own names
    f" ON CONFLICT (id) DO UPDATE SET {_UPDATE}"
)
_SAVE_STATUS = "UPDATE fault SET status = ? WHERE id = ?"
_VALUES = attrgetter(*COLUMNS)
_JSON_AT = tuple(COLUMNS.index(name) for name in JSON)
# Unchanged rows touch no page: each costs a write of 4096 bytes.
_OTHER_FRAMES = "DELETE FROM freeze_frame WHERE fault = ? AND number NOT IN"
_SAVE_FRAME = (
    "INSERT INTO freeze_frame VALUES (?, ?, ?, ?) ON CONFLICT (fault, number)"
    " DO UPDATE SET t_ns = excluded.t_ns, content = excluded.content"
    " WHERE t_ns IS NOT excluded.t_ns OR content IS NOT excluded.content"
)
_SAVE_CAUSE = (
    "INSERT INTO cause VALUES (?, ?, ?)"
    " ON CONFLICT (fault) DO UPDATE SET hold = excluded.hold, content = excluded.content"
    " WHERE hold IS NOT excluded.hold OR content IS NOT excluded.content"
)
SELECT_CAUSES = "SELECT fault, hold, content FROM cause"
_SAVE_FACT = "INSERT INTO fact VALUES (?, ?) ON CONFLICT (name) DO UPDATE SET value = excluded.value"
SELECT_RECORDS = f"SELECT {', '.join(COLUMNS)} FROM fault"  # noqa: S608 - our own names
#: Columns of the table of interventions, named as in :class:`Intervention`.
INTERVENTION = tuple(f.name for f in fields(Intervention))
SELECT_INTERVENTIONS = f"SELECT {', '.join(INTERVENTION)} FROM intervention"  # noqa: S608 - our own names
SELECT_ECU_DTCS = "SELECT ecu, dtc, status, there, came, first_ns, last_ns, went_ns, snapshots FROM ecu_dtc"
SELECT_RECORDINGS = "SELECT fault, t_ns, frames, dropped, log FROM recording"


def read_records(db: sqlite3.Connection) -> list[Record]:
    """Return all records with their freeze frames, in order of their DTCs.

    Raises:
        sqlite3.Error, ValueError: the file is damaged.
    """
    records = {}
    for row in db.execute(f"{SELECT_RECORDS} ORDER BY dtc, id"):
        values = dict(zip(COLUMNS, row, strict=True))
        for name in JSON:
            values[name] = json.loads(values[name])
        records[values["id"]] = Record(**values)
    for fault, number, t_ns, content in db.execute(
        "SELECT fault, number, t_ns, content FROM freeze_frame ORDER BY number"
    ):
        if fault not in records:
            raise ValueError(f"a freeze frame of {fault!r}, which is not there")
        records[fault].freeze_frames[number] = FreezeFrame(number, t_ns, json.loads(content))
    for row in db.execute(SELECT_CAUSES):
        fault, hold, cause = read_cause(*row)
        if fault not in records:
            raise ValueError(f"a cause of {fault!r}, which is not there")
        records[fault].cause, records[fault].hold = cause, hold
    return list(records.values())


def read_cause(fault: str, hold: str, content: str) -> tuple[str, str, Cause | None]:
    """Return a row of what explains an entry.

    Raises:
        ValueError: it makes no sense.
    """
    told = json.loads(content)
    if hold not in HOLDS:
        raise ValueError(f"no state of an entry: {hold!r}")
    return fault, hold, None if told is None else Cause.parse(told)


class Written(NamedTuple):
    """Outcome of changes that were written.

    Attributes:
        gone: numbers of interventions that had to go.
        records: rows of each record, its freeze frames and its cause, as they are read.
    """

    gone: list[int]
    records: dict[str, list[Sequence[Any]]]


def write(db: sqlite3.Connection, changes: Changes) -> Written:
    """Write changes, within a transaction.

    Raises:
        sqlite3.Error: they could not be written.
    """
    records = _write_records(db, changes.records)
    if changes.statuses:
        db.executemany(_SAVE_STATUS, ((status, fault) for fault, status in changes.statuses.items()))
    if changes.facts:
        db.executemany(_SAVE_FACT, changes.facts.items())
    if any((changes.cycles, changes.recordings, changes.identifiers, changes.described, changes.answered)):
        _write_rare(db, changes)
    if changes.permanent is not None:
        db.execute("DELETE FROM permanent")
        db.executemany(
            "INSERT INTO permanent VALUES (?, ?, ?)",
            [(p.fault, p.dtc, p.t_ns) for p in changes.permanent],
        )
    if changes.ecu_dtcs:
        _write_ecu_dtcs(db, changes.ecu_dtcs)
    if changes.outgoing or changes.arrived or changes.dropped.dropped:
        outgoing.write(db, changes.outgoing, changes.arrived, changes.outgoing_bytes, changes.dropped)
    gone = _write_interventions(db, changes) if changes.interventions or changes.kept_interventions else []
    if changes.buses is not None:
        _write_buses(db, changes.buses)
    return Written(gone, records)


def _write_rare(db: sqlite3.Connection, changes: Changes) -> None:
    """Write what few commits have."""
    db.executemany(
        "INSERT OR REPLACE INTO operation_cycle VALUES (?, ?, ?, ?)",
        [(name, c.number, c.open, c.t_ns) for name, c in changes.cycles.items()],
    )
    for r in changes.recordings:
        db.execute(
            "INSERT INTO recording (fault, t_ns, frames, dropped, log) VALUES (?, ?, ?, ?, ?)",
            (r.fault, r.t_ns, r.frames, r.dropped, r.log),
        )
        db.execute(
            "DELETE FROM recording WHERE fault = ?1 AND id NOT IN"
            " (SELECT id FROM recording WHERE fault = ?1 ORDER BY id DESC LIMIT ?2)",
            (r.fault, changes.kept_recordings),
        )
    for did, data in changes.identifiers.items():
        if data is None:
            db.execute("DELETE FROM identifier WHERE did = ?", (did,))
        else:
            db.execute("INSERT OR REPLACE INTO identifier VALUES (?, ?)", (did, data))
    db.executemany(
        "INSERT OR REPLACE INTO catalogue VALUES (?, ?, ?, ?)",
        [(fault, *description) for fault, description in changes.described.items()],
    )
    for request, done in changes.answered.items():
        db.execute("UPDATE request SET done = ? WHERE id = ?", (done, request))


def _write_interventions(db: sqlite3.Connection, changes: Changes) -> list[int]:
    marks = ", ".join("?" * len(INTERVENTION))
    db.executemany(
        f"INSERT OR REPLACE INTO intervention ({', '.join(INTERVENTION)}) VALUES ({marks})",  # noqa: S608 - our own names
        [[getattr(each, name) for name in INTERVENTION] for each in changes.interventions.values()],
    )
    if not changes.kept_interventions:
        return []
    gone = db.execute(
        "DELETE FROM intervention WHERE number <= ? AND number NOT IN (SELECT value FROM json_each(?))"
        " RETURNING number",
        (max(changes.kept_interventions), json.dumps(list(changes.kept_interventions))),
    )
    return [number for (number,) in gone.fetchall()]


def _write_ecu_dtcs(db: sqlite3.Connection, changed: Mapping[tuple[str, str], EcuDtc | None]) -> None:
    db.executemany("DELETE FROM ecu_dtc WHERE ecu = ? AND dtc = ?", list(changed))
    db.executemany(
        "INSERT INTO ecu_dtc VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?)",
        [(*astuple(each)[:-1], json.dumps(each.snapshots)) for each in changed.values() if each is not None],
    )


def read_ecu_dtcs(db: sqlite3.Connection) -> list[EcuDtc]:
    """Return the DTCs of other ECUs.

    Raises:
        ValueError: a row makes no sense.
    """
    return [read_ecu_dtc(*row) for row in db.execute(f"{SELECT_ECU_DTCS} ORDER BY ecu, dtc")]


def read_ecu_dtc(*row: Any) -> EcuDtc:
    """Return a row of the DTCs of other ECUs.

    Raises:
        ValueError: it makes no sense.
    """
    ecu, dtc, status, there, came, first_ns, last_ns, went_ns, content = row
    snapshots: Any = json.loads(content) if isinstance(content, str) else None
    numbers = (status, there, came, first_ns, last_ns, 0 if went_ns is None else went_ns)
    texts = isinstance(ecu, str) and isinstance(dtc, str) and isinstance(snapshots, dict)
    if not texts or not all(isinstance(each, int) for each in numbers):
        raise ValueError(row)
    return EcuDtc(ecu, dtc, status, bool(there), came, first_ns, last_ns, went_ns, snapshots)


def _write_buses(db: sqlite3.Connection, states: Sequence[Mapping[str, Any]]) -> None:
    known = ("bus", "uri", "state", "t_ns")
    db.execute("DELETE FROM bus")
    for state in states:
        more = {name: value for name, value in state.items() if name not in (*known, "event")}
        db.execute(
            "INSERT INTO bus VALUES (?, ?, ?, ?, ?)",
            (*(state[name] for name in known), json.dumps(more)),
        )


def _write_records(db: sqlite3.Connection, records: Sequence[Record]) -> dict[str, list[Sequence[Any]]]:
    written: dict[str, list[Sequence[Any]]] = {r.id: [_values_of(r)] for r in records}
    db.executemany(_SAVE_RECORD, [values for (values,) in written.values()])
    bare = [(r.id,) for r in records if not r.freeze_frames]
    alone = [(r.id,) for r in records if r.cause is None and not r.hold]
    gone = [(r.id,) for r in records if r.occurrence == 0]
    for name, faults in (("freeze_frame", bare), ("cause", alone), ("recording", gone)):
        if faults:
            db.executemany(f"DELETE FROM {name} WHERE fault = ?", faults)  # noqa: S608 - our own names
    for r in records:
        if frames := sorted(r.freeze_frames):
            db.execute(f"{_OTHER_FRAMES} ({', '.join('?' * len(frames))})", (r.id, *frames))
            kept = [r.freeze_frames[number] for number in frames]
            made = [(r.id, frame.number, frame.t_ns, json.dumps(frame.content)) for frame in kept]
            db.executemany(_SAVE_FRAME, made)
            written[r.id] += [frame[1:] for frame in made]
        if r.cause is not None or r.hold:
            content = json.dumps(None if r.cause is None else r.cause.as_dict())
            db.execute(_SAVE_CAUSE, (r.id, r.hold, content))
            written[r.id].append(("cause", r.hold, content))
    return written


def _values_of(r: Record) -> list[Any]:
    values = list(_VALUES(r))
    for place in _JSON_AT:
        values[place] = json.dumps(values[place]) if values[place] else "{}"
    return values

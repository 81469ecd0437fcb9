"""Recovery of a fault memory that is damaged, or that cannot be opened where it is: row by row.

The file itself is never changed: a copy is read, so that an investigator finds it as it was.
"""

from __future__ import annotations

import json
import shutil
import sqlite3
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, TypeVar

from gateway.faults import chain, outgoing, rows
from gateway.faults.interventions import PROTOCOLS, Intervention
from gateway.faults.records import COUNTERS, PLACES, Changes, Cycle, FreezeFrame, Permanent, Record, Recording
from gateway.faults.rollback import generation_of
from gateway.faults.vehicle import EcuDtc

T = TypeVar("T")

#: Files of SQLite beside the database.
SUFFIXES = ("", "-wal", "-shm", "-journal")
#: Rows of a damaged table that are asked for one by one.
MOST_ROWS = 20_000
#: Kept in memory by the kernel, so that a full disk does not matter.
FAST = Path("/dev/shm")  # noqa: S108 - a folder of our own in it


@dataclass
class Salvage:
    """Rows that were read.

    Attributes:
        records, cycles, permanent, recordings, identifiers, facts, interventions, ecu_dtcs, outgoing: as a
            :class:`Store` gives them.
        head: digest of the last link of its chain, b"": not known.
        generation: of the file, 0: not known.
        recovered: rows read.
        lost: rows, or tables, of which it is known that they could not be read.
    """

    records: list[Record] = field(default_factory=list)
    cycles: dict[str, Cycle] = field(default_factory=dict)
    permanent: list[Permanent] = field(default_factory=list)
    recordings: list[Recording] = field(default_factory=list)
    identifiers: dict[int, bytes] = field(default_factory=dict)
    facts: dict[str, int] = field(default_factory=dict)
    interventions: list[Intervention] = field(default_factory=list)
    ecu_dtcs: list[EcuDtc] = field(default_factory=list)
    outgoing: list[outgoing.Outgoing] = field(default_factory=list)
    head: bytes = b""
    generation: int = 0
    recovered: int = 0
    lost: int = 0

    def changes(self) -> Changes:
        """Return all of it for an empty file."""
        return Changes(
            records=self.records,
            cycles=self.cycles,
            permanent=self.permanent,
            recordings=self.recordings,
            kept_recordings=max(len(self.recordings), 1),
            identifiers=self.identifiers,
            facts=self.facts,
            interventions={each.number: each for each in self.interventions},
            ecu_dtcs={each.key: each for each in self.ecu_dtcs},
            outgoing=self.outgoing,
            outgoing_bytes=sum(len(event.body) for event in self.outgoing),
        )


def put_aside(path: Path, why: str, now: datetime | None = None, *, apart: bool = False) -> Path:
    """Rename a file, and the files that belong to it, to a name with the reason and the date; returns the new name.

    Args:
        path: the file.
        why: the reason.
        now: the date.
        apart: whether the log does not belong to the file any more: it is kept as ``NAME.log``, which SQLite does not
            copy into whatever the file is now.

    Raises:
        OSError: it cannot be renamed.
    """
    stamp = (now or datetime.now(UTC)).strftime("%Y%m%dT%H%M%SZ")
    aside = path.with_name(f"{path.name}.{why}-{stamp}")
    number = 1
    while any(Path(f"{aside}{suffix}").exists() for suffix in (*SUFFIXES, ".log")):
        number += 1
        aside = path.with_name(f"{path.name}.{why}-{stamp}-{number}")
    if apart:
        with suppress(FileNotFoundError):
            Path(f"{path}-wal").rename(f"{aside}.log")
        Path(f"{path}-shm").unlink(missing_ok=True)
    for suffix in SUFFIXES:
        with suppress(FileNotFoundError):
            Path(f"{path}{suffix}").rename(f"{aside}{suffix}")
    return aside


def salvage(path: Path) -> Salvage:
    """Read what can be read of a fault memory; nothing is raised, and the file is left as it is."""
    try:
        folder = Path(tempfile.mkdtemp(dir=FAST if FAST.is_dir() else None))
    except OSError:
        return Salvage(lost=1)
    try:
        copy = folder / "copy.sqlite"
        for suffix in ("", "-wal"):
            with suppress(FileNotFoundError):
                shutil.copyfile(f"{path}{suffix}", f"{copy}{suffix}")
        db = sqlite3.connect(copy, isolation_level=None)
        db.execute("PRAGMA writable_schema = ON")  # a definition that is damaged hides no other table
        try:
            return _read(db)
        finally:
            db.close()
    except (OSError, sqlite3.Error):
        return Salvage(lost=1)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _read(db: sqlite3.Connection) -> Salvage:
    found = Salvage()
    tables = {name for (name,) in db.execute("SELECT name FROM sqlite_schema")}  # an earlier version has fewer
    records = {r.id: r for r in _rows(db, found, rows.SELECT_RECORDS, "fault", _record)}
    for fault, frame in _rows(
        db, found, "SELECT fault, number, t_ns, content FROM freeze_frame", "freeze_frame", _frame
    ):
        if fault in records:
            records[fault].freeze_frames[frame.number] = frame
        else:
            found.recovered, found.lost = found.recovered - 1, found.lost + 1
    if "cause" in tables:
        _explain(db, found, records)
    found.records = list(records.values())
    cycles = "SELECT name, number, open, t_ns FROM operation_cycle"
    found.cycles = dict(_rows(db, found, cycles, "operation_cycle", _cycle))
    permanent = _rows(db, found, "SELECT fault, dtc, t_ns FROM permanent", "permanent", _permanent)
    found.permanent = list({each.fault: each for each in permanent}.values())  # a damaged table may have one twice
    found.recordings = [
        recording
        for recording in _rows(db, found, rows.SELECT_RECORDINGS, "recording", _recording)
        if recording.fault in records
    ]
    identifiers = "SELECT did, data FROM identifier"
    found.identifiers = dict(_rows(db, found, identifiers, "identifier", _identifier))
    found.facts = dict(_rows(db, found, "SELECT name, value FROM fact", "fact", _fact))
    found.interventions = list(_rows(db, found, rows.SELECT_INTERVENTIONS, "intervention", _intervention))
    with suppress(sqlite3.Error):
        found.head = chain.head(db).digest
        found.generation = generation_of(db)
    if "ecu_dtc" in tables:
        found.ecu_dtcs = list(_rows(db, found, rows.SELECT_ECU_DTCS, "ecu_dtc", rows.read_ecu_dtc))
    if "outgoing" in tables:
        found.outgoing = list(_rows(db, found, outgoing.SELECT, "outgoing", outgoing.read))
    return found


def _explain(db: sqlite3.Connection, found: Salvage, records: Mapping[str, Record]) -> None:
    for fault, hold, cause in _rows(db, found, rows.SELECT_CAUSES, "cause", rows.read_cause):
        if fault in records:
            records[fault].cause, records[fault].hold = cause, hold
        else:
            found.recovered, found.lost = found.recovered - 1, found.lost + 1


def _rows(db: sqlite3.Connection, found: Salvage, select: str, table: str, read: Callable[..., T]) -> Iterator[T]:
    """Give the rows of a table that can be read and make sense, counting both kinds."""
    for row in _raw_rows(db, found, select, table):
        try:
            made = read(*row)
        except (ValueError, TypeError, KeyError):
            found.lost += 1
        else:
            found.recovered += 1
            yield made


def _raw_rows(db: sqlite3.Connection, found: Salvage, select: str, table: str) -> Iterator[tuple[Any, ...]]:
    """Give the rows from the front up to the damage, from the back up to it, and one by one between."""
    select = select.replace("SELECT ", "SELECT rowid, ", 1)
    seen: set[int] = set()
    whole = True
    for order in ("", " DESC"):
        try:
            for number, *row in db.execute(f"{select} ORDER BY rowid{order}"):
                if number not in seen:
                    seen.add(number)
                    yield tuple(row)
        except sqlite3.Error:
            whole = False
        if whole:
            return
    found.lost += 1  # at least
    last = max([*seen, *_numbers(db, table)], default=0)
    for number in range(1, min(last, MOST_ROWS) + 1):
        if number in seen:
            continue
        with suppress(sqlite3.Error):
            for _, *row in db.execute(f"{select} WHERE rowid = ?", (number,)):
                yield tuple(row)


def _numbers(db: sqlite3.Connection, table: str) -> list[int]:
    """Return the greatest row number that an index of a table knows."""
    with suppress(sqlite3.Error):
        return [int(db.execute(f"SELECT max(rowid) FROM {table}").fetchone()[0])]  # noqa: S608 - our own names
    return []


def _whole(value: object, low: int, high: int) -> int:
    if not isinstance(value, int) or not low <= value <= high:
        raise ValueError(value)
    return value


def _name(value: object) -> str:
    if not isinstance(value, str) or not value or not value.isprintable():
        raise ValueError(value)
    return value


def _numbers_by_name(text: object) -> dict[str, float | None]:
    """Read evidence or signals; values that make no sense are left out, the rest of their row is kept."""
    try:
        content = json.loads(text) if isinstance(text, str) else {}
    except ValueError:
        return {}
    if not isinstance(content, dict):
        return {}
    return {
        name: value
        for name, value in content.items()
        if value is None or (isinstance(value, int | float) and not isinstance(value, bool))
    }


def _record(*row: Any) -> Record:
    values = dict(zip(rows.COLUMNS, row, strict=True))
    record = Record(_name(values["id"]), _whole(values["dtc"], 0, 0xFFFFFF), _whole(values["status"], 0, 0xFF))
    for name in COUNTERS:
        setattr(record, name, _whole(values[name], 0, 2**62))
    for name in PLACES:
        value = values[name]
        setattr(record, name, None if value is None else _whole(value, -(2**63), 2**63 - 1))
    for name in rows.JSON:
        setattr(record, name, _numbers_by_name(values[name]))
    return record


def _frame(fault: Any, number: Any, t_ns: Any, content: Any) -> tuple[str, FreezeFrame]:
    frame = FreezeFrame(_whole(number, 1, 255), _whole(t_ns, -(2**63), 2**63 - 1), _numbers_by_name(content))
    return _name(fault), frame


def _cycle(name: Any, number: Any, is_open: Any, t_ns: Any) -> tuple[str, Cycle]:
    cycle = Cycle(_whole(number, 0, 2**62), bool(_whole(is_open, 0, 1)), _whole(t_ns, -(2**63), 2**63 - 1))
    return _name(name), cycle


def _permanent(fault: Any, dtc: Any, t_ns: Any) -> Permanent:
    return Permanent(_name(fault), _whole(dtc, 0, 0xFFFFFF), _whole(t_ns, -(2**63), 2**63 - 1))


def _recording(fault: Any, t_ns: Any, frames: Any, dropped: Any, log: Any) -> Recording:
    if not isinstance(log, bytes):
        raise TypeError(log)
    return Recording(
        _name(fault),
        _whole(t_ns, -(2**63), 2**63 - 1),
        _whole(frames, 0, 2**62),
        _whole(dropped, 0, 2**62),
        log,
    )


def _identifier(did: Any, data: Any) -> tuple[int, bytes]:
    if not isinstance(data, bytes):
        raise TypeError(data)
    return _whole(did, 0, 0xFFFF), data


def _intervention(*row: Any) -> Intervention:
    each = Intervention(*row)
    for value in (each.t_ns, each.first_ns):
        _whole(value, -(2**63), 2**63 - 1)
    for value, most in (
        (each.address, 0xFFFFFFFF), (each.session, 0xFF), (each.security, 0xFF), (each.outcome, 0xFF),
        (each.count, 2**62), (each.number, 2**62),
    ):  # fmt: skip
        _whole(value, 0, most)
    _name(each.action)
    if each.protocol not in PROTOCOLS or not isinstance(each.request, bytes):
        raise ValueError(row)
    if not isinstance(each.bus, str) or not isinstance(each.role, str):
        raise TypeError(row)
    return each


def _fact(name: Any, value: Any) -> tuple[str, int]:
    return _name(name), _whole(value, -(2**63), 2**63 - 1)

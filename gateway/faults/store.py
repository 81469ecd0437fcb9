"""The fault memory's SQLite file: one writer, written before it is acknowledged.

Write-ahead log with ``synchronous=FULL``: what :meth:`Store.save` has returned from survives ``kill -9`` and
power loss. Other processes may read at any time; to clear they ask the writer through the ``request`` table.
"""

from __future__ import annotations

import json
import os
import sqlite3
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path
from typing import Any

from gateway.errors import GatewayError, InputError
from gateway.faults.lock import take_lock
from gateway.faults.records import Changes, Cycle, FreezeFrame, Permanent, Record, Recording
from gateway.faults.schema import APPLICATION_ID, MIGRATIONS

_MAGIC = b"SQLite format 3\0"

#: Columns of the table of faults, named as in :class:`Record`; these two hold JSON.
_COLUMNS = tuple(f.name for f in fields(Record) if f.name != "freeze_frames")
_JSON = ("evidence", "inputs")


class OutdatedError(InputError):
    """The file is of an earlier version, and was opened for reading only."""


class Store:
    """A fault memory file.

    Args:
        path: the file, made when missing; None keeps everything in this process.
        write: False opens an existing file for reading beside its writer.

    Raises:
        InputError: the file is missing (reading), is not a fault memory or a damaged one, or is of a later
            version.
        InUseError: it has a writer already.
    """

    def __init__(self, path: Path | None, *, write: bool = True) -> None:
        self.path = path
        self._lock: int | None = None
        if path is not None and not write and not path.exists():
            raise InputError("there is no fault memory here", file=path)
        if path is not None and path.exists():
            _refuse_foreign(path)
        try:
            if path is not None and write:
                path.parent.mkdir(parents=True, exist_ok=True)
                self._lock = take_lock(path)
            self._db = sqlite3.connect(
                ":memory:" if path is None else path, isolation_level=None, timeout=10.0
            )
        except (sqlite3.Error, OSError) as error:
            self._unlock()
            raise InputError(f"not usable as a fault memory: {error}", file=path) from error
        except InputError:
            self._unlock()
            raise
        try:
            self._open(write=write)
        except sqlite3.Error as error:
            self.close()
            raise InputError(f"not usable as a fault memory: {error}", file=path) from error
        except InputError:
            self.close()
            raise

    def _open(self, *, write: bool) -> None:
        version = int(self._db.execute("PRAGMA user_version").fetchone()[0])
        mark = int(self._db.execute("PRAGMA application_id").fetchone()[0])
        tables = int(self._db.execute("SELECT count(*) FROM sqlite_schema").fetchone()[0])
        if tables and mark != APPLICATION_ID:
            raise InputError("this is another program's database", file=self.path)
        if version > len(MIGRATIONS):
            raise InputError(
                f"written by a later gateway: version {version}, this one knows {len(MIGRATIONS)}",
                file=self.path,
            )
        if not write:
            if not tables:
                raise InputError("there is no fault memory in this file", file=self.path)
            if version < len(MIGRATIONS):
                raise OutdatedError(
                    f"written by an earlier gateway: version {version}, this one knows"
                    f" {len(MIGRATIONS)}",
                    file=self.path,
                )
            return
        self._refuse_damaged()
        self._db.execute("PRAGMA journal_mode = WAL")
        self._db.execute("PRAGMA synchronous = FULL")
        self._db.execute("PRAGMA foreign_keys = ON")
        for k in range(version, len(MIGRATIONS)):
            self._db.executescript(
                f"BEGIN IMMEDIATE; PRAGMA application_id = {APPLICATION_ID};"
                f"{MIGRATIONS[k]} PRAGMA user_version = {k + 1}; COMMIT;"
            )
        # Whoever asked a writer that is gone has been told that nothing was done.
        self._db.execute("DELETE FROM request")

    def _refuse_damaged(self) -> None:
        """Refuse now what would otherwise fail at a later commit."""
        found = self._db.execute("PRAGMA quick_check(1)").fetchone()[0]
        if found != "ok":
            raise InputError(f"a damaged fault memory: {found}", file=self.path)

    def compact(self) -> None:
        """Check the file whole, and give back what it does not use.

        Raises:
            GatewayError: it is damaged, or cannot be written.
        """
        try:
            found = self._db.execute("PRAGMA integrity_check(1)").fetchone()[0]
            if found != "ok":
                raise GatewayError(f"{self.path}: a damaged fault memory: {found}")
            self._db.execute("VACUUM")
        except sqlite3.Error as error:
            raise GatewayError(f"{self.path}: fault memory not compacted: {error}") from error

    def close(self) -> None:
        """Close the file."""
        self._db.close()
        self._unlock()

    def _unlock(self) -> None:
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    @contextmanager
    def transaction(self) -> Iterator[None]:
        """One transaction, durable at its end; inside another one, a part of that.

        Raises:
            GatewayError: it could not be written (disk full, file system gone); nothing of it was.
        """
        nested = self._db.in_transaction
        if nested:
            yield
            return
        try:
            self._db.execute("BEGIN IMMEDIATE")
            yield
            self._db.execute("COMMIT")
        except BaseException as error:
            if self._db.in_transaction:  # SQLite has rolled back already when the disk is full
                self._db.execute("ROLLBACK")
            if isinstance(error, sqlite3.Error):
                raise GatewayError(f"{self.path}: fault memory not written: {error}") from error
            raise

    @contextmanager
    def _reading(self) -> Iterator[None]:
        """See the file as of one commit of its writer.

        Raises:
            InputError: it is damaged.
        """
        nested = self._db.in_transaction
        try:
            if not nested:
                self._db.execute("BEGIN")
            try:
                yield
            finally:
                if not nested:
                    self._db.execute("ROLLBACK")
        except (sqlite3.Error, ValueError) as error:
            raise InputError(f"a damaged fault memory: {error}", file=self.path) from error

    def load(self) -> list[Record]:
        """Return all records, in order of their DTCs, as of one commit of the writer.

        Raises:
            InputError: the file is damaged.
        """
        records = {}
        columns = ", ".join(_COLUMNS)
        with self._reading():  # else a commit could fall between records and freeze frames
            for row in self._db.execute(f"SELECT {columns} FROM fault ORDER BY dtc, id"):  # noqa: S608 - our own names
                values = dict(zip(_COLUMNS, row, strict=True))
                for name in _JSON:
                    values[name] = json.loads(values[name])
                records[values["id"]] = Record(**values)
            for fault, number, t_ns, content in self._db.execute(
                "SELECT fault, number, t_ns, content FROM freeze_frame ORDER BY number"
            ):
                frame = FreezeFrame(number, t_ns, json.loads(content))
                records[fault].freeze_frames[number] = frame
        return list(records.values())

    def cycles(self) -> dict[str, Cycle]:
        """Return the last operation cycle of each name."""
        with self._reading():
            rows = list(self._db.execute("SELECT name, number, open, t_ns FROM operation_cycle"))
        return {name: Cycle(number, bool(opened), t_ns) for name, number, opened, t_ns in rows}

    def permanent(self) -> list[Permanent]:
        """Return the permanent DTCs, the oldest first."""
        with self._reading():
            rows = list(self._db.execute("SELECT fault, dtc, t_ns FROM permanent ORDER BY rowid"))
        return [Permanent(*row) for row in rows]

    def recordings(self, fault: str | None = None) -> list[Recording]:
        """Return the recordings of a fault, or of all, the oldest first."""
        with self._reading():
            rows = list(
                self._db.execute(
                    "SELECT fault, t_ns, frames, dropped, log FROM recording"
                    " WHERE ?1 IS NULL OR fault = ?1 ORDER BY id",
                    (fault,),
                )
            )
        return [Recording(*row) for row in rows]

    def identifiers(self) -> dict[int, bytes]:
        """Return the values that testers wrote, by data identifier."""
        with self._reading():
            return dict(self._db.execute("SELECT did, data FROM identifier"))

    def facts(self) -> dict[str, int]:
        """Return numbers by name."""
        with self._reading():
            return dict(self._db.execute("SELECT name, value FROM fact"))

    def save(self, changes: Changes) -> None:
        """Write changes in one transaction; durable on return.

        Raises:
            GatewayError: they could not be written; nothing of them was.
        """
        with self.transaction():
            for record in changes.records:
                self._save_record(record)
            self._db.executemany(
                "INSERT OR REPLACE INTO operation_cycle VALUES (?, ?, ?, ?)",
                [(name, c.number, c.open, c.t_ns) for name, c in changes.cycles.items()],
            )
            if changes.permanent is not None:
                self._db.execute("DELETE FROM permanent")
                self._db.executemany(
                    "INSERT INTO permanent VALUES (?, ?, ?)",
                    [(p.fault, p.dtc, p.t_ns) for p in changes.permanent],
                )
            for r in changes.recordings:
                self._db.execute(
                    "INSERT INTO recording (fault, t_ns, frames, dropped, log) VALUES (?, ?, ?, ?, ?)",
                    (r.fault, r.t_ns, r.frames, r.dropped, r.log),
                )
                self._db.execute(
                    "DELETE FROM recording WHERE fault = ?1 AND id NOT IN"
                    " (SELECT id FROM recording WHERE fault = ?1 ORDER BY id DESC LIMIT ?2)",
                    (r.fault, changes.kept_recordings),
                )
            self._db.executemany(
                "INSERT OR REPLACE INTO identifier VALUES (?, ?)", changes.identifiers.items()
            )
            self._db.executemany("INSERT OR REPLACE INTO fact VALUES (?, ?)", changes.facts.items())
            for request, done in changes.answered.items():
                self._db.execute("UPDATE request SET done = ? WHERE id = ?", (done, request))

    def _save_record(self, r: Record) -> None:
        values = [
            json.dumps(value) if name in _JSON else value
            for name, value in ((name, getattr(r, name)) for name in _COLUMNS)
        ]
        marks = ", ".join("?" * len(_COLUMNS))
        update = ", ".join(f"{name} = excluded.{name}" for name in _COLUMNS[1:])
        self._db.execute(
            f"INSERT INTO fault ({', '.join(_COLUMNS)}) VALUES ({marks})"  # noqa: S608 - our own names
            f" ON CONFLICT (id) DO UPDATE SET {update}",
            values,
        )
        self._db.execute("DELETE FROM freeze_frame WHERE fault = ?", (r.id,))
        self._db.executemany(
            "INSERT INTO freeze_frame VALUES (?, ?, ?, ?)",
            [
                (r.id, frame.number, frame.t_ns, json.dumps(frame.content))
                for frame in r.freeze_frames.values()
            ],
        )
        if r.occurrence == 0:
            self._db.execute("DELETE FROM recording WHERE fault = ?", (r.id,))

    def save_buses(self, states: Sequence[Mapping[str, Any]]) -> None:
        """Replace what is known of the buses: name, URI, state, time, and counters.

        Raises:
            GatewayError: it could not be written.
        """
        known = ("bus", "uri", "state", "t_ns")
        with self.transaction():
            self._db.execute("DELETE FROM bus")
            self._db.executemany(
                "INSERT INTO bus VALUES (?, ?, ?, ?, ?)",
                [
                    (
                        *(state[name] for name in known),
                        json.dumps({k: v for k, v in state.items() if k not in (*known, "event")}),
                    )
                    for state in states
                ],
            )

    def buses(self) -> list[dict[str, Any]]:
        """Return what the daemon said last of its buses."""
        with self._reading():
            rows = list(self._db.execute("SELECT name, uri, state, t_ns, counters FROM bus"))
        return [
            {"bus": name, "uri": uri, "state": state, "t_ns": t_ns, **json.loads(counters)}
            for name, uri, state, t_ns, counters in rows
        ]

    def save_catalogue(self, told: Mapping[str, tuple[str, int, str]]) -> None:
        """Keep what faults are called, for readers without the configuration; others that are there stay.

        Args:
            told: fault -> description, severity (byte of ISO 14229-1, Annex D.3), what to do.

        Raises:
            GatewayError: it could not be written.
        """
        with self.transaction():
            self._db.executemany(
                "INSERT OR REPLACE INTO catalogue VALUES (?, ?, ?, ?)",
                [(fault, *facts) for fault, facts in told.items()],
            )

    def catalogue(self) -> dict[str, tuple[str, int, str]]:
        """Return what faults are called: fault -> description, severity, what to do."""
        with self._reading():
            rows = list(
                self._db.execute("SELECT fault, description, severity, remedy FROM catalogue")
            )
        return {fault: (text, severity, remedy) for fault, text, severity, remedy in rows}

    def requests(self) -> list[tuple[int, str, str]]:
        """Return the requests of other processes not answered yet: (id, kind, argument)."""
        return list(
            self._db.execute(
                "SELECT id, kind, argument FROM request WHERE done IS NULL ORDER BY id"
            )
        )

    def request(self, kind: str, argument: str) -> int:
        """Ask the writer for something; returns the request's id."""
        with self.transaction():
            cursor = self._db.execute(
                "INSERT INTO request (kind, argument) VALUES (?, ?)", (kind, argument)
            )
        return int(cursor.lastrowid or 0)

    def answer(self, request: int) -> int | None:
        """Return what the writer answered, None before it did."""
        row = self._db.execute("SELECT done FROM request WHERE id = ?", (request,)).fetchone()
        return None if row is None else row[0]

    def withdraw(self, request: int) -> int | None:
        """Take a request back; returns the answer if the writer was faster, else it is never done."""
        with self.transaction():
            answer = self.answer(request)
            self._db.execute("DELETE FROM request WHERE id = ?", (request,))
        return answer

    def watch(self) -> Callable[[], bool]:
        """Return a cheap test of whether another process has written since the last call."""
        last = -1

        def changed() -> bool:
            nonlocal last
            version = int(self._db.execute("PRAGMA data_version").fetchone()[0])
            different = version != last
            last = version
            return different

        return changed


def _refuse_foreign(path: Path) -> None:
    """Refuse a file that SQLite would take for an empty database and overwrite."""
    try:
        with path.open("rb") as file:
            head = file.read(len(_MAGIC))
    except OSError as error:
        raise InputError(error.strerror or str(error), file=path) from error
    if head and head != _MAGIC:
        raise InputError("not usable as a fault memory: it is no SQLite file", file=path)

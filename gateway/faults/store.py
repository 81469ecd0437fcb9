"""The fault memory's SQLite file: one writer, written before it is acknowledged.

Write-ahead log with ``synchronous=FULL``: what :meth:`Store.save` has returned from survives ``kill -9`` and
power loss. Other processes may read at any time; to clear they ask the writer through the ``request`` table.
"""

from __future__ import annotations

import json
import os
import sqlite3
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from gateway.errors import GatewayError, InputError
from gateway.faults.lock import take_lock
from gateway.faults.schema import APPLICATION_ID, MIGRATIONS

_MAGIC = b"SQLite format 3\0"


@dataclass
class FreezeFrame:
    """Signals at a failure. Record 1 is of the first failure, record 2 of the latest."""

    number: int
    t_ns: int
    content: dict[str, float | None]


@dataclass
class Record:
    """What the memory keeps of one fault."""

    id: str
    dtc: int
    status: int
    failed_cycles: int = 0
    occurrence: int = 0
    first_ns: int | None = None
    last_ns: int | None = None
    evidence: dict[str, float | None] = field(default_factory=dict)
    freeze_frames: dict[int, FreezeFrame] = field(default_factory=dict)


@dataclass
class Cycle:
    """The operation cycle: its number, and whether it was ended."""

    number: int
    open: bool
    t_ns: int


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

    def load(self) -> list[Record]:
        """Return all records, in order of their DTCs, as of one commit of the writer.

        Raises:
            InputError: the file is damaged.
        """
        try:
            self._db.execute("BEGIN")  # else a commit could fall between records and freeze frames
            try:
                return self._load()
            finally:
                self._db.execute("ROLLBACK")
        except (sqlite3.Error, ValueError) as error:
            raise InputError(f"a damaged fault memory: {error}", file=self.path) from error

    def _load(self) -> list[Record]:
        records = {
            row[0]: Record(
                id=row[0],
                dtc=row[1],
                status=row[2],
                failed_cycles=row[3],
                occurrence=row[4],
                first_ns=row[5],
                last_ns=row[6],
                evidence=json.loads(row[7]),
            )
            for row in self._db.execute(
                "SELECT id, dtc, status, failed_cycles, occurrence, first_ns, last_ns, evidence"
                " FROM fault ORDER BY dtc, id"
            )
        }
        for fault, number, t_ns, content in self._db.execute(
            "SELECT fault, number, t_ns, content FROM freeze_frame ORDER BY number"
        ):
            frame = FreezeFrame(number, t_ns, json.loads(content))
            records[fault].freeze_frames[number] = frame
        return list(records.values())

    def cycle(self) -> Cycle:
        """Return the last operation cycle."""
        number, opened, t_ns = self._db.execute("SELECT number, open, t_ns FROM cycle").fetchone()
        return Cycle(number, bool(opened), t_ns)

    def save(
        self,
        records: Iterable[Record],
        cycle: Cycle | None = None,
        answered: dict[int, int] | None = None,
    ) -> None:
        """Write records, and the cycle and answered requests, in one transaction; durable on return."""
        with self.transaction():
            for r in records:
                self._db.execute(
                    "INSERT INTO fault VALUES (?, ?, ?, ?, ?, ?, ?, ?) ON CONFLICT (id) DO UPDATE SET"
                    " dtc = excluded.dtc, status = excluded.status,"
                    " failed_cycles = excluded.failed_cycles, occurrence = excluded.occurrence,"
                    " first_ns = excluded.first_ns, last_ns = excluded.last_ns,"
                    " evidence = excluded.evidence",
                    (
                        r.id,
                        r.dtc,
                        int(r.status),
                        r.failed_cycles,
                        r.occurrence,
                        r.first_ns,
                        r.last_ns,
                        json.dumps(r.evidence),
                    ),
                )
                self._db.execute("DELETE FROM freeze_frame WHERE fault = ?", (r.id,))
                self._db.executemany(
                    "INSERT INTO freeze_frame VALUES (?, ?, ?, ?)",
                    [
                        (r.id, frame.number, frame.t_ns, json.dumps(frame.content))
                        for frame in r.freeze_frames.values()
                    ],
                )
            if cycle is not None:
                self._db.execute(
                    "UPDATE cycle SET number = ?, open = ?, t_ns = ?",
                    (cycle.number, cycle.open, cycle.t_ns),
                )
            for request, done in (answered or {}).items():
                self._db.execute("UPDATE request SET done = ? WHERE id = ?", (done, request))

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

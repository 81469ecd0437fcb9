"""The fault memory's SQLite file: one writer, written before it is acknowledged.

Write-ahead log with ``synchronous=FULL``: what :meth:`Store.save` has returned from survives ``kill -9`` and
power loss. Other processes may read at any time; to clear they ask the writer through the ``request`` table.
"""

from __future__ import annotations

import fcntl
import json
import os
import sqlite3
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path

from gateway.errors import InputError

#: "GWFM": marks the file as a fault memory.
_APPLICATION_ID = 0x4757464D
_MAGIC = b"SQLite format 3\0"

_FIRST = """
CREATE TABLE fault (
    id TEXT PRIMARY KEY,
    dtc INTEGER NOT NULL,
    status INTEGER NOT NULL,
    failed_cycles INTEGER NOT NULL,
    occurrence INTEGER NOT NULL,
    first_ns INTEGER,
    last_ns INTEGER,
    evidence TEXT NOT NULL
);
CREATE TABLE freeze_frame (
    fault TEXT NOT NULL REFERENCES fault (id),
    number INTEGER NOT NULL,
    t_ns INTEGER NOT NULL,
    content TEXT NOT NULL,
    PRIMARY KEY (fault, number)
);
CREATE TABLE cycle (number INTEGER NOT NULL, open INTEGER NOT NULL, t_ns INTEGER NOT NULL);
INSERT INTO cycle VALUES (0, 0, 0);
CREATE TABLE request (id INTEGER PRIMARY KEY, kind TEXT NOT NULL, argument TEXT NOT NULL, done INTEGER);
"""

#: Scripts that bring a file from version k to k + 1.
_MIGRATIONS = (_FIRST,)


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
        InputError: the file is missing (reading), is not a fault memory, is of a later version, or has
            a writer already.
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
                self._lock = _take_lock(path)
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
        if tables and mark != _APPLICATION_ID:
            raise InputError("this is another program's database", file=self.path)
        if version > len(_MIGRATIONS):
            raise InputError(
                f"written by a later gateway: version {version}, this one knows {len(_MIGRATIONS)}",
                file=self.path,
            )
        if not write:
            if not tables:
                raise InputError("there is no fault memory in this file", file=self.path)
            return
        self._db.execute("PRAGMA journal_mode = WAL")
        self._db.execute("PRAGMA synchronous = FULL")
        self._db.execute("PRAGMA foreign_keys = ON")
        for k in range(version, len(_MIGRATIONS)):
            self._db.executescript(
                f"BEGIN IMMEDIATE; PRAGMA application_id = {_APPLICATION_ID};"
                f"{_MIGRATIONS[k]} PRAGMA user_version = {k + 1}; COMMIT;"
            )

    def close(self) -> None:
        """Close the file."""
        self._db.close()
        self._unlock()

    def _unlock(self) -> None:
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    def load(self) -> list[Record]:
        """Return all records, in order of their DTCs."""
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
        self._db.execute("BEGIN IMMEDIATE")
        try:
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
            self._db.execute("COMMIT")
        except BaseException:
            self._db.execute("ROLLBACK")
            raise

    def requests(self) -> list[tuple[int, str, str]]:
        """Return the requests of other processes not answered yet: (id, kind, argument)."""
        return list(
            self._db.execute(
                "SELECT id, kind, argument FROM request WHERE done IS NULL ORDER BY id"
            )
        )

    def request(self, kind: str, argument: str) -> int:
        """Ask the writer for something; returns the request's id."""
        cursor = self._db.execute(
            "INSERT INTO request (kind, argument) VALUES (?, ?)", (kind, argument)
        )
        return int(cursor.lastrowid or 0)

    def answer(self, request: int) -> int | None:
        """Return what the writer answered, None before it did."""
        row = self._db.execute("SELECT done FROM request WHERE id = ?", (request,)).fetchone()
        return None if row is None else row[0]

    def withdraw(self, request: int) -> None:
        """Take a request back, or forget one that was answered."""
        self._db.execute("DELETE FROM request WHERE id = ?", (request,))

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


def _take_lock(path: Path) -> int:
    """Become the only writer; the kernel gives the lock up when this process ends, however it ends."""
    lock = os.open(f"{path}-lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        os.close(lock)
        raise InputError(
            "another gateway keeps this fault memory; stop it, or give this one its own", file=path
        ) from error
    return lock


def has_writer(path: Path) -> bool:
    """Tell whether a process keeps this fault memory."""
    try:
        os.close(_take_lock(path))
    except InputError:
        return True
    return False

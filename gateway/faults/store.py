"""The fault memory's SQLite file: one writer, written before it is acknowledged.

Write-ahead log with ``synchronous=FULL``: changes for which :meth:`Store.save` has returned survive ``kill -9`` and
power loss. Other processes may read at any time; to clear they ask the writer through the ``request`` table.
"""

from __future__ import annotations

import json
import os
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, cast

from gateway.faults import chain, journal_file, rows, write_ahead
from gateway.faults.interventions import Intervention
from gateway.faults.journal_file import LastVerdict
from gateway.faults.lock import is_kept, is_marked, mark, take_lock
from gateway.faults.records import Changes, Cycle, Description, Permanent, Record, Recording
from gateway.faults.schema import APPLICATION_ID, CHAINED, MAGIC, MIGRATIONS
from gateway.faults.vehicle import EcuDtc
from gateway_fdi.errors import GatewayError, InputError

#: Another process that writes (a request to clear) is waited for this long [s].
PATIENCE_S = 1.0
#: Primary result codes of SQLite that mean damage; all others are the disk's, and may pass.
_DAMAGE = (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB)


#: Opens a database, as ``sqlite3.connect`` does.
Connect = Callable[..., sqlite3.Connection]


class OutdatedError(InputError):
    """The file is of an earlier version, and was opened for reading only."""


class DamagedError(InputError):
    """The file was a fault memory, and is damaged."""


class ForeignError(InputError):
    """The file is another program's database."""


class UnusableError(InputError):
    """The file cannot be opened for writing at present: disk full, read-only, no permission, I/O error."""


class StoreError(GatewayError):
    """Changes could not be written; nothing of them was.

    Attributes:
        reason: in a few words.
        full: only room is missing: the same connection may be tried again.
    """

    def __init__(self, path: Path | None, reason: str, *, full: bool = False) -> None:
        self.reason, self.full = reason, full
        super().__init__(f"{path}: fault memory not written: {reason}")


def _code(error: sqlite3.Error) -> int:
    return int(getattr(error, "sqlite_errorcode", sqlite3.SQLITE_ERROR)) & 0xFF


def damage(path: Path | None, what: object) -> DamagedError:
    """Return what to raise for a damaged file."""
    return DamagedError(
        f"a damaged fault memory: {what}; the next gateway that keeps it (gateway run) puts it aside"
        " and recovers what can be read",
        file=path,
    )


class Store:
    """A fault memory file.

    Args:
        path: the file, made when missing; None keeps everything in this process.
        write: False opens an existing file for reading beside its writer.
        connect: opens the database.

    Raises:
        InputError: the file is missing (reading), is not a fault memory, or is of a later version.
        DamagedError: it is a damaged one.
        UnusableError: it cannot be written.
        InUseError: it has a writer already.
    """

    def __init__(self, path: Path | None, *, write: bool = True, connect: Connect = sqlite3.connect) -> None:
        self.path = path
        self._open_database = connect
        self._write = write
        self._lock: int | None = None
        self._was_kept = False
        self._head = chain.NO_HEAD  # the last link that this one wrote
        self._logged = write_ahead.MANY  # pages of the log since it was tended, as estimated: a new one is due
        self._unwritten = Changes()  # of a store without a file: rows are made of them when they are read
        self._kept: dict[str, Record] = {}  # likewise, by id
        self._db = sqlite3.connect(":memory:")  # until the file is open
        self._connect()
        self._waiting = self.waiting() if write else []

    def _connect(self) -> None:
        """Open the file, and become its writer if that is asked for."""
        path = self.path
        if path is not None and not self._write and not path.exists():
            raise InputError("there is no fault memory here", file=path)
        if path is not None and path.is_dir():
            raise InputError("this is a folder; name a file for the fault memory", file=path)
        if path is not None and path.exists():
            _refuse_foreign(path)
        try:
            if path is not None and self._write:
                path.parent.mkdir(parents=True, exist_ok=True)
                if self._lock is None:
                    self._lock = take_lock(path)
                self._was_kept = path.exists() and is_marked(path)
            self._db = self._open_database(
                ":memory:" if path is None else path,
                isolation_level=None,
                timeout=PATIENCE_S,
                check_same_thread=False,  # one thread at a time, but not always the same
            )
        except (sqlite3.Error, OSError) as error:
            self._unlock()
            raise UnusableError(f"not usable as a fault memory: {error}", file=path) from error
        except InputError:
            self._unlock()
            raise
        try:
            self._open()
            if self._lock is not None:
                mark(self._lock)
        except sqlite3.Error as error:
            self.close()
            if _code(error) in _DAMAGE:
                raise damage(path, error) from error
            raise UnusableError(f"not usable as a fault memory: {error}", file=path) from error
        except UnicodeDecodeError as error:  # a damaged name of a table is a part of what SQLite says of it
            self.close()
            raise damage(path, error) from error
        except InputError:
            self.close()
            raise

    def _open(self) -> None:
        version = int(self._db.execute("PRAGMA user_version").fetchone()[0])
        stamp = int(self._db.execute("PRAGMA application_id").fetchone()[0])
        tables = int(self._db.execute("SELECT count(*) FROM sqlite_schema").fetchone()[0])
        if not tables and self._was_kept:
            raise damage(self.path, "it is empty")
        if tables and stamp != APPLICATION_ID:
            raise ForeignError("this is another program's database", file=self.path)
        if version > len(MIGRATIONS):
            raise InputError(
                f"written by a later gateway: version {version}, this one knows {len(MIGRATIONS)}",
                file=self.path,
            )
        if not self._write:
            # Only the writer may copy the log: by that it knows whether another process has changed the file.
            self._db.execute("PRAGMA wal_autocheckpoint = 0")
            if not tables:
                raise InputError("there is no fault memory in this file", file=self.path)
            if version < len(MIGRATIONS):
                raise OutdatedError(
                    f"written by an earlier gateway: version {version}, this one knows {len(MIGRATIONS)}",
                    file=self.path,
                )
            return
        self.refuse_damaged()
        self._db.execute("PRAGMA journal_mode = WAL")
        self._db.execute("PRAGMA synchronous = FULL")
        self._db.execute(f"PRAGMA wal_autocheckpoint = {write_ahead.PAGES}")
        self._db.execute("PRAGMA foreign_keys = ON")
        if version < len(MIGRATIONS):  # in one transaction: a new file is there at once
            self._db.executescript(
                f"BEGIN IMMEDIATE; PRAGMA application_id = {APPLICATION_ID};"
                f"{''.join(MIGRATIONS[version:])} PRAGMA user_version = {len(MIGRATIONS)};"
            )
            if version < CHAINED:
                chain.begin(self._db)
            self._db.execute("COMMIT")
        # Processes that asked a writer that is gone have been told that nothing was done.
        self._db.execute("DELETE FROM request")

    def refuse_damaged(self) -> None:
        """Refuse now what would otherwise fail, or be missed, later.

        Raises:
            DamagedError: the file is damaged.
        """
        with self._reading():
            found = self._db.execute("PRAGMA integrity_check(1)").fetchone()[0]
            orphan = self._db.execute("PRAGMA foreign_key_check").fetchone()
        if found != "ok":
            raise damage(self.path, found)
        if orphan is not None:
            raise damage(self.path, f"a {orphan[0]} of a {orphan[2]} that is not there")

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
            StoreError: it could not be written (disk full, file system gone); nothing of it was.
        """
        nested = self._db.in_transaction
        if nested:
            yield
            return
        self._write_rows()
        try:
            self._db.execute("BEGIN IMMEDIATE")
            yield
            self._db.execute("COMMIT")
        except BaseException as error:
            if self._db.in_transaction:  # SQLite has rolled back already when the disk is full
                with suppress(sqlite3.Error):
                    self._db.execute("ROLLBACK")
            if isinstance(error, sqlite3.Error):
                full = _code(error) in (sqlite3.SQLITE_FULL, sqlite3.SQLITE_BUSY)
                raise StoreError(self.path, str(error), full=full) from error
            raise

    @contextmanager
    def _reading(self) -> Iterator[None]:
        """See the file as of one commit of its writer.

        Raises:
            DamagedError: it is damaged.
            InputError: it cannot be read.
        """
        nested = self._db.in_transaction
        self._write_rows()
        try:
            if not nested:
                self._db.execute("BEGIN")
            try:
                yield
            finally:
                if not nested:
                    self._db.execute("ROLLBACK")
        except (sqlite3.Error, ValueError) as error:
            # Our statements are right for the schema: one that SQLite cannot make sense of means another schema.
            # An error without a code is the driver's: a text that is not UTF-8.
            other = getattr(error, "sqlite_errorcode", sqlite3.SQLITE_ERROR) == sqlite3.SQLITE_ERROR
            operational = isinstance(error, sqlite3.OperationalError) and not other
            if operational and _code(cast(sqlite3.Error, error)) not in _DAMAGE:
                raise InputError(f"fault memory not readable: {error}", file=self.path) from error
            raise damage(self.path, error) from error

    def load(self) -> list[Record]:
        """Return all records, in order of their DTCs, as of one commit of the writer.

        A reader gets them with the verdicts that wait for the next writer, if there is none now.

        Raises:
            DamagedError: the file is damaged.
        """
        with self._reading():  # else a commit could fall between records and freeze frames
            records = rows.read_records(self._db)
            if self.path is not None and not self._write and not is_kept(self.path):
                journal_file.show(self.waiting(), records)
        return records

    def cycles(self) -> dict[str, Cycle]:
        """Return the last operation cycle of each name."""
        with self._reading():
            found = list(self._db.execute("SELECT name, number, open, t_ns FROM operation_cycle"))
        return {name: Cycle(number, bool(opened), t_ns) for name, number, opened, t_ns in found}

    def permanent(self) -> list[Permanent]:
        """Return the permanent DTCs, the oldest first."""
        with self._reading():
            found = list(self._db.execute("SELECT fault, dtc, t_ns FROM permanent ORDER BY rowid"))
        return [Permanent(*row) for row in found]

    def recordings(self, fault: str | None = None) -> list[Recording]:
        """Return the recordings of a fault, or of all, the oldest first."""
        with self._reading():
            found = list(
                self._db.execute(
                    f"{rows.SELECT_RECORDINGS} WHERE ?1 IS NULL OR fault = ?1 ORDER BY id",
                    (fault,),
                )
            )
        return [Recording(*row) for row in found]

    def recorded(self) -> dict[str, int]:
        """Return how many recordings there are of each fault that has some; their logs are not read."""
        with self._reading():
            return dict(self._db.execute("SELECT fault, count(*) FROM recording GROUP BY fault"))

    def identifiers(self) -> dict[int, bytes]:
        """Return the values that testers wrote, by data identifier."""
        with self._reading():
            return dict(self._db.execute("SELECT did, data FROM identifier"))

    def interventions(self) -> list[Intervention]:
        """Return what testers did, the oldest first."""
        with self._reading():
            return [Intervention(*row) for row in self._db.execute(f"{rows.SELECT_INTERVENTIONS} ORDER BY number")]

    def ecu_dtcs(self) -> list[EcuDtc]:
        """Return the DTCs of other ECUs."""
        with self._reading():
            return rows.read_ecu_dtcs(self._db)

    def facts(self) -> dict[str, int]:
        """Return numbers by name."""
        with self._reading():
            return dict(self._db.execute("SELECT name, value FROM fact"))

    def verify(self) -> chain.Verdict:
        """Return what of the file is as its chain says, as of one commit of the writer.

        Raises:
            DamagedError: it cannot be read.
        """
        with self._reading():
            return chain.verify(self._db)

    def save(self, changes: Changes, whole: Callable[[], Changes] | None = None) -> None:
        """Write changes in one transaction; durable on return.

        Args:
            changes: since the last call that succeeded.
            whole: returns all there is, for a store that has to begin a new file.

        Raises:
            StoreError: they could not be written; nothing of them was.
        """
        if self.path is None and self._keeps_unwritten(changes):
            return
        with self.transaction():
            if self.path is None:
                rows.write(self._db, changes)
            else:
                self._head = chain.write(self._db, changes)
        self._logged += 3 + 2 * changes.faults + sum(len(r.log) for r in changes.recordings) // write_ahead.PAGE

    def _keeps_unwritten(self, changes: Changes) -> bool:
        """Keep changes of verdicts as they are; False: there are others, or an entry has gone."""
        if not (changes.of_verdicts and all(record.occurrence for record in changes.records)):
            return False
        for record in changes.records:
            self._kept[record.id] = record
            self._unwritten.statuses.pop(record.id, None)  # of before
        self._unwritten.statuses.update(changes.statuses)
        self._unwritten.facts = {**self._unwritten.facts, **changes.facts}
        return True

    def _write_rows(self) -> None:
        """Make rows of what a store without a file has kept as it is."""
        unwritten, self._unwritten = self._unwritten, Changes()
        unwritten.records, self._kept = list(self._kept.values()), {}
        if unwritten.faults or unwritten.facts:
            rows.write(self._db, unwritten)

    def waiting(self) -> list[LastVerdict]:
        """Return the verdicts that were told and that the file does not have, in order (see :mod:`.journal_file`)."""
        if self.path is None:
            return []
        with self._reading():
            return journal_file.waiting(self.path, chain.head(self._db).digest)

    def take_waiting(self) -> list[LastVerdict]:
        """Return, once, the verdicts that waited when the file was opened for writing."""
        waiting, self._waiting = self._waiting, []
        return waiting

    def buses(self) -> list[dict[str, Any]]:
        """Return what the daemon said last of its buses."""
        with self._reading():
            found = list(self._db.execute("SELECT name, uri, state, t_ns, counters FROM bus"))
        return [
            {"bus": name, "uri": uri, "state": state, "t_ns": t_ns, **json.loads(counters)}
            for name, uri, state, t_ns, counters in found
        ]

    def descriptions(self) -> dict[str, Description]:
        """Return what faults are called, by their id."""
        with self._reading():
            found = self._db.execute("SELECT fault, description, severity, remedy FROM catalogue")
            return {fault: Description(*description) for fault, *description in found}

    def requests(self) -> list[tuple[int, str, str]]:
        """Return the requests of other processes not answered yet: (id, kind, argument)."""
        with self._reading():
            return list(self._db.execute("SELECT id, kind, argument FROM request WHERE done IS NULL ORDER BY id"))

    def request(self, kind: str, argument: str) -> int:
        """Ask the writer for something; returns the request's id."""
        with self.transaction():
            cursor = self._db.execute("INSERT INTO request (kind, argument) VALUES (?, ?)", (kind, argument))
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
            try:
                version = int(self._db.execute("PRAGMA data_version").fetchone()[0])
            except sqlite3.Error:  # errors are found at the next commit
                return False
            different = version != last
            last = version
            return different

        return changed


def _refuse_foreign(path: Path) -> None:
    """Refuse a file that SQLite would take for an empty database and overwrite."""
    try:
        with path.open("rb") as file:
            head = file.read(len(MAGIC))
    except OSError as error:
        raise InputError(error.strerror or str(error), file=path) from error
    if head and head != MAGIC:
        if is_marked(path):  # nothing else was ever kept under this name
            raise damage(path, "it is no SQLite file any more")
        raise InputError("not usable as a fault memory: it is no SQLite file", file=path)

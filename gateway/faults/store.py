"""The fault memory's SQLite file: one writer, written before it is acknowledged.

Write-ahead log with ``synchronous=FULL``: changes for which :meth:`Store.save` has returned survive ``kill -9`` and
power loss. Other processes may read at any time; to clear they ask the writer through the ``request`` table.

One connection writes, for one thread at a time: a second thread that would write meanwhile gets an error. This
process reads by another connection, which sees whole commits, and never touches the one that writes.
"""

from __future__ import annotations

import os
import secrets
import sqlite3
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import cast

from gateway.faults import chain, journal_file, lock, rollback, rows, write_ahead
from gateway.faults.contents import Contents
from gateway.faults.journal_file import LastVerdict
from gateway.faults.lock import is_marked, take_lock
from gateway.faults.records import Changes, Record
from gateway.faults.salvage import put_aside
from gateway.faults.schema import APPLICATION_ID, CHAINED, MAGIC, MIGRATIONS
from gateway_fdi.common.log import get_logger
from gateway_fdi.errors import GatewayError, InputError

log = get_logger(__name__)

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


class StrangeError(InputError):
    """The file is none of SQLite's."""


class OlderError(DamagedError):
    """The file is whole, but of an earlier time than the files beside it."""


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


class Store(Contents):
    """A fault memory file.

    Args:
        path: the file, made when missing; None keeps everything in this process.
        write: False opens an existing file for reading beside its writer.
        connect: opens the database.

    Attributes:
        generation: number that no other file has; 0: it is none.

    Raises:
        InputError: the file is missing (reading), is not a fault memory, or is of a later version.
        DamagedError: it is a damaged one, or went back to an earlier state (:mod:`gateway.faults.rollback`).
        UnusableError: it cannot be written.
        InUseError: it has a writer already.
    """

    def __init__(self, path: Path | None, *, write: bool = True, connect: Connect = sqlite3.connect) -> None:
        self.path = path
        self._open_database = connect
        self._write = write
        self._lock: int | None = None
        self._was_kept = False
        self._known: list[rollback.LastLink] = []  # last links, as the files beside had them before it was opened
        self._turn, self._writing = threading.RLock(), 0  # who writes: the thread's number
        self._readings = threading.RLock()
        self._reader: sqlite3.Connection | None = None  # None: the one that writes reads, too
        self.generation = 0
        self._head = self._next = chain.NO_HEAD  # the last link on the disk, and within a transaction
        self._notes = self._expected = 0  # notes of last links; generation of a file that is begun
        self._logged = write_ahead.MANY  # pages of the log since it was tended, as estimated: a new one is due
        self._unwritten = Changes()  # of a store without a file: rows are made of them when they are read
        self._kept: dict[str, Record] = {}  # likewise, by id
        self._db = sqlite3.connect(":memory:")  # until the file is open
        self._waiting: list[LastVerdict] = []
        self._connect()

    def _connect(self) -> None:
        """Open the file, and become its writer if that is asked for; one that was never finished is begun again."""
        try:
            self._connect_once()
        except (DamagedError, StrangeError):
            if self.path is None or not self._write or not lock.is_unfinished(self.path):
                raise
            aside = put_aside(self.path, "unfinished")
            log.warning("fault memory begun again: its first write was cut off", file=str(self.path), aside=str(aside))
            self._connect_once()

    def _connect_once(self) -> None:
        path = self.path
        if path is not None and not self._write and not path.exists():
            raise InputError("there is no fault memory here", file=path)
        if path is not None and path.is_dir():
            raise InputError("this is a folder; name a file for the fault memory", file=path)
        if path is not None and path.exists():
            _refuse_foreign(path)
        try:
            if path is not None and self._write:
                self._become_writer(path)
            self._close_reader()
            self._db = self._connection(":memory:" if path is None else path)
        except (sqlite3.Error, OSError) as error:
            self._unlock()
            raise UnusableError(f"not usable as a fault memory: {error}", file=path) from error
        except InputError:
            self._unlock()
            raise
        try:
            self._open()
            if path is not None and self._write:
                self._reader = self._connection(f"{path.resolve().as_uri()}?mode=ro", uri=True)
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

    def _become_writer(self, path: Path) -> None:
        """Take the lock, and read what the files beside know; say beside a new file what it is going to be."""
        path.parent.mkdir(parents=True, exist_ok=True)
        if self._lock is None:
            self._lock = take_lock(path)
        self._was_kept = path.exists() and is_marked(path)
        self._known = last_links(path)
        self._notes = self._expected = 0
        if not path.exists() or not path.stat().st_size:
            self._expected = secrets.randbits(62) | 1
            lock.note(self._lock, self._notes, rollback.LastLink(self._expected, 0, bytes(32)))
            lock.sync(self._lock, path.resolve().parent)
            self._notes += 1

    def _connection(self, place: Path | str, **options: bool) -> sqlite3.Connection:
        return self._open_database(
            place,
            isolation_level=None,
            timeout=PATIENCE_S,
            check_same_thread=False,  # one thread at a time, but not always the same
            **options,
        )

    def _close_reader(self) -> None:
        """Close the connection that reads: the last one that is closed must be the one that writes."""
        with self._readings:
            reader, self._reader = self._reader, None
            if reader is not None:
                with suppress(sqlite3.Error):
                    reader.close()

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
        if version >= CHAINED:
            self._refuse_older(version)
        self._db.execute("PRAGMA journal_mode = WAL")
        self._db.execute("PRAGMA synchronous = FULL")
        self._db.execute(f"PRAGMA wal_autocheckpoint = {write_ahead.PAGES}")
        self._db.execute("PRAGMA foreign_keys = ON")
        if version < len(MIGRATIONS):
            self._migrate(version)
        # Processes that asked a writer that is gone have been told that nothing was done.
        self._db.execute("DELETE FROM request")
        self.generation, self._head = rollback.generation_of(self._db), chain.head(self._db)
        self._note_head()
        if self._expected and self._lock is not None and self.path is not None:
            lock.sync(self._lock, self.path.resolve().parent)  # it is a memory from now on

    def _refuse_older(self, version: int) -> None:
        """Refuse a file that went back; else find the verdicts that wait for it.

        Raises:
            OlderError: it did.
        """
        if missing := rollback.what_is_missing(self._db, self._known):
            broken = chain.verify(self._db).broken if version == len(MIGRATIONS) else []
            raise damage(self.path, broken[0]) if broken else OlderError(missing, file=self.path)
        if self.path is not None:  # a migration may write links: the verdicts came after the last one that is there now
            generation = rollback.generation_of(self._db)
            self._waiting = journal_file.waiting(self.path, chain.head(self._db).digest, generation)

    def _migrate(self, version: int) -> None:
        """Bring the file to the version of today, in one transaction; a new file is there at once."""
        self._db.executescript(
            f"BEGIN IMMEDIATE; PRAGMA application_id = {APPLICATION_ID};"
            f"{''.join(MIGRATIONS[version:])} PRAGMA user_version = {len(MIGRATIONS)};"
        )
        if version < CHAINED:
            chain.begin(self._db)
        if self._expected:
            self._db.execute("UPDATE generation SET id = ?", (self._expected,))
        self._db.execute("COMMIT")

    def _note_head(self) -> None:
        """Note the last link, which is on the disk, beside the file."""
        if self._lock is not None and self._head.number:
            lock.note(self._lock, self._notes, rollback.LastLink(self.generation, *self._head))
            self._notes += 1

    def refuse_damaged(self) -> None:
        """Refuse now what would otherwise fail, or be missed, later.

        Raises:
            DamagedError: the file is damaged.
        """
        with self._reading() as db:
            found = db.execute("PRAGMA integrity_check(1)").fetchone()[0]
            orphan = db.execute("PRAGMA foreign_key_check").fetchone()
        if found != "ok":
            raise damage(self.path, found)
        if orphan is not None:
            raise damage(self.path, f"a {orphan[0]} of a {orphan[2]} that is not there")

    def compact(self) -> None:
        """Check the file whole, and give back what it does not use.

        Raises:
            GatewayError: it is damaged, or cannot be written.
        """
        with self._alone():
            try:
                found = self._db.execute("PRAGMA integrity_check(1)").fetchone()[0]
                if found != "ok":
                    raise GatewayError(f"{self.path}: a damaged fault memory: {found}")
                self._db.execute("VACUUM")
            except sqlite3.Error as error:
                raise GatewayError(f"{self.path}: fault memory not compacted: {error}") from error

    def close(self) -> None:
        """Close the file, after the thread that writes has ended its write."""
        with self._turn:
            self._close_reader()
            self._db.close()
            self._unlock()

    def _unlock(self) -> None:
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    @property
    def _mine(self) -> bool:
        """Whether this thread writes."""
        return self._writing == threading.get_ident()

    @contextmanager
    def _alone(self) -> Iterator[None]:
        """Have the connection that writes for this thread alone.

        Raises:
            StoreError: another thread writes.
        """
        if self._writing and not self._mine:
            raise StoreError(self.path, "another thread writes it now", full=True)
        with self._turn:
            before, self._writing = self._writing, threading.get_ident()
            try:
                yield
            finally:
                self._writing = before

    @contextmanager
    def transaction(self) -> Iterator[None]:
        """One transaction, durable at its end; inside another one of this thread, a part of that.

        Raises:
            StoreError: it could not be written (disk full, file system gone), or another thread writes; nothing of it
                was.
        """
        with self._alone():
            nested = self._db.in_transaction
            if nested:
                yield
                return
            self._write_rows()
            self._next = self._head
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
            if self._next != self._head:
                self._head = self._next
                self._note_head()

    @contextmanager
    def reading(self) -> Iterator[None]:
        """Have all that is read within be of one commit.

        Raises:
            InputError: it cannot be read.
        """
        with self._reading():
            yield

    @contextmanager
    def _reading(self) -> Iterator[sqlite3.Connection]:
        """Give the connection that reads, within one transaction; in a transaction of this thread, the one that writes.

        Raises:
            DamagedError: it is damaged.
            InputError: it cannot be read.
        """
        apart = self._reader is not None and not self._mine
        with self._readings if apart else self._turn:
            db = self._reader if apart and self._reader is not None else self._db
            nested = db.in_transaction
            try:
                self._write_rows()
                if not nested:
                    db.execute("BEGIN")
                try:
                    yield db
                finally:
                    if not nested:
                        db.execute("ROLLBACK")
            except (sqlite3.Error, ValueError) as error:
                # Our statements are right for the schema: one that SQLite cannot make sense of means another schema.
                # An error without a code is the driver's: a text that is not UTF-8.
                other = getattr(error, "sqlite_errorcode", sqlite3.SQLITE_ERROR) == sqlite3.SQLITE_ERROR
                operational = isinstance(error, sqlite3.OperationalError) and not other
                if operational and _code(cast(sqlite3.Error, error)) not in _DAMAGE:
                    raise InputError(f"fault memory not readable: {error}", file=self.path) from error
                raise damage(self.path, error) from error

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
                self._next = chain.write(self._db, changes)
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
        if self.path is not None:
            return
        unwritten, self._unwritten = self._unwritten, Changes()
        unwritten.records, self._kept = list(self._kept.values()), {}
        if unwritten.faults or unwritten.facts:
            rows.write(self._db, unwritten)

    def take_waiting(self) -> list[LastVerdict]:
        """Return, once, the verdicts that waited when the file was opened for writing."""
        waiting, self._waiting = self._waiting, []
        return waiting

    def request(self, kind: str, argument: str) -> int:
        """Ask the writer for something; returns the request's id."""
        with self.transaction():
            cursor = self._db.execute("INSERT INTO request (kind, argument) VALUES (?, ?)", (kind, argument))
        return int(cursor.lastrowid or 0)

    def answer(self, request: int) -> int | None:
        """Return what the writer answered, None before it did."""
        with self._reading() as db:
            row = db.execute("SELECT done FROM request WHERE id = ?", (request,)).fetchone()
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
                with self._alone():
                    version = int(self._db.execute("PRAGMA data_version").fetchone()[0])
            except (sqlite3.Error, StoreError):  # errors are found at the next commit
                return False
            different = version != last
            last = version
            return different

        return changed


def last_links(path: Path) -> list[rollback.LastLink]:
    """Return the last links of a fault memory as the files beside it have them; to be read before the memory is."""
    found = [*lock.noted(path), *journal_file.links_beside(path)]
    return [*found, *lock.noted(path, beside_link=True)] if path.is_symlink() else found


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
        raise StrangeError("not usable as a fault memory: it is no SQLite file", file=path)

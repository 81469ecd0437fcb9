"""The fault memory's file under a gateway that must go on, even if the file is damaged or gone.

- It cannot be opened or written (disk full, read-only, I/O error): everything stays in this process, and the file is
  tried again when the memory saves next.
- It is damaged, or went back to an earlier state (:mod:`gateway.faults.rollback`): it is put aside with its date, its
  readable parts are recovered, and a new one is begun.
- It is deleted, or another one is put in its place, under the running gateway: likewise; all that this process knows
  goes into the new one, but nothing from the other file.
- It is cut off or overwritten in place, under the running gateway: likewise (see :mod:`gateway.faults.tamper_check`).
- It is another program's database: a daemon puts it aside and begins a new one; others refuse it.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

from gateway.faults import chain, journal_file, rows, write_ahead
from gateway.faults.file_identity import Place
from gateway.faults.interventions import Intervention
from gateway.faults.journal import Journal
from gateway.faults.lock import InUseError, is_in_place, is_marked, take_lock
from gateway.faults.outgoing import Outgoing
from gateway.faults.records import Changes, Cycle, Permanent, Record, Recording
from gateway.faults.rollback import LastLink
from gateway.faults.salvage import SUFFIXES, Salvage, salvage
from gateway.faults.schema import MIGRATIONS
from gateway.faults.store import (
    Connect,
    DamagedError,
    ForeignError,
    OlderError,
    Store,
    StoreError,
    UnusableError,
    damage,
)
from gateway.faults.store_incidents import Incident, StoreIncidents
from gateway.faults.vehicle import EcuDtc
from gateway.host.locks import mark_unsaved
from gateway.host.sockets import CAN
from gateway_fdi.common.log import get_logger
from gateway_fdi.errors import GatewayError, InputError

T = TypeVar("T")

log = get_logger(__name__)


class ResilientStore(Store):
    """A store that opens always, and that can begin a new file.

    Args:
        path, connect: see :class:`Store`; so is what it raises, but for a file that is damaged or cannot be written.
        displacing: whether another program's database at this place is put aside, not refused.

    Attributes:
        detached: why there is no file at present, "" if there is one.
        journal: of verdicts that are told before the file has them; None: there is none.
    """

    def __init__(self, path: Path | None, *, connect: Connect = sqlite3.connect, displacing: bool = False) -> None:
        self.detached = ""
        self.journal: Journal | None = None
        self._displacing = displacing
        self._place = Place()
        self._recorded = self._recordings_lost = 0
        self._suspect = False  # whether the file must be looked at before it is written again
        self._mishaps = StoreIncidents()
        self._recordings: list[Recording] = []  # of a file that is gone, for the next one
        self._events: list[Outgoing] = []  # likewise, of the fleet's queue
        self._unsaved = False
        self._unread = False  # whether there is a file that could not be read when this began
        gone = path is not None and not path.exists() and is_marked(path)
        try:
            super().__init__(path, connect=connect)
            self._read_all()
            if gone:
                self._mishaps.deleted()
        except DamagedError as error:
            assert path is not None
            self._begin_with(path, error)
        except UnusableError as error:
            assert path is not None
            found = salvage(path) if path.exists() else Salvage()
            self._unread = path.exists() and found.lost > 0
            self._detach(error.message, found)
            self._waiting = journal_file.waiting(path, found.head, found.generation)
        self._note_place()

    # Reading: a running gateway replaces a damaged file by a new one with all that it knows

    def load(self) -> list[Record]:
        """Return all records (see :meth:`Store.load`)."""
        return self._or_nothing(super().load, [])

    def cycles(self) -> dict[str, Cycle]:
        """Return the last operation cycle of each name."""
        return self._or_nothing(super().cycles, {})

    def permanent(self) -> list[Permanent]:
        """Return the permanent DTCs, the oldest first."""
        return self._or_nothing(super().permanent, [])

    def identifiers(self) -> dict[int, bytes]:
        """Return the values that testers wrote, by data identifier."""
        return self._or_nothing(super().identifiers, {})

    def interventions(self) -> list[Intervention]:
        """Return what testers did, the oldest first."""
        return self._or_nothing(super().interventions, [])

    def ecu_dtcs(self) -> list[EcuDtc]:
        """Return the DTCs of other ECUs."""
        return self._or_nothing(super().ecu_dtcs, [])

    def facts(self) -> dict[str, int]:
        """Return numbers by name."""
        return self._or_nothing(super().facts, {})

    def _or_nothing(self, read: Callable[[], T], nothing: T) -> T:
        try:
            return read()
        except InputError:
            self._suspect = True
            return nothing

    # Mishaps

    @property
    def happened(self) -> bool:
        """Whether :meth:`incidents` has something to tell."""
        return bool(self._mishaps)

    def incidents(self) -> list[Incident]:
        """Return what happened to the file since the last call."""
        return self._mishaps.take()

    def look(self) -> bool:
        """Look whether the file is still there; returns False if all has to be written into another."""
        if self.path is not None and not self.detached and not self._place.is_in_place(self.path):
            self._suspect = True
        return not self._suspect

    @property
    def doubtful(self) -> bool:
        """Whether another process has touched the file or its log since the last write: :meth:`examine` says more."""
        return self._place.doubtful

    def examine(self) -> bool:
        """If in doubt, look thoroughly whether the file is as written; no other thread uses this store meanwhile.

        Returns:
            False if all has to be written into another.
        """
        if not self._suspect and self.doubtful and self.look():
            self._suspect = not self._place.examine(self._head)
        return not self._suspect

    @property
    def log_is_due(self) -> bool:
        """Whether :meth:`tend_log` has something to do."""
        due = self._logged >= write_ahead.MANY or self.doubtful
        return self.path is not None and due and not (self.detached or self._suspect)

    def tend_log(self) -> None:
        """Spare commits the care of the file's log; no other thread uses this store meanwhile."""
        with self._alone():
            self._logged = 0
            if self.path is not None and self.look() and self.examine():
                with suppress(sqlite3.Error, OSError):  # errors are found at the next commit
                    write_ahead.lengthen(self._db, self.path.resolve(), self._place.log)
                self._copy_log()

    def _copy_log(self) -> None:
        """Copy the log into the file, which no other process has touched."""
        self._logged = 0
        with suppress(sqlite3.Error):
            write_ahead.copy(self._db)
        self._place.note_checkpoint()

    def compact(self) -> None:
        """Check the file whole, and give back what it does not use (see :meth:`Store.compact`)."""
        if not self.examine():
            raise GatewayError(f"{self.path}: fault memory not compacted: {self._place.what_changed}")
        with self._alone():
            super().compact()
            self._copy_log()

    # The journal

    def _note_head(self) -> None:
        super()._note_head()
        if self.journal is not None:
            self.journal.note(LastLink(self.generation, *self._head))

    def begin_journal(self) -> None:
        """Begin the journal, if there is none, and the system can have one."""
        if self.journal is not None or self.path is None or not CAN:
            return
        try:
            self.journal = Journal(self.path, self.generation)
        except OSError as error:
            self._say_without(error.strerror or str(error))

    def _say_without(self, reason: str) -> None:
        log.warning("no journal: verdicts are told when the fault memory has them", file=str(self.path), reason=reason)

    def arm_journal(self, settled: bool) -> bool:
        """Let the journal take verdicts, or not; returns whether it does.

        Args:
            settled: whether the file has all there is, and no write is under way.
        """
        if self.journal is None:
            return False
        armed = settled and not (self.detached or self._suspect)
        return self.journal.arm(self._head.digest if armed else b"", self._head.number, self.generation)

    def withdraw(self, number: int) -> bool:
        """Return whether the journal has sent the frame of a verdict; if not, it never will."""
        return self.journal is not None and self.journal.withdraw(number)

    def settle_journal(self) -> None:
        """Have the journal send none of the frames that wait there: a socket is to be closed."""
        if self.journal is not None:
            self.journal.settle()

    def look_at_journal(self) -> None:
        """Look whether the journal does its work, and do without it if not."""
        if self.journal is not None and (reason := self.journal.look()):
            self._say_without(reason)

    def note_unsaved(self, unsaved: bool) -> None:
        """Let other processes see whether this one has changes that the file does not have."""
        if unsaved != self._unsaved and self._lock is not None:
            self._unsaved = unsaved
            mark_unsaved(self._lock, unsaved)

    # Writing

    def save(self, changes: Changes, whole: Callable[[], Changes] | None = None) -> None:
        """Write changes (see :meth:`Store.save`); if the file is damaged or gone, all there is into a new one."""
        if self.path is None:
            super().save(changes)
            return
        with self._alone():
            self._save(self.path, changes, whole)

    def _save(self, path: Path, changes: Changes, whole: Callable[[], Changes] | None) -> None:
        nested = self._db.in_transaction
        if nested and self._place.file_is_doubtful:
            raise StoreError(path, "its file may have been changed in place")  # the next commit looks
        if not nested:
            self.examine()
        if whole is not None and (self.detached or self._suspect):
            self._restore(path, whole())
            return
        self._refuse_overwritten(path)
        try:
            super().save(changes)
        except StoreError as error:
            self._suspect = not error.full
            raise
        if nested:
            return
        self._count_recordings(changes)
        if not self._place.is_same:
            self.examine()
            if whole is not None and (any(self._place.overwritten) or not self._place.is_in_place(path)):
                self._restore(path, whole())  # written, but into a file that no reader will find
                return
            self._refuse_overwritten(path)
        if self._logged >= write_ahead.PAGES:
            self._copy_log()

    def _refuse_overwritten(self, path: Path) -> None:
        """Refuse to write, or to say that it is written, into a file that another process has changed.

        Raises:
            StoreError: it is such a file.
        """
        if any(self._place.overwritten):
            raise StoreError(path, self._place.what_changed)

    def _count_recordings(self, changes: Changes | None = None) -> None:
        if changes is None or changes.recordings or not all(record.occurrence for record in changes.records):
            with suppress(InputError):
                self._recorded = sum(self.recorded().values())

    @contextmanager
    def transaction(self) -> Iterator[None]:
        """One transaction, durable at its end (see :meth:`Store.transaction`); the log is noted as this one left it."""
        with self._alone():
            # A commit must not hide a change of the log by another process.
            ours = self._place.watched and not self._db.in_transaction and self._place.log_is_same
            with super().transaction():
                yield
            if ours:
                self._place.note_commit()

    def close(self) -> None:
        """Close the file."""
        if self.journal is not None:
            self.journal.close()
            self.journal = None
        if not self.examine():
            self._place.keep_from_copying()
        super().close()
        self._place.end()

    def _restore(self, path: Path, everything: Changes) -> None:
        """Open the file again, or a new one, and write all there is."""
        self._suspect = True
        if not self.detached:
            self._leave(path)
        try:
            fresh = self._make_way(path)
            if self._lock is not None and not is_in_place(path, self._lock):
                lock = take_lock(path)
                self._unlock()
                self._lock = lock
                mark_unsaved(lock, self._unsaved)
            fresh |= self._reopen(path)
            self.detached = ""
            self._note_place()
            if fresh:
                everything = replace(
                    everything,
                    recordings=[*self._recordings, *everything.recordings],
                    outgoing=[*self._events, *everything.outgoing],
                    outgoing_bytes=max(everything.outgoing_bytes, sum(len(event.body) for event in self._events)),
                    kept_recordings=max(everything.kept_recordings, _most_of_one(self._recordings)),
                )
            Store.save(self, everything)
        except (InputError, OSError) as error:
            reason = error.message if isinstance(error, InputError) else str(error)
            if not self.detached:
                self._detach(reason, Salvage())
            self.detached = reason
            raise StoreError(path, reason) from error
        self._suspect = False
        self._recordings, self._events = [], []
        self._count_recordings()

    def _leave(self, path: Path) -> None:
        """Give up a file that is damaged, gone, or replaced; its recordings are kept for the next one."""
        with suppress(InputError):
            self._recordings = self._own_recordings() if any(self._place.overwritten) else self.recordings()
            self._events = [] if any(self._place.overwritten) else self.outgoing()
        self._recordings_lost = max(self._recorded - len(self._recordings), 0)
        self._place.keep_from_copying()
        self._close_reader()
        with suppress(sqlite3.Error):
            self._db.close()
        self._place.end()
        if not path.exists():
            self._mishaps.deleted()

    def _own_recordings(self) -> list[Recording]:
        """Return the recordings of a file that was changed in place, as far as they are what was written.

        Raises:
            InputError: it cannot be read.
        """
        verdict = self.verify()
        if verdict.head != self._head:
            return []
        changed = {broken.subject for broken in verdict.broken}
        return [recording for recording in self.recordings() if recording.fault not in changed]

    def _make_way(self, path: Path) -> bool:
        """Make way for our own file under the path; returns whether it will be a new one.

        Raises:
            OSError: the file that stands there cannot be put aside.
        """
        if not path.exists():
            # Else SQLite would find the log of a file that is no more.
            for suffix in SUFFIXES:
                Path(f"{path}{suffix}").unlink(missing_ok=True)
            return True
        if self._unread:
            self._mishaps.unread(path)
        elif self._place.is_taken(path):
            if self._place.has_own_log(path):  # our own, of a file that is no more
                for suffix in SUFFIXES[1:]:
                    Path(f"{path}{suffix}").unlink(missing_ok=True)
            self._mishaps.replaced(path)
        elif any(self._place.overwritten):
            kept, lost, apart = len(self._recordings), self._recordings_lost, bool(self._place.overwritten[0])
            self._mishaps.overwritten(path, self._place.what_changed, kept, lost, apart=apart)
        else:
            return False
        self._unread = False
        return True

    def _reopen(self, path: Path) -> bool:
        """Connect to the file; returns whether it is a new one."""
        try:
            self._connect()
        except DamagedError as error:
            found = salvage(path)
            self._mishaps.damaged(path, error, found)
            self._recordings, self._events = self._recordings or found.recordings, self._events or found.outgoing
            self._connect()
            return True
        return False

    def _connect(self) -> None:
        lock, database = self._lock, self._db
        self._place.end()
        self._place.overwritten = ("", "")
        try:
            super()._connect()
            if self.path is not None:
                self._db.execute("PRAGMA wal_autocheckpoint = 0")  # see :meth:`_copy_log`
        except ForeignError as error:
            if not self._displacing or self.path is None:
                raise
            self._mishaps.foreign(self.path, error)
            self._connect()
        except InputError as error:
            self._db = database  # that of this process, if there is no file: it is read still
            if not isinstance(error, DamagedError | UnusableError):
                raise
            # The right to write is kept: no other process may begin meanwhile.
            if lock is not None and self._lock is None and self.path is not None:
                with suppress(InUseError, OSError):
                    self._lock = take_lock(self.path)
                    mark_unsaved(self._lock, self._unsaved)
            raise

    # Beginning without, or with another file

    def _read_all(self) -> None:
        """Find what is damaged but not seen by SQLite: rows that make no sense, or that the chain does not know.

        Raises:
            DamagedError: something is.
        """
        for read in (super().load, super().cycles, super().permanent, super().identifiers, super().interventions):
            read()
        super().facts()
        super().ecu_dtcs()
        broken = self.verify().broken
        if broken:
            raise damage(self.path, broken[0])

    def _begin_with(self, path: Path, damage: DamagedError) -> None:
        """Begin a new file with what can be read of a damaged one."""
        self.close()
        found = salvage(path)
        try:
            self._mishaps.damaged(path, damage, found)
            super().__init__(path, connect=self._open_database)
            if not isinstance(damage, OlderError):  # else they were told in a time that is not that of the file
                self._waiting = journal_file.waiting(path, found.head, found.generation)
            Store.save(self, found.changes())
        except UnusableError as error:
            self._unread = found.lost > 0
            self._detach(error.message, found)
        except StoreError as error:
            self._detach(error.reason, found)

    def _detach(self, reason: str, found: Salvage) -> None:
        """Keep everything in this process until the file can be written."""
        self._close_reader()
        with suppress(sqlite3.Error):
            self._db.close()
        self._place.end()
        self._db = sqlite3.connect(":memory:", isolation_level=None, check_same_thread=False)
        for script in MIGRATIONS:
            self._db.executescript(script)
        with self.transaction():
            rows.write(self._db, found.changes())
        self._recordings, self._events = self._recordings or found.recordings, self._events or found.outgoing
        self.detached, self._suspect = reason, True

    # Where the file is

    def _note_place(self) -> None:
        if self.path is not None and not self.detached:
            self._logged = write_ahead.MANY
            with suppress(sqlite3.Error):
                self._head = chain.head(self._db)
            self._place.begin(self.path)
            self._count_recordings()


def _most_of_one(recordings: list[Recording]) -> int:
    faults = [recording.fault for recording in recordings]
    return max([faults.count(fault) for fault in set(faults)], default=1)

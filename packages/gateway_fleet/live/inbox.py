"""The collector's inbox: what has come and is not in the tables yet, and which ids have come at all.

A file of SQLite, written before a batch is answered. Ids of a car come in order, but for those that it had to give up.
So it suffices to keep, of each file of its memory, up to which number nothing comes any more, and the later ones that
have come. An event that is sent again, a week later too, is known.
"""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from gateway.runtime.contract import wrong
from gateway_fdi.errors import InputError
from gateway_fleet.live.batch import Batch, Sent

#: "GWFI": marks the file as an inbox; version of its tables.
APPLICATION_ID, VERSION = 0x47574649, 1
#: Refused batches and events that are kept, and characters of one.
MOST_REFUSED, LONGEST = 1000, 2000

_TABLES = """
CREATE TABLE event (
    seq INTEGER PRIMARY KEY AUTOINCREMENT, car TEXT NOT NULL, model TEXT NOT NULL, software TEXT NOT NULL,
    origin TEXT NOT NULL, number INTEGER NOT NULL, limits INTEGER NOT NULL, received_ns INTEGER NOT NULL,
    body TEXT NOT NULL
);
CREATE INDEX event_of_car ON event (car);
CREATE TABLE seen (
    car TEXT NOT NULL, origin TEXT NOT NULL, upto INTEGER NOT NULL, later TEXT NOT NULL, PRIMARY KEY (car, origin)
) WITHOUT ROWID;
CREATE TABLE car (
    car TEXT PRIMARY KEY, model TEXT NOT NULL, software TEXT NOT NULL, latest_ns INTEGER NOT NULL,
    events INTEGER NOT NULL, again INTEGER NOT NULL, dropped INTEGER NOT NULL
) WITHOUT ROWID;
CREATE TABLE forgotten (car TEXT PRIMARY KEY, t_ns INTEGER NOT NULL) WITHOUT ROWID;
CREATE TABLE refused (
    seq INTEGER PRIMARY KEY, t_ns INTEGER NOT NULL, car TEXT NOT NULL, reason TEXT NOT NULL, body TEXT NOT NULL
);
CREATE TABLE export (first INTEGER PRIMARY KEY, last INTEGER NOT NULL, hour TEXT NOT NULL);
CREATE TABLE total (name TEXT PRIMARY KEY, value INTEGER NOT NULL) WITHOUT ROWID;
"""  # fmt: skip


@dataclass
class Kept:
    """Outcome of batches.

    Attributes:
        new, again: events that were kept, and that were there already.
        refused: events that are none of the contract.
        forgotten: events of cars whose data were to go.
    """

    new: int = 0
    again: int = 0
    refused: int = 0
    forgotten: int = 0


@dataclass
class _Seen:
    """Ids of one file of a car's memory: nothing comes any more up to a number, and what has come beyond."""

    upto: int = 0
    later: set[int] = field(default_factory=set)

    def is_new(self, number: int) -> bool:
        """Return whether an id has not come before, and note it."""
        if number <= self.upto or number in self.later:
            return False
        self.later.add(number)
        return True

    def settle(self, first: int) -> None:
        """Note that nothing before a number comes any more."""
        self.upto = max(self.upto, first - 1)
        while self.upto + 1 in self.later:
            self.upto += 1
        self.later = {number for number in self.later if number > self.upto}


@dataclass(frozen=True)
class Row:
    """An event that was kept; attributes as of the table."""

    seq: int
    car: str
    model: str
    software: str
    origin: str
    number: int
    limits: int
    received_ns: int
    body: str


class Inbox:
    """The inbox of a collector.

    Args:
        path: of its file, made when missing.

    Raises:
        InputError: it is another program's file, or cannot be opened.
    """

    def __init__(self, path: Path) -> None:
        try:
            self._db = sqlite3.connect(path, isolation_level=None, timeout=10.0, check_same_thread=False)
            (stamp,) = self._db.execute("PRAGMA application_id").fetchone()
            (tables,) = self._db.execute("SELECT count(*) FROM sqlite_schema").fetchone()
            (version,) = self._db.execute("PRAGMA user_version").fetchone()
            if (tables and stamp != APPLICATION_ID) or version > VERSION:
                raise InputError("no inbox of a collector that this version knows", file=path)
            self._db.execute("PRAGMA journal_mode = WAL")
            self._db.execute("PRAGMA synchronous = FULL")
            self._db.execute("PRAGMA secure_delete = ON")
            if not tables:
                with self.transaction():
                    for statement in filter(str.strip, _TABLES.split(";\n")):
                        self._db.execute(statement)
                    self._db.execute(f"PRAGMA application_id = {APPLICATION_ID}")
                    self._db.execute(f"PRAGMA user_version = {VERSION}")
        except sqlite3.Error as error:
            raise InputError(f"not usable as an inbox: {error}", file=path) from error

    def close(self) -> None:
        """Close the file."""
        self._db.close()

    @contextmanager
    def transaction(self) -> Iterator[None]:
        """One transaction, durable at its end; nothing of it is where it fails."""
        self._db.execute("BEGIN IMMEDIATE")
        try:
            yield
            self._db.execute("COMMIT")
        except BaseException:
            self._db.execute("ROLLBACK")
            raise

    # Taking

    def take(self, batches: Sequence[Batch], t_ns: int) -> Kept:
        """Keep the events of batches, each once; on return they are on the disk."""
        kept = Kept()
        with self.transaction():
            for batch in batches:
                self._take_one(batch, t_ns, kept)
        return kept

    def _take_one(self, batch: Batch, t_ns: int, kept: Kept) -> None:
        if self._db.execute("SELECT 1 FROM forgotten WHERE car = ?", (batch.car,)).fetchone():
            kept.forgotten += len(batch.events)  # they are answered: the car need not keep them either
            self._add("forgotten", len(batch.events))
            return
        seen: dict[str, _Seen] = {}
        new, again = list[Sent](), 0
        for sent in batch.events:
            of = self._seen(batch.car, sent.id.origin, seen)
            if not of.is_new(sent.id.number):
                again += 1
            elif reason := wrong(sent.event):
                self.refuse(reason, batch.car, sent.body, t_ns)
                kept.refused += 1
            else:
                new.append(sent)
        if batch.first is not None:
            self._seen(batch.car, batch.first.origin, seen).settle(batch.first.number)
        self._db.executemany(
            "INSERT INTO event (car, model, software, origin, number, limits, received_ns, body)"
            " VALUES (?, ?, ?, ?, ?, ?, ?, ?)",
            [(batch.car, batch.model, batch.software, *sent.id, sent.limits, t_ns, sent.body) for sent in new],
        )
        self._db.executemany(
            "INSERT OR REPLACE INTO seen VALUES (?, ?, ?, ?)",
            [(batch.car, origin, of.upto, json.dumps(sorted(of.later))) for origin, of in seen.items()],
        )
        self._db.execute(
            "INSERT INTO car VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7) ON CONFLICT (car) DO UPDATE SET model = ?2,"
            " software = ?3, latest_ns = ?4, events = events + ?5, again = again + ?6, dropped = max(dropped, ?7)",
            (batch.car, batch.model, batch.software, t_ns, len(new), again, batch.dropped),
        )
        kept.new += len(new)
        kept.again += again

    def _seen(self, car: str, origin: str, known: dict[str, _Seen]) -> _Seen:
        if origin not in known:
            select = "SELECT upto, later FROM seen WHERE car = ? AND origin = ?"
            row = self._db.execute(select, (car, origin)).fetchone()
            known[origin] = _Seen() if row is None else _Seen(row[0], set(json.loads(row[1])))
        return known[origin]

    def refuse(self, reason: str, car: str, body: str, t_ns: int) -> None:
        """Keep what was refused, of the last ones; all are counted."""
        self._db.execute(
            "INSERT INTO refused (t_ns, car, reason, body) VALUES (?, ?, ?, ?)", (t_ns, car, reason, body[:LONGEST])
        )
        self._db.execute("DELETE FROM refused WHERE seq <= (SELECT max(seq) FROM refused) - ?", (MOST_REFUSED,))
        self._add("refused", 1)

    def _add(self, name: str, more: int) -> None:
        self._db.execute(
            "INSERT INTO total VALUES (?1, ?2) ON CONFLICT (name) DO UPDATE SET value = value + ?2", (name, more)
        )

    # Into the tables

    def plan(self, hour: str) -> None:
        """Say which events go into the tables next: all that are there."""
        with self.transaction():
            first, last = self._db.execute("SELECT min(seq), max(seq) FROM event").fetchone()
            if first is not None:
                self._db.execute("INSERT INTO export VALUES (?, ?, ?)", (first, last, hour))

    def planned(self) -> tuple[int, int, str] | None:
        """Return first and last event that go into the tables, and the hour; None: none do."""
        row = self._db.execute("SELECT first, last, hour FROM export").fetchone()
        return None if row is None else (row[0], row[1], row[2])

    def rows(self, first: int, last: int) -> list[Row]:
        """Return events, in order."""
        found = self._db.execute("SELECT * FROM event WHERE seq BETWEEN ? AND ? ORDER BY seq", (first, last))
        return [Row(*row) for row in found]

    def done(self, first: int, last: int) -> None:
        """Let events go that are in the tables."""
        with self.transaction():
            self._db.execute("DELETE FROM event WHERE seq BETWEEN ? AND ?", (first, last))
            self._db.execute("DELETE FROM export")

    # Facts

    def totals(self) -> dict[str, int]:
        """Return counts by name: events, again, dropped, cars, refused, forgotten, waiting."""
        row = self._db.execute("SELECT count(*), total(events), total(again), total(dropped) FROM car").fetchone()
        found = dict(zip(("cars", "events", "again", "dropped"), map(int, row), strict=True))
        found |= {"refused": 0, "forgotten": 0} | dict(self._db.execute("SELECT name, value FROM total"))
        (found["waiting"],) = self._db.execute("SELECT count(*) FROM event").fetchone()
        return found

    def forget(self, car: str, t_ns: int) -> int:
        """Forget a car: its events, its ids, itself; later ones are not kept. Returns how many events went."""
        with self.transaction():
            gone = self._db.execute("DELETE FROM event WHERE car = ?", (car,)).rowcount
            for table in ("seen", "car", "refused"):
                self._db.execute(f"DELETE FROM {table} WHERE car = ?", (car,))  # noqa: S608 - our own names
            self._db.execute("INSERT OR REPLACE INTO forgotten VALUES (?, ?)", (car, t_ns))
        self._db.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        return int(gone)

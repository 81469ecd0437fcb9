"""Events on their way to the fleet: a queue in the fault memory's file, of a bounded number of bytes.

An event is written in the commit of what it tells, and stays until it is said to have arrived. Each has an id that no
other one of any car has: the number that the file was born with (:mod:`gateway.faults.rollback`), and a count. It keeps
the id where a damaged file is given up for a new one. Where the bytes do not suffice, the oldest details go first, then
the oldest of all; what goes is counted.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterable, Sequence
from typing import NamedTuple


class Outgoing(NamedTuple):
    """An event that waits.

    Attributes:
        t_ns: when it was, of the wall clock [ns].
        detail: whether it goes before others where there is no room: it tells of one thing more than others do.
        limits: serial number of the campaign whose limits judged, 0: the configuration's own.
        body: the event, as JSON.
        id: that it has in all the world; "": it gets one when it is written.
        number: of its row; 0: it has none yet.
    """

    t_ns: int
    detail: bool
    limits: int
    body: str
    id: str = ""
    number: int = 0


class Tally(NamedTuple):
    """Counts of a queue since its file was begun.

    Attributes:
        last: events written.
        bytes: of those that wait.
        dropped, dropped_bytes: of those that went without having arrived.
    """

    last: int
    bytes: int
    dropped: int
    dropped_bytes: int


#: Share of the bytes that is filled again where events go that cannot be written: else each next one looks at all.
SPARE = 0.9
SELECT = "SELECT t_ns, detail, limits, body, id, number FROM outgoing"
_ADD = "INSERT INTO outgoing (t_ns, detail, limits, body, id, number) VALUES (?, ?, ?, ?, ?, ?)"


def read(*row: object) -> Outgoing:
    """Return a row of the queue.

    Raises:
        ValueError: it makes no sense.
    """
    t_ns, detail, limits, body, key, number = row
    if not (isinstance(body, str) and isinstance(key, str) and key):
        raise ValueError(row)
    if not (isinstance(t_ns, int) and isinstance(detail, int) and isinstance(limits, int) and isinstance(number, int)):
        raise ValueError(row)
    return Outgoing(t_ns, bool(detail), limits, body, key, number)


def tally(db: sqlite3.Connection) -> Tally:
    """Return the counts of a file's queue."""
    return Tally(*db.execute("SELECT last, bytes, dropped, dropped_bytes FROM outgoing_tally").fetchone())


def write(db: sqlite3.Connection, new: Sequence[Outgoing], arrived: Iterable[int], most: int, dropped: Tally) -> None:
    """Add events, take those away that have arrived, and keep to the bytes, within a transaction.

    Args:
        db: the file.
        new: events.
        arrived: numbers of rows.
        most: bytes that may wait.
        dropped: of events that never came to be written.
    """
    count = tally(db)
    (origin,) = db.execute("SELECT id FROM generation").fetchone()
    last, size = count.last, count.bytes
    for event in new:
        last += 1  # no number is given again
        db.execute(_ADD, (*event[:4], event.id or f"{origin:x}-{last}", last))
        size += len(event.body)
    for number in arrived:
        for (gone,) in db.execute("DELETE FROM outgoing WHERE number = ? RETURNING length(body)", (number,)).fetchall():
            size -= gone
    lost, before = dropped.dropped, size
    if size > most:
        order = db.execute("SELECT number, length(body) FROM outgoing ORDER BY detail DESC, number")
        given_up = []
        while size > most and (row := order.fetchone()) is not None:
            given_up.append(row[:1])
            size -= row[1]
        db.executemany("DELETE FROM outgoing WHERE number = ?", given_up)
        lost += len(given_up)
    found = (last, size, count.dropped + lost, count.dropped_bytes + before - size + dropped.dropped_bytes)
    db.execute("UPDATE outgoing_tally SET last = ?, bytes = ?, dropped = ?, dropped_bytes = ?", found)


def fitting(events: Sequence[Outgoing], most: int) -> tuple[list[Outgoing], Tally]:
    """Return those of events that cannot be written now for which there is room, with some to spare, and what goes."""
    size = sum(len(event.body) for event in events)
    gone: set[int] = set()
    before = size
    for place in sorted(range(len(events)), key=lambda k: (not events[k].detail, k)):
        if size <= SPARE * most:
            break
        gone.add(place)
        size -= len(events[place].body)
    left = [event for place, event in enumerate(events) if place not in gone]
    return left, Tally(0, size, len(gone), before - size)

"""Tables of the fault memory's file, and how a file comes from one version to the next.

A script that is there is never changed: files were made by it, and the chain names the columns of its version
(:mod:`gateway.faults.chain`). A new column or table is a new script.
"""

from __future__ import annotations

import sqlite3
from contextlib import closing
from functools import cache

#: First bytes of each SQLite file.
MAGIC = b"SQLite format 3\0"
#: "GWFM": marks the file as a fault memory.
APPLICATION_ID = 0x4757464D

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

# Healing, aging and the order of failures; several operation cycles; permanent DTCs; recorded frames; values that
# testers wrote. The contents of a file of version 1 are kept: the order of its failures is that of their times.
_SECOND = """
ALTER TABLE fault ADD COLUMN passed_cycles INTEGER NOT NULL DEFAULT 0;
ALTER TABLE fault ADD COLUMN aged_cycles INTEGER NOT NULL DEFAULT 0;
ALTER TABLE fault ADD COLUMN inputs TEXT NOT NULL DEFAULT '{}';
ALTER TABLE fault ADD COLUMN peak_fdc INTEGER NOT NULL DEFAULT 0;
ALTER TABLE fault ADD COLUMN near_misses INTEGER NOT NULL DEFAULT 0;
ALTER TABLE fault ADD COLUMN first_failed INTEGER;
ALTER TABLE fault ADD COLUMN last_failed INTEGER;
ALTER TABLE fault ADD COLUMN first_confirmed INTEGER;
ALTER TABLE fault ADD COLUMN last_confirmed INTEGER;
UPDATE fault SET
    first_failed = (SELECT count(*) FROM fault AS f WHERE f.first_ns < fault.first_ns) + 1,
    last_failed = (SELECT count(*) FROM fault AS f WHERE f.last_ns < fault.last_ns) + 1
    WHERE occurrence > 0;
UPDATE fault SET first_confirmed = first_failed, last_confirmed = last_failed WHERE status & 8;
CREATE TABLE operation_cycle (
    name TEXT PRIMARY KEY, number INTEGER NOT NULL, open INTEGER NOT NULL, t_ns INTEGER NOT NULL
);
INSERT INTO operation_cycle SELECT 'power', number, open, t_ns FROM cycle;
DROP TABLE cycle;
CREATE TABLE permanent (fault TEXT PRIMARY KEY, dtc INTEGER NOT NULL, t_ns INTEGER NOT NULL);
CREATE TABLE recording (
    id INTEGER PRIMARY KEY,
    fault TEXT NOT NULL,
    t_ns INTEGER NOT NULL,
    frames INTEGER NOT NULL,
    dropped INTEGER NOT NULL,
    log BLOB NOT NULL
);
CREATE INDEX recording_of_fault ON recording (fault, id);
CREATE TABLE identifier (did INTEGER PRIMARY KEY, data BLOB NOT NULL);
CREATE TABLE fact (name TEXT PRIMARY KEY, value INTEGER NOT NULL);
"""

# How the buses of the daemon do, for other processes.
_THIRD = """
CREATE TABLE bus (
    name TEXT PRIMARY KEY, uri TEXT NOT NULL, state TEXT NOT NULL, t_ns INTEGER NOT NULL, counters TEXT NOT NULL
);
"""

# Names of the faults, how severe they are, what to do: for readers without the configuration.
_FOURTH = """
CREATE TABLE catalogue (
    fault TEXT PRIMARY KEY, description TEXT NOT NULL, severity INTEGER NOT NULL, remedy TEXT NOT NULL
);
"""

# Interventions of testers: who, what, when, and with which outcome.
_FIFTH = """
CREATE TABLE intervention (
    number INTEGER PRIMARY KEY,
    first_ns INTEGER NOT NULL,
    t_ns INTEGER NOT NULL,
    count INTEGER NOT NULL,
    protocol TEXT NOT NULL,
    bus TEXT NOT NULL,
    address INTEGER NOT NULL,
    session INTEGER NOT NULL,
    security INTEGER NOT NULL,
    role TEXT NOT NULL,
    action TEXT NOT NULL,
    request BLOB NOT NULL,
    outcome INTEGER NOT NULL
);
"""

# All that was written, link by link (see gateway/faults/chain.py, which begins the chain with the rows there are).
_SIXTH = """
CREATE TABLE link (
    number INTEGER PRIMARY KEY,
    kind TEXT NOT NULL,
    subject TEXT NOT NULL,
    content BLOB NOT NULL,
    digest BLOB NOT NULL
);
"""

# Explanation of an entry, and whether its confirmation waits for that. A table of its own: the rows of faults, which
# the chain has digests of, stay as they were written.
_SEVENTH = """
CREATE TABLE cause (fault TEXT PRIMARY KEY REFERENCES fault (id), hold TEXT NOT NULL, content TEXT NOT NULL);
"""

# DTCs of other ECUs, as these tell them. They are copies, and not links of the chain.
_EIGHTH = """
CREATE TABLE ecu_dtc (
    ecu TEXT NOT NULL,
    dtc TEXT NOT NULL,
    status INTEGER NOT NULL,
    there INTEGER NOT NULL,
    came INTEGER NOT NULL,
    first_ns INTEGER NOT NULL,
    last_ns INTEGER NOT NULL,
    went_ns INTEGER,
    snapshots TEXT NOT NULL,
    PRIMARY KEY (ecu, dtc)
);
"""

# A number that no other file has, beside the file too: one that was put in its place shows
# (gateway/faults/rollback.py). And the version that a link's digests are of.
_NINTH = """
CREATE TABLE generation (id INTEGER NOT NULL);
INSERT INTO generation SELECT (random() & 0x3FFFFFFFFFFFFFFF) | 1;
ALTER TABLE link ADD COLUMN version INTEGER NOT NULL DEFAULT 8;
"""

# Events on their way to the fleet, and how many there were. They are copies, and not links of the chain.
_TENTH = """
CREATE TABLE outgoing (
    number INTEGER PRIMARY KEY,
    id TEXT NOT NULL,
    t_ns INTEGER NOT NULL,
    detail INTEGER NOT NULL,
    limits INTEGER NOT NULL,
    body TEXT NOT NULL
);
CREATE INDEX outgoing_detail ON outgoing (detail DESC, number);
CREATE TABLE outgoing_tally (
    last INTEGER NOT NULL, bytes INTEGER NOT NULL, dropped INTEGER NOT NULL, dropped_bytes INTEGER NOT NULL
);
INSERT INTO outgoing_tally VALUES (0, 0, 0, 0);
"""

#: Scripts that bring a file from version k to k + 1.
MIGRATIONS = (_FIRST, _SECOND, _THIRD, _FOURTH, _FIFTH, _SIXTH, _SEVENTH, _EIGHTH, _NINTH, _TENTH)
#: First version that has a chain.
CHAINED = 6


@cache
def columns_of(scripts: tuple[str, ...]) -> dict[str, tuple[str, ...]]:
    """Return the columns of each table, in their order, as these scripts make them."""
    with closing(sqlite3.connect(":memory:")) as db:
        db.executescript("".join(scripts))
        tables = db.execute("SELECT name FROM sqlite_schema WHERE type = 'table'").fetchall()
        return {
            table: tuple(name for (name,) in db.execute("SELECT name FROM pragma_table_info(?)", (table,)))
            for (table,) in tables
        }

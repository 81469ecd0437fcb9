"""Tables of the fault memory's file, and how a file comes from one version to the next."""

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

#: Scripts that bring a file from version k to k + 1.
MIGRATIONS = (_FIRST,)

"""The write-ahead log of the fault memory's file, kept so that a commit costs one write into blocks that are there.

A log that grows needs new blocks and a new size, which the file system puts down with each commit, and SQLite itself
copies the log into the database within the commit that makes it long. Both are done here instead, between commits: the
log gets its whole length once, and it is copied (a checkpoint) when no commit waits. Zeros after the written frames
mean nothing to SQLite: it reads frames as far as salts and checksums go on (https://www.sqlite.org/walformat.html).
"""

from __future__ import annotations

import os
import shutil
import sqlite3
from pathlib import Path

from gateway.host.process import RAW

#: Length that the log gets, in pages of :data:`PAGE` bytes; SQLite copies a longer log by itself.
PAGES, PAGE = 1000, 4096
LENGTH = PAGES * (PAGE + 24) + 32
#: Pages, as estimated, that make it worth to copy the log.
MANY = PAGES // 2
#: The log gets its length where this much room is left on the disk [byte]: a disk that is nearly full needs it.
ROOM = 64 << 20
#: Bytes that the log grows by while no other process can write.
_STEP = 64 << 10


def _zeros(log: int, start: int, count: int) -> int:
    """Write zeros into a file; returns how many."""
    os.lseek(log, start, os.SEEK_SET)
    return os.write(log, bytes(count))


def lengthen(db: sqlite3.Connection, database: Path, known: tuple[int, int]) -> None:
    """Give the log its length, if there is room on the disk.

    Args:
        db: the connection to the database, which no other thread uses meanwhile.
        database: its file.
        known: device and inode of its log: the file of that name may belong to another one now.

    Raises:
        sqlite3.Error: another process writes for long.
        OSError: it cannot be written.
    """
    log = os.open(f"{database}-wal", os.O_WRONLY | RAW)
    try:
        found = os.fstat(log)
        size = found.st_size
        short = size < LENGTH and shutil.disk_usage(database.parent).free >= ROOM
        if not short or (found.st_dev, found.st_ino) != known:
            return
        while size < LENGTH:
            db.execute("BEGIN IMMEDIATE")  # no other process appends now
            try:
                size = os.fstat(log).st_size
                size += _zeros(log, size, min(_STEP, max(LENGTH - size, 0)))
            finally:
                db.execute("ROLLBACK")
        os.fsync(log)
    finally:
        os.close(log)


def copy(db: sqlite3.Connection) -> None:
    """Copy into the database what the log has; others may read and write meanwhile.

    Raises:
        sqlite3.Error: it could not be done; nothing is lost by that.
    """
    db.execute("PRAGMA wal_checkpoint(PASSIVE)").fetchone()

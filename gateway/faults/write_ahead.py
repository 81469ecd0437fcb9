"""The write-ahead log of the fault memory's file, kept so that a commit costs one write into blocks that are there.

A log that grows needs new blocks and a new size, which the file system puts down with each commit, and SQLite itself
copies the log into the database within the commit that makes it long. Both are done here instead, between commits: the
log gets its whole length once, and it is copied (a checkpoint) when nobody waits. Zeros behind what was written mean
nothing to SQLite: it reads frames as far as salts and checksums go on (https://www.sqlite.org/walformat.html).
"""

from __future__ import annotations

import os
import shutil
import sqlite3
from collections.abc import Callable
from pathlib import Path

#: Length that the log gets, in pages of :data:`PAGE` bytes; SQLite copies by itself what is longer.
PAGES, PAGE = 1000, 4096
LENGTH = PAGES * (PAGE + 24) + 32
#: Pages, as estimated, that make it worth to copy the log.
MANY = PAGES // 2
#: The log gets its length where so much room is left on the disk [byte]: who is nearly full needs it for other things.
ROOM = 64 << 20
#: Bytes that the log grows by while nobody else can write.
_STEP = 64 << 10


def is_short(database: Path) -> bool:
    """Tell whether the log could have its length, and does not."""
    try:
        return Path(f"{database}-wal").stat().st_size < LENGTH and shutil.disk_usage(database.parent).free >= ROOM
    except OSError:
        return False


def lengthen(db: sqlite3.Connection, database: Path) -> None:
    """Give the log its length.

    Args:
        db: a connection to the database that is used for nothing else meanwhile.
        database: its file.

    Raises:
        sqlite3.Error: somebody else writes for long.
        OSError: it cannot be written.
    """
    log = os.open(f"{database}-wal", os.O_WRONLY | os.O_CLOEXEC)
    try:
        size = os.fstat(log).st_size
        while size < LENGTH:
            db.execute("BEGIN IMMEDIATE")  # nobody else appends now
            try:
                size = os.fstat(log).st_size
                size += os.pwrite(log, bytes(min(_STEP, max(LENGTH - size, 0))), size)
            finally:
                db.execute("ROLLBACK")
        os.fsync(log)
    finally:
        os.close(log)


def tend(database: Path, connect: Callable[..., sqlite3.Connection], patience_s: float) -> None:
    """Give the log its length, and copy into the database what it has.

    Args:
        database: the file, which others may use meanwhile.
        connect: opens it, as ``sqlite3.connect`` does.
        patience_s: how long another writer is waited for [s].

    Raises:
        sqlite3.Error, OSError: it could not be done; nothing is lost by that.
    """
    database = database.resolve()  # SQLite keeps the log beside the file itself
    uri = f"{database.as_uri()}?mode=rw"  # one that is gone is not made anew
    db = connect(uri, isolation_level=None, timeout=patience_s, uri=True)
    try:
        db.execute("PRAGMA synchronous = FULL")
        if is_short(database):
            lengthen(db, database)
        db.execute("PRAGMA wal_checkpoint(PASSIVE)").fetchone()
    finally:
        db.close()

"""The right to write a fault memory: one process at a time."""

from __future__ import annotations

import fcntl
import os
import struct
import time
from contextlib import suppress
from pathlib import Path

from gateway_fdi.errors import InputError

#: Longer than :func:`is_kept` takes [s].
LOOK_S = 0.02
#: struct flock (fcntl(2)): type, whence, start, length, process.
_FLOCK = "@hhqqi0q"
#: Bytes that SQLite locks for reading: the first, and how many (https://www.sqlite.org/lockingv3.html).
_SHARED = (0x40000002, 510)


class InUseError(InputError):
    """Another process keeps this fault memory."""


def is_kept(path: Path) -> bool:
    """Return whether a process keeps this fault memory at present."""
    try:
        lock = os.open(f"{path.resolve()}-lock", os.O_RDONLY | os.O_CLOEXEC)
    except OSError:
        return False
    try:
        fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    finally:
        os.close(lock)
    return False


def _flock(kind: int, start: int = 0, length: int = 1) -> bytes:
    return struct.pack(_FLOCK, kind, os.SEEK_SET, start, length, 0)


def keep_from_copying(database: int) -> None:
    """Keep SQLite from copying its log into a database, and deleting the log, when the last connection is closed.

    For that it wants the database for itself; a lock of another descriptor, also of this process, refuses it.

    Args:
        database: descriptor of the file; the lock ends when it is closed.
    """
    with suppress(OSError):
        fcntl.fcntl(database, fcntl.F_OFD_SETLK, _flock(fcntl.F_RDLCK, *_SHARED))


def mark_unsaved(lock: int, unsaved: bool) -> None:
    """Let other processes see whether the writer holds changes that its file does not have.

    A second lock on the same file says so, because that can still be told when nothing can be written.

    Args:
        lock: from :func:`take_lock`.
        unsaved: whether there are such changes.
    """
    kind = fcntl.F_WRLCK if unsaved else fcntl.F_UNLCK
    fcntl.fcntl(lock, fcntl.F_OFD_SETLK, _flock(kind))


def is_unsaved(path: Path) -> bool:
    """Return whether the process that keeps this fault memory has changes that the file does not have."""
    try:
        lock = os.open(f"{path.resolve()}-lock", os.O_RDONLY | os.O_CLOEXEC)
    except OSError:
        return False
    try:
        # Whether a lock for reading would be refused.
        found = fcntl.fcntl(lock, fcntl.F_OFD_GETLK, _flock(fcntl.F_RDLCK))
    finally:
        os.close(lock)
    return bool(struct.unpack(_FLOCK, found)[0] != fcntl.F_UNLCK)


def mark(lock: int) -> None:
    """Note in the lock's file that there was a fault memory beside it."""
    with suppress(OSError):  # a full disk
        if not os.fstat(lock).st_size:
            os.pwrite(lock, b"kept\n", 0)


def is_marked(path: Path) -> bool:
    """Return whether there was a fault memory under this name before (see :func:`mark`)."""
    try:
        return Path(f"{path.resolve()}-lock").stat().st_size > 0
    except OSError:
        return False


def is_in_place(path: Path, lock: int) -> bool:
    """Return whether a lock is still that of the path: its file has not been deleted."""
    try:
        return os.path.samestat(os.fstat(lock), Path(f"{path.resolve()}-lock").stat())
    except OSError:
        return False


def take_lock(path: Path) -> int:
    """Become the only writer; the kernel gives the lock up when this process ends, however it ends.

    Args:
        path: the fault memory; links to it share its lock.

    Returns:
        descriptor that holds the lock until it is closed.

    Raises:
        InUseError: another process is the writer.
        OSError: the lock file cannot be made.
    """
    lock = os.open(f"{path.resolve()}-lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    try:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            time.sleep(LOOK_S)  # another process may only have looked
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        os.close(lock)
        raise InUseError(
            "another gateway keeps this fault memory; stop it, or give this one its own", file=path
        ) from error
    return lock

"""The right to write a fault memory: one process at a time."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from gateway.host import locks
from gateway.host.process import RAW
from gateway_fdi.errors import InputError

#: Longer than :func:`is_kept` takes [s].
LOOK_S = 0.02
#: Bytes that SQLite locks for reading: the first, and how many (https://www.sqlite.org/lockingv3.html).
_SHARED = (0x40000002, 510)


class InUseError(InputError):
    """Another process keeps this fault memory."""


def _asked(path: Path, question: Callable[[int], bool]) -> bool:
    """Return what a fault memory's lock answers; no lock: no."""
    try:
        lock = os.open(f"{path.resolve()}-lock", os.O_RDONLY | RAW)
    except OSError:
        return False
    try:
        return question(lock)
    finally:
        os.close(lock)


def is_kept(path: Path) -> bool:
    """Return whether a process keeps this fault memory at present."""
    return _asked(path, locks.is_kept)


def is_unsaved(path: Path) -> bool:
    """Return whether the process that keeps this fault memory has changes that the file does not have."""
    return _asked(path, locks.is_unsaved)


def keep_from_copying(database: int) -> None:
    """Keep SQLite from copying its log into a database, and deleting the log, when the last connection is closed.

    For that it wants the database for itself; a lock of another descriptor, also of this process, refuses it.

    Args:
        database: descriptor of the file; the lock ends when it is closed.
    """
    locks.share(database, *_SHARED)


def mark(lock: int) -> None:
    """Note in the lock's file that there was a fault memory beside it."""
    with suppress(OSError):  # a full disk
        if not os.fstat(lock).st_size:
            os.lseek(lock, 0, os.SEEK_SET)
            os.write(lock, b"kept\n")


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
    lock = os.open(f"{path.resolve()}-lock", os.O_RDWR | os.O_CREAT | RAW, 0o644)
    try:
        try:
            locks.keep(lock)
        except BlockingIOError:
            time.sleep(LOOK_S)  # another process may only have looked
            locks.keep(lock)
    except BlockingIOError as error:
        os.close(lock)
        raise InUseError(
            "another gateway keeps this fault memory; stop it, or give this one its own", file=path
        ) from error
    return lock

"""Locks of a file, two in one: that a process keeps it, and that it has something unsaved.

The system gives both up when their process ends, however it ends. On Linux and macOS the first is ``flock``, the second
a lock of a byte that belongs to the descriptor (``F_OFD_SETLK``); on Windows each is a lock of a byte of its own,
behind the end of the file.
"""

from __future__ import annotations

import os
import struct
import sys
from contextlib import suppress
from importlib import import_module
from typing import Any

fcntl: Any
try:
    fcntl = import_module("fcntl")
except ImportError:
    fcntl = None
    _windows: Any = import_module("msvcrt")

#: struct flock: fcntl(2) of Linux has type, whence, start, length, process; that of macOS begins with the numbers.
_LINUX, _MACOS = "@hhqqi0q", "@qqihh"
#: On Windows: the bytes that stand for the two locks.
_KEPT, _UNSAVED = 1 << 20, (1 << 20) + 1


def _flock(kind: int, start: int = 0, length: int = 1) -> bytes:
    if sys.platform == "darwin":
        return struct.pack(_MACOS, start, length, 0, kind, os.SEEK_SET)
    return struct.pack(_LINUX, kind, os.SEEK_SET, start, length, 0)


def _kind(found: bytes) -> int:
    return int(struct.unpack(_MACOS, found)[3] if sys.platform == "darwin" else struct.unpack(_LINUX, found)[0])


def _lock_byte(lock: int, place: int) -> bool:
    """Lock a byte on Windows; returns whether no other process has it."""
    os.lseek(lock, place, os.SEEK_SET)
    try:
        _windows.locking(lock, _windows.LK_NBLCK, 1)
    except OSError:
        return False
    return True


def _free_byte(lock: int, place: int) -> None:
    os.lseek(lock, place, os.SEEK_SET)
    with suppress(OSError):  # it was free
        _windows.locking(lock, _windows.LK_UNLCK, 1)


def keep(lock: int) -> None:
    """Become the only keeper of a file.

    Args:
        lock: descriptor, opened for reading and writing.

    Raises:
        BlockingIOError: another process keeps it.
    """
    if fcntl is not None:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    elif not _lock_byte(lock, _KEPT):
        raise BlockingIOError("another process keeps this file")


def is_kept(lock: int) -> bool:
    """Return whether another descriptor keeps a file; this one looks for a moment, and keeps nothing."""
    if fcntl is None:
        if free := _lock_byte(lock, _KEPT):
            _free_byte(lock, _KEPT)
        return not free
    try:
        fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    return False


def mark_unsaved(lock: int, unsaved: bool) -> None:
    """Let other processes see whether the keeper has changes that its file does not have.

    A lock says so, because that can still be told when nothing can be written.
    """
    if fcntl is not None:
        fcntl.fcntl(lock, fcntl.F_OFD_SETLK, _flock(fcntl.F_WRLCK if unsaved else fcntl.F_UNLCK))
    elif unsaved:
        _lock_byte(lock, _UNSAVED)
    else:
        _free_byte(lock, _UNSAVED)


def is_unsaved(lock: int) -> bool:
    """Return whether another descriptor has marked a file as unsaved."""
    if fcntl is None:
        if free := _lock_byte(lock, _UNSAVED):
            _free_byte(lock, _UNSAVED)
        return not free
    # Whether a lock for reading would be refused.
    return _kind(fcntl.fcntl(lock, fcntl.F_OFD_GETLK, _flock(fcntl.F_RDLCK))) != int(fcntl.F_UNLCK)


def share(descriptor: int, start: int, length: int) -> None:
    """Hold bytes of a file for reading, so that nobody gets them for writing; the lock is the descriptor's.

    On Windows nothing is held: its locks keep readers out, too.
    """
    if fcntl is not None:
        with suppress(OSError):
            fcntl.fcntl(descriptor, fcntl.F_OFD_SETLK, _flock(fcntl.F_RDLCK, start, length))

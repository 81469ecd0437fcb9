"""The right to write a fault memory: one process at a time."""

from __future__ import annotations

import fcntl
import os
import time
from pathlib import Path

from gateway.errors import InputError

#: Longer than :func:`is_kept` takes [s].
LOOK_S = 0.02


class InUseError(InputError):
    """Another process keeps this fault memory."""


def is_kept(path: Path) -> bool:
    """Tell whether a process keeps this fault memory at present."""
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
            time.sleep(LOOK_S)  # somebody may only have looked
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        os.close(lock)
        raise InUseError(
            "another gateway keeps this fault memory; stop it, or give this one its own", file=path
        ) from error
    return lock

"""The right to write a fault memory: one process at a time."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path

from gateway.errors import InputError


class InUseError(InputError):
    """Another process keeps this fault memory."""


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
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        os.close(lock)
        raise InUseError(
            "another gateway keeps this fault memory; stop it, or give this one its own", file=path
        ) from error
    return lock

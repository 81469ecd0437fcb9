"""The right to write a fault memory: one process at a time; and, in the file of the lock, the last link it wrote."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from gateway.faults.rollback import LastLink, packed, unpacked
from gateway.host import locks
from gateway.host.process import RAW
from gateway_fdi.errors import InputError

#: Longer than :func:`is_kept` takes [s].
LOOK_S = 0.02
#: Bytes that SQLite locks for reading: the first, and how many (https://www.sqlite.org/lockingv3.html).
_SHARED = (0x40000002, 510)

#: Written into the lock's file by earlier versions.
_EARLIER = b"kept"
#: Places for last links in it, a sector each.
_SLOTS, _SLOT = 2, 512


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


def is_marked(path: Path) -> bool:
    """Return whether there was a fault memory under this name before."""
    try:
        content = Path(f"{path.resolve()}-lock").read_bytes()
    except OSError:
        return False
    return content.startswith(_EARLIER) or any(link.number for link in _links(content))


def note(lock: int, place: int, link: LastLink) -> None:
    """Note the last link in the lock's file, which nothing else has: a file that went back shows.

    It is to be called when the link is on the disk. It is not synchronised: after a power cut the lock may know an
    earlier link than the file has, never a later one.

    Args:
        lock: its descriptor.
        place: counted: each second one is overwritten, so that a write that is torn leaves the other.
        link: the last link of the memory's file.
    """
    with suppress(OSError):  # a full disk
        os.lseek(lock, place % _SLOTS * _SLOT, os.SEEK_SET)
        os.write(lock, packed(link))


def sync(lock: int, folder: Path) -> None:
    """Have the lock's file, and its name in the folder, on the disk."""
    with suppress(OSError):
        os.fsync(lock)
        if hasattr(os, "O_DIRECTORY"):
            names = os.open(folder, os.O_RDONLY | RAW)
            try:
                os.fsync(names)
            finally:
                os.close(names)


def is_unfinished(path: Path) -> bool:
    """Return whether a fault memory was expected here that was never there: its first write was cut off."""
    links = noted(path)
    return bool(links) and not any(link.number for link in links)


def noted(path: Path, *, beside_link: bool = False) -> list[LastLink]:
    """Return the last links that were noted beside a fault memory, and generations that were expected (number 0).

    Args:
        path: of the memory.
        beside_link: where it is a link, beside that: a memory that was here before another one's link was.
    """
    try:
        return _links(Path(f"{path if beside_link else path.resolve()}-lock").read_bytes())
    except OSError:
        return []


def _links(content: bytes) -> list[LastLink]:
    return [link for at in range(0, _SLOTS * _SLOT, _SLOT) if (link := unpacked(content[at:])) is not None]


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

"""This process: its user, its processors, flags of the files that it opens."""

from __future__ import annotations

import getpass
import os
import signal
import threading
import time
from functools import partial
from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable
    from pathlib import Path

#: Flags for :func:`os.open`: bytes as they are, and no child process has the file.
RAW = getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0) | getattr(os, "O_NOINHERIT", 0)
#: Signals that ask a process to end; a console of Windows sends SIGBREAK at Ctrl-Break, and when it is closed.
ENDS: tuple[int, ...] = tuple(
    getattr(signal, f"SIG{name}") for name in ("INT", "TERM", "BREAK") if hasattr(signal, f"SIG{name}")
)
#: Nice value of a process that gives way.
_NICE = 10
#: Of a user that the system does not number, or does not tell.
NOBODY = -1


def call_at_end(loop: asyncio.AbstractEventLoop, tell: Callable[[], None]) -> None:
    """Have a function called in a loop when a signal asks this process to end; Windows' loops take no handlers."""

    def handle(*_: object) -> None:
        if not loop.is_closed():
            loop.call_soon_threadsafe(tell)

    for number in ENDS:
        signal.signal(number, handle)


def user() -> int:
    """Return the number of this process's user; NOBODY on Windows, which has none."""
    return os.geteuid() if hasattr(os, "geteuid") else NOBODY


def user_in_words() -> str:
    """Return this process's user for the trace of what was done: "uid 1000", on Windows the user's name."""
    return f"uid {os.getuid()}" if hasattr(os, "getuid") else f"user {getpass.getuser()}"


def user_named(name: str) -> int | None:
    """Return a user's number, None if there is no such user, or the system numbers none."""
    try:
        return int(import_module("pwd").getpwnam(name).pw_uid)
    except (ImportError, KeyError):
        return None


def group_named(name: str) -> int | None:
    """Return a group's number, None if there is no such group, or the system numbers none."""
    try:
        return int(import_module("grp").getgrnam(name).gr_gid)
    except (ImportError, KeyError):
        return None


def open_to_others(file: Path, mode: int = 0o077) -> bool:
    """Return whether a file's mode has any of these bits; not on Windows, where a folder's list says who may what.

    Raises:
        OSError: there is no such file.
    """
    found = file.stat().st_mode
    return hasattr(os, "getuid") and bool(found & mode)


def read_at(file: int, count: int, start: int) -> bytes:
    """Return bytes of a file; on Windows the descriptor's place moves, so that no two threads may share it."""
    if hasattr(os, "pread"):
        return os.pread(file, count, start)
    os.lseek(file, start, os.SEEK_SET)
    return os.read(file, count)


def boot() -> str:
    """Return what names the boot of this machine; "" where the system does not tell.

    A service that does not see /proc/sys is told by its unit (``Environment=BOOT_ID=%b``).
    """
    if told := os.environ.get("BOOT_ID", ""):
        return told.replace("-", "")
    try:
        with open("/proc/sys/kernel/random/boot_id") as file:  # noqa: PTH123 - pathlib takes long to load
            return file.read().strip().replace("-", "")
    except OSError:
        return ""


def processors() -> int:
    """Return how many processors this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return max(1, len(os.sched_getaffinity(0)))
    return os.cpu_count() or 1


def thread_clock() -> Callable[[], float]:
    """Return what tells the processor time of the calling thread [s], to any thread, as long as it runs.

    Where the system does not tell it of another thread (macOS, Windows), the time by the clock.
    """
    if not hasattr(time, "pthread_getcpuclockid"):
        return time.monotonic
    return partial(time.clock_gettime, time.pthread_getcpuclockid(threading.get_ident()))


def prefer(priority: int) -> None:
    """Let the kernel prefer this process (SCHED_RR).

    Args:
        priority: 1 to 99.

    Raises:
        OSError: this user may not ask for that, or this system has no such order.
    """
    if not hasattr(os, "sched_setscheduler"):
        raise OSError("this system has no such priority")
    os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(priority))


def give_way() -> None:
    """Let every other process go first (SCHED_IDLE), as far as the system can.

    Raises:
        OSError: SCHED_IDLE is forbidden; its nice value is higher all the same.
    """
    if hasattr(os, "nice"):
        os.nice(_NICE)
    if hasattr(os, "sched_setscheduler") and hasattr(os, "SCHED_IDLE"):
        os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))

"""When a thread gets the processor: real time, or slices that it asks for. Short ones have it come soon after it woke.

Linux' fair scheduler (EEVDF) gives the processor to the thread whose slice has to end first. So of two threads with the
same share the one that asks for short slices does not wait for the other's (3 ms) to end. It gets no more time by
that, and needs no right to ask (sched(7), ``sched_setattr``; Linux 6.12, earlier ones take no notice).
"""

from __future__ import annotations

import ctypes
import os
import platform
import struct
from collections.abc import Iterator
from contextlib import contextmanager

#: Numbers of the calls sched_setattr and sched_getattr.
_CALLS = {"x86_64": (314, 315), "aarch64": (274, 275), "riscv64": (274, 275)}
#: struct sched_attr: size, policy, flags, nice, priority, runtime, deadline, period, two for utilization.
_ATTR = struct.Struct("=IIQiIQQQII")
#: A slice that is short, the shortest there is [ns].
SHORT_NS = 100_000

_POLICY, _RUNTIME = 1, 5
_FAIR = 0


def _call(number: int, room: ctypes.Array[ctypes.c_char], *more: int) -> bool:
    return not ctypes.CDLL(None).syscall(number, 0, room, *more)


def _attributes() -> list[int] | None:
    """Return how this thread is scheduled; None: the system does not tell."""
    calls = _CALLS.get(platform.machine()) if hasattr(os, "sched_getaffinity") else None
    room = ctypes.create_string_buffer(_ATTR.size)
    if calls is None or not _call(calls[1], room, _ATTR.size, 0):
        return None
    return list(_ATTR.unpack(room.raw))


def slice_ns() -> int | None:
    """Return the slice of this thread [ns], 0: the system's own; None: the system does not tell."""
    found = _attributes()
    return None if found is None else found[_RUNTIME]


def _ask(runtime_ns: int) -> bool:
    found = _attributes()
    if found is None or found[_POLICY] != _FAIR:  # one of another class, as real time, is left as it is
        return False
    found[_RUNTIME] = runtime_ns
    return _call(_CALLS[platform.machine()][0], ctypes.create_string_buffer(_ATTR.pack(*found), _ATTR.size), 0)


@contextmanager
def short_slices(runtime_ns: int = SHORT_NS) -> Iterator[None]:
    """Ask for short slices of processor time for this thread; where the system has none, nothing happens.

    Args:
        runtime_ns: their length, at least 100,000 [ns].
    """
    before = slice_ns()
    asked = before is not None and _ask(runtime_ns)
    try:
        yield
    finally:
        if asked and before is not None:
            _ask(before)


def is_real_time() -> bool:
    """Return whether this thread is of real time: somebody has said how it is scheduled, and it is left as it is."""
    if not hasattr(os, "SCHED_RESET_ON_FORK"):  # Linux alone has it
        return False
    return os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK in (os.SCHED_FIFO, os.SCHED_RR)


def come_first() -> bool:
    """Have this thread come before all others on its processor; returns whether it may (root, or ``LimitRTPRIO``).

    From then on it is of real time, at the least priority (sched(7)): it has the processor until it waits. Threads and
    processes that it begins are not of real time.
    """
    if is_real_time():
        return True
    if not hasattr(os, "SCHED_RESET_ON_FORK"):
        return False
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(1))
    except OSError:
        return False
    return True


@contextmanager
def real_time() -> Iterator[bool]:
    """Have this thread come first for a while; gives whether it may."""
    before = is_real_time()
    came = come_first()
    try:
        yield came
    finally:
        if came and not before:  # to take the flag back, too, would be another right
            os.sched_setscheduler(0, os.SCHED_OTHER | os.SCHED_RESET_ON_FORK, os.sched_param(0))

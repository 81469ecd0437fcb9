"""Python behind monitors: a kernel calls it by its number, and it has a limit of time.

A step takes Python's lock. One that takes a processor for :data:`LIMIT_S` is interrupted, and the monitor is
switched off; one that loops in C is not reached so: that is the watchdog's (:mod:`gateway.live.watchdog`).
"""

from __future__ import annotations

import ctypes
import itertools
import threading
import time
import traceback
import weakref
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from gateway.host.process import thread_clock
from gateway.monitors.capabilities import Failure
from gateway_fdi.jit import python_entry

#: How long a step may take of a processor, and by the clock, where other processes are at work too [s].
LIMIT_S, LASTS_S = 1.0, 3.0
#: How often that is looked at [s].
LOOKED_S = 0.1

_steps: dict[int, Callable[[], None]] = {}
_numbers, _stepped = itertools.count(1), itertools.count(1)
#: Why the last step of each that failed did so.
_failures: dict[int, str] = {}
_late: set[int] = set()


class TooLongError(BaseException):
    """A step took too long: no ``except Exception`` of its author keeps it."""


class _Watched:
    """A thread that steps.

    No lock: an interrupt between taking and holding one would leave it taken for ever.

    Attributes:
        step: number of the step that it is in; 0: in none.
        looked_at: the thread of limits looks at it just now.
        interrupted: whether its step was interrupted.
    """

    def __init__(self) -> None:
        self.step = 0
        self.looked_at = self.interrupted = False
        self._thread, self._processor_s = threading.get_ident(), thread_clock()
        self._seen, self._since_s = 0, (0.0, 0.0)
        _watch().append(self)

    def look(self) -> None:
        """Interrupt its step if that has taken too long since it was seen first (the thread of limits)."""
        self.looked_at = True
        step = self.step
        if step:
            processor_s, clock_s = self._processor_s(), time.monotonic()
            if step != self._seen:
                self._seen, self._since_s = step, (processor_s, clock_s)
            elif processor_s - self._since_s[0] > LIMIT_S or clock_s - self._since_s[1] > LASTS_S:
                self.interrupted = True
                _interrupt(self._thread, TooLongError)
        self.looked_at = False

    def settle(self) -> None:
        """Put an end to the interrupts of a step that is over.

        Raises:
            TooLongError: it was interrupted. Called again, it raises nothing more.
        """
        while self.looked_at:
            time.sleep(0.0)
        if self.interrupted:
            self.interrupted = False
            # One that is only taken back leaves CPython 3.11 looking for it for ever, where a trace function hangs:
            # so another takes its place, and comes in here.
            _interrupt(self._thread, TooLongError)


class _Thread(threading.local):
    """Each thread has its own."""

    def __init__(self) -> None:
        self.watched = _Watched()


@cache
def _watch() -> list[_Watched]:
    """Return the list of the threads that are watched, by a thread of its own."""
    watched: list[_Watched] = []

    def work() -> None:
        while True:
            time.sleep(LOOKED_S)
            for one in watched:
                one.look()

    threading.Thread(target=work, name="limit of steps", daemon=True).start()
    return watched


def _interrupt(thread: int, kind: type[BaseException]) -> None:
    ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(thread), ctypes.py_object(kind))


_this = _Thread()


def enter(step: Callable[[], None], state: Any) -> int:
    """Return the number of a function that a monitor's kernel calls, as long as the table of its state is there.

    Args:
        step: steps it.
        state: record of the monitor's state.
    """
    number, owner = next(_numbers), state
    while isinstance(getattr(owner, "base", None), np.ndarray):
        owner = owner.base
    _steps[number] = step
    if isinstance(owner, np.ndarray):
        weakref.finalize(owner, _steps.pop, number, None)
        weakref.finalize(owner, _failures.pop, number, None)
        weakref.finalize(owner, _late.discard, number)
    return number


@cache
def address() -> int:
    """Return the address for :func:`gateway_fdi.jit.call_entry`; its first number is that of :func:`enter`."""
    return python_entry(call, (None, None, None, None))


def call(number: int, *_: int) -> None:
    """Step what stands behind a monitor.

    Raises:
        RuntimeError: it failed; :data:`FAILURE` says how.
    """
    failed: BaseException | None = None
    watched, late = _this.watched, False
    try:
        watched.step = next(_stepped)
        _steps[number]()
    except (TooLongError, SystemExit, Exception) as error:
        failed = error
    finally:
        watched.step = 0  # CPython interrupts at calls and loops only: not between the step and this line
    for _attempt in range(4):  # each interrupt that is on its way comes in here
        try:
            watched.settle()
        except TooLongError:
            late = True
    if late and not isinstance(failed, TooLongError):
        failed = TooLongError()  # it kept the interrupt to itself, or came back just then
    if failed is not None:
        _failures[number] = _text_of(failed)
        if isinstance(failed, TooLongError):
            _late.add(number)
        raise RuntimeError(_failures[number]) from None


#: Capability of a monitor whose state has the number of :func:`enter` in its field ``number``.
FAILURE = Failure(lambda s: _failures.get(int(s["number"]), ""), lambda s: int(s["number"]) in _late)


def _text_of(error: BaseException) -> str:
    here = str(__file__)
    places = [at for at in traceback.extract_tb(error.__traceback__) if at.filename != here]
    where = f" ({places[-1].filename}:{places[-1].lineno})" if places else ""
    if isinstance(error, TooLongError):
        return f"its step takes longer than {LIMIT_S:g} s{where}"
    told = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
    return f"{' '.join(told.split())}{where}"

"""Ends a process in which a step of a monitor does not return; the next one leaves that monitor off.

Nothing else can: the thread of the loop is in compiled code, where no signal handler of Python runs. The thread that
looks needs Python's lock only, which compiled code does not hold. It looks at what the loop says of itself: which
monitor is being stepped, and how many steps it has ended.
"""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from gateway.engine.core import Engine
from gateway.faults.hung_monitors import hung_beside
from gateway_fdi.jit import COMPILED

#: Exit code: a step did not return. A service manager starts the gateway again (EX_TEMPFAIL of sysexits.h).
HUNG_EXIT = 75
#: How long a step may take [s]; the service manager's watchdog must be more patient.
LIMIT_S = 5.0
#: How long, once the process was asked to end [s].
ASKED_LIMIT_S = 1.0
#: Time between two looks [s], and looks that must have seen the same step: a machine that slept proves nothing.
LOOK_S, LOOKS = 0.25, 4


def _say(text: str) -> None:
    """Say it where it is seen although the process ends at once."""
    print(text, file=sys.stderr, flush=True)


class Stepped(NamedTuple):
    """A step under way: of which engine, which monitor, after how many steps of it."""

    engine: int
    monitor: int
    steps: int


def step_under_way(engine: Engine) -> Stepped | None:
    """Return the step that is under way; None: none is."""
    tables = engine.tables
    timer = int(tables.clock[0]["stepping"]) - 1
    if timer < 0:
        return None
    monitor = int(tables.timers[timer]["index"])
    return Stepped(id(engine), monitor, int(tables.handlers[monitor]["steps"]))


class Watchdog:
    """Looks whether steps return.

    Args:
        engine: returns the engine that runs now.
        memory: returns the fault memory's file, beside which it is noted who did not return; None: there is none.
        asked: returns whether the process was asked to end.
        leave: ends the process.
        monotonic: clock [s].
    """

    def __init__(
        self,
        engine: Callable[[], Engine],
        memory: Callable[[], Path | None],
        *,
        asked: Callable[[], bool] = lambda: False,
        leave: Callable[[int], None] = os._exit,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        self._engine, self._memory, self._asked = engine, memory, asked
        self._leave, self._monotonic = leave, monotonic
        self._seen: Stepped | None = None
        self._since_s, self._looks = 0.0, 0
        self._ended = threading.Event()

    def begin(self) -> None:
        """Look from now on, in a thread."""
        threading.Thread(target=self._work, name="watchdog", daemon=True).start()

    def end(self) -> None:
        """Look no more."""
        self._ended.set()

    def _work(self) -> None:
        while not self._ended.wait(LOOK_S):
            self.look()

    def look(self) -> None:
        """Look once; ends the process if a step has not returned for too long."""
        engine, now_s = self._engine(), self._monotonic()
        found = step_under_way(engine)
        if found is None or found != self._seen:
            self._seen, self._since_s, self._looks = found, now_s, 0
            return
        self._looks += 1
        limit_s = ASKED_LIMIT_S if self._asked() else LIMIT_S
        if self._looks >= LOOKS and now_s - self._since_s >= limit_s:
            self._give_up(engine, found.monitor, now_s - self._since_s)

    def _give_up(self, engine: Engine, monitor: int, seconds: float) -> None:
        instance = engine.monitors[monitor]
        kind = instance.monitor
        reason = f"its step did not return for {seconds:.0f} s"
        _say(f"monitor {instance.name} (type {kind.type}, {kind.file}): {reason}; the process ends")
        path = self._memory()
        if path is not None:
            try:
                hung_beside(path).add(instance.name, kind.digest, reason)
            except OSError as error:
                _say(f"{path}: cannot note that monitor {instance.name} is to stay off: {error}")
        self._leave(HUNG_EXIT)


@contextmanager
def steps_watched(engine: Engine, *, asked: Callable[[], bool] = lambda: False) -> Iterator[None]:
    """End the process if a step does not return meanwhile: neither Ctrl-C nor SIGTERM would.

    For what a person starts: he sees the line, nothing is noted. Kernels as plain Python can be interrupted, and may
    wait in a debugger.

    Args:
        engine: whose steps they are.
        asked: returns whether the process was asked to end.
    """
    watchdog = Watchdog(lambda: engine, lambda: None, asked=asked)
    if COMPILED:
        watchdog.begin()
    try:
        yield
    finally:
        watchdog.end()

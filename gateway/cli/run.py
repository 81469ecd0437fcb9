"""``gateway run``: monitor live buses."""

from __future__ import annotations

import math
import os
import signal
import socket
import threading
import time
from contextlib import ExitStack, nullcontext
from pathlib import Path
from typing import Self

from gateway.bus.logs import open_writer
from gateway.cli.events import EventPrinter
from gateway.cli.present import find_config, say, say_unless_stored, socket_of
from gateway.common.calls import call_of
from gateway.common.extras import need
from gateway.config.load import load_config
from gateway.faults.catalogue import FaultDefinition
from gateway.host.process import ENDS
from gateway.host.slice import real_time
from gateway.live.daemon import Daemon
from gateway.live.notify import Notifier
from gateway_fdi.common.log import get_logger

log = get_logger(__name__)


class Ending:
    """Tells when to end: a signal that asks for it came, or a time is over. Install one in a process.

    Until :meth:`ready` a signal ends the process at once, with nothing begun that had to be kept: kernels are compiled
    then, in calls into C that may take long, and in which no handler of Python runs.

    Args:
        starting: exit code of such an end; None: there is nothing to wait for, it is ready.
    """

    def __init__(self, starting: int | None = None) -> None:
        self._signalled = 0
        self._limit = math.inf
        self._starting = starting
        #: Whether a signal came, even one for which no handler of Python could run yet.
        self.heard = False
        for number in ENDS:
            signal.signal(number, self._on_signal)
        if starting is not None:
            # The handler in C writes the signal's number there, even while the main thread is busy.
            self._numbers, wakeup = socket.socketpair()
            self._wakeup = wakeup
            wakeup.setblocking(False)
            signal.set_wakeup_fd(wakeup.fileno(), warn_on_full_buffer=False)
            threading.Thread(target=self._watch, name="signals", daemon=True).start()

    def _watch(self) -> None:
        while number := self._numbers.recv(1):
            if number[0] not in ENDS:
                continue
            self.heard = True
            if self._starting is not None:
                os._exit(self._starting or 0)

    def ready(self) -> None:
        """From now on a signal is an end in good order."""
        self._starting = None

    def _on_signal(self, number: int, _: object) -> None:
        self._signalled = number

    @property
    def code(self) -> int:
        """Exit code of a work that a signal has ended early, as shells have it; 0: none has."""
        return 128 + self._signalled if self._signalled else 0

    def after(self, seconds: float | None) -> Self:
        """End after this number of seconds; None: only at a signal."""
        self._limit = math.inf if seconds is None else time.monotonic() + seconds
        return self

    def __call__(self) -> bool:
        """Return whether to end."""
        return bool(self._signalled) or time.monotonic() >= self._limit


def run(
    config_path: Path | None,
    *,
    bus: str | None,
    memory: Path | None,
    record: Path | None,
    duration: float | None,
    status: Path | None = None,
    serve: bool = False,
    port: int = 0,
    realtime: bool = False,
    json: bool,
    fail_on_dtc: bool,
) -> int:
    """Monitor until told to stop; returns the exit code.

    ``serve``: a page is served beside it, at ``port``; ``realtime``: the loop comes before other programs.
    """
    ending = Ending(starting=0)
    path = find_config(config_path)
    printer = EventPrinter(as_json=json, start_ns=time.time_ns())
    with ExitStack() as stack:
        taps = []
        if serve:
            need("serve", "pages", key="--serve")

            status = socket_of(load_config(path), memory, status)
        if record is not None:
            channels = {k: entry.channel for k, entry in enumerate(load_config(path).bus)}
            taps.append(stack.enter_context(open_writer(record, interfaces=channels)))
        daemon = Daemon(
            path,
            bus=bus,
            memory=memory,
            report=printer,
            taps=taps,
            notifier=Notifier(),
            on_built=ending.ready,
            status=status,
            asked=lambda: ending.heard,
        )
        stack.callback(daemon.close)

        def definition(fault: str) -> FaultDefinition | None:
            return daemon.gateway.catalogue.get(fault)  # of the gateway that runs: a reload makes another

        printer.definition, printer.ecus = definition, daemon.gateway.senders
        end = ending.after(duration)

        def ends() -> bool:
            printer.look()
            return end()

        if serve and status is not None:
            stack.callback(call_of("page_process")(status, port).close)
        if hasattr(signal, "SIGHUP"):
            signal.signal(signal.SIGHUP, daemon.reloader.request)
        say(daemon.describe())
        begun = time.monotonic()
        with real_time() if realtime else nullcontext(True) as may:
            if not may:
                log.warning("--realtime: not granted; it needs root or LimitRTPRIO=1, and Linux")
            daemon.run(ends)
        printer(daemon.gateway.summary(time.monotonic() - begun))
        lost = say_unless_stored(daemon.gateway.stored, daemon.gateway.store.path)
    if lost:
        return lost
    return 1 if fail_on_dtc and printer.failures else 0

"""``gateway run``: monitor live buses."""

from __future__ import annotations

import math
import signal
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Self

from gateway.bus.logs import open_writer
from gateway.cli.present import EventPrinter, find_config, say, say_if_cold, say_unless_stored
from gateway.config import load_config
from gateway.live.daemon import Daemon
from gateway.live.notify import Notifier


class Ending:
    """Tells when to end: SIGINT or SIGTERM came, or a time is over. Install one in a process."""

    def __init__(self) -> None:
        self._signalled = False
        self._limit = math.inf
        signal.signal(signal.SIGINT, self._on_signal)
        signal.signal(signal.SIGTERM, self._on_signal)

    def _on_signal(self, *_: object) -> None:
        self._signalled = True

    def after(self, seconds: float | None) -> Self:
        """End so many seconds from now; None: only at a signal."""
        self._limit = math.inf if seconds is None else time.monotonic() + seconds
        return self

    def __call__(self) -> bool:
        """Tell whether to end."""
        return self._signalled or time.monotonic() >= self._limit


def run(
    config_path: Path | None,
    *,
    bus: str | None,
    memory: Path | None,
    record: Path | None,
    duration: float | None,
    json: bool,
    fail_on_dtc: bool,
) -> int:
    """Monitor until told to stop; returns the exit code."""
    ending = Ending()
    path = find_config(config_path)
    say_if_cold()
    printer = EventPrinter(as_json=json, start_ns=time.time_ns())
    with ExitStack() as stack:
        taps = []
        if record is not None:
            channels = {k: entry.channel for k, entry in enumerate(load_config(path).bus)}
            taps.append(stack.enter_context(open_writer(record, interfaces=channels)))
        daemon = Daemon(path, bus=bus, memory=memory, tell=printer, taps=taps, notifier=Notifier())
        stack.callback(daemon.close)
        signal.signal(signal.SIGHUP, daemon.reloader.request)
        say(daemon.describe())
        begun = time.monotonic()
        daemon.run(ending.after(duration))
        printer(daemon.gateway.summary(time.monotonic() - begun))
        lost = say_unless_stored(daemon.gateway.stored, daemon.gateway.store.path)
    if lost:
        return lost
    return 1 if fail_on_dtc and printer.failures else 0

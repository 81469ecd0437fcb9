"""``gateway run``: monitor live buses."""

from __future__ import annotations

import math
import signal
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Self

from gateway.app import Gateway
from gateway.bus.base import Bus
from gateway.bus.logs import open_writer
from gateway.bus.uri import open_bus
from gateway.cli.present import EventPrinter, find_config, say, say_if_cold
from gateway.config import load_config
from gateway.errors import InputError
from gateway.live import GRACE_NS, run_live


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
    config = load_config(path)
    uris = [entry.uri for entry in config.bus]
    if bus is not None:
        if len(uris) > 1:
            raise InputError("the configuration has several buses; set their URIs there", value=bus)
        uris = [bus]
    say_if_cold()
    printer = EventPrinter(as_json=json, start_ns=time.time_ns())
    with ExitStack() as stack:
        gateway = Gateway(config, memory or config.memory.path, file=path)
        stack.callback(gateway.close)
        gateway.listen(printer)
        buses = [stack.enter_context(open_bus(uri, index)) for index, uri in enumerate(uris)]
        for opened in buses:
            ids = gateway.identifiers_on(opened.index)
            if ids is not None and record is None:
                opened.set_filters(ids)
        writer = None if record is None else stack.enter_context(open_writer(record))
        gateway.start(time.time_ns())
        for entry, opened in zip(config.bus, buses, strict=True):
            printer(_bus_event(entry.name, opened, "open", time.time_ns()))
        say(f"{config.name}: monitoring {', '.join(uris)}")
        begun = time.monotonic()
        run_live(gateway, buses, ending.after(duration), record=writer)
        gateway.advance(time.time_ns() - GRACE_NS)
        gateway.stop(gateway.engine.now_ns)
        for entry, opened in zip(config.bus, buses, strict=True):
            printer(_bus_event(entry.name, opened, "closed", gateway.engine.now_ns))
        printer(gateway.summary(time.monotonic() - begun))
    return 1 if fail_on_dtc and printer.failures else 0


def _bus_event(name: str, bus: Bus, state: str, t_ns: int) -> dict[str, Any]:
    return {
        "event": "bus",
        "t_ns": t_ns,
        "bus": name,
        "uri": bus.uri,
        "state": state,
        **vars(bus.statistics),
    }

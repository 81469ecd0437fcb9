"""``gateway run``: monitor live buses."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import structlog

from gateway.app import Gateway
from gateway.bus.logs import open_writer
from gateway.bus.uri import open_bus
from gateway.cli.present import EventPrinter, find_config, say, say_if_cold
from gateway.config import load_config
from gateway.errors import InputError
from gateway.live import GRACE_NS, run_live

log = structlog.get_logger(__name__)


def until_signal(duration: float | None) -> Callable[[], bool]:
    """Return a test for the end: SIGINT or SIGTERM came, or the duration [s] is over."""
    ended = False

    def end(*_: object) -> None:
        nonlocal ended
        ended = True

    signal.signal(signal.SIGINT, end)
    signal.signal(signal.SIGTERM, end)
    limit = None if duration is None else time.monotonic() + duration
    return lambda: ended or (limit is not None and time.monotonic() >= limit)


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
    stop = until_signal(None)
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
            ids = gateway.engine.plan.identifiers(opened.index)
            if ids is not None and record is None:
                opened.set_filters(ids)
        writer = None if record is None else stack.enter_context(open_writer(record))
        gateway.start(time.time_ns())
        say(f"{config.name}: monitoring {', '.join(uris)}")
        begun = time.monotonic()
        limit = until_signal(duration) if duration is not None else stop
        run_live(gateway, buses, limit, record=writer)
        gateway.advance(time.time_ns() - GRACE_NS)
        gateway.stop(gateway.engine.now_ns)
        for opened in buses:
            log.info("bus closed", uri=opened.uri, **vars(opened.statistics))
        printer(gateway.summary(time.monotonic() - begun))
    return 1 if fail_on_dtc and printer.failures else 0

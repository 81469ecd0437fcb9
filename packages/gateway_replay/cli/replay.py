"""``gateway replay``: a recorded log through the monitors."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from gateway.bus.frames import Frames
from gateway.cli.events import EventPrinter
from gateway.cli.present import find_config, say_unless_stored
from gateway.common.calls import call_of
from gateway.common.extras import need
from gateway.config.load import load_config
from gateway.config.model import Config
from gateway.faults.status import Status
from gateway.live.watchdog import steps_watched
from gateway.runtime.app import Gateway
from gateway.runtime.assemble import prepare
from gateway_fdi.errors import InputError, InputErrors
from gateway_replay.cli.junit import Case, of_faults, write_junit
from gateway_replay.cli.signal_plot import Watched
from gateway_replay.injection import Injector
from gateway_replay.injector import FaultInjector, injectors_of
from gateway_replay.log import Log
from gateway_replay.log_contents import Contents
from gateway_replay.replay import FrameConsumer
from gateway_replay.replay import replay as feed
from gateway_replay.trace import Trace, only, single


def replay(
    log: Path,
    config_path: Path | None,
    *,
    memory: Path | None,
    maps: Sequence[str] = (),
    allow_empty: bool = False,
    allow_cut: bool = False,
    monitor: str | None = None,
    trace: bool = False,
    injections: Sequence[str] = (),
    seed: int = 1,
    html: Path | None = None,
    series: Path | None = None,
    plot: Path | None = None,
    chosen: Sequence[str] = (),
    every: bool = False,
    json: bool,
    fail_on_dtc: bool,
    junit: Path | None = None,
    among: bool = False,
) -> int:
    """Replay a log; returns the exit code. Arguments as the command has them (``gateway replay --help``).

    ``among``: it is one of several logs, which lines of JSON name.

    Raises:
        InputErrors: the log is damaged, cut off, or holds nothing for a configured bus; its contents have been replayed
            and told before.
    """
    if html is not None:
        need("serve", "reports", key="--html")
    path = find_config(config_path)
    config = _configured(path, monitor, trace=trace)
    watched = Watched(series, plot, chosen)
    printer = EventPrinter(as_json=json, log=str(log) if among else None, every=every)
    recorded = Log(log, config, maps)
    parts = prepare(config, path, extra=chosen)
    if not allow_empty:
        recorded.refuse_foreign(parts.databases)
    injectors = injectors_of(config, parts, injections, seed)
    gateway = Gateway(config, memory, file=path, parts=parts, lasting=True)
    printer.definition, printer.ecus = gateway.catalogue.get, gateway.senders
    gateway.listen(printer)
    failures = _Failures(printer, gateway)
    try:
        begun = time.monotonic()
        traced = Trace(gateway.engine) if trace else None
        report = None if html is None else call_of("run_report")(html, gateway, path)
        collector = gateway if report is None else report.collector
        with watched.of(gateway, parts, collector) as consumer, steps_watched(gateway.engine):
            fed = FaultInjector(consumer, injectors, gateway) if injectors else consumer
            _feed(fed, recorded, printer, log.name, traced)
        seconds = time.monotonic() - begun
        found = recorded.contents(allow_empty=allow_empty, allow_cut=allow_cut)
        summary = gateway.summary(seconds)
        found.notes += [*_notes(found, config, summary, dict(zip(injections, injectors, strict=True))), *watched.notes]
        printer(found.event())
        printer(summary)
        if report is not None:
            report.write_log(log, [found.event(), summary], injections)
        if junit is not None:
            _write_junit(junit, gateway, failures, found, [log, *([] if html is None else [html])], seconds, injections)
    finally:
        gateway.close()
    if found.wrong:
        raise InputErrors(found.wrong)
    if lost := say_unless_stored(gateway.stored, memory):
        return lost
    return 1 if fail_on_dtc and printer.failures else 0


class _Failures:
    """Keeps when each fault failed first, as a line for people.

    Args:
        printer: that knows the time which people see as zero.
        gateway: not started yet.
    """

    def __init__(self, printer: EventPrinter, gateway: Gateway) -> None:
        self._printer = printer
        self.told: dict[str, str] = {}
        gateway.listen(self)

    def __call__(self, event: Mapping[str, Any]) -> None:
        """Take one event."""
        if event["event"] == "dtc" and event["status"] & Status.TEST_FAILED:
            seconds = (event["t_ns"] - self._printer.start_ns) / 1e9
            shown = ", ".join(f"{name} {value:.6g}" for name, value in event["evidence"].items() if value is not None)
            self.told.setdefault(event["fault"], f"{event['dtc']} set at {seconds:.3f} s\n{shown}")


def _write_junit(
    path: Path,
    gateway: Gateway,
    failures: _Failures,
    found: Contents,
    files: Sequence[Path],
    seconds: float,
    injected: Sequence[str],
) -> None:
    """Write a test case for each fault, and one for the log itself, the first of the files."""
    faults = [(definition.id, str(definition.dtc)) for definition in gateway.catalogue]
    open_ones = [name for name, _ in faults if gateway.memory.status_now(name) & Status.NOT_COMPLETED_THIS_CYCLE]
    wrong = "\n".join(str(error) for error in found.wrong)
    cases = [Case("log is whole", wrong, "error" if wrong else "passed"), *of_faults(faults, failures.told, open_ones)]
    properties = [("log", files[0].name), *(("injected", text) for text in injected)]
    write_junit(path, gateway.config.name, cases, seconds, properties, files)


def _notes(found: Contents, config: Config, summary: Mapping[str, Any], injected: Mapping[str, Injector]) -> list[str]:
    """Return what a person should know of a replay beyond its events, one line each."""
    notes = [f"--inject {text!r}: {injector.count} frames" for text, injector in injected.items()]
    if found.state != "foreign" and not summary["decoded"] and _watches(config):
        notes.append("none of its frames is one that a monitor or check here wants")
    return notes


def _configured(path: Path, monitor: str | None, *, trace: bool) -> Config:
    """Read the configuration, of one monitor if that is asked for."""
    config = load_config(path)
    if monitor is not None:
        config = only(config, monitor)
    if trace and len(config.monitor) != 1:
        raise InputError("of one monitor: --only NAME", key="--trace")
    return config


def _watches(config: Config) -> bool:
    return bool(config.monitor) or any(bus.check for bus in config.bus)


def _feed(gateway: FrameConsumer, log: Log, printer: EventPrinter, name: str, trace: Trace | None = None) -> None:
    """Feed a log, showing how far it is."""
    columns = (TextColumn(name), BarColumn(), TextColumn("{task.fields[frames]} frames"))
    console = Console(stderr=True)
    with Progress(
        *columns,
        TimeRemainingColumn(),
        console=console,
        transient=True,
        disable=trace is not None or not console.is_terminal,
    ) as progress:
        task = progress.add_task(name, total=log.reader.bytes_total, frames=0)
        seen = 0

        def show(frames: Frames) -> None:
            nonlocal seen
            seen += len(frames)
            progress.update(task, completed=log.reader.bytes_done, frames=seen)
            for step in trace.steps() if trace is not None else ():
                printer(step)

        def stamped() -> Iterator[Frames]:
            for frames in log:
                if not seen and not printer.start_ns and len(frames):
                    printer.start_ns = int(frames[0]["t_ns"])
                if trace is None:
                    yield frames
                else:  # one by one, for a look at each
                    yield from single(frames)

        feed(gateway, stamped(), progress=show, whole=lambda: log.whole)

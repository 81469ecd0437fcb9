"""``gateway replay``: a recorded log through the monitors."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from gateway.app import Gateway
from gateway.bus.frames import Frames
from gateway.bus.ring import read_recording
from gateway.cli.present import EventPrinter, find_config, say_if_cold, say_unless_stored
from gateway.config import channels_of, load_config
from gateway.replay import replay as feed


def replay(
    log: Path, config_path: Path | None, *, memory: Path | None, json: bool, fail_on_dtc: bool
) -> int:
    """Replay a log; returns the exit code."""
    path = find_config(config_path)
    config = load_config(path)
    say_if_cold()
    printer = EventPrinter(as_json=json)
    gateway = Gateway(config, memory, file=path)
    gateway.listen(printer)
    reader = read_recording(log, channels_of(config))
    columns = (TextColumn(log.name), BarColumn(), TextColumn("{task.fields[frames]} frames"))
    try:
        with Progress(
            *columns, TimeRemainingColumn(), console=Console(stderr=True), transient=True
        ) as progress:
            task = progress.add_task(log.name, total=reader.bytes_total, frames=0)
            seen = 0

            def show(frames: Frames) -> None:
                nonlocal seen
                seen += len(frames)
                progress.update(task, completed=reader.bytes_done, frames=seen)

            def stamped() -> Iterator[Frames]:
                for frames in reader:
                    if not seen and not printer.start_ns and len(frames):
                        printer.start_ns = int(frames[0]["t_ns"])
                    yield frames

            begun = time.monotonic()
            feed(gateway, stamped(), progress=show)
        printer(gateway.summary(time.monotonic() - begun))
        lost = say_unless_stored(gateway.stored, memory)
    finally:
        gateway.close()
    if lost:
        return lost
    return 1 if fail_on_dtc and printer.failures else 0

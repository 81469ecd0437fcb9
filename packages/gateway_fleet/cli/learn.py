"""``gateway learn``: a configuration from databases and healthy logs."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from gateway.cli.present import print_json
from gateway.signals.database import SUFFIXES
from gateway_fleet.learn.car import Asking, asked_for, learned
from gateway_fleet.learn.learn import Asked, Progress, Result
from gateway_fleet.learn.novelty import in_words
from gateway_fleet.learn.report import data, observed, summary

#: Time between two lines where no terminal is [s].
PERIOD_S = 5.0


def learn_car(
    files: Sequence[Path],
    *,
    out: Path,
    buses: Sequence[str],
    ecu: Path | None,
    hold_out: float,
    maps: Sequence[str],
    pgn: bool,
    seed: int,
    false_per_hour: float,
    update: bool,
    force: bool,
    json: bool,
) -> int:
    """Learn a configuration and write it; returns the exit code."""
    databases = [file for file in files if file.suffix.lower() in SUFFIXES]
    logs = [file for file in files if file not in databases]
    how = Asking(buses, ecu, hold_out, maps, seed, pgn=pgn, update=update, force=force, per_hour=false_per_hour)
    asked = asked_for(databases, logs, out, how)
    with _shown(json) as progress:
        result = learned(asked, progress)
    if json:
        print_json(data(result))
    else:
        _say(asked, result)
    return 0


def _say(asked: Asked, result: Result) -> None:
    found = summary(result)
    print(
        f"{asked.out}: {found['messages']} messages ({found['timeouts']} timeouts, {found['counters']} counters,"
        f" {found['checksums']} checksums),\n  limits of {found['signals']} signals, {found['relations']} relations;"
        f" from {found['frames']} frames, {found['seconds']:.0f} s"
    )
    print(in_words(found["new_per_minute"]))
    if found["kept"]:
        print(f"kept: {found['kept']} lines that were changed, taken out or added by hand")
    for finding in result.learned.findings:
        print(f"A FAULT IN WHAT WAS LEARNED FROM? {finding}")
    for change in result.changes:
        print(f"widened: {change}")
    for line in result.dropped:
        print(f"dropped: {line}")
    if result.alarms:
        print(f"healthy frames still set {', '.join(result.alarms)}: see these lines")
    elif found["held_out_frames"]:
        print(f"proof: silent on all, and on {found['held_out_frames']} frames, {found['held_out_s']:.0f} s held out")
    if result.trials.everyday:
        print("everyday faults put into these: tried, found, named, silent")
        for kind, counts in found["everyday"].items():
            print(f"  {kind:18}" + "".join(f"{count:4}" for count in counts))
    if result.conditions:
        print(f"the logs themselves: {', '.join(result.conditions)}")
    for line in (line for lines in observed(result).values() for line in lines):
        print(line)
    for note in result.learned.notes:
        print(note if len(note) <= 78 or "DOES NOT LOOK" in note else f"{note[:75]}...")
    print(f"{asked.out.with_suffix('.md')}: the evidence. Next: gateway check {asked.out}")


@contextmanager
def _shown(quiet: bool) -> Iterator[Progress]:
    """Show how far it is: a bar in a terminal, a line every 5 s in a pipe."""
    if sys.stderr.isatty() and not quiet:
        from rich.console import Console  # noqa: PLC0415 - only where a person looks
        from rich.progress import BarColumn, TextColumn  # noqa: PLC0415
        from rich.progress import Progress as Bars  # noqa: PLC0415

        columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.percentage:.0f} %"))
        with Bars(*columns, console=Console(stderr=True), transient=True) as bars:
            task = bars.add_task("", total=1.0)
            yield lambda what, which, done: bars.update(task, description=f"{what} {which}", completed=done)
        return
    said: list[Any] = [float("-inf"), ""]

    def line(what: str, which: str, done: float) -> None:
        now = time.monotonic()
        if now - said[0] >= PERIOD_S or (what != said[1] and said[1] == ""):
            said[:] = [now, what]
            print(f"{what} {which}: {100 * done:.0f} %", file=sys.stderr, flush=True)

    yield line

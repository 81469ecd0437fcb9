"""``gateway learn``: a configuration from databases and healthy logs."""

from __future__ import annotations

import json as json_text
import re
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from gateway.bus.ring import read_recording
from gateway.cli.present import print_json
from gateway.signals.database import SUFFIXES
from gateway_fdi.errors import InputError
from gateway_fleet.learn.answers import answers_asked
from gateway_fleet.learn.document import BusAsked, relative
from gateway_fleet.learn.learn import Asked, Progress, Result, learn, write
from gateway_fleet.learn.report import data, markdown, observed, summary
from gateway_fleet.learn.state import state_path

#: Time between two lines where no terminal is [s].
PERIOD_S = 5.0
#: Bus where none is named.
BUS = "can0"


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
    update: bool,
    force: bool,
    json: bool,
) -> int:
    """Learn a configuration and write it; returns the exit code."""
    databases = [file for file in files if file.suffix.lower() in SUFFIXES]
    logs = tuple(file for file in files if file not in databases)
    if not logs:
        raise InputError("name a log of a healthy drive, too, e.g. gateway learn car.dbc drive.log", key="LOG")
    if out.exists() and not (update or force):
        raise InputError("this file is there: --update adds the logs to it, --force overwrites it", file=out)
    if update and ecu is not None:
        raise InputError("the ECUs of a file that is updated are its own", key="--ecu", value=str(ecu))
    if update:
        asked_buses = answers_asked(out, out, update=True)
    elif ecu is not None:
        asked_buses = _with_databases(answers_asked(ecu, out), databases, buses, ecu)
    else:
        asked_buses = _buses(databases, buses, logs)
    if pgn:
        asked_buses = [bus if bus.of_answers else replace(bus, match="pgn") for bus in asked_buses]
    asked = Asked(
        name=re.sub(r"[^A-Za-z0-9_-]", "_", out.stem),
        buses=tuple(_relative(bus, out) for bus in asked_buses),
        logs=logs,
        out=out,
        hold_out=hold_out,
        maps=tuple(maps),
        seed=seed,
        update=update,
    )
    _all_there([*databases, *logs])
    with _shown(json) as progress:
        result = learn(asked, progress)
    page, state = markdown(asked, result), json_text.dumps(result.state) + "\n"
    write(result.files(out) | {out.with_suffix(".md"): page, state_path(out): state})
    if json:
        print_json(data(result))
    else:
        _say(asked, result)
    return 0


def _buses(databases: Sequence[Path], named: Sequence[str], logs: Sequence[Path]) -> list[BusAsked]:
    """Return the buses as asked for, ``NAME[=FILE[,FILE]]``; or one of all databases; or one a channel of the logs."""
    made: list[BusAsked] = []
    for text in named:
        name, equals, files = text.partition("=")
        paths = tuple(part for part in files.split(",") if part)
        if not re.fullmatch(r"[A-Za-z0-9_-]+", name) or bool(equals) != bool(paths):
            raise InputError("NAME[=DATABASE[,DATABASE]], e.g. powertrain=pt.dbc", key="--bus", value=text)
        _all_there([Path(path) for path in paths])
        made.append(BusAsked(name, f"socketcan:can{len(made)}", paths))
    if databases and made:
        raise InputError("with --bus, each database belongs to one of them", key="DATABASE", value=str(databases[0]))
    channels = [] if databases or made else _channels(logs)
    if len(channels) > 1:
        made = [BusAsked(name, f"socketcan:{name}", ()) for name in channels]
    return made or [BusAsked(BUS, f"socketcan:{BUS}", tuple(str(path) for path in databases))]


def _channels(logs: Sequence[Path]) -> list[str]:
    """Return the channels of logs, in order.

    Raises:
        InputError: a log that cannot be read; several channels, and one has a name that no bus can have.
    """
    seen: set[str] = set()
    for log in logs:
        reader = read_recording(log)
        for _ in reader:
            pass
        seen.update(name for name, frames in reader.seen.items() if frames)
    for name in seen if len(seen) > 1 else ():
        if not re.fullmatch(r"[A-Za-z0-9_-]+", name):
            text = f"no bus can be called as this channel is, one of {len(seen)}: name the buses by --bus and --map"
            raise InputError(text, file=logs[0], value=name)
    return sorted(seen)


def _with_databases(
    asked: Sequence[BusAsked], databases: Sequence[Path], named: Sequence[str], file: Path
) -> list[BusAsked]:
    """Return the buses of a file of ECUs with databases beside its own.

    Raises:
        InputError: databases of no bus, or of one that the file does not have.
    """
    made = list(asked)
    names = [bus.name for bus in asked if not bus.of_answers]
    if databases and len(names) > 1:
        raise InputError("of several buses: name the bus, --bus NAME=DATABASE", file=file, key="bus")
    more = {names[0]: BusAsked(names[0], "", tuple(str(path) for path in databases))} if databases and not named else {}
    more |= {bus.name: bus for bus in _buses(databases, named, ())} if named else {}
    for name, bus in more.items():
        if name not in names:
            raise InputError(f"the buses of {file} are {', '.join(names)}", key="--bus", value=name)
        k = names.index(name)
        made[k] = replace(made[k], databases=(*made[k].databases, *bus.databases))
    return made


def _relative(bus: BusAsked, out: Path) -> BusAsked:
    return replace(
        bus, databases=tuple(relative(Path(path), out.parent) for path in bus.databases), files=bus.databases
    )


def _all_there(paths: Sequence[Path]) -> None:
    for path in paths:
        if not path.exists():
            raise InputError("no such file", file=path)


def _say(asked: Asked, result: Result) -> None:
    found = summary(result)
    print(
        f"{asked.out}: {found['messages']} messages ({found['timeouts']} timeouts, {found['counters']} counters,"
        f" {found['checksums']} checksums),\n  limits of {found['signals']} signals, {found['relations']} relations;"
        f" from {found['frames']} frames, {found['seconds']:.0f} s"
    )
    if found["kept"]:
        print(f"kept: {found['kept']} lines that were changed, taken out or added by hand")
    for change in result.changes:
        print(f"widened: {change}")
    for line in result.dropped:
        print(f"dropped: {line}")
    if result.alarms:
        print(f"healthy frames still set {', '.join(result.alarms)}: see these lines")
    elif found["held_out_frames"]:
        print(f"proof: silent on all, and on {found['held_out_frames']} frames, {found['held_out_s']:.0f} s held out")
    if result.outcomes:
        print(f"{found['faults_named']} of {found['faults_tried']} faults put into these were named")
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

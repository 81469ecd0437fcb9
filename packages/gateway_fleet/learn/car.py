"""A car's databases and healthy logs to a configuration's file, with its evidence beside it."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from gateway.bus.logs import LogReader
from gateway_api.progress import Progress as Shown
from gateway_api.progress import shown
from gateway_fdi.errors import InputError
from gateway_fleet.learn.answers import answers_asked
from gateway_fleet.learn.document import BusAsked, relative
from gateway_fleet.learn.learn import Asked, Progress, Result, write
from gateway_fleet.learn.learn import learn as learn_from
from gateway_fleet.learn.report import data, markdown
from gateway_fleet.learn.state import state_path
from gateway_fleet.learn.tails import FALSE_PER_HOUR

#: Bus where none is named.
BUS = "can0"


@dataclass(frozen=True)
class Asking:
    """How is learned.

    Attributes:
        buses: ``NAME[=DATABASE[,DATABASE]]`` each; none: one of all databases, or one a channel of the logs.
        ecu: configuration whose ECUs are asked, None: none.
        hold_out: share of each log at its end that is not learned from.
        maps: channels of the logs taken as buses, ``"channel=bus"`` each.
        seed: of the faults that are put in.
        pgn: extended identifiers match by PGN.
        update: the logs are added to a file that is there.
        force: a file that is there is overwritten.
        per_hour: false codes of all limits of signals together that are accepted [1/h].
    """

    buses: Sequence[str] = ()
    ecu: Path | None = None
    hold_out: float = 0.3
    maps: Sequence[str] = ()
    seed: int = 1
    pgn: bool = False
    update: bool = False
    force: bool = False
    per_hour: float = FALSE_PER_HOUR


def asked_for(databases: Sequence[Path], logs: Sequence[Path], out: Path, how: Asking) -> Asked:
    """Return the request for a configuration.

    Args:
        databases: of the buses.
        logs: healthy ones.
        out: file of the configuration.
        how: is learned.

    Raises:
        InputError: a file is not there, or is in the way; buses that do not go with the databases.
    """
    if not logs:
        raise InputError("name a log of a healthy drive, too, e.g. gateway learn car.dbc drive.log", key="LOG")
    if out.exists() and not (how.update or how.force):
        raise InputError("this file is there: --update adds the logs to it, --force overwrites it", file=out)
    if how.update and how.ecu is not None:
        raise InputError("the ECUs of a file that is updated are its own", key="--ecu", value=str(how.ecu))
    if how.update:
        buses = answers_asked(out, out, update=True)
    elif how.ecu is not None:
        buses = _with_databases(answers_asked(how.ecu, out), databases, how.buses, how.ecu)
    else:
        buses = _buses(databases, how.buses, logs)
    if how.pgn:
        buses = [bus if bus.of_answers else replace(bus, match="pgn") for bus in buses]
    _all_there([*databases, *logs])
    return Asked(
        name=re.sub(r"[^A-Za-z0-9_-]", "_", out.stem),
        buses=tuple(_relative(bus, out) for bus in buses),
        logs=tuple(logs),
        out=out,
        hold_out=how.hold_out,
        maps=tuple(how.maps),
        seed=how.seed,
        update=how.update,
        per_hour=how.per_hour,
    )


def learned(asked: Asked, progress: Progress) -> Result:
    """Learn, and write the configuration with its evidence and what another drive is added to.

    Raises:
        InputError, InputErrors: a log is damaged, or a file cannot be written.
    """
    result, out = learn_from(asked, progress), asked.out
    page, state = markdown(asked, result), json.dumps(result.state) + "\n"
    write(result.files(out) | {out.with_suffix(".md"): page, state_path(out): state})
    return result


def learn(
    databases: Sequence[Path],
    logs: Sequence[Path],
    out: Path,
    *,
    overwrite: bool,
    update: bool,
    hold_out: float,
    maps: Sequence[str],
    seed: int,
    progress: Shown,
) -> tuple[Path, Mapping[str, Any]]:
    """Learn a configuration; see :func:`gateway_api.learn`. Returns its file, and what was learned."""
    how = Asking(hold_out=hold_out, maps=maps, seed=seed, update=update, force=overwrite)
    asked = asked_for(databases, logs, out, how)
    with shown(progress) as report:
        result = learned(asked, lambda what, which, done: report(done))
    return out, data(result)


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
        reader = LogReader(log)
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

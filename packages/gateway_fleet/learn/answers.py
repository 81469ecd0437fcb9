"""Answers of ECUs, of which less is learned than of what is broadcast: they come when somebody asks.

How often they come is the habit of a tester, not of the ECU, and one that asks more seldom hides how steep a signal is
and how long it stands. So there is no timeout but one that the file of the ECUs asks for, and no gradient, standstill
or counter; ranges and relations there are, at the rate at which they come.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import tomlkit

from gateway.bus.frames import EXTENDED
from gateway.config.load import load_config
from gateway.config.resolve import answer_buses
from gateway_fdi.errors import InputError
from gateway_fleet.learn.document import BusAsked, EcuAsked, relative
from gateway_fleet.learn.limit_relaxation import asks
from gateway_fleet.learn.limits import signal_lines
from gateway_fleet.learn.lines import CHECK, HEALTH, Learned, Line
from gateway_fleet.learn.observe import Observation, Seen
from gateway_fleet.learn.protections import ProtectionFound
from gateway_fleet.learn.ranges import Shown

#: Keys of a bus that learning has itself.
_OF_BUS = ("name", "uri", "database", "match", "codes")
#: No counter or checksum is looked for.
NOTHING = ProtectionFound(None, None, (), 0)
#: Keys of a signal's line that depend on how often it is asked for.
_OF_RHYTHM = ("gradient", "stuck")

#: Keys of a check that it may have of another log, and that no tester's habit gives.
_LEARNED = {"message", "length", "value"}


def answers_asked(file: Path, out: Path, *, update: bool = False) -> list[BusAsked]:
    """Return the buses of a file of ECUs, and behind them those of their answers.

    Args:
        file: of ``[[bus]]`` and ``[[ecu]]``.
        out: the configuration to be written: paths are relative to its folder.
        update: the file is that configuration, whose checks are learned ones but for what only a person writes.

    Raises:
        InputError, InputErrors: the file or a layout is wrong; it has more than buses and ECUs.
    """
    config = load_config(file)
    text = tomlkit.parse(file.read_text())
    if not update:
        _refuse_more(text, file)
    tables = text.get("bus", [])
    made = [
        BusAsked(
            bus.name,
            bus.uri,
            tuple(str(path) for path in bus.database),
            bus.match,
            keys={key: value for key, value in table.items() if key not in _OF_BUS and not (update and key == HEALTH)},
        )
        for bus, table in zip(config.bus, tables, strict=True)
    ]
    for bus, ecus, answers in zip(
        config.buses[len(config.bus) :], config.answered.values(), answer_buses(config), strict=True
    ):
        found = []
        for at, k in enumerate(ecus):
            table = dict(text["ecu"][k])
            checks = {str(each["message"]): dict(each) for each in _plain(table.pop("check", []))}
            if update:
                checks = {name: keys for name, keys in checks.items() if set(keys) - _LEARNED}
            if config.ecu[k].signals:
                table["signals"] = [relative(path, out.parent) for path in config.ecu[k].signals]
            table.setdefault("bus", config.bus[0].name)
            ids = {page.can_id & ~EXTENDED for pages in answers.pages[at].values() for page in pages}
            names = frozenset(message.name for message in answers.database if message.frame_id in ids)
            found.append(EcuAsked(config.ecu[k], table, checks, names))
        made.append(BusAsked(bus.name, bus.uri, (), ecus=tuple(found)))
    return made


def _plain(value: Any) -> Any:
    return value.unwrap() if hasattr(value, "unwrap") else value


def _refuse_more(text: Mapping[str, Any], file: Path) -> None:
    """Refuse a file that says more than this command takes from it."""
    for key in text:
        if key not in ("name", "bus", "ecu"):
            raise InputError("only [[bus]] and [[ecu]] are taken from a file of ECUs", file=file, key=key)
    if "ecu" not in text:
        raise InputError("there is no [[ecu]] in it", file=file, key="ecu")
    for k, bus in enumerate(text.get("bus", [])):
        if "check" in bus:
            raise InputError("checks of a bus are learned, not taken from here", file=file, key=f"bus[{k}].check")


def answer_lines(learned: Learned, bus: BusAsked, seen: Seen, seconds: float, taken: set[str], drive: Shown) -> None:
    """Add what is asked of an answer and its signals.

    Args:
        learned: gets the lines.
        bus: of the answers.
        seen: of one message.
        seconds: length of the logs [s].
        taken: names of faults that are in use; those of the lines are added.
        drive: values of all signals, and how often a healthy one may alarm.
    """
    name = seen.message.name
    given = next((ecu.checks[name] for ecu in bus.ecus if name in ecu.checks), None)
    why = f"{seen.frames} answers; " + (
        "as the file of the ECUs asks" if given else "no timeout: they come when asked for"
    )
    learned.add(Line(bus.name, CHECK, name, given or {"message": name}, why))
    for line in signal_lines(bus.name, seen, NOTHING, seconds, taken, drive):
        keys = {key: value for key, value in line.keys.items() if key not in _OF_RHYTHM}
        if asks(line.table, keys):
            learned.add(replace(line, keys=keys))


def absent_lines(learned: Learned, bus: BusAsked) -> None:
    """Add the checks that the file of the ECUs asks for of answers that did not come."""
    for ecu in bus.ecus:
        for name, keys in ecu.checks.items():
            if (bus.name, CHECK, name) not in learned.lines:
                learned.add(Line(bus.name, CHECK, name, keys, "no answer in the logs; as the file of the ECUs asks"))


def answer_notes(observation: Observation, buses: Sequence[BusAsked]) -> list[str]:
    """Return which answers came, and what is not asked of them; one line a bus."""
    notes = []
    for index, bus in enumerate(buses):
        came = sorted(name for at, name in observation.seen if at == index)
        absent = sum(at == index for at, _ in observation.absent)
        if bus.ecus:
            names = f" ({', '.join(came)})" if came else ""
            notes.append(
                f"{bus.name}: of {len(came) + absent} answers that have a layout {len(came)} came{names};"
                " when they come is up to who asks: no timeout, gradient or standstill is learned of them"
            )
    return notes

"""The learned configuration as a file: grouped, one line a message, signal or relation, each with its evidence."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from gateway.config.ecu import EcuParams
from gateway_fleet.learn.lines import CAUSE, CHECK, HEALTH, RULE, SIGNAL, Learned, Line, inline


@dataclass(frozen=True)
class EcuAsked:
    """An ECU as the user's file has it.

    Attributes:
        params: of it.
        keys: of its table but its checks; files relative to the configuration.
        checks: of its answers, by message.
        messages: names of its answers.
    """

    params: EcuParams
    keys: Mapping[str, Any]
    checks: Mapping[str, Mapping[str, Any]]
    messages: frozenset[str]


@dataclass(frozen=True)
class BusAsked:
    """A bus as the user names it.

    Attributes:
        name: of it.
        uri: where it is.
        databases: files, relative to the configuration.
        match: as in the configuration.
        files: the databases' files as given, relative to where the command runs; empty: as ``databases``.
        keys: others of the user's file of ECUs.
        ecus: of a bus of answers, which nothing opens: those whose answers come on it.
    """

    name: str
    uri: str
    databases: tuple[str, ...]
    match: Literal["id", "pgn"] = "id"
    files: tuple[str, ...] = ()
    keys: Mapping[str, Any] = field(default_factory=dict)
    ecus: tuple[EcuAsked, ...] = ()

    @property
    def of_answers(self) -> bool:
        """Whether it is a bus ``answers:<bus>``."""
        return self.name.startswith("answers:")


_POWER = """
# While it moves it is not being switched off: who stops then is at fault.
[power]
moving = {}
"""

_CAUSES = """
# Of a signal that has a fault of its own no relation says any more.
[fault]
"""

#: A signal in the text of a relation.
SIGNAL_NAME = re.compile(r"[A-Za-z_][\w-]*(?:\.[A-Za-z_]\w*)+")

_HEAD = """\
#:schema gateway.schema.json
# {title}
#
# Learned from healthy logs: {logs}.
# One line a message, signal or relation; after it its evidence. Change lines that you know better: `gateway learn
# --update` keeps every line that you changed, took out or added. Meaning of the keys: docs/protections.md,
# docs/signals.md, docs/configure.md.

name = {name}
"""

_BUS = """
[[bus]]
name = {name}
uri = {uri}
database = {database}{match}
codes = "own"                           # each message DTCs of its own: gateway check lists them
check = [
{lines}
]
"""

_MONITOR = """
# {what}
[[monitor]]
name = {name}
type = "{type}"
bus = {bus}
{type} = [
{lines}
]
"""


def document(name: str, buses: Sequence[BusAsked], learned: Learned, logs: Sequence[str]) -> str:
    """Return the text of the configuration."""
    title = f"{name}: {sum(len(learned.of(bus.name, CHECK)) for bus in buses)} messages"
    text = _HEAD.format(title=title, logs="; ".join(logs), name=inline(name))
    for bus in buses:
        text += "".join(_ecu(ecu, bus.name, learned) for ecu in bus.ecus)
        if bus.of_answers:
            continue
        more = "".join(f"\n{key} = {inline(value)}" for key, value in bus.keys.items())
        more += "".join(f"\n{line.text()}" for line in learned.of(bus.name, HEALTH))
        text += _BUS.format(
            name=inline(bus.name),
            uri=inline(bus.uri),
            database=inline(list(bus.databases)),
            match=("" if bus.match == "id" else f"\nmatch = {inline(bus.match)}") + more,
            lines=_lines(learned, bus.name, CHECK),
        )
    for bus in buses:
        for table in (SIGNAL, RULE):
            if learned.of(bus.name, table):
                text += monitor_text(bus, table, buses, learned)
    if learned.moving:
        text += _POWER.format(inline(learned.moving))
    if made := causes(buses, learned):
        text += _CAUSES + "".join(f"{line.text()}\n" for line in made)
    if learned.notes:
        text += "\n# Not in it:\n" + "".join(f"# {line}\n" for note in learned.notes for line in _folded(note))
    return text


def _ecu(ecu: EcuAsked, bus: str, learned: Learned) -> str:
    """Return the text of an ECU, with the checks of its answers."""
    text = "\n[[ecu]]\n"
    for key, value in ecu.keys.items():
        if key == "read":
            text += "read = [\n" + "".join(f"    {inline(each)},\n" for each in value) + "]\n"
        else:
            text += f"{key} = {inline(value)}\n"
    lines = [line.text() for line in learned.of(bus, CHECK) if line.name in ecu.messages]
    return text + "".join(["check = [\n", *(f"{line}\n" for line in lines), "]\n"])


_WHAT = {SIGNAL: "Signals: ranges, steepness, invalid codes.", RULE: "Signals that follow each other."}


def monitor_text(bus: BusAsked, table: str, buses: Sequence[BusAsked], learned: Learned) -> str:
    """Return the text of the monitor of a bus's signals or relations."""
    return _MONITOR.format(
        what=_WHAT[table], name=inline(monitor_name(bus.name, table, buses)), type=table, bus=inline(bus.name),
        lines=_lines(learned, bus.name, table),
    )  # fmt: skip


#: Keys of a signal's line -> its faults.
_FAULTS = {
    "plausible": ("low", "high"), "gradient": ("gradient",), "stuck": ("stuck",), "undefined": ("undefined",),
    "invalid": ("invalid",),
}  # fmt: skip


def causes(buses: Sequence[BusAsked], learned: Learned) -> list[Line]:
    """Return that of a signal with a fault of its own no relation says any more."""
    faults: dict[str, list[str]] = {}
    for bus in buses:
        for line in learned.of(bus.name, SIGNAL):
            name = line.keys.get("name", line.name.rpartition(".")[2])
            mine = [kind for key, kinds in _FAULTS.items() if line.keys.get(key) for kind in kinds]
            prefix = f"{monitor_name(bus.name, SIGNAL, buses)}.{name}"
            faults[f"{bus.name}.{line.name}"] = [f"{prefix}.{kind}" for kind in mine]
    lines = []
    for bus in buses:
        for line in learned.of(bus.name, RULE):
            found = []
            for signal in dict.fromkeys(SIGNAL_NAME.findall(line.keys["holds"])):
                full = signal if signal.count(".") == 2 else f"{bus.name}.{signal}"
                found += faults.get(full, [])
            if found:
                fault = f"{monitor_name(bus.name, RULE, buses)}.{line.name}"
                lines.append(Line("", CAUSE, fault, {"caused_by": found}, ""))
    return lines


def monitor_name(bus: str, table: str, buses: Sequence[BusAsked]) -> str:
    """Return what the monitor of a bus's signals or relations is called."""
    name = {SIGNAL: "signals", RULE: "relations"}[table]
    return name if len(buses) == 1 else f"{bus.replace(':', '_')}_{name}"


def _lines(learned: Learned, bus: str, table: str) -> str:
    return "\n".join(line.text() for line in learned.of(bus, table))


def _folded(text: str, width: int = 110) -> list[str]:
    lines, line = [], ""
    for word in text.split(" "):
        if line and len(line) + len(word) >= width:
            lines.append(line)
            line = "    " + word
        else:
            line = f"{line} {word}" if line else word
    return [*lines, line]


def relative(database: Path, folder: Path) -> str:
    """Return a database's path as a configuration in a folder has it."""
    return os.path.relpath(database.resolve(), folder.resolve())

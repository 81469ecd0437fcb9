"""What was learned as a configuration file: grouped, one line a message, signal or relation, each with its evidence."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from gateway.learn.lines import CHECK, RULE, SIGNAL, Learned, inline


@dataclass(frozen=True)
class BusAsked:
    """A bus as the user names it: name, URI, its database's files relative to the configuration."""

    name: str
    uri: str
    databases: tuple[str, ...]
    match: str = "id"


_HEAD = """\
# {title}
#
# Learned from healthy logs: {logs}.
# One line a message, signal or relation; behind it what it stands on. Change what you know better: `gateway learn
# --update` keeps every line that you changed, took out or added. What the keys mean: docs/protections.md,
# docs/signals.md, docs/configure.md.

name = {name}
"""

_BUS = """
[[bus]]
name = {name}
uri = {uri}
database = {database}{match}

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
    """Return the text of the configuration.

    Args:
        name: of the gateway.
        buses: of it.
        learned: lines and notes.
        logs: what was read, for people.
    """
    title = f"{name}: {sum(len(learned.of(bus.name, CHECK)) for bus in buses)} messages"
    text = _HEAD.format(title=title, logs="; ".join(logs), name=inline(name))
    for bus in buses:
        text += _BUS.format(
            name=inline(bus.name),
            uri=inline(bus.uri),
            database=inline(list(bus.databases)),
            match="" if bus.match == "id" else f"\nmatch = {inline(bus.match)}",
            lines=_lines(learned, bus.name, CHECK),
        )
    for bus in buses:
        for table, what in ((SIGNAL, "Signals: ranges, steepness, invalid codes."), (RULE, "Signals that follow each other.")):
            if learned.of(bus.name, table):
                text += _MONITOR.format(
                    what=what, name=inline(monitor_name(bus.name, table, buses)), type=table, bus=inline(bus.name),
                    lines=_lines(learned, bus.name, table),
                )  # fmt: skip
    if learned.notes:
        text += "\n# Not in it:\n" + "".join(f"# {line}\n" for note in learned.notes for line in _folded(note))
    return text


def monitor_name(bus: str, table: str, buses: Sequence[BusAsked]) -> str:
    """Return what the monitor of a bus's signals or relations is called."""
    name = {SIGNAL: "signals", RULE: "relations"}[table]
    return name if len(buses) == 1 else f"{bus}_{name}"


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

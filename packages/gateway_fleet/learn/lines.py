"""Learned lines: each an entry of a configuration, with its evidence."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import tomlkit
from tomlkit.items import Item

#: Tables that lines belong to.
CHECK, SIGNAL, RULE, CAUSE, HEALTH = "check", "signal", "rule", "fault", "health"


@dataclass(frozen=True)
class Line:
    """One entry of a table.

    Attributes:
        bus: name of the bus.
        table: CHECK, SIGNAL, RULE; CAUSE: faults that a fault is not told beside; HEALTH: of the bus, one line each.
        name: of the message, of the signal ("Message.Signal"), of the rule, or of the fault; HEALTH.
        keys: of the entry.
        why: its evidence, for people.
    """

    bus: str
    table: str
    name: str
    keys: Mapping[str, Any]
    why: str

    @property
    def place(self) -> tuple[str, str, str]:
        """Key by which it is found again."""
        return self.bus, self.table, self.name

    def text(self) -> str:
        """Return it as it stands in the file."""
        if self.table == CAUSE:
            return f'"{self.name}".caused_by = {inline(self.keys["caused_by"])}'
        if self.table == HEALTH:
            known = ", ".join(f"0x{can_id:X}" for can_id in self.keys["known"])
            more = "".join(f"{key} = {inline(value)}, " for key, value in self.keys.items() if key != "known")
            return f"health = {{{more}known = [{known}]}}  # {self.why}"
        return f"    {inline(self.keys)},  # {self.why}"


@dataclass
class Learned:
    """All that goes into a configuration.

    Attributes:
        lines: by their places, in the order of the file.
        notes: things left out, and why; one line each.
        findings: what looks like a fault of the logs that were learned from; one line each.
        moving: conditions that say that the vehicle moves.
    """

    lines: dict[tuple[str, str, str], Line] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    findings: list[str] = field(default_factory=list)
    moving: list[dict[str, Any]] = field(default_factory=list)

    def add(self, *lines: Line) -> None:
        """Add lines."""
        self.lines |= {line.place: line for line in lines}

    def of(self, bus: str, table: str) -> list[Line]:
        """Return the lines of one table."""
        return [line for line in self.lines.values() if (line.bus, line.table) == (bus, table)]


def inline(value: Any) -> str:
    """Return a value in TOML on one line."""
    return str(_item(value).as_string())


def _item(value: Any) -> Item:
    if isinstance(value, Mapping):
        table = tomlkit.inline_table()
        for key, each in value.items():
            table.append(key, _item(each))
        return table
    if isinstance(value, list | tuple):
        array = tomlkit.array()
        for each in value:
            array.append(_item(each))
        return array
    made: Item = tomlkit.item(value)
    return made


def short(value: float, digits: int = 4) -> float:
    """Return a number with few digits, as people write it; whole ones stay whole."""
    return float(f"{value:.{digits}g}")


def shown(value: float) -> str:
    """Return a number for a comment."""
    return f"{value:.4g}"

"""New lines put into a file that a person has edited: lines changed, taken out or added by hand stay as they are."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from gateway_fdi.common.tomlfile import parse_toml
from gateway_fleet.learn.document import BusAsked, causes, monitor_text
from gateway_fleet.learn.lines import CAUSE, CHECK, HEALTH, RULE, SIGNAL, Learned, Line

#: A line of a table that we have written, whole on one line.
_ENTRY = re.compile(r"\s*(?P<entry>\{.*\})\s*,?\s*(?:#.*)?$")
_KEY = re.compile(r'\s*(?P<key>[A-Za-z_]+)\s*=\s*"(?P<value>[^"]*)"')
_ARRAY = re.compile(r"\s*(?P<key>check|signal|rule)\s*=\s*\[\s*(?:#.*)?$")
_CAUSE = re.compile(r'\s*"(?P<fault>[^"]+)"\.caused_by\s*=\s*(?P<list>\[.*\])\s*(?:#.*)?$')
_HEALTH = re.compile(r"\s*health\s*=\s*(?P<table>\{.*\})\s*(?:#.*)?$")
_HEADER = re.compile(r"\s*\[+(?P<name>[^\]]+)\]+")
#: Which key of an entry is its name.
_NAMED = {CHECK: "message", SIGNAL: "signal", RULE: "name"}


@dataclass(frozen=True)
class Found:
    """An entry in the file.

    Attributes:
        number: of its line, from 0.
        place: bus, table, name.
        keys: of it.
    """

    number: int
    place: tuple[str, str, str]
    keys: dict[str, Any]


@dataclass
class File:
    """A configuration's text with what was found in it.

    Attributes:
        lines: of the text.
        found: entries by place.
        ends: (bus, table) -> number of the line that ends its array, or that its one line goes before.
    """

    lines: list[str]
    found: dict[tuple[str, str, str], Found]
    ends: dict[tuple[str, str], int]


def read(text: str) -> File:
    """Find the health of buses, and the entries of checks, signals and relations, in a configuration."""
    file = File(text.splitlines(), {}, {})
    tables = parse_toml(text).get("bus", [])
    buses = [str(bus.get("name", "")) for bus in tables]
    for name, keys in zip(buses, tables, strict=True):
        if "health" in keys:  # in a form of a person's, until its line is found
            file.found[name, HEALTH, HEALTH] = Found(-1, (name, HEALTH, HEALTH), {})
    bus, table, of, section = "", "", "", -1
    for number, line in enumerate(file.lines):
        header = _HEADER.match(line)
        key = _KEY.match(line)
        array = _ARRAY.match(line)
        if header is not None and not table:
            of = "answers:" if header["name"].strip() == "ecu" else ""
            bus = of + buses[0] if len(buses) == 1 else ""
            section += header["name"].strip() == "bus"
            if header["name"].strip() == "bus":
                file.ends[buses[section], HEALTH] = number + 1
        elif table and line.strip().startswith("]"):
            file.ends[bus, table] = number
            table = ""
        elif table:
            _note(file, number, line, bus, table)
        elif cause := _CAUSE.match(line):
            place = "", CAUSE, cause["fault"]
            file.found[place] = Found(number, place, {"caused_by": tomllib.loads(f"x = {cause['list']}")["x"]})
            file.ends["", CAUSE] = number + 1
        elif (health := _HEALTH.match(line)) and section >= 0:
            place = buses[section], HEALTH, HEALTH
            file.found[place] = Found(number, place, tomllib.loads(f"x = {health['table']}")["x"])
        elif array is not None:
            table = array["key"]
        elif key is not None and (key["key"] == "bus" or (key["key"] == "name" and key["value"] in buses)):
            bus = of + key["value"] if key["key"] == "bus" or not of else bus
    return file


def _note(file: File, number: int, line: str, bus: str, table: str) -> None:
    entry = _ENTRY.match(line)
    if entry is None:
        return
    try:
        keys = tomllib.loads(f"x = {entry['entry']}")["x"]
    except tomllib.TOMLDecodeError:
        return
    name = keys.get(_NAMED[table])
    if isinstance(name, str):
        file.found[bus, table, name] = Found(number, (bus, table, name), keys)


def of_a_person(file: File, written: Mapping[tuple[str, str, str], Line]) -> set[tuple[str, str, str]]:
    """Return the places that a person has changed, taken out or added.

    Args:
        file: as it is now.
        written: lines that we wrote last, by place.
    """
    added = {place for place in file.found if place not in written}
    gone = {place for place in written if place not in file.found}
    changed = {
        place for place, line in written.items() if place in file.found and file.found[place].keys != _plain(line.keys)
    }
    return added | gone | changed


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(each) for key, each in value.items()}
    return [_plain(each) for each in value] if isinstance(value, list | tuple) else value


def merged(
    file: File,
    learned: Learned,
    written: Mapping[tuple[str, str, str], Line],
    kept: set[tuple[str, str, str]],
    buses: Sequence[BusAsked],
) -> str:
    """Return the text with our lines put in; a person's stay as they are.

    Args:
        file: as it is now.
        learned: lines without those of a person's places.
        written: lines that we wrote last.
        kept: a person's places.
        buses: as asked for.
    """
    ours = dict(learned.lines)
    theirs = {place: Line(*place, found.keys, "") for place, found in file.found.items() if place in kept}
    for line in causes(buses, Learned(ours | theirs)):
        ours[line.place] = line
    base = dict(written) | {line.place: line for line in causes(buses, Learned(dict(written)))}
    hand = kept | {place for place in of_a_person(file, base) if place[1] == CAUSE}
    ours = {place: line for place, line in ours.items() if place not in hand}
    gone = {place for place in base if place not in ours and place not in hand}
    text = "\n".join(_text(file, ours, gone)) + "\n"
    for bus in buses:
        for table in (SIGNAL, RULE):
            if (bus.name, table) not in file.ends and learned.of(bus.name, table):
                text += monitor_text(bus, table, buses, learned)
    if ("", CAUSE) not in file.ends:
        lines = [line.text() for line in ours.values() if line.table == CAUSE]
        head = "" if re.search(r"^\[fault\]", text, re.MULTILINE) else "\n[fault]\n"
        text += head + "".join(f"{line}\n" for line in lines) if lines else ""
    return text


def _text(file: File, ours: Mapping[tuple[str, str, str], Line], gone: set[tuple[str, str, str]]) -> Iterator[str]:
    at = {found.number: found.place for found in file.found.values()}
    ends = {number: where for where, number in file.ends.items()}
    new: dict[tuple[str, str], list[Line]] = {}
    for place, line in ours.items():
        if place not in file.found:
            new.setdefault(place[:2], []).append(line)
    for number, text in enumerate([*file.lines, ""]):
        if number in ends:
            yield from (line.text() for line in new.get(ends[number], []))
        mine = at.get(number)
        if number == len(file.lines) or mine in gone:
            continue
        yield ours[mine].text() if mine is not None and mine in ours else text

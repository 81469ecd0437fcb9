"""Every mistake of a configuration at once.

A configuration is read and built in stages, each of which refuses the mistakes it finds: keys, relations between
tables, names of the databases, inputs of monitors, codes. So that one stage does not hide the next, the tables that are
wrong are taken out of the configuration, and the rest is tried again until it is right.

A table that is taken out makes others wrong that name it: the faults of a monitor, the monitors of a bus, ... Such
consequences are taken out, too, and not told. A possible consequence is not told either: it comes when the rest is
mended.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from copy import deepcopy
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from gateway.config.load import config_of
from gateway.config.model import Config
from gateway.monitors.registry import MONITORS
from gateway.runtime.app import Gateway
from gateway_fdi.common.tomlfile import key_path, read_toml, texts_in
from gateway_fdi.errors import InputError, InputErrors

#: A table, or a key that stands alone, by its path: ``("bus", 0, "check", 2)``.
Place = tuple[str | int, ...]

#: Keys of a bus that nothing depends on -> what stands for one that is wrong; None: nothing.
_ALONE = {"uri": "virtual:check", "bitrate": None, "data_bitrate": None}
#: Tables that nothing else names.
_UNNAMED = {"name", "clock", "memory", "access", "usage", "status", "record", "report"}
_TOKEN = re.compile(r'"([^"]*)"|\[(\d+)\]|([\w-]+)')
_LISTED = re.compile(r"\b(bus\[\d+\]\.check|monitor|did|ecu)\[(\d+)\]")
_AFTER_ALL = 1 << 30


def mistakes(path: Path) -> list[InputError]:
    """Return the mistakes of a configuration in the order of its file, as far as none hides another."""
    try:
        rest = _Rest(path, read_toml(path))
    except InputError as error:
        return [error]
    while errors := list(_refused(rest.data, path)):
        if not rest.take_out(errors):
            break
    return rest.found


def _refused(data: dict[str, Any], path: Path) -> Iterator[InputError]:
    """Yield what the first stage says that refuses the data."""
    try:
        Gateway(config_of(deepcopy(data), path), None, file=path).close()
    except InputErrors as errors:
        yield from (error.within(path) for error in errors.errors)
    except InputError as error:
        yield error.within(path)


class _Rest:
    """The rest of a configuration, and the mistakes found."""

    def __init__(self, path: Path, data: dict[str, Any]) -> None:
        self._path, self._whole, self.data = path, data, deepcopy(data)
        self._found: dict[str, tuple[tuple[int, ...], InputError]] = {}
        self._origin: dict[str, list[int]] = {}  # list of tables -> the numbers in the file of those that are left
        self._gone = _Gone()

    @property
    def found(self) -> list[InputError]:
        """The mistakes, in the order of the file."""
        return [error for _, error in sorted(self._found.values(), key=lambda each: each[0])]

    def take_out(self, errors: Iterable[InputError]) -> bool:
        """Note what is a mistake, and take out the tables that are wrong; returns whether the rest can be tried."""
        before = deepcopy(self.data)
        wrong: set[Place] = set()
        placed = True
        for error in errors:
            tokens = _tokens(error.key)
            places = list(self._places(error, tokens))
            if not self._gone.explains(error, tokens):
                self._note(error, places)
            placed = placed and bool(places)
            wrong.update(places)
        wrong |= {other for place in wrong for other in self._dependent(place)}
        # The last of a list first, so that the others keep their numbers, and the contents of a table before the table.
        for place in sorted(
            wrong, key=lambda place: [(isinstance(token, str), token) for token in place], reverse=True
        ):
            self._gone.note(place, self.data)
            self._remove(place)
        return placed and self.data != before

    def _note(self, error: InputError, places: list[Place]) -> None:
        """Add a mistake, with the numbers that tables have in the file."""
        key = None if error.key is None else self._as_written(error.key)
        told = InputError(self._as_written(error.message), file=error.file, line=error.line, key=key, value=error.value)
        tokens, table = _tokens(key), _tokens(self._as_written(key_path(places[0])) if places else None)
        where = tokens if tokens[: len(table)] == table else table
        self._found.setdefault(str(told), (_rank(self._whole, where), told))

    def _as_written(self, text: str) -> str:
        def numbered(found: re.Match[str]) -> str:
            origin, number = self._origin.get(found[1]), int(found[2])
            return f"{found[1]}[{number if origin is None else origin[number]}]"

        return _LISTED.sub(numbered, text)

    # Where an error stands

    def _places(self, error: InputError, tokens: Place) -> Iterator[Place]:
        """Yield the tables that are wrong by an error; none: it is not known which."""
        head, second = (*tokens, None, None)[:2]
        if head == "monitor" and second == "type":  # of a plug-in
            yield from (("monitor", k) for k, table in self._tables("monitor") if _type_of(table) in tokens[2:3])
        elif head == "monitor" and isinstance(second, str):
            yield from (("monitor", k) for k, table in self._tables("monitor") if table.get("name") == second)
        elif error.file != str(self._path):
            yield from self._naming(Path(error.file or ""))
        elif head == "bus":
            yield from self._of_bus(tokens)
        elif head in ("monitor", "did", "ecu", "fault", "cycle", "output"):
            if len(tokens) > 1 and _has(self.data, tokens[:2]):
                yield tokens[:2]
        elif isinstance(head, str) and head in self.data and self._is_unnamed(head):
            yield (head,)

    def _of_bus(self, tokens: Place) -> Iterator[Place]:
        if not _has(self.data, tokens[:2]) or len(tokens) < 2 or tokens[2:3] == ("name",):
            return  # the bus of each table is not known
        if tokens[2:3] == ("check",) and len(tokens) > 3:
            yield tokens[:4]
        else:
            yield tokens[:3] if tokens[2:3] and tokens[2] in _ALONE else tokens[:2]

    def _is_unnamed(self, head: str) -> bool:
        """Return whether nothing names a table; one that is misspelt is taken for what it is near to."""
        near = get_close_matches(head, Config.model_fields, n=1, cutoff=0.5)
        return head in _UNNAMED or not isinstance(self.data[head], list | dict) or bool(near and near[0] in _UNNAMED)

    def _tables(self, kind: str) -> Iterator[tuple[int, dict[str, Any]]]:
        tables = self.data.get(kind)
        yield from (
            (k, table) for k, table in enumerate(tables if isinstance(tables, list) else ()) if isinstance(table, dict)
        )

    def _naming(self, file: Path) -> Iterator[Place]:
        """Yield the tables that name another file."""
        of_lists: list[tuple[Place, Any]] = [
            ((kind, k), t) for kind in ("bus", "monitor", "ecu") for k, t in self._tables(kind)
        ]
        outputs = self.data.get("output")
        of_outputs: list[tuple[Place, Any]] = [
            (("output", name), table) for name, table in (outputs.items() if isinstance(outputs, dict) else ())
        ]
        for place, table in of_lists + of_outputs:
            if any((self._path.parent / text).resolve() == file.resolve() for text in texts_in(table)):
                yield place

    def _dependent(self, place: Place) -> Iterator[Place]:
        """Yield the tables that mean nothing without another."""
        if place == ("output", "uds") and "access" in self.data:  # its levels and roles
            yield ("access",)
        if len(place) == 2 and place[0] == "bus":
            name, alone = self.data["bus"][place[1]].get("name"), len(self.data["bus"]) == 1
            on_it = {name, None} if alone else {name}
            kinds = ("monitor", "ecu")
            yield from ((kind, k) for kind in kinds for k, table in self._tables(kind) if table.get("bus") in on_it)

    def _remove(self, place: Place) -> None:
        *above, last = place
        table = _at(self.data, above)
        if above == ["bus"]:  # the others keep their numbers, and its senders a bus
            table[last] = {"name": table[last].get("name"), "uri": _ALONE["uri"], "health": {"watched": False}}
        elif len(place) == 3 and _ALONE[str(last)] is not None:
            table[last] = _ALONE[str(last)]
        else:
            if isinstance(last, int):
                self._origin.setdefault(key_path(tuple(above)), list(range(len(table)))).pop(last)
            table.pop(last)


class _Gone:
    """Names in the tables that have been taken out; others may use them."""

    def __init__(self) -> None:
        self._owners: set[str] = set()  # of faults and live values: monitors, buses
        self._buses: set[str] = set()
        self._names: set[str] = set()  # of cycles and identifiers
        self._faults = self._any_owner = False

    def note(self, place: Place, data: dict[str, Any]) -> None:
        """Note a table before it is taken out."""
        head = place[0]
        table = _at(data, place[:2])
        name = str(table.get("name")) if isinstance(table, dict) else ""
        if head == "bus" and len(place) != 3:
            self._owners.add(name)  # a check's, too: its message may be misspelt
            self._buses |= {name} if len(place) == 2 else set()
        elif head == "monitor":
            self._owners.add(name)
            self._any_owner = self._any_owner or not isinstance(table.get("name"), str)
        elif head == "ecu":
            buses = [str(bus.get("name")) for bus in data.get("bus", ()) if isinstance(bus, dict)]
            bus = table.get("bus", buses[0] if buses else "") if isinstance(table, dict) else ""
            self._owners |= {name, f"answers:{bus}"}
            self._buses.add(f"answers:{bus}")
        elif head == "report":
            self._owners |= {name for name in texts_in(table) if "." not in name}
        elif head in ("did", "cycle"):
            self._names.add(name if head == "did" else str(place[1]))
        elif head == "fault":
            self._faults = True

    def explains(self, error: InputError, tokens: Place) -> bool:
        """Return whether an error may be a consequence."""
        value, last = "" if error.value is None else str(error.value), tokens[-1] if tokens else ""
        if tokens[:1] == ("fault",) and len(tokens) == 2:
            return self._lacks(str(tokens[1]))
        if last == "caused_by":
            return self._lacks(value)
        if tokens[:1] == ("fault",) and last in ("dtc", "spn"):  # two faults have it; one may have had another
            return self._faults
        if tokens[:1] == ("bus",) and len(tokens) == 4:  # two checks have the same codes
            return self._faults
        owner, colon, _ = value.partition(":")
        if value in self._names or (colon and (self._any_owner or owner in self._owners)):
            return True
        if any(re.search(rf"(?<![\w.]){re.escape(bus)}(?![\w-])", value) for bus in self._buses):
            return True
        # A name without a bus is looked for on all of them.
        named = tokens[:1] != ("monitor",) and tokens[2:3] != ("signals",)  # that of an ECU is a file
        return bool(self._buses) and named and value.count(".") == 1

    def _lacks(self, fault: str) -> bool:
        return self._any_owner or any(fault.startswith(f"{owner}.") for owner in self._owners)


def _tokens(key: str | None) -> Place:
    """Return the parts of a key: ``bus[0].check[2].message`` is ``("bus", 0, "check", 2, "message")``."""
    return tuple(int(found[2]) if found[2] else found[1] or found[3] for found in _TOKEN.finditer(key or ""))


def _type_of(table: dict[str, Any]) -> str | None:
    """Return the type that a monitor calls itself; that of "package.module:NAME" may be another text."""
    asked = str(table.get("type"))
    try:
        found = MONITORS.get(asked)
    except InputError:
        return asked
    return asked if found is None else found.type


def _at(data: Any, place: Iterable[str | int]) -> Any:
    for token in place:
        data = data[token]
    return data


def _has(data: Any, place: Place) -> bool:
    try:
        _at(data, place)
    except (KeyError, IndexError, TypeError):
        return False
    return True


def _rank(data: Any, place: Place) -> tuple[int, ...]:
    """Return where a key stands, as what can be compared; a key that is missing comes after those of its table."""
    rank: list[int] = []
    for token in place:
        known = list(data) if isinstance(data, dict) else list(range(len(data))) if isinstance(data, list) else []
        if token not in known:
            return (*rank, _AFTER_ALL)
        rank.append(known.index(token))
        data = data[token]
    return tuple(rank)

"""Vehicle profiles of WiCAN (JSON), as layouts: requests, and expressions over the bytes that an adapter shows.

An expression counts all bytes of all frames of an answer, from 0 on, the transport's own among them: B0 is the length
of a single frame, B8 the number of the second frame. Where these stand depends on how many frames an answer has: there
are several if a byte above 7 is used, or a digit behind the request says so (of a PID: how many ECUs answer). Addresses
are those of the commands AT SH and AT CRA; the adapter does not obey AT H0, which would hide the transport's bytes.
Definition: meatpiHQ/wican-fw, vehicle_profiles/README.md, main/autopid.c.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from gateway.bus.frames import EXTENDED
from gateway.config.ecu import TWO_BYTES
from gateway.isotp.addressing import FUNCTIONAL
from gateway_ask.answers import expressions
from gateway_ask.answers.expressions import NotOne
from gateway_ask.answers.jsonfile import Place, document_of, list_at, object_at
from gateway_ask.answers.model import Address, AnswerLayout, Layouts, LeftOut, Limits, message_of
from gateway_fdi.errors import InputError

#: Bytes of a frame; data bytes of a first, and of each further frame.
_FRAME, _FIRST, _NEXT = 8, 6, 7
#: WiCAN's words of units that are written otherwise here.
_UNITS = {"°C": "degC", "°F": "degF", "psi": "psi", "none": None, "": None}
#: Priority of identifiers of 29 bits, where no AT CP says it.
_PRIORITY = 0x18
#: Instead of a request: what a profile takes out of the one that it extends.
_REMOVE = "remove"
#: Profiles that one extends, at most.
_DEEPEST = 8
#: Commands of an adapter that say how an ECU is asked, or which bytes it shows.
_KEYS = ("ATSH", "ATCRA", "STCAFCP", "ATCP", "ATCEA")


class _Adapter(NamedTuple):
    """Settings of an adapter, as its commands leave them.

    Attributes:
        header: digits of AT SH.
        answers: digits of AT CRA.
        priority: of 29 bits.
        hidden: why it is not known which bytes an answer shows; "": it is known.
    """

    header: str = ""
    answers: str = ""
    priority: int = _PRIORITY
    hidden: str = ""

    def after(self, text: str, place: Place) -> _Adapter:
        """Return it after further commands."""
        made = self
        for word in filter(None, re.split(r"[;\r\n]+", text.upper().replace(" ", ""))):
            made = made._after(word, place)
        return made

    def _after(self, word: str, place: Place) -> _Adapter:
        key = next((each for each in _KEYS if word.startswith(each)), "")
        value = word[len(key) :]
        if key and not re.fullmatch(r"[0-9A-F]*(,[0-9A-F]+)*", value):
            raise place.wrong("an adapter's command has hexadecimal digits", word)
        if key == "ATSH":
            return self._replace(header=value)
        if key in ("ATCRA", "STCAFCP"):
            return self._replace(answers=value.rpartition(",")[2])
        if key == "ATCP":
            return self._replace(priority=int(value or "0", 16))
        if key == "ATCEA" and value:
            return self._replace(hidden="extended addressing (AT CEA): it is not said which bytes are counted")
        return self

    def address(self, place: Place) -> Address | None:
        """Return the ECU's address; None: the request is to all."""
        if not self.header:
            return None
        try:
            request, answers = int(self.header, 16), int(self.answers, 16) if self.answers else None
        except ValueError:
            raise place.wrong("no header of a request", self.header) from None
        if request > 0x7FF:  # 000726 is one of 11 bits
            request |= EXTENDED | (self.priority << 24 if len(self.header) <= 6 else 0)
            answers = None if answers is None else answers | EXTENDED
        return None if request in FUNCTIONAL else Address(request, answers)


def read(path: Path, year: int | None) -> Layouts:
    """Read a vehicle profile, with those that it extends.

    Args:
        path: of the file.
        year: not None: the file has no model years.

    Raises:
        InputError: it cannot be read, is no profile of one car, or has nothing that a client asks; names key and value.
    """
    if year is not None:
        raise InputError("a vehicle profile of WiCAN has no model years", file=path, key="--year", value=year)
    left: list[LeftOut] = []
    found: dict[tuple[Address | None, int, int], AnswerLayout] = {}
    profiles = list(_profiles(path))
    own, at = profiles[-1]
    adapter = _Adapter().after(_text(own, "init", at), at.at("init"))
    for profile, place in profiles:
        entries = [object_at(entry, place.at("pids")) for entry in list_at(profile.get("pids", []), place.at("pids"))]
        names = {name for k, table in enumerate(entries) for name, *_ in _parameters(table, place.at(f"pids[{k}]"))}
        found = {key: layout for key, one in found.items() if (layout := _without(one, names)) is not None}
        for k, table in enumerate(entries):
            at = place.at(f"pids[{k}]")
            if table.get("pid") == _REMOVE:
                continue
            adapter = adapter.after(_text(table, "pid_init", at), at.at("pid_init"))
            layout = _layout(table, adapter, at, left)
            if layout is not None:
                key = layout.address, layout.service, layout.identifier
                found[key] = _joined(found[key], layout) if key in found else layout
    if not found:
        where, why = left[0] if left else (at.key, "it has no requests")
        raise InputError(f"no answer can be read: {why}", file=path, key=where or None)
    return Layouts(tuple(found.values()), tuple(left))


def _joined(first: AnswerLayout, second: AnswerLayout) -> AnswerLayout:
    """Return a layout with the signals of both; of two with one name the second counts."""
    signals = {signal.name: signal for one in (first, second) for signal in one.message.signals}
    message = message_of(first.service, first.identifier, list(signals.values()))
    return replace(second, message=message, limits={**first.limits, **second.limits})


def _without(layout: AnswerLayout, names: Collection[str]) -> AnswerLayout | None:
    """Return a layout without signals that a later profile has, or takes out; None: it has no others."""
    kept = [signal for signal in layout.message.signals if signal.name not in names]
    return replace(layout, message=message_of(layout.service, layout.identifier, kept)) if kept else None


def _profiles(path: Path, depth: int = 0) -> Iterator[tuple[Mapping[str, Any], Place]]:
    """Yield the profile of a file, those that it extends before it."""
    document, place = document_of(path), Place(path, "")
    if "cars" in document:
        cars = list_at(document["cars"], place.at("cars"))
        if len(cars) != 1:
            raise place.at("cars").wrong("must have one car: take its profile out", f"{len(cars)} cars")
        document, place = dict(object_at(cars[0], place.at("cars[0]"))), place.at("cars[0]")
    extended = document.get("extends")
    if extended is not None:
        if not isinstance(extended, str) or depth >= _DEEPEST:
            raise place.at("extends").wrong("must be the file of a profile", extended)
        # Named from the folder of all profiles on.
        files = [folder / extended for folder in (path.parent.parent, path.parent)]
        file = next((each for each in files if each.is_file() and each != path), None)
        if file is None:
            raise place.at("extends").wrong("this profile is not there", extended)
        yield from _profiles(file, depth + 1)
    yield document, place


def _text(table: Mapping[str, Any], key: str, place: Place) -> str:
    value = table.get(key) or ""
    if not isinstance(value, str):
        raise place.at(key).wrong("must be a text", value)
    return value


def _layout(table: Mapping[str, Any], adapter: _Adapter, place: Place, left: list[LeftOut]) -> AnswerLayout | None:
    """Return the layout of a request; None: nothing of it can be read."""
    text = _text(table, "pid", place).replace(" ", "")
    if not re.fullmatch(r"[0-9A-Fa-f]{3,}", text):
        raise place.at("pid").wrong("a request is hexadecimal digits", table.get("pid"))
    parameters = list(_parameters(table, place))
    service = int(text[:2], 16)
    digits = 6 if service in TWO_BYTES else 4
    why = adapter.hidden or ("" if len(text) in (digits, digits + 1) else "a request of one identifier is read")
    if why or not parameters:
        left.append(LeftOut(f"{place.key} {text}", why or "it has no expressions"))
        return None
    frames = int(text[digits:], 16) if len(text) > digits else None
    wanted = [int(index) for _, one, _ in parameters for index in re.findall(r"[BS](\d{1,4})", one)]
    several = max(wanted, default=0) >= _FRAME or (service != 0x01 and (frames or 1) > 1)
    head = bytes([service + 0x40]) + bytes.fromhex(text[2:digits])
    made: dict[str, Any] = {}
    limits: dict[str, Limits] = {}
    for name, expression, more in parameters:
        unit = more.get("unit")
        try:
            made[name] = expressions.signal(
                name, expression, lambda index: _place(index, head, several=several), _UNITS.get(str(unit or ""), unit)
            )
        except NotOne as error:
            left.append(LeftOut(f"{place.key} {text} {name}", f"{expression}: {error}"))
            continue
        low, high = (_limit(more, key) for key in ("min", "max"))
        if low is not None and high is not None and low < high:
            limits[name] = Limits(low=low, high=high)
    if not made:
        return None
    identifier = int(text[2:digits], 16)
    message = message_of(service, identifier, list(made.values()))
    return AnswerLayout(service, identifier, message, adapter.address(place.at("pid_init")), limits)


def _parameters(table: Mapping[str, Any], place: Place) -> Iterator[tuple[str, str, Mapping[str, Any]]]:
    """Yield name, expression, and what else is said of it: a table of both, or a list of tables."""
    given = table.get("parameters", {})
    at = place.at("parameters")
    entries = list(object_at(given, at).items()) if isinstance(given, dict) else list(enumerate(list_at(given, at)))
    for key, entry in entries:
        more = {"name": key, "expression": entry} if isinstance(given, dict) else object_at(entry, at.at(f"[{key}]"))
        name, expression = more.get("name"), more.get("expression")
        if not isinstance(name, str) or not re.fullmatch(r"[A-Za-z_]\w*", name):
            raise at.at(str(key)).wrong("a name has letters, digits and _", name)
        if not isinstance(expression, str):
            raise at.at(str(key)).wrong("an expression is a text", expression)
        yield name, expression, more


def _limit(table: Mapping[str, Any], key: str) -> float | None:
    try:
        return float(table[key])
    except (KeyError, TypeError, ValueError):
        return None


def _place(index: int, head: bytes, *, several: bool) -> tuple[str, int] | None:
    """Return where a byte that an expression counts stands: in the answer's data, or a number; None: nobody knows."""
    frame, at = divmod(index, _FRAME)
    if several and frame:
        if not at:
            return "number", 0x20 | frame & 0xF
        byte = _FIRST + _NEXT * (frame - 1) + at - 1
    else:
        byte = index - (2 if several else 1)
    if byte < 0 or (frame and not several):
        return None  # the transport's length
    return ("number", head[byte]) if byte < len(head) else ("data", byte - len(head))

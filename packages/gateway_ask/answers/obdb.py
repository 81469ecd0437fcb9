"""Signal sets of the OBDb project (JSON, version 3), as layouts.

A command is a request; ``bix`` is the place of a signal's first bit, the highest bit of the first byte being 0, and a
value is ``raw * mul / div + add``. ``blsb`` turns the signal's bytes round before its bits are taken, in numbers, not
in texts (``map``): as the project's own tools do. Definition: OBDb/.schemas, signals.json.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from gateway.bus.frames import EXTENDED
from gateway.config.ecu import request_name
from gateway.isotp.addressing import FUNCTIONAL, TESTER
from gateway_ask.answers.jsonfile import Place, count_at, document_of, hex_at, list_at, number_at, object_at
from gateway_ask.answers.model import (
    LONGEST_SIGNAL,
    Address,
    AnswerLayout,
    Layouts,
    LeftOut,
    Limits,
    message_of,
    signal_of,
)
from gateway_fdi.errors import InputError

#: OBDb's words of units -> as the project writes them. Those of two words are texts (below).
UNITS = {
    "ampereHours": "Ah", "amps": "A", "bars": "bar", "celsius": "degC", "centimeters": "cm", "coulombs": "C",
    "degrees": "deg", "fahrenheit": "degF", "feet": "ft", "framesPerSecond": "1/s", "gallons": "gal",
    "gallonsPerHour": "gal/h", "gigahertz": "GHz", "gramsPerLiter": "g/l", "gramsPerSecond": "g/s", "gravity": "g",
    "hertz": "Hz", "hours": "h", "inches": "in", "inchPound": "lbf.in", "joules": "J", "kelvin": "K",
    "kiloampereHours": "kAh", "kiloamps": "kA", "kilogramsPerHour": "kg/h", "kilohertz": "kHz", "kilojoules": "kJ",
    "kilometers": "km", "kilometersPerHour": "km/h", "kiloohms": "kohm", "kilopascal": "kPa", "kilovolts": "kV",
    "kilowattHours": "kWh", "kilowattHoursPer100Kilometers": "kWh/100km", "kilowattHoursPer100Miles": "kWh/100mi",
    "kilowatts": "kW", "liters": "l", "litersPerHour": "l/h", "megahertz": "MHz", "megaohms": "Mohm", "meters": "m",
    "metersPerSecond": "m/s", "metersPerSecondSquared": "m/s^2", "microhertz": "uHz", "microohms": "uohm",
    "miles": "mi", "milesPerKilowattHour": "mi/kWh", "milesPerHour": "mi/h", "milliampereHours": "mAh",
    "milliamps": "mA", "milligramsPerDeciliter": "mg/dl", "milligramsPerStroke": "mg/stroke", "millihertz": "mHz",
    "millimeters": "mm", "milliohms": "mohm", "milliseconds": "ms", "millivolts": "mV", "milliwatts": "mW",
    "minutes": "min", "nanohertz": "nHz", "newtonMeters": "Nm", "ohms": "ohm", "percent": "%", "poundFoot": "lbf.ft",
    "psi": "psi", "radians": "rad", "rpm": "rpm", "seconds": "s", "terahertz": "THz", "volts": "V", "watts": "W",
    "yards": "yd",
}  # fmt: skip
#: Units that name what 0 and 1 mean.
_TEXTS = {"noyes": {0: "no", 1: "yes"}, "yesno": {0: "yes", 1: "no"}, "offon": {0: "off", 1: "on"}}
#: Priority of diagnostic frames with 29 bits (ISO 15765-2).
_PRIORITY = 0x18


@dataclass(frozen=True)
class Years:
    """Model years that a command is for.

    Attributes:
        first: of a range; None: from the first on.
        last: of a range; None: up to the latest. A range whose first is after its last is what lies outside.
        single: others.
    """

    first: int | None = None
    last: int | None = None
    single: frozenset[int] = frozenset()

    @staticmethod
    def of(table: Any, place: Place) -> Years:
        """Return the years of a ``filter``; a command without one is for all."""
        fields = object_at(table or {}, place)
        first, last = (
            None if fields.get(key) is None else count_at(fields, key, place, None, 0) for key in ("from", "to")
        )
        years = list_at(fields.get("years") or [], place.at("years"))
        single = [count_at({"years": year}, "years", place, None, 0) for year in years]
        return Years(first, last, frozenset(single))

    def match(self, year: int) -> bool:
        """Return whether a year is among them."""
        if self == Years() or year in self.single:
            return True
        if self.first is None and self.last is None:
            return False
        after, before = self.first is None or year >= self.first, self.last is None or year <= self.last
        outside = self.first is not None and self.last is not None and self.first >= self.last
        return (after or before) if outside else (after and before)

    @property
    def latest(self) -> float:
        """Return the latest of them; infinite: there is no end."""
        open_end = self.last is None or (self.first is not None and self.first >= self.last)
        if self.single and self.first is None and self.last is None:
            return max(self.single)
        return math.inf if open_end else max([self.last or 0, *self.single])


class _Command(NamedTuple):
    """One command: its request, and its signals as they stand there."""

    place: Place
    address: Address | None
    service: int
    identifier: int
    years: Years
    every_s: float | None
    signals: list[Any]

    @property
    def name(self) -> str:
        return request_name(self.service, self.identifier)


def _command(entry: Any, place: Place) -> _Command:
    """Return a command of the file."""
    table = object_at(entry, place)
    request = object_at(table.get("cmd"), place.at("cmd"))
    if len(request) != 1:
        raise place.at("cmd").wrong("must have one service", dict(request))
    word = next(iter(request))
    try:
        service = int(word, 16)
    except ValueError:
        service = 0
    if not 0 < service < 0x40:
        raise place.at("cmd").wrong("a service is two hexadecimal digits, less than 40", word)
    identifier = hex_at(request, word, place.at("cmd"), 0xFFFF if service == 0x22 else 0xFF)
    if identifier is None:
        raise place.at("cmd").at(word).wrong("an identifier is missing")
    return _Command(
        place,
        None if (address := _address(table, place)).request in FUNCTIONAL else address,
        service,
        identifier,
        Years.of(table.get("filter"), place.at("filter")),
        number_at(table, "freq", place),
        list_at(table.get("signals"), place.at("signals")),
    )


def _address(table: Mapping[str, Any], place: Place) -> Address:
    """Return the address of a command: 11 bits (``7E0``), the middle two bytes of 29 (``DA10``), or all of them."""
    header = table.get("hdr")
    request = hex_at(table, "hdr", place, 0x1FFF_FFFF)
    if request is None or not isinstance(header, str):
        raise place.at("hdr").wrong("the header of a request is missing")
    response = hex_at(table, "rax", place, 0x1FFF_FFFF)
    own, tester = hex_at(table, "eax", place, 0xFF), hex_at(table, "tst", place, 0xFF)
    if len(header) == 3:
        if request > 0x7FF or (response or 0) > 0x7FF:
            raise place.at("hdr").wrong("an identifier of three digits has at most 7FF", header)
        return Address(request, response, own, None if own is None else own if tester is None else tester)
    source = TESTER if tester is None else tester
    if len(header) == 4:
        priority = hex_at(table, "pri", place, 0x1F)
        request |= (_PRIORITY if priority is None else priority) << 16
        request = request << 8 | source
    if response is not None:  # of fewer than eight digits it is the end of an identifier, as FE0076 of 17FE0076
        bits = 4 * len(table["rax"])
        response |= (request >> 24 << 24 | 0xDA0000 | source << 8) >> bits << bits
    return Address(request | EXTENDED, None if response is None else response | EXTENDED, own, own)


def _answered(commands: list[_Command]) -> Iterator[_Command]:
    """Return the commands, one that does not say who answers with the address of those that do for its ECU."""
    addresses = [one.address for one in commands if one.address is not None]
    known = {(one.request, one.extended): one for one in addresses if one.response is not None}
    for one in commands:
        own = one.address
        if own is not None and own.response is None:
            own = known.get((own.request, own.extended), own)
        yield one._replace(address=own)


def _signal(entry: Any, place: Place) -> tuple[Any, Limits] | LeftOut:
    """Return a signal and its limits."""
    table = object_at(entry, place)
    name, fmt = table.get("id"), object_at(table.get("fmt"), place.at("fmt"))
    if not isinstance(name, str) or not name:
        raise place.at("id").wrong("a name is missing", name)
    place = place.at("fmt")
    first, length = count_at(fmt, "bix", place, 0, 0), count_at(fmt, "len", place, None, 1)
    unit = fmt.get("unit")
    if unit == "ascii" or length > LONGEST_SIGNAL:
        return LeftOut(name, f"a text, or a number of {length} bits: at most {LONGEST_SIGNAL} are decoded")
    texts = _texts(fmt, place)
    big, start = True, 8 * (first // 8) + 7 - first % 8
    if fmt.get("blsb") and length > 8 and "map" not in fmt:
        size = -(-length // 8)
        start, big = 8 * (first // 8) + 8 * size - first % 8 - length, False
        if start < 8 * (first // 8):
            return LeftOut(name, "its bytes are turned round, and its bits reach beyond them")
    scale, offset = number_at(fmt, "mul", place), number_at(fmt, "add", place)
    divisor = number_at(fmt, "div", place)
    if divisor == 0 or scale == 0:
        raise place.wrong("a factor is a number other than 0", 0)
    numbers = [number_at(fmt, key, place) for key in ("nullmin", "nullmax", "omin", "omax", "min", "max")]
    least, most = numbers[4:]
    signal = signal_of(
        name,
        start,
        length,
        big=big,
        signed=bool(fmt.get("sign")) and "map" not in fmt,
        scale=1 if texts else (1 if scale is None else scale) / (divisor or 1),
        offset=0 if texts or offset is None else offset,
        texts=texts,
        unit=UNITS.get(str(unit)),
        limits=(least or 0, most) if most is not None and most > (least or 0) and "map" not in fmt else None,
        comment=str(table.get("name") or ""),
    )
    return signal, Limits(*numbers[:4])


def _texts(fmt: Mapping[str, Any], place: Place) -> dict[int, str]:
    """Return what values mean."""
    if "map" not in fmt:
        simple = not {"mul", "div", "add", "sign"} & set(fmt)
        return _TEXTS.get(str(fmt.get("unit")), {}) if simple else {}
    texts = {}
    for raw, meaning in object_at(fmt["map"], place.at("map")).items():
        try:
            number = int(raw)
        except ValueError:
            raise place.at("map").wrong("the keys of texts are whole numbers", raw) from None
        texts[number] = str(meaning.get("value") if isinstance(meaning, dict) else meaning)
    return texts


def _joined(commands: list[_Command], left: list[LeftOut]) -> AnswerLayout | None:
    """Return the layout of one request, which several commands may describe."""
    latest = max(one.years.latest for one in commands)
    signals: dict[str, Any] = {}
    limits = {}
    for one in commands:
        if one.years.latest < latest:
            left.append(LeftOut(f"{one.place.key} {one.name}", f"of model years up to {one.years.latest:.0f}: --year"))
            continue
        for k, entry in enumerate(one.signals):
            made = _signal(entry, one.place.at(f"signals[{k}]"))
            if isinstance(made, LeftOut):
                left.append(LeftOut(f"{one.name} {made.where}", made.why))
            elif made[0].name in signals:
                left.append(LeftOut(f"{one.name} {made[0].name}", "the request has it twice"))
            else:
                signals[made[0].name], limit = made
                if limit != Limits():
                    limits[made[0].name] = limit
    if not signals:
        return None
    first = commands[-1]
    message = message_of(first.service, first.identifier, list(signals.values()))
    return AnswerLayout(first.service, first.identifier, message, first.address, limits, first.every_s)


def of_year(path: Path, year: int) -> str:
    """Return the text of a signal set that has the commands of one model year only."""
    document = document_of(path)
    place = Place(path, "commands")
    document["commands"] = [
        entry
        for k, entry in enumerate(list_at(document.get("commands"), place))
        if _command(entry, Place(path, f"commands[{k}]")).years.match(year)
    ]
    return json.dumps(document, indent=1) + "\n"


def read(path: Path, year: int | None) -> Layouts:
    """Read a signal set.

    Args:
        path: of the file.
        year: model year; None: all, of two commands for one request those of the later years.

    Raises:
        InputError: it cannot be read, is no signal set, or has nothing for the year; names key and value.
    """
    top = Place(path, "")
    entries = list_at(document_of(path).get("commands"), top.at("commands"))
    commands = [_command(entry, top.at(f"commands[{k}]")) for k, entry in enumerate(entries)]
    left: list[LeftOut] = []
    requests: dict[tuple[Address | None, int, int], list[_Command]] = {}
    for one in _answered(commands):
        if year is None or one.years.match(year):
            requests.setdefault((one.address, one.service, one.identifier), []).append(one)
        else:
            left.append(LeftOut(f"{one.place.key} {one.name}", f"not of model year {year}"))
    layouts = [layout for group in requests.values() if (layout := _joined(group, left)) is not None]
    if not layouts:
        raise InputError("no command with signals" + ("" if year is None else f" of model year {year}"), file=path)
    return Layouts(tuple(layouts), tuple(left))

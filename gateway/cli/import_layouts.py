"""``gateway import``: tables ``[[ecu]]`` from a file that says how ECUs answer."""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from gateway.answers.layout import Address, AnswerLayout, LeftOut, read_file
from gateway.answers.obdb import of_year
from gateway.answers.pages import answer_bus
from gateway.answers.weave import READ_SERVICES
from gateway.bus.frames import EXTENDED, ID_MASK
from gateway.cli.lines import Lines
from gateway.cli.present import print_json
from gateway.clients.document import Asked, Read, tables
from gateway.clients.params import AskParams
from gateway_fdi.errors import InputError

#: Time between two requests where a file does not say [ms].
EVERY_MS = 1000.0
#: Requests to all -> answers of the engine's ECU.
FUNCTIONAL = {0x7DF: 0x7E8, EXTENDED | 0x18DB33F1: EXTENDED | 0x18DAF110}
#: Parts that are left out and named one by one; of more their number is told.
_NAMED = 8


def import_layouts(
    source: Path, *, out: Path, bus: str, request: str | None, response: str | None, year: int | None, force: bool,
    json: bool,
) -> int:  # fmt: skip
    """Write tables of a file's ECUs; returns the exit code.

    Raises:
        InputError: the file cannot be read; it has no addresses and none are given; a file that would be written is
            there.
    """
    found = read_file(source, year)
    left = list(found.left_out)
    files = {out: ""}
    signals = source
    if year is not None and source.suffix.lower() == ".json":
        signals = out.with_name(f"{out.stem}-{year}.json")
        files[signals] = of_year(source, year)
    for file in files:
        if file.exists() and not force:
            raise InputError("this file is there: --force overwrites it", file=file)
    given = _given(request, response)
    relative = os.path.relpath(signals, out.parent)
    asked, assumed = [], []
    groups: dict[str, list[AnswerLayout]] = {}
    for own, layouts in _by_address(found.layouts, given, source).items():
        address = own
        if own.response is None:
            address = Address(own.request, _response(own.request), own.extended, own.tester)
            assumed.append(f"{own.request & ID_MASK:X}: response {(address.response or 0) & ID_MASK:X} is assumed")
        asked.append(_asked(address, layouts, relative, left))
        groups[asked[-1].name] = layouts
    rate = sum(1000 / read.every_ms for ecu in asked for read in ecu.reads)
    head = f"ECUs of {source.name}. Each line of read asks the car: take out what you do not need."
    files[out] = tables(asked, bus, head, _limits(groups))
    for file, text in files.items():
        try:
            file.write_text(text)
        except OSError as error:
            raise InputError(error.strerror or str(error), file=file) from error
    facts = {
        "written": [str(file) for file in files],
        "ecus": [_facts(ecu) for ecu in asked],
        "requests_per_s": round(rate, 3),
        "assumed": assumed,
        "left_out": [part._asdict() for part in left],
    }
    if json:
        print_json(facts)
    else:
        _say(facts, asked, left)
    return 0


def _given(request: str | None, response: str | None) -> Address | None:
    """Return the address of the options."""
    numbers = []
    for key, text in (("--request", request), ("--response", response)):
        try:
            number = None if text is None else int(text, 0)
        except ValueError:
            number = -1
        if number is not None and not 0 <= number <= ID_MASK:
            raise InputError("an identifier, e.g. 0x7E0", key=key, value=text)
        numbers.append(number)
    asks, answers = numbers
    if asks is None or answers is None:
        if asks != answers:
            raise InputError("--request and --response go together", key="--request", value=request)
        return None
    flag = EXTENDED if max(asks, answers) > 0x7FF else 0
    return Address(asks | flag, answers | flag)


def _response(request: int) -> int:
    """Return the usual identifier of answers to one of requests, where a file does not say it."""
    if request & EXTENDED and request >> 16 & 0xFF == 0xDA:  # normal fixed addressing: the addresses change places
        return request & ~0xFFFF | (request & 0xFF) << 8 | request >> 8 & 0xFF
    return FUNCTIONAL.get(request, request + 8)


def _by_address(
    layouts: Sequence[AnswerLayout], given: Address | None, source: Path
) -> dict[Address, list[AnswerLayout]]:
    """Return the layouts of each ECU; those without an address are of the given one."""
    found: dict[Address, list[AnswerLayout]] = {}
    for layout in layouts:
        address = layout.address or given
        if address is None:
            raise InputError("the file has no addresses of ECUs: give --request and --response", file=source)
        found.setdefault(address, []).append(layout)
    return found


def _asked(address: Address, layouts: Sequence[AnswerLayout], signals: str, left: list[LeftOut]) -> Asked:
    """Return one ECU; requests that a client does not make are left out."""
    name = f"ecu_{address.request & ID_MASK:X}" + ("" if address.extended is None else f"_{address.extended:02X}")
    reads = []
    for layout in layouts:
        if layout.service not in READ_SERVICES:
            left.append(LeftOut(f"{name} {layout.name}", f"service 0x{layout.service:02X} is not asked"))
            continue
        every_ms = EVERY_MS if layout.every_s is None else 1000 * layout.every_s
        names = [signal.name for signal in layout.message.signals]
        shown = ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
        reads.append(Read(layout.service, layout.identifier, every_ms, shown))
    keyed = {(layout.service, layout.identifier): layout for layout in layouts}
    left += [LeftOut(name, text) for text in answer_bus([(name, keyed)]).left_out]
    return Asked(name, address, reads, [signals])


def _limits(groups: Mapping[str, Sequence[AnswerLayout]]) -> list[tuple[str, float, float]]:
    """Return the signals that the file gives limits, by their names on the bus of the answers."""
    found = []
    count = Counter(name for layouts in groups.values() for name in {layout.message.name for layout in layouts})
    for ecu, layouts in groups.items():
        for layout in layouts:
            for signal, limits in layout.limits.items():
                if limits.low is not None and limits.high is not None and limits.low < limits.high:
                    name = layout.message.name
                    shown = f"{ecu}_{name}" if count[name] > 1 else name
                    found.append((f"{shown}.{signal}", limits.low, limits.high))
    return found


def _facts(ecu: Asked) -> dict[str, Any]:
    address = ecu.address
    return {
        "name": ecu.name,
        "request": address.request & ID_MASK,
        "response": (address.response or 0) & ID_MASK,
        "target": address.extended,
        "requests": len(ecu.reads),
    }


def _say(facts: dict[str, Any], asked: Sequence[Asked], left: Sequence[LeftOut]) -> None:
    lines = Lines()
    print(f"{'ECU':<16} {'request':>9} {'response':>9} {'reads':>6}")
    for ecu in facts["ecus"]:
        print(f"{ecu['name']:<16} {ecu['request']:>9X} {ecu['response']:>9X} {ecu['requests']:>6}")
    for text in facts["assumed"]:
        lines.print(f"assumed  {text}")
    rate, most = facts["requests_per_s"], AskParams().requests_per_s
    if rate > most:
        lines.print(f"{rate:.1f} requests/s in all; a bus has {most:g}, or its [bus.ask] requests_per_s")
    reasons = Counter(re.sub(r"\d+", "N", part.why) for part in left)
    if left:
        print(f"left out: {len(left)}")
    for part in left[:_NAMED]:
        lines.print(f"  {part.where}: {part.why}", hang=4)
    for reason, count in reasons.most_common() if len(left) > _NAMED else ():
        lines.print(f"  in all {count}: {reason}", hang=4)
    print(f"written: {', '.join(facts['written'])}")

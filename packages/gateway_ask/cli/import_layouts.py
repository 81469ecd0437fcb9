"""``gateway import``: tables ``[[ecu]]`` from a file that says how ECUs answer."""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from gateway.bus.frames import EXTENDED, ID_MASK
from gateway.cli.lines import Lines
from gateway.cli.present import print_json
from gateway.config.ecu import READ_SERVICES, AskParams
from gateway_ask.answers.layout import Address, AnswerLayout, LeftOut, read_file
from gateway_ask.answers.obdb import of_year
from gateway_ask.answers.pages import answer_bus
from gateway_ask.document import Asked, Read, tables
from gateway_fdi.errors import InputError

#: Time between two requests where a file does not say [ms].
EVERY_MS = 1000.0
#: ECU of the engine (ISO 15765-4), which is asked for what a file has to ask of all.
ENGINE = Address(0x7E0, 0x7E8)
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
    groups, assumed = _by_address(found.layouts, given, source, left)
    asked = [_asked(address, layouts, relative, left) for address, layouts in groups.items()]
    rate = sum(1000 / read.every_ms for ecu in asked for read in ecu.reads)
    head = f"ECUs of {source.name}. Each line of read asks the car: take out what you do not need."
    files[out] = tables(asked, bus, head, _limits(asked, groups.values()))
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


def _answering(own: Address) -> Address:
    """Return an address with the usual identifier of answers, where a file does not say it."""
    request = own.request
    if own.response is not None:
        return own
    response = request + 8
    if request & EXTENDED and request >> 16 & 0xFF == 0xDA:  # normal fixed addressing: the addresses change places
        response = request & ~0xFFFF | (request & 0xFF) << 8 | request >> 8 & 0xFF
    return Address(request, response, own.extended, own.tester)


def _by_address(
    layouts: Sequence[AnswerLayout], given: Address | None, source: Path, left: list[LeftOut]
) -> tuple[dict[Address, list[AnswerLayout]], list[str]]:
    """Return the layouts of each ECU, and what is assumed of addresses; those of any ECU are of the given one."""
    found: dict[Address, dict[tuple[int, int], AnswerLayout]] = {}
    assumed: dict[str, None] = {}
    if given is None and all(layout.address is None for layout in layouts):
        raise InputError("the file has no addresses of ECUs: give --request and --response", file=source)
    for layout in layouts:
        own = layout.address or given or ENGINE
        address = _answering(own)
        if own.response is None:
            assumed[f"{own.request & ID_MASK:X}: response {(address.response or 0) & ID_MASK:X}"] = None
        if own is ENGINE:
            assumed[f"{layout.name}: of all ECUs that of the engine, {ENGINE.request:X}"] = None
        known = found.setdefault(address, {}).setdefault((layout.service, layout.identifier), layout)
        if known is not layout:
            left.append(LeftOut(f"{address.request & ID_MASK:X} {layout.name}", "the file has it twice"))
    return {address: list(own.values()) for address, own in found.items()}, list(assumed)


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


def _limits(asked: Sequence[Asked], groups: Iterable[Sequence[AnswerLayout]]) -> list[tuple[str, float, float]]:
    """Return the signals that the file gives limits, by their names on the bus of the answers."""
    found = []
    every = [(ecu.name, layout) for ecu, layouts in zip(asked, groups, strict=True) for layout in layouts]
    count = Counter(layout.message.name for _, layout in every)
    for ecu, layout in every:
        name = layout.message.name
        shown = f"{ecu}_{name}" if count[name] > 1 else name
        for signal, limits in layout.limits.items():
            if limits.low is not None and limits.high is not None and limits.low < limits.high:
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

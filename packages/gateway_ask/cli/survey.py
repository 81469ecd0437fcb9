"""``gateway survey``: the ECUs of a bus, and what they say of themselves."""

from __future__ import annotations

import select
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from gateway.bus.base import Bus, send_all
from gateway.bus.frames import EXTENDED, ID_MASK, empty
from gateway.bus.uri import open_bus
from gateway.cli.lines import Lines
from gateway.cli.present import print_json
from gateway_ask.answers.layout import Address, j1979
from gateway_ask.answers.monitor_tests import Result
from gateway_ask.document import Asked, Read, tables
from gateway_ask.identification import Said
from gateway_ask.survey import Found, Place, Survey
from gateway_fdi.errors import InputError

#: Longest wait for frames [s]; frames that are taken at once; time between two lines of progress in a pipe [s].
_WAIT_S, _BATCH, _PERIOD_S = 0.02, 1024, 5.0
#: How often a written configuration asks for DTCs [s], and for a value, at least [ms].
_DTCS_S, _EVERY_MS = 600, 1000
#: Share of the rate that a written configuration uses for values.
_SHARE = 0.5


def survey(uri: str, *, out: Path | None, rate: float, yes: bool, force: bool, json: bool) -> int:
    """Ask all ECUs of a bus; returns the exit code.

    Raises:
        InputError: there is traffic on the bus, and nobody has agreed; the file to be written is there.
    """
    if out is not None and out.exists() and not force:
        raise InputError("this file is there: --force overwrites it", file=out)

    def may_ask(found: Found) -> bool:
        return not found.frames or yes or _agreed(found, uri)

    made = Survey(rate, may_ask)
    with open_bus(uri) as bus:
        try:
            _run(bus, made)
        except KeyboardInterrupt:
            print("\nstopped: what follows is not all", file=sys.stderr)
    found = made.found
    if out is not None:
        out.write_text(
            tables(_asked(found, rate), f"can0={uri}", "Found by gateway survey; take out what you do not need.")
        )
    facts = _facts(found) | {"complete": made.done}
    if json:
        print_json(facts | ({} if out is None else {"written": str(out)}))
    else:
        _say(found, facts)
        if out is not None:
            print(f"written: {out}")
    return 0 if made.done else 1


def _agreed(found: Found, uri: str) -> bool:
    """Return whether a person agrees that a bus with traffic is asked.

    Raises:
        InputError: there is no person, or he does not.
    """
    pace = found.frames / (found.heard_ns / 1e9)
    text = f"{uri} has {pace:.0f} frames/s: the vehicle may be driving. Ask its ECUs?"
    if sys.stdin.isatty():
        print(f"{text} [y/N] ", end="", file=sys.stderr, flush=True)
        if sys.stdin.readline().strip().lower() in ("y", "yes"):
            return True
        raise InputError("nothing was sent", key="BUS", value=uri)
    raise InputError(f"{pace:.0f} frames/s: the vehicle may be driving; --yes asks its ECUs all the same", value=uri)


def _run(bus: Bus, made: Survey) -> None:
    """Run a survey on a bus until it is over."""
    batch, shown_s = empty(_BATCH), time.monotonic()
    terminal = sys.stderr.isatty()
    while not made.done:
        count = bus.receive(batch)
        now = time.time_ns()
        heard = batch[:count].copy()
        heard["t_ns"], heard["bus"] = now, 0
        out = made.poll(now, heard)
        if len(out):
            send_all(bus, out)
        if terminal or time.monotonic() - shown_s >= _PERIOD_S:
            shown_s = time.monotonic()
            told = f"question {made.step} of {made.steps}, {len(made.found.ecus)} ECUs"
            print(f"\r{told}" if terminal else told, end="" if terminal else "\n", file=sys.stderr, flush=True)
        if not count:
            select.select([bus.fileno()], [], [], _WAIT_S)
    if terminal:
        print(file=sys.stderr)


def _ecus(found: Found) -> Iterator[tuple[Place, Said]]:
    for place, told in found.ecus.items():
        yield place, told or Said({})


def _asked(found: Found, rate: float) -> Iterator[Asked]:
    """Yield the ECUs as tables: PIDs that have a layout, DTCs."""
    layouts = {layout.identifier: layout for layout in j1979()}
    known = [(place, told, [pid for pid in told.pids if pid in layouts]) for place, told in _ecus(found)]
    every_ms = max(_EVERY_MS, sum(len(pids) for *_, pids in known) * 1000 / (rate * _SHARE))
    for place, told, pids in known:
        reads = [Read(0x01, pid, every_ms, ", ".join(s.name for s in layouts[pid].message.signals[:3])) for pid in pids]
        yield Asked(
            place.name,
            Address(place.request, place.response),
            reads,
            dtcs_s=_DTCS_S if told.reads_dtcs else None,
            dtc_protocol=told.reads_dtcs,
            protocol=told.speaks[0] if len(told.speaks) == 1 else "",
            comment="\n".join(f"{words}: {said}" for words, said in _words(told)),
        )


def _words(told: Said) -> Iterator[tuple[str, str]]:
    if told.vin:
        yield "VIN", told.vin
    yield from told.parts.items()


def _known(result: Result) -> dict[str, Any]:
    """Return a result of a test; None: a number whose scaling nobody knows."""
    return {name: None if value != value else value for name, value in result._asdict().items()}  # noqa: PLR0124 - NaN


def _facts(found: Found) -> dict[str, Any]:
    return {
        "frames_heard": found.frames,
        "ecus": [
            {
                "name": place.name,
                "request": place.request & ID_MASK,
                "response": place.response & ID_MASK,
                "extended": bool(place.request & EXTENDED),
                "vin": told.vin or None,
                "parts": told.parts,
                "services": {f"{service:02X}": known for service, known in told.services.items()},
                "obd": told.speaks,
                "pids": told.pids,
                "monitors": told.monitors,
                "tests": {f"{monitor:02X}": [_known(one) for one in tests] for monitor, tests in told.tests.items()},
                "dtcs": [{"dtc": dtc, "status": status} for dtc, status in told.dtcs.items()],
            }
            for place, told in _ecus(found)
        ],
        "j1939_names": {f"{address:02X}": f"{name:016X}" for address, name in sorted(found.names.items())},
        "j1939_dtcs": {f"{address:02X}": dtcs for address, dtcs in sorted(found.active.items())},
        "not_tried": [can_id & ID_MASK for can_id in found.not_tried],
        "unclear": [can_id & ID_MASK for can_id in found.unclear],
    }


def _say(found: Found, facts: dict[str, Any]) -> None:
    lines = Lines()
    print(f"{'request':>9} {'response':>9}  {'VIN':<17} {'PIDs':>4} {'DTCs':>4}  services that read")
    for ecu in facts["ecus"]:
        known = " ".join(service for service, is_known in ecu["services"].items() if is_known)
        numbers = f"{len(ecu['pids']):>4} {len(ecu['dtcs']):>4}"
        print(f"{ecu['request']:>9X} {ecu['response']:>9X}  {ecu['vin'] or '-':<17} {numbers}  {known or '-'}")
    for place, told in _ecus(found):
        for words, said in told.parts.items():
            lines.print(f"{place.name}  {words}: {said}", hang=4)
        for dtc, status in told.dtcs.items():
            lines.print(f"{place.name}  DTC {dtc}  status 0x{status:02X}", hang=4)
        for monitor, tests in told.tests.items():
            lines.print(f"{place.name}  monitor {monitor:02X}: {'; '.join(map(str, tests))}", hang=4)
        silent = [f"{service:02X}" for service, known in told.services.items() if known is None]
        if silent:
            lines.print(f"{place.name}  no answer to {' '.join(silent)}: not known whether it has them", hang=4)
    for address, name in facts["j1939_names"].items():
        print(f"J1939 address {address}: name {name}")
    for address, dtcs in facts["j1939_dtcs"].items():
        lines.print(f"J1939 address {address}: {', '.join(dtcs) or 'no active DTC'}", hang=4)
    print(f"{len(found.ecus)} ECUs, {len(found.names)} J1939 names")
    if found.not_tried:
        listed = " ".join(f"{can_id:X}" for can_id in facts["not_tried"])
        lines.print(f"not tried, as there is traffic on them: {listed}", hang=4)
    if found.unclear:
        listed = " ".join(f"{can_id:X}" for can_id in facts["unclear"])
        lines.print(f"answered once and not again, so taken for none: {listed}", hang=4)
    print("not tried: ECUs with extended addressing, and addresses outside 700 to 7FF and 18DAxxF1")

"""Tables ``[[ecu]]`` as text, for a configuration."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from gateway.bus.frames import EXTENDED, ID_MASK
from gateway.isotp.addressing import TESTER
from gateway_ask.answers.model import Address

#: Bounds of the time between two requests [ms].
_LEAST_MS, _MOST_MS = 10, 86_400_000


class Read(NamedTuple):
    """One line of ``read``.

    Attributes:
        service: of the request.
        identifier: DID or PID.
        every_ms: time between two requests [ms].
        comment: for people.
    """

    service: int
    identifier: int
    every_ms: float
    comment: str = ""

    @property
    def line(self) -> str:
        """Its text."""
        if self.service == 0x22:
            key = f"did = 0x{self.identifier:04X}"
        elif self.service == 0x01:
            key = f"pid = 0x{self.identifier:02X}"
        else:
            key = f"service = 0x{self.service:02X}, identifier = 0x{self.identifier:02X}"
        every = min(max(round(self.every_ms), _LEAST_MS), _MOST_MS)
        comment = f"    # {' '.join(self.comment.split())}" if self.comment else ""
        return f"    {{ {key}, every_ms = {every} }},{comment}"


class Asked(NamedTuple):
    """One ECU, as it is written.

    Attributes:
        name: of the ECU.
        address: with a response.
        reads: its requests.
        signals: files of its layouts, relative to the configuration.
        dtcs_s: how often its DTCs are read [s]; None: they are not.
        dtc_protocol: by which they are read; "": the usual one.
        protocol: of OBD that it answers; "": it is found.
        comment: for people.
    """

    name: str
    address: Address
    reads: Sequence[Read] = ()
    signals: Sequence[str] = ()
    dtcs_s: float | None = None
    dtc_protocol: str = ""
    protocol: str = ""
    comment: str = ""


def tables(ecus: Iterable[Asked], bus: str, head: str, limits: Sequence[tuple[str, float, float]] = ()) -> str:
    """Return the text of some ECUs.

    Args:
        ecus: with their addresses.
        bus: NAME or NAME=URI of their bus; the file is a whole configuration with it.
        head: comment of the file, a line each.
        limits: signal of the answers, and between which values it is likely; a comment that can be made a monitor.
    """
    bus, _, uri = bus.partition("=")
    lines = ["#:schema gateway.schema.json", *(f"# {line}".rstrip() for line in head.splitlines())]
    lines += ["", "[[bus]]", f"name = {json.dumps(bus)}", f"uri = {json.dumps(uri or f'socketcan:{bus}')}"]
    for ecu in ecus:
        lines += ["", *(f"# {line}" for line in ecu.comment.splitlines()), "[[ecu]]", f"name = {json.dumps(ecu.name)}"]
        lines += [f"bus = {json.dumps(bus)}", *_address(ecu.address)]
        if ecu.protocol:
            lines.append(f"protocol = {json.dumps(ecu.protocol)}")
        if ecu.signals:
            lines.append(f"signals = {json.dumps(list(ecu.signals))}")
        if ecu.reads:
            lines += ["read = [", *(read.line for read in ecu.reads), "]"]
        if ecu.dtcs_s is not None:
            protocol = f", protocol = {json.dumps(ecu.dtc_protocol)}" if ecu.dtc_protocol else ""
            lines.append(f"dtcs = {{ every_s = {ecu.dtcs_s:g}{protocol} }}")
    if limits:
        lines += ["", "# Limits that the file gives. To have them monitored, take the # away:", "# [[monitor]]"]
        lines += ['# name = "limits"', '# type = "signal"', f"# bus = {json.dumps(f'answers:{bus}')}", "# signal = ["]
        lines += [
            f"#     {{ signal = {json.dumps(name)}, plausible = [{low}, {high}] }}," for name, low, high in limits
        ]
        lines.append("# ]")
    return "\n".join(lines) + "\n"


def _address(address: Address) -> list[str]:
    request, response = address.request & ID_MASK, (address.response or 0) & ID_MASK
    if address.request & EXTENDED and (request >> 16, response >> 16) == (0x18DA, 0x18DA):
        target = request >> 8 & 0xFF
        if request & 0xFF == TESTER and response == 0x18DA0000 | TESTER << 8 | target:
            return [f"address = 0x{target:02X}"]
    lines = [f"request = 0x{request:03X}", f"response = 0x{response:03X}"]
    if address.request & EXTENDED and max(request, response) <= 0x7FF:
        lines.append("extended = true")
    if address.extended is not None:
        lines.append(f"target = 0x{address.extended:02X}")
        if address.tester is not None:
            lines.append(f"tester = 0x{address.tester:02X}")
    return lines

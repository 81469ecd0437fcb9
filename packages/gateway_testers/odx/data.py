"""Data of answers: identifiers, numbers with names for people, records of what testers did."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from gateway.faults.interventions import PROTOCOLS
from gateway.servers.access import SESSIONS
from gateway.servers.identifiers import ACTIVE_SESSION, CODES, DidParams
from gateway.servers.uds.context import Context
from gateway_ask.answers.j1979 import j1979
from gateway_testers.odx.dictionary import Dictionary, Param, value
from gateway_testers.odx.xml import short

#: Session by its number, as a state.
SESSION_NAMES = {number: name.capitalize() for name, number in SESSIONS.items()}
#: Pages of data identifiers that OBD on UDS has (SAE J1979-2).
_OBD = {0xF4: "pid", 0xF6: "test", 0xF8: "infotype"}
_UNIT = re.compile(r"(.*) \[(.*)\]")


class Served(NamedTuple):
    """A gateway, as far as testers see it.

    Attributes:
        context: of the UDS server.
        units: name of a signal -> its unit.
        inputs: fault id -> inputs of its monitor, in the order of record 0x21.
    """

    context: Context
    units: Mapping[str, str]
    inputs: Mapping[str, Sequence[str]]


class Identified(NamedTuple):
    """A data identifier: its name, its signal ("": it has none), its data."""

    name: str
    signal: str
    params: Sequence[Param]


class Data:
    """Makes parameters of data, in a dictionary."""

    def __init__(self, dictionary: Dictionary, served: Served) -> None:
        self._dictionary, self._served = dictionary, served

    def identifiers(self) -> dict[int, Identified]:
        """Return all identifiers that can be read, in their order."""
        ids = self._served.context.identifiers
        found = {n: Identified(did.name, did.signal or "", self.of_did(did)) for n, did in ids.table.items()}
        found |= {n: Identified(name, "", self._of_own(n, name)) for n, (name, _) in ids.served.items()}
        session = value("active_session", self._dictionary.number("B", texts=SESSION_NAMES))
        found[ACTIVE_SESSION] = Identified(session.name, "", [session])
        for page, kind in _OBD.items():
            for number in range(page << 8, (page + 1) << 8):
                data = None if number in found else ids.read(number)
                if data is not None:
                    name = f"{kind}_{number & 0xFF:02X}"
                    found[number] = Identified(name, "", self._of_obd(number, name, data))
        return dict(sorted(found.items()))

    def of_did(self, did: DidParams) -> list[Param]:
        """Return the data of an identifier."""
        if did.signal is None:
            return [value(short(did.name), self._dictionary.data(len(did.constant), text=did.text is not None))]
        code = CODES[did.type]
        size = {"B": 8, "H": 16, "I": 32}.get(code)
        dop = self._dictionary.number(
            code,
            scale=did.scale,
            offset=did.offset,
            unit=self._served.units.get(did.signal, ""),
            unknown=None if size is None else (1 << size) - 1,
        )
        return [value(short(did.name), dop, long=did.signal)]

    def _of_own(self, number: int, name: str) -> list[Param]:
        """Return the data of an identifier by which the gateway speaks of itself."""
        if number == self._served.context.trace_did:
            return [value(name, self._dictionary.counted(name, self.intervention()))]
        return [value(name, self._dictionary.data(None))]

    def _of_obd(self, number: int, name: str, data: bytes) -> list[Param]:
        """Return the data of an identifier of OBD: signals where the standard's are known, else bytes."""
        known = {layout.identifier: layout.message for layout in j1979()} if number >> 8 == 0xF4 else {}
        message = known.get(number & 0xFF)
        if message is None or message.length != len(data):
            return [value(name, self._dictionary.data(len(data) if number >> 8 == 0xF4 else None))]
        bits = [self._of_signal(signal) for signal in message.signals]
        return [value(name, self._dictionary.structure(name, bits, size=len(data)))]

    def _of_signal(self, signal: Any) -> Param:
        """Return a signal of the standard: high byte first."""
        first = 8 * (signal.start // 8) + 7 - signal.start % 8
        last = first + signal.length - 1
        dop = self._dictionary.number(
            "i" if signal.is_signed else "I",
            scale=float(signal.scale),
            offset=float(signal.offset),
            unit=signal.unit or "",
            texts={int(k): str(text) for k, text in (signal.choices or {}).items()},
            bits=signal.length,
        )
        return value(short(signal.name), dop, bit=(first // 8, 7 - last % 8))

    def coded(self, name: str, code: str) -> list[Param]:
        """Return a number; a time is two, whose sum it is: ODX has 32 bits at most."""
        if code != "q":
            return [value(name, self._dictionary.number(code))]
        base = name.removesuffix("_ns")
        return [
            value(f"{base}_upper", self._dictionary.number("i", scale=2**32 / 1e9, unit="s")),
            value(f"{base}_rest", self._dictionary.number("I", scale=1e-9, unit="s")),
        ]

    def numbers(self, names: Sequence[str], *, signals: bool = False) -> list[Param]:
        """Return float64 numbers by their names for people, each with its unit."""
        made = []
        for name in names:
            found = None if signals else _UNIT.fullmatch(name)
            plain, unit = (name, self._served.units.get(name, "")) if found is None else found.groups()
            made.append(value(short(plain), self._dictionary.number("d", unit=unit), long=name))
        return made

    def intervention(self) -> list[Param]:
        """Return a record of the trace."""
        number = self._dictionary.number
        return [
            *self.coded("first_ns", "q"),
            *self.coded("last_ns", "q"),
            value("count", number("H")),
            value("protocol", number("B", texts=dict(enumerate(PROTOCOLS)))),
            value("address", number("I")),
            value("session", number("B")),
            value("security", number("B")),
            value("service", number("B")),
            value("request", self._dictionary.data(7)),
            value("outcome", number("B")),
        ]

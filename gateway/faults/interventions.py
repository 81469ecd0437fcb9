"""Interventions of testers: who, what, when, and with which outcome. Bounded, and kept with the fault memory.

Alike interventions in a row are one record with a count. Refused ones take half of the room at most, so that no flood
of refused requests displaces those that were done.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from dataclasses import dataclass, replace

#: Records kept.
MOST = 200
#: Bytes of a request that are kept.
MOST_BYTES = 16
#: Outcome of what was done; others are negative response codes.
DONE = 0
#: Records that one reading of the data identifier gives, the latest first, and the bytes of each.
MOST_READ = 32
#: By what an intervention came; the place is its number in the data identifier.
PROTOCOLS = ("gateway", "uds", "obd", "j1939", "local")
_RECORD = struct.Struct(">qqHBIBBB8s")


@dataclass(frozen=True)
class Intervention:
    """One intervention, or several alike in a row.

    Attributes:
        t_ns: when, the latest one; wall clock.
        protocol: "uds", "obd", "j1939"; "local": another process of this machine; "gateway": by itself.
        bus: name of the bus, "" if by none.
        address: identifier of the request, or source address of J1939; 0 if by no bus.
        session: number of the diagnostic session, 0 where there are none.
        security: security level that was unlocked, 0: none.
        role: as which role the tester was authenticated, "": none; of "local": who it is, and why he overrode a rule.
        action: name of the rule of access that it goes by, or what became of it ("lockout", "dtc_setting_ended").
        request: its first bytes.
        outcome: 0: done; else the negative response code (of UDS also where others refused).
        first_ns: when the first of these was.
        count: how many.
        number: of the record, ascending; 0: not kept yet.
    """

    t_ns: int
    protocol: str
    bus: str
    address: int
    action: str
    request: bytes = b""
    outcome: int = DONE
    session: int = 0
    security: int = 0
    role: str = ""
    first_ns: int = 0
    count: int = 1
    number: int = 0

    @property
    def kind(self) -> tuple[object, ...]:
        """Common fields of alike interventions."""
        return (
            self.protocol, self.bus, self.address, self.action, self.outcome, self.session, self.security, self.role,
        )  # fmt: skip


class Interventions:
    """The records that are kept, the oldest first."""

    def __init__(self, kept: Iterable[Intervention] = ()) -> None:
        self._by_number = {each.number: each for each in sorted(kept, key=lambda each: each.number)}
        self._next = max(self._by_number, default=0) + 1

    def all(self) -> list[Intervention]:
        """Return them, the oldest first."""
        return list(self._by_number.values())

    def note(self, new: Intervention) -> tuple[Intervention, list[int]]:
        """Take one; returns the record that has it now, and the numbers of those that had to go."""
        last = next(reversed(self._by_number.values()), None)
        if last is not None and last.kind == new.kind:
            made = replace(last, t_ns=new.t_ns, count=last.count + 1, request=new.request[:MOST_BYTES])
            self._by_number[made.number] = made
            return made, []
        made = replace(new, number=self._next, first_ns=new.t_ns, request=new.request[:MOST_BYTES])
        self._next += 1
        self._by_number[made.number] = made
        return made, self._make_room()

    def _make_room(self) -> list[int]:
        gone = []
        while len(self._by_number) > MOST:
            refused = [number for number, each in self._by_number.items() if each.outcome != DONE]
            number = refused[0] if len(refused) > MOST // 2 else next(iter(self._by_number))
            del self._by_number[number]
            gone.append(number)
        return gone


def encode(interventions: list[Intervention], numbers: dict[str, int]) -> bytes:
    """Return the latest records as a data identifier has them.

    One byte with how many there are, then for each, the latest first, 34 bytes: times of the first and the latest [ns],
    count, protocol, address, session, security level, service, first 7 bytes of the request, outcome.

    Args:
        interventions: the oldest first.
        numbers: service identifiers of actions.
    """
    latest = interventions[::-1][:MOST_READ]
    made = bytes([len(latest)])
    for each in latest:
        made += _RECORD.pack(
            each.first_ns,
            each.t_ns,
            min(each.count, 0xFFFF),
            PROTOCOLS.index(each.protocol),
            each.address & 0xFFFFFFFF,
            each.session,
            each.security,
            numbers.get(each.action, 0),
            each.request[:7].ljust(7, b"\0") + bytes([each.outcome]),
        )
    return made

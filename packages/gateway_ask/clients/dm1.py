"""Active DTCs that other ECUs broadcast (SAE J1939-73, DM1): nothing is asked."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np
from numpy.typing import NDArray

from gateway.bus.frames import EXTENDED, OWN, Frames
from gateway.faults.vehicle import DtcAnswer
from gateway.j1939.frame import GLOBAL, TP_CM, TP_DT, read_pdu
from gateway.j1939.overheard import Overheard

DM1 = 0xFECA
_GROUPS = (DM1, TP_CM | GLOBAL, TP_DT | GLOBAL)
#: The same as values and masks of identifiers, of any sender.
MASKS = frozenset((EXTENDED | group << 8, EXTENDED | 0x3FFFF << 8) for group in _GROUPS)
#: Bit of a status that an active DTC has: it fails now.
ACTIVE = 0x01


class Dm1Listener:
    """Puts DM1 of all senders together.

    Args:
        buses: indices of the buses.
        names: names of senders by bus and source address; others are named by them, ``obd:21``.
        of_buses: names of the buses, by index.
        ours: bus and source address of the gateway itself.
    """

    def __init__(
        self,
        buses: Collection[int],
        names: Mapping[tuple[int, int], str],
        of_buses: Mapping[int, str],
        ours: Collection[tuple[int, int]],
    ) -> None:
        self.buses = sorted(buses)
        self._names, self._of_buses, self._ours = names, of_buses, frozenset(ours)
        self._transports = {bus: Overheard({DM1}) for bus in self.buses}

    def among(self, frames: Frames) -> NDArray[np.bool_]:
        """Return which frames may be of DM1, shape (n,)."""
        ids = frames["can_id"]
        mine = np.isin((ids >> 8) & 0x3FFFF, _GROUPS) & (ids & EXTENDED != 0) & (frames["flags"] & OWN == 0)
        return np.asarray(mine & np.isin(frames["bus"], self.buses), np.bool_)

    def take(self, frame: np.void) -> DtcAnswer | None:
        """Take one of those; returns what a message says that it completes."""
        bus, pdu = int(frame["bus"]), read_pdu(frame)
        if (bus, pdu.source) in self._ours:
            return None
        if pdu.pgn == DM1:
            return self._read(bus, pdu.source, pdu.data)
        transport, t_ns = self._transports[bus], int(frame["t_ns"])
        transport.pass_time(t_ns)
        message = transport.take(pdu, t_ns)
        return None if message is None else self._read(bus, message.source, message.data)

    def _read(self, bus: int, source: int, data: bytes) -> DtcAnswer | None:
        if len(data) < 6:
            return None
        found = {}
        for k in range(2, len(data) - 3, 4):
            spn = int.from_bytes(data[k : k + 2], "little") | (data[k + 2] >> 5) << 16
            fmi = data[k + 2] & 0x1F
            if spn and data[k : k + 4] != b"\xff\xff\xff\xff":
                found[f"SPN {spn} FMI {fmi}"] = ACTIVE
        name = self._names.get((bus, source), f"{self._of_buses[bus]}:{source:02X}")
        return DtcAnswer(name, found, ACTIVE, whole=False)

    def succeed(self, old: Dm1Listener, buses: Mapping[int, int]) -> None:
        """Keep messages that are under way."""
        self._transports |= {
            buses[bus]: transport for bus, transport in old._transports.items() if buses.get(bus) in self._transports
        }

    @property
    def errors(self) -> int:
        """Messages that were cut."""
        return sum(each.cut for each in self._transports.values())

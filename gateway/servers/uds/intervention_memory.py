"""The user-defined memory of 0x19 17 to 19: interventions, as DTCs of their own (ISO 14229-1, 12.3).

Each kind of intervention is a DTC ``U1Fxx-68``: xx is the service, 68 is "event information" (SAE J2012-DA). It is
confirmed if it was done, pending if it was only refused. Snapshot records are the latest interventions of the kind, the
latest first, each as the data identifier of the trace has it; extended data records 01, 10 and 11 are number, first and
latest time, as those of the other DTCs.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence

from gateway.faults.dtc import Dtc
from gateway.faults.interventions import DONE, Intervention, encode
from gateway.faults.status import Status
from gateway.servers.access import FREE, GUARDED

#: The memory's number (MemorySelection).
SELECTION = 0x01
#: Actions -> lower byte of their base code; the number of their service in the trace.
NUMBERS = {
    **GUARDED,
    **FREE,
    "obd_clear": 0x04,
    "j1939_clear": 0xD3,
    "lockout": 0x36,
    "address": 0xD8,
    "dtc_setting_ended": 0xC5,
    "communication_ended": 0x68,
}
#: Of actions without a number: later versions of the file have them.
OTHER = 0x00
_EVENT_INFORMATION = 0x68
#: Snapshot records of a kind.
MOST_SNAPSHOTS = 16


def dtc_of(action: str) -> Dtc:
    """Return the DTC of an action."""
    return Dtc.parse(f"U1F{NUMBERS.get(action, OTHER):02X}-{_EVENT_INFORMATION:02X}")


class InterventionMemory:
    """The interventions, as 0x19 reads them.

    Args:
        interventions: of testers, the oldest first.
        did: data identifier of the trace.
    """

    def __init__(self, interventions: Sequence[Intervention], did: int) -> None:
        self._did = did
        self._by_dtc: dict[Dtc, list[Intervention]] = {}
        for each in reversed(interventions):
            self._by_dtc.setdefault(dtc_of(each.action), []).append(each)

    def by_status(self, mask: int) -> list[tuple[Dtc, int]]:
        """Return the DTCs with any bit of a mask set, and their status, in order."""
        found = [(dtc, _status(each)) for dtc, each in sorted(self._by_dtc.items())]
        return [(dtc, status) for dtc, status in found if status & mask]

    def status(self, dtc: Dtc) -> int | None:
        """Return the status of a DTC, None if there is none."""
        return _status(self._by_dtc[dtc]) if dtc in self._by_dtc else None

    def snapshots(self, dtc: Dtc) -> list[tuple[int, list[tuple[int, bytes]]]]:
        """Return the snapshot records of a DTC: number, and identifiers with their bytes."""
        latest = self._by_dtc[dtc][:MOST_SNAPSHOTS]
        return [(k, [(self._did, encode([each], NUMBERS)[1:])]) for k, each in enumerate(latest, start=1)]

    def extended_data(self, dtc: Dtc) -> dict[int, bytes]:
        """Return the extended data records of a DTC, by number."""
        mine = self._by_dtc[dtc]
        return {
            0x01: bytes([min(sum(each.count for each in mine), 255)]),
            0x10: struct.pack(">q", min(each.first_ns for each in mine)),
            0x11: struct.pack(">q", max(each.t_ns for each in mine)),
        }


def _status(interventions: Iterable[Intervention]) -> int:
    done = any(each.outcome == DONE for each in interventions)
    return int(Status.CONFIRMED_DTC if done else Status.PENDING_DTC)

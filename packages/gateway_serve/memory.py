"""Contents of the fault memory's file, read beside the daemon that writes it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from gateway.faults import service
from gateway.faults.dtc import Dtc
from gateway.faults.fault_groups import cases_of
from gateway.faults.lock import is_unsaved
from gateway.faults.memory_reader import MemoryReader
from gateway.faults.records import Recording
from gateway.faults.status import Status
from gateway.faults.summary import NO_RESULT, summary_of
from gateway_fdi.errors import GatewayError, InputError
from gateway_serve.words import sentences

#: Bits of the status byte, the lowest first, as ISO 14229-1 calls them.
BITS = (
    "testFailed",
    "testFailedThisOperationCycle",
    "pendingDTC",
    "confirmedDTC",
    "testNotCompletedSinceLastClear",
    "testFailedSinceLastClear",
    "testNotCompletedThisOperationCycle",
    "warningIndicatorRequested",
)


class MemoryFile:
    """Reads a fault memory; of a part that cannot be read it says why, under ``error``.

    Args:
        path: of the file; None: the daemon keeps it in its process only.
    """

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self._opened = None if path is None else MemoryReader(path)

    def close(self) -> None:
        """Leave the file to its writer; a look opens it again."""
        if self._opened is not None:
            self._opened.close()

    def read(self, faults: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
        """Return entries, the cases that they are, the status byte of each fault, operation cycles and readiness.

        Args:
            faults: the catalogue, as the status socket's hello has it.
        """
        if self._path is None or self._opened is None:
            return {"error": "this gateway keeps its faults in its process only", **_NOTHING}
        try:
            store = self._opened.store()
            records = store.load()
            stored = not is_unsaved(self._path)
            entries = service.entries_in(store, records, stored=stored)
            status = {record.id: record.status for record in records}
            restarts = service.restarts_in(store)
            ecu_dtcs = [service.ecu_dtc_as_dict(each) for each in store.ecu_dtcs()]
            cycles = {name: {"number": c.number, "open": c.open} for name, c in store.cycles().items()}
        except (GatewayError, OSError) as error:
            self.close()
            return {"error": str(error), **_NOTHING}
        tested = {fault["id"]: fault.get("tested", "") for fault in faults}
        for entry in entries:
            entry["words"] = sentences(entry | {"tested": tested.get(entry["fault"])})
        return {
            "error": "",
            "entries": entries,
            "cases": [case.as_dict() for case in cases_of(entries)],
            "status": status,
            "cycles": cycles,
            "ecu_dtcs": ecu_dtcs,
            "restarts": restarts,
            "stored": stored,
            "readiness": readiness(faults, status),
            "summary": summary_of(
                entries,
                ecus={fault["monitor"]: fault.get("ecu", "") for fault in faults},
                tests=len(faults),
                not_judged=[NO_RESULT for fault in faults if status.get(fault["id"], _OPEN) & _OPEN_NOW],
            ).as_dict(),
        }

    def interventions(self) -> list[dict[str, Any]]:
        """Return what testers did, the oldest first.

        Raises:
            GatewayError: the file cannot be read.
        """
        return [] if self._path is None else service.interventions(self._path)

    def recordings(self, dtc: str) -> list[Recording]:
        """Return the recordings of a DTC, the oldest first; none, where there is no entry of it.

        Raises:
            GatewayError: the file cannot be read.
        """
        try:
            return [] if self._path is None else service.recordings(self._path, dtc)
        except InputError:
            return []

    def recording(self, dtc: str, number: int) -> Recording | None:
        """Return a recording of a DTC, the oldest has number 1; None: there is none.

        Raises:
            InputError: it is not a DTC.
        """
        found = self.recordings(str(Dtc.parse(dtc)))
        return found[number - 1] if 1 <= number <= len(found) else None


#: Status of a test that has never run, and the bit that says so of this cycle.
_OPEN_NOW = int(Status.NOT_COMPLETED_THIS_CYCLE)
_OPEN = int(Status.NOT_COMPLETED_SINCE_CLEAR) | _OPEN_NOW

_NOTHING: dict[str, Any] = {
    "entries": [], "cases": [], "status": {}, "cycles": {}, "ecu_dtcs": [], "restarts": {"count": 0}, "stored": True,
    "readiness": [], "summary": summary_of(()).as_dict(),
}  # fmt: skip


def shown(memory: Mapping[str, Any]) -> dict[str, Any]:
    """Return the part of a memory that a page shows: not the status of each of many tests."""
    return {key: value for key, value in memory.items() if key not in ("status", "cases")}


def readiness(faults: Sequence[Mapping[str, Any]], status: Mapping[str, int]) -> list[dict[str, Any]]:
    """Return how many tests have run to their end since the clear, and in this cycle: of each monitor, and each ECU."""
    made: dict[str, dict[str, Any]] = {}
    for fault in faults:
        owner = f"ECU {fault['ecu']}" if fault.get("ecu") else fault["monitor"]
        row = made.setdefault(owner, {"monitor": owner, "tests": 0, "since_clear": 0, "this_cycle": 0})
        bits = status.get(fault["id"], _OPEN)
        row["tests"] += 1
        row["since_clear"] += not bits & Status.NOT_COMPLETED_SINCE_CLEAR
        row["this_cycle"] += not bits & Status.NOT_COMPLETED_THIS_CYCLE
    return list(made.values())

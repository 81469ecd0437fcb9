"""Contents of the fault memory's file, read beside the daemon that writes it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from gateway.faults import service
from gateway.faults.cases import cases_of
from gateway.faults.dtc import Dtc
from gateway.faults.lock import is_unsaved
from gateway.faults.records import Recording
from gateway.faults.status import Status
from gateway.faults.store import Store
from gateway.serve.words import told_in_words
from gateway_fdi.errors import GatewayError, InputError

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

    It stays open between two looks: to open it takes thousands of small pieces of memory, and between those that go
    with the connection lie those of what was read, so that the heap of the process would grow.

    Args:
        path: of the file; None: the daemon keeps it in its process only.
    """

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self._store: Store | None = None
        self._inode = 0

    def _opened(self, path: Path) -> Store:
        inode = path.stat().st_ino  # another one, where a damaged file was put aside
        if self._store is None or inode != self._inode:
            self.close()
            self._store, self._inode = service.open_reader(path), inode
        return self._store

    def close(self) -> None:
        """Leave the file to its writer; a look opens it again."""
        store, self._store = self._store, None
        if store is not None:
            store.close()

    def read(self, faults: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
        """Return entries, the cases that they are, the status byte of each fault, operation cycles and readiness.

        Args:
            faults: the catalogue, as the status socket's hello has it.
        """
        if self._path is None:
            return {"error": "this gateway keeps its faults in its process only", **_NOTHING}
        try:
            store = self._opened(self._path)
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
        for entry in entries:
            entry["words"] = told_in_words(entry)
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


_NOTHING: dict[str, Any] = {
    "entries": [], "cases": [], "status": {}, "cycles": {}, "ecu_dtcs": [], "restarts": {"count": 0}, "stored": True,
    "readiness": [],
}  # fmt: skip


def readiness(faults: Sequence[Mapping[str, Any]], status: Mapping[str, int]) -> list[dict[str, Any]]:
    """Return of each monitor how many of its tests have run to their end since the clear, and in this cycle."""
    made: dict[str, dict[str, Any]] = {}
    for fault in faults:
        row = made.setdefault(
            fault["monitor"], {"monitor": fault["monitor"], "tests": 0, "since_clear": 0, "this_cycle": 0}
        )
        bits = status.get(fault["id"], int(Status.NOT_COMPLETED_SINCE_CLEAR | Status.NOT_COMPLETED_THIS_CYCLE))
        row["tests"] += 1
        row["since_clear"] += not bits & Status.NOT_COMPLETED_SINCE_CLEAR
        row["this_cycle"] += not bits & Status.NOT_COMPLETED_THIS_CYCLE
    return list(made.values())

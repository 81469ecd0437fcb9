"""The fault memory as others may read it: as it was last written."""

from __future__ import annotations

from gateway.faults.catalogue import Catalogue, FaultDefinition
from gateway.faults.entries import DtcState, DtcStatus, Entry, entry_of
from gateway.faults.ledger import Ledger
from gateway.faults.mil import is_mil_on
from gateway.faults.records import Permanent
from gateway.faults.status import Status


class Readable:
    """The reading side of a fault memory.

    While nothing can be written it shows what the memory knows; see :class:`gateway.faults.ledger.Ledger`.
    """

    catalogue: Catalogue
    ledger: Ledger
    _definitions: dict[str, FaultDefinition]
    _order: list[tuple[str, bool]]  # ids in order of DTC, and whether the fault is in the catalogue
    _by_dtc: dict[int, list[tuple[str, bool]]]

    def _put_in_order(self) -> None:
        """Put the faults in order of DTC; to be called when there are others."""
        found = sorted(self.ledger.records.values(), key=lambda record: (record.dtc, record.id))
        self._order = [(record.id, self.catalogue.get(record.id) is not None) for record in found]
        self._by_dtc = {}
        for record, place in zip(found, self._order, strict=True):
            self._by_dtc.setdefault(record.dtc, []).append(place)

    def entries(self) -> list[Entry]:
        """Return every DTC that has failed since it was cleared, in order of DTC."""
        found = [entry_of(r) for r in self.ledger.shown_failed()]
        return sorted(found, key=lambda entry: (entry.dtc, entry.fault))

    def supported(self, mask: int | None = None) -> list[DtcStatus]:
        """Return every DTC of the catalogue, and those that are still stored, in order of DTC.

        Args:
            mask: only those with any of these status bits set; None: all.
        """
        found = ((self.ledger.shown[fault], monitored) for fault, monitored in self._order)
        return [
            DtcStatus(record.dtc, record.id, record.status)
            for record, monitored in found
            if (mask is None or record.status & mask) and (monitored or record.occurrence)
        ]

    def entry_of_dtc(self, dtc: int) -> Entry | None:
        """Return what is known of a DTC of the catalogue, or of one that is still stored; None: it is neither."""
        for fault, monitored in self._by_dtc.get(dtc, ()):
            if monitored or self.ledger.shown[fault].occurrence:
                return self.entry(fault)
        return None

    def entry(self, fault: str) -> Entry:
        """Return what is known of one fault, also when it has not failed since it was cleared."""
        return entry_of(self.ledger.shown[fault])

    def state(self, fault: str) -> DtcState:
        """Return what frames tell of one fault: the short way, for each change."""
        record = self.ledger.shown[fault]
        return DtcState(record.dtc, record.status, record.occurrence)

    def definition(self, fault: str) -> FaultDefinition:
        """Return the definition of a fault, also of one that is only stored any more."""
        return self._definitions[fault]

    def by_status_mask(self, mask: int) -> list[Entry]:
        """Return the entries with any of the mask's bits set."""
        return [entry for entry in self.entries() if entry.status & mask]

    def count_by_status_mask(self, mask: int) -> int:
        """Return how many entries :meth:`by_status_mask` finds."""
        return self.ledger.count_failed(mask)

    def status(self, fault: str) -> Status:
        """Return the status byte of a fault."""
        return Status(self.ledger.shown[fault].status)

    def is_mil_on(self) -> bool:
        """Return whether a DTC asks for the MIL."""
        return is_mil_on(self.ledger.shown.values(), self._definitions)

    def permanent(self) -> list[Permanent]:
        """Return the permanent DTCs, the oldest first."""
        return self.ledger.shown_permanent

    def in_order(self, what: str) -> list[Entry]:
        """Return faults in order of ``first_failed``, ``last_failed``, ``first_confirmed``, ``last_confirmed``."""
        known = [r for r in self.ledger.shown_failed() if getattr(r, what) is not None]
        return [entry_of(r) for r in sorted(known, key=lambda r: getattr(r, what))]

"""What others may read of the fault memory: what was last written."""

from __future__ import annotations

from gateway.faults.catalogue import Catalogue, FaultDefinition
from gateway.faults.entries import Entry, entry_of
from gateway.faults.ledger import Ledger
from gateway.faults.mil import is_mil_on
from gateway.faults.records import Permanent
from gateway.faults.status import Status


class Readable:
    """The reading side of a fault memory.

    While nothing can be written it shows what the memory knows; see :class:`gateway.faults.ledger.Ledger`.
    """

    catalogue: Catalogue
    _held: Ledger
    _definitions: dict[str, FaultDefinition]

    def entries(self) -> list[Entry]:
        """Return every DTC that has failed since it was cleared, in order of DTC."""
        found = [entry_of(r) for r in self._held.shown.values() if r.occurrence > 0]
        return sorted(found, key=lambda entry: (entry.dtc, entry.fault))

    def supported(self) -> list[Entry]:
        """Return every DTC of the catalogue, and those that are still stored, in order of DTC."""
        found = [entry_of(r) for r in self._held.shown.values() if r.occurrence or self.catalogue.get(r.id) is not None]
        return sorted(found, key=lambda entry: (entry.dtc, entry.fault))

    def entry(self, fault: str) -> Entry:
        """Return what is known of one fault, also when it has not failed since it was cleared."""
        return entry_of(self._held.shown[fault])

    def definition(self, fault: str) -> FaultDefinition:
        """Return the definition of a fault, also of one that is only stored any more."""
        return self._definitions[fault]

    def by_status_mask(self, mask: int) -> list[Entry]:
        """Return the entries with any of the mask's bits set."""
        return [entry for entry in self.entries() if entry.status & mask]

    def count_by_status_mask(self, mask: int) -> int:
        """Return how many entries :meth:`by_status_mask` finds."""
        return sum(1 for r in self._held.shown.values() if r.occurrence > 0 and r.status & mask)

    def status(self, fault: str) -> Status:
        """Return the status byte of a fault."""
        return Status(self._held.shown[fault].status)

    def is_mil_on(self) -> bool:
        """Tell whether a DTC asks for the MIL."""
        return is_mil_on(self._held.shown.values(), self._definitions)

    def permanent(self) -> list[Permanent]:
        """Return the permanent DTCs, the oldest first."""
        return self._held.shown_permanent

    def in_order(self, what: str) -> list[Entry]:
        """Return faults in order of ``first_failed``, ``last_failed``, ``first_confirmed``, ``last_confirmed``."""
        known = [r for r in self._held.shown.values() if getattr(r, what) is not None]
        return [entry_of(r) for r in sorted(known, key=lambda r: getattr(r, what))]

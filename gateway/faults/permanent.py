"""Permanent DTCs: they survive a clear until their test has passed (OBD mode 0A, ISO 14229-1 0x19 15)."""

from __future__ import annotations

from collections.abc import Iterable

from gateway.faults.catalogue import FaultDefinition
from gateway.faults.records import Permanent
from gateway.faults.status import Status

_NOT_PASSED = Status.NOT_COMPLETED_THIS_CYCLE | Status.TEST_FAILED_THIS_CYCLE


def _lit(definition: FaultDefinition) -> Status:
    """Return the bit that makes a DTC permanent: its lamp, or that it is confirmed if it has none."""
    return Status.WARNING_INDICATOR if definition.indicator else Status.CONFIRMED_DTC


class PermanentDtcs:
    """The permanent DTCs, the oldest first."""

    def __init__(self, kept: Iterable[Permanent]) -> None:
        self._by_fault = {entry.fault: entry for entry in kept}

    def all(self) -> list[Permanent]:
        """Return them, the oldest first."""
        return list(self._by_fault.values())

    def on_failed(self, definition: FaultDefinition, status: Status, t_ns: int) -> bool:
        """Take a failure with the status after it; returns whether a DTC became permanent."""
        known = definition.id in self._by_fault
        if known or not definition.permanent or not status & _lit(definition):
            return False
        self._by_fault[definition.id] = Permanent(definition.id, definition.dtc.value, t_ns)
        return True

    def on_cycle_end(self, definition: FaultDefinition, status: Status) -> bool:
        """Take the status at the end of a cycle; returns whether the DTC is permanent no more.

        Its test has passed in the whole cycle, and its lamp is out.
        """
        return not status & (_lit(definition) | _NOT_PASSED) and self.give_up(definition.id)

    def give_up(self, fault: str) -> bool:
        """Forget one; returns whether it was there."""
        return self._by_fault.pop(fault, None) is not None

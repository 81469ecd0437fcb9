"""The DTCs that J1939 tells of: those of faults with SPN and FMI, by their state."""

from __future__ import annotations

from collections.abc import Iterable

from gateway.faults.entries import Entry
from gateway.faults.memory import FaultMemory
from gateway.faults.status import Status
from gateway_testers.j1939.messages import Coded

_ACTIVE = Status.CONFIRMED_DTC | Status.TEST_FAILED


class CodedDtcs:
    """Entries of the fault memory with their definitions, in the order in which they failed first.

    Active are confirmed DTCs whose test fails; previously active those whose test does not any more.
    """

    def __init__(self, memory: FaultMemory) -> None:
        self._memory = memory

    def _coded(self, entries: Iterable[Entry]) -> list[Coded]:
        found = [(self._memory.definition(entry.fault), entry) for entry in entries]
        return [coded for coded in found if coded[0].spn is not None]

    def all(self) -> list[Coded]:
        """Return those of every state."""
        return self._coded(self._memory.in_order("first_failed"))

    def active(self) -> list[Coded]:
        """Return those that are active."""
        return [coded for coded in self.all() if coded[1].status & _ACTIVE == _ACTIVE]

    def previous(self) -> list[Coded]:
        """Return those that were active, and are not any more."""
        return [coded for coded in self.all() if coded[1].status & _ACTIVE == Status.CONFIRMED_DTC]

    def pending(self) -> list[Coded]:
        """Return those that failed in this operation cycle or the last one."""
        return [coded for coded in self.all() if coded[1].status & Status.PENDING_DTC]

    def permanent(self) -> list[Coded]:
        """Return those that survive a clear."""
        return self._coded(self._memory.entry(p.fault) for p in self._memory.permanent())

    def is_active(self, fault: str) -> bool:
        """Return whether a fault's DTC is active."""
        return self._memory.status(fault) & _ACTIVE == _ACTIVE

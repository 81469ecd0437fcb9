"""Operation cycles (AUTOSAR DEM): effects of their begin and end on status bytes - confirmation, healing, aging.

The state of each cycle is stored (DemOperationCycleStatusStorage). A process that dies ends none of them: what it left
open goes on in the next one, with the same number and the same status bytes, until an end in order. So a death counts
for nothing, however often it happens.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from gateway.faults import status as transition
from gateway.faults.catalogue import FaultDefinition
from gateway.faults.event_memory import EventMemory
from gateway.faults.ledger import Ledger
from gateway.faults.records import Cycle, Record
from gateway.faults.settings import POWER
from gateway.faults.status import STATUS, Status


class OperationCycles:
    """Begins and ends operation cycles. Times are of the wall clock.

    Args:
        held: cycles and records, with what is to be written.
        definitions: of all faults, by id.
        entries: of those that have failed.
        before_end: called before a cycle ends.
    """

    def __init__(
        self,
        held: Ledger,
        definitions: Mapping[str, FaultDefinition],
        entries: EventMemory,
        before_end: Callable[[], None],
    ) -> None:
        self._held, self._definitions, self._entries = held, definitions, entries
        self._before_end = before_end
        self._left_open = {name for name, cycle in held.cycles.items() if cycle.open}

    def succeed(self, old: OperationCycles) -> None:
        """Go on with what another one of the same process knows."""
        self._left_open = old._left_open

    def is_left_open(self, name: str) -> bool:
        """Return whether a process that is gone left a cycle open, and it neither went on nor ended since."""
        return name in self._left_open

    def go_on(self, name: str) -> bool:
        """Go on with a cycle that a process left open which is gone; returns whether there is such a one."""
        left = self.is_left_open(name)
        self._left_open.discard(name)
        return left

    def start(self, t_ns: int, name: str) -> bool:
        """Start a cycle; one that is open is ended first (Dem_RestartOperationCycle).

        But the power cycle that a process left open which is gone goes on.

        Returns:
            whether a new cycle began.
        """
        if name == POWER and self.go_on(name):
            return False
        self.end(t_ns, name)
        for record in self._held.records.values():
            if self._definitions[record.id].cycle == name:
                record.status = int(transition.on_cycle_start(STATUS[record.status]))
                self._held.touch(record.id)
                self._entries.test_anew(record.id)
        self._held.note_cycle(name, Cycle(self.number(name) + 1, True, t_ns))
        return True

    def end(self, t_ns: int, name: str) -> None:
        """End a cycle, if it is open; the end of the power cycle ends all of them."""
        ended = [name] if name != POWER else sorted(self._held.cycles, key=lambda each: each == POWER)
        for each in ended:
            if self.is_open(each):
                self._end(t_ns, each)

    def _end(self, t_ns: int, name: str) -> None:
        self._before_end()
        self._left_open.discard(name)
        for record in self._held.records.values():
            definition = self._definitions[record.id]
            if definition.aging_cycle == name and record.occurrence:
                self._age(record, definition)
            if definition.cycle == name:
                status, cycles = transition.on_cycle_end(STATUS[record.status], record.cycles, definition.rules)
                record.become(status, cycles)
                if not status & Status.PENDING_DTC:
                    record.hold = ""  # there is nothing left to confirm
                self._held.touch(record.id)
                self._held.note_permanent(self._held.permanent.on_cycle_end(definition, status))
        self._held.note_cycle(name, Cycle(self._held.cycles[name].number, False, t_ns))

    def _age(self, record: Record, definition: FaultDefinition) -> None:
        status, cycles, aged = transition.on_aging_cycle_end(STATUS[record.status], record.cycles, definition.rules)
        record.become(status, cycles)
        self._held.touch(record.id)
        if aged:
            self._entries.remove(record)

    def number(self, name: str) -> int:
        """Return the number of a cycle, from 1; 0 before the first."""
        return self._held.cycles[name].number if name in self._held.cycles else 0

    def is_open(self, name: str) -> bool:
        """Return whether a cycle has begun, and is not over."""
        return name in self._held.cycles and self._held.cycles[name].open

    def counts(self, name: str) -> bool:
        """Return whether results count in an operation cycle: it has begun, and is not over.

        The power cycle is there from the start, also where nothing begins it.
        """
        return self.is_open(name) or (name == POWER and not self.number(POWER))

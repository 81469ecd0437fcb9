"""Failures with an entry, and its contents (AUTOSAR DEM: event memory, displacement, freeze frames).

Room is made for a more important failure; one that finds none waits, as does one that gave way, until there is room or
its operation cycle is over.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable, Mapping

from gateway.faults import freeze_frames
from gateway.faults import status as transition
from gateway.faults.catalogue import Catalogue, FaultDefinition
from gateway.faults.displacement import victim
from gateway.faults.entries import Foreseen
from gateway.faults.explanation import WAITING
from gateway.faults.failures import Failure, Observed, finite, known, latest_signals
from gateway.faults.ledger import OVERFLOW, Ledger
from gateway.faults.records import FreezeFrame, Record
from gateway.faults.status import STATUS, Cycles, Status

#: The occurrence counter stops here.
MOST_OCCURRENCES = 255

_TEST_FAILED, _CONFIRMED = int(Status.TEST_FAILED), int(Status.CONFIRMED_DTC)
#: The bit that stores a freeze frame when it rises; a counter's value stands for testFailed.
_FREEZE_FRAME_AT: dict[str | int, int] = {
    "pending": int(Status.PENDING_DTC),
    "confirmed": _CONFIRMED,
}


class EventMemory:
    """Makes, displaces and removes entries.

    Args:
        held: records of all faults, with what is to be written.
        definitions: of all of them, by id.
        catalogue: the faults that are monitored.
        size: entries there is room for; None: for all.

    Attributes:
        room: whether an entry has gone since those that wait were tried again.
        explained: ids of the faults whose confirmation waits for what explains them.
    """

    def __init__(
        self, held: Ledger, definitions: Mapping[str, FaultDefinition], catalogue: Catalogue, size: int | None
    ) -> None:
        self._held, self._definitions, self._catalogue = held, definitions, catalogue
        self._size = size
        self._prestored: dict[str, FreezeFrame] = {}
        self._refused: dict[str, Failure] = {}
        self.room = False
        self.explained: Container[str] = ()

    def succeed(self, old: EventMemory) -> None:
        """Go on with what waits in another one."""
        self._prestored |= old._prestored
        self._refused |= old._refused
        self.room = True  # there may be more of it now

    # Results of a fault

    def prestore(self, fault: str, frame: FreezeFrame) -> None:
        """Keep a freeze frame of the time before a failure, for the case that it fails."""
        self._prestored[fault] = frame

    @property
    def waits(self) -> bool:
        """Whether there is anything for :meth:`give_up`."""
        return bool(self._prestored or self._refused)

    def give_up(self, record: Record) -> None:
        """Give up what waits of a fault: it has passed. The frame of one that can still be confirmed is kept."""
        if not record.hold:
            self._prestored.pop(record.id, None)
        self._refused.pop(record.id, None)

    def test_anew(self, fault: str) -> None:
        """Give up a failure that found no room: the fault is tested again in a new operation cycle."""
        self._refused.pop(fault, None)

    def fail(self, definition: FaultDefinition, record: Record, failure: Failure) -> None:
        """Take one qualified failure: the only way by which a DTC becomes pending or confirmed."""
        old, waits, status, cycles = self._after_failure(definition, record)
        if not record.occurrence and not self._make_room(definition):
            record.become(transition.on_displaced(status), Cycles())
            seen = failure.observe()
            self._refused[record.id] = failure._replace(observe=lambda: seen)
            return
        record.become(status, cycles)
        if waits and not record.hold and cycles.failed >= definition.confirm_cycles:
            record.hold = WAITING
        risen = int(status) & ~int(old)
        freezes = risen & _FREEZE_FRAME_AT.get(definition.freeze_frame_at, _TEST_FAILED)
        if record.hold and definition.freeze_frame_at == "confirmed":  # it is of this time, if it comes
            self.prestore(definition.id, FreezeFrame(0, failure.t_ns, finite(failure.observe().frame)))
        observed = failure.observe() if freezes or risen & _TEST_FAILED else Observed()
        if risen & _TEST_FAILED:
            self._note_failure(record, failure, observed)
        if risen & _CONFIRMED:
            self._note_confirmed(record)
        if freezes:
            prestored = self._prestored.pop(definition.id, None)
            frame = prestored or FreezeFrame(0, failure.t_ns, finite(observed.frame))
            freeze_frames.keep(record.freeze_frames, frame, definition.freeze_frames)
        became = self._held.permanent.on_failed(definition, status, failure.t_ns)
        self._held.note_permanent(became)

    def _after_failure(self, definition: FaultDefinition, record: Record) -> tuple[Status, bool, Status, Cycles]:
        """Return the status byte that a failure finds, whether its confirmation waits, and what it becomes."""
        old = STATUS[record.status]
        if not record.occurrence:  # failures that were refused earlier in this cycle have not been counted
            old &= ~(Status.TEST_FAILED | Status.TEST_FAILED_THIS_CYCLE)
        waits = record.id in self.explained and not int(old) & _CONFIRMED
        return old, waits, *transition.on_failed(old, record.cycles, definition.rules, wait=waits)

    def foresee(self, definition: FaultDefinition, record: Record) -> Foreseen:
        """Return a DTC after its next verdict, if that counts; nothing changes."""
        if self._size is not None and not record.occurrence:
            return Foreseen()  # there may be no room for it
        old, _, status, _ = self._after_failure(definition, record)
        more = int(status) & ~int(old) & _TEST_FAILED
        occurrence = min(record.occurrence + bool(more), MOST_OCCURRENCES)
        passed = int(transition.on_passed(STATUS[record.status]))
        return Foreseen.of(record.status, int(status), passed, occurrence)

    def wait_no_longer(self, definition: FaultDefinition, record: Record, t_ns: int) -> None:
        """Confirm a DTC whose confirmation has waited, or was held."""
        record.hold = ""
        self._held.touch(record.id)
        old = record.status
        record.status = int(transition.on_awaited(STATUS[old], record.cycles, definition.rules))
        if not record.status & ~old & _CONFIRMED:
            return
        self._note_confirmed(record)
        if definition.freeze_frame_at == "confirmed" and definition.id in self._prestored:
            freeze_frames.keep(record.freeze_frames, self._prestored.pop(definition.id), definition.freeze_frames)
        self._held.note_permanent(self._held.permanent.on_failed(definition, STATUS[record.status], t_ns))

    def _note_confirmed(self, record: Record) -> None:
        record.last_confirmed = self._held.next_in_order()
        if record.first_confirmed is None:
            record.first_confirmed = record.last_confirmed

    def _note_failure(self, record: Record, failure: Failure, observed: Observed) -> None:
        sequence = self._held.next_in_order()
        record.occurrence = min(record.occurrence + 1, MOST_OCCURRENCES)
        self._held.touch(record.id)
        record.first_ns = failure.t_ns if record.first_ns is None else record.first_ns
        record.last_ns = failure.t_ns
        record.first_failed = sequence if record.first_failed is None else record.first_failed
        record.last_failed = sequence
        record.evidence = failure.evidence
        record.inputs = finite(observed.inputs)

    # Room

    def stored(self) -> list[Record]:
        """Return the records that have an entry."""
        return self._held.failed()

    def _has_room(self) -> bool:
        return self._size is None or len(self.stored()) < self._size

    def _make_room(self, definition: FaultDefinition) -> bool:
        """Make room for one entry; False if all that is there is more important."""
        if self._has_room():
            return True
        found = victim(definition, [(self._definitions[r.id], r) for r in self.stored()])
        self._held.set_fact(OVERFLOW, 1)
        if found is None:
            return False
        if found.status & Status.TEST_FAILED and self._catalogue.get(found.id) is not None:
            seen = Observed(latest_signals(found), known(found.inputs))
            self._refused[found.id] = Failure(found.last_ns or 0, found.evidence, lambda: seen)
        found.status = int(transition.on_displaced(Status(found.status)))
        self.remove(found)
        self.room = False  # the newcomer takes it
        return True

    def remove(self, record: Record) -> None:
        """Remove what is stored of a fault; its status byte stays."""
        fresh = Record(record.id, record.dtc, record.status)
        fresh.peak_fdc, fresh.near_misses = record.peak_fdc, record.near_misses
        record.take_over(fresh)
        self.room = True
        self._held.touch(record.id)

    def forget(self, cleared: Iterable[str]) -> None:
        """Give up what waits of cleared faults; their entries leave room for others."""
        for fault in cleared:
            self.give_up(self._held.records[fault])
            self.room = True

    def admit_refused(self, counts: Callable[[str], bool]) -> list[tuple[FaultDefinition, Record, Status]]:
        """Enter failures that a full memory refused, or whose entries gave way, if there is room for them now.

        The most important come first, of these the oldest; a fault whose operation cycle is over is not entered.

        Args:
            counts: returns whether results count in an operation cycle.

        Returns:
            each with its record, and the status byte before.
        """
        if not self.room:
            return []
        self.room = False
        entered = []
        waiting = [(self._definitions[fault], failure) for fault, failure in self._refused.items()]
        for definition, failure in sorted(waiting, key=lambda w: (w[0].priority, w[1].t_ns)):
            if not self._has_room():
                break
            if not counts(definition.cycle):
                continue
            record = self._held.records[definition.id]
            old = STATUS[record.status]
            del self._refused[definition.id]
            self.fail(definition, record, failure)
            entered.append((definition, record, old))
        return entered

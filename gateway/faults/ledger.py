"""Contents of the fault memory in this process, the changes that are not written yet, and how they get written.

There are two views of the records: as they are (``records``), and as they were last written (``shown``), which is what
others may see. A write can be done by a thread beside the gateway, with copies of its own; one at a time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from copy import copy
from dataclasses import dataclass
from operator import add
from typing import Any

from gateway.faults.interventions import DONE, Intervention, Interventions
from gateway.faults.outgoing import Outgoing, Tally, fitting
from gateway.faults.permanent import PermanentDtcs
from gateway.faults.records import Changes, Cycle, Description, Permanent, Record, Recording
from gateway.faults.retry_policy import RetryPolicy
from gateway.faults.status import PASSED
from gateway.faults.store import Store, StoreError
from gateway.faults.vehicle import DtcAnswer, EcuDtc, VehicleMemory
from gateway.faults.writer_thread import Work, Writer

#: Number in the store: how many failures and confirmations the memory has put in order; whether an entry had to be
#: given up.
SEQUENCE, OVERFLOW = "sequence", "overflow"


def _with_entry(records: Mapping[str, Record], faults: Iterable[str]) -> list[Record]:
    return [record for record in (records[fault] for fault in faults) if record.occurrence]


def _joined(first: Changes, then: Changes) -> Changes:
    """Return earlier changes together with later ones, which win."""
    return Changes(
        cycles={**first.cycles, **then.cycles},
        answered={**first.answered, **then.answered},
        permanent=first.permanent if then.permanent is None else then.permanent,
        recordings=[*first.recordings, *then.recordings],
        kept_recordings=then.kept_recordings,
        identifiers={**first.identifiers, **then.identifiers},
        facts={**first.facts, **then.facts},
        buses=first.buses if then.buses is None else then.buses,
        described={**first.described, **then.described},
        interventions={**first.interventions, **then.interventions},
        kept_interventions=then.kept_interventions or first.kept_interventions,
        cleared=[*first.cleared, *then.cleared],
        ecu_dtcs={**first.ecu_dtcs, **then.ecu_dtcs},
        outgoing=[*first.outgoing, *then.outgoing],
        arrived={*first.arrived, *then.arrived},
        dropped=Tally(*map(add, first.dropped, then.dropped)),
        outgoing_bytes=then.outgoing_bytes,
    )


@dataclass(frozen=True)
class _Write:
    """A write that a thread does, and its changes."""

    work: Work
    t_ns: int
    changes: Changes
    permanent: list[Permanent]


class Ledger:
    """Records, cycles, numbers and identifiers, as read from a store, with what has changed since.

    A write that fails loses nothing: its changes stay here, and go with a later one.

    Args:
        store: where they are kept.
        recordings: recordings kept of each fault.
        ahead: whether others see what is not written yet.

    Attributes:
        records: by fault id.
        cycles: the last operation cycle of each name.
        identifiers: values that testers wrote, by data identifier.
        interventions: of testers.
        outage: of the store.
        commits: how many transactions were written.
    """

    def __init__(self, store: Store, recordings: int = 1, *, ahead: bool = False) -> None:
        self.store, self._ahead = store, ahead
        with store.reading():
            self.records: dict[str, Record] = {record.id: record for record in store.load()}
            self.cycles: dict[str, Cycle] = store.cycles()
            self.identifiers: dict[int, bytes] = store.identifiers()
            self.interventions = Interventions(store.interventions())
            self.vehicle = VehicleMemory(store.ecu_dtcs())
            self._facts = store.facts()
            self._permanent = PermanentDtcs(store.permanent())
        self.outage = RetryPolicy()
        self.commits = 0
        self._pending = Changes(kept_recordings=recordings)
        self._dirty: set[str] = set()
        self._new: set[str] = set()  # records that the store does not have
        self._touched = set(self.records)
        self._more = False  # whether anything waits beside records
        self._outgoing_bytes = 0  # of events for the fleet that are not written
        self._buses: Sequence[Mapping[str, Any]] | None = None
        self._described: Mapping[str, Description] = {}
        self._stored: dict[str, Record] = {}
        self._failed: set[str] = set()  # of those
        self._counts: dict[int, int] = {}  # of these, by status byte
        self._keep(record.copy() for record in self.records.values())
        self._stored_permanent = self._permanent.all()
        self._write: _Write | None = None
        self._tending: Work | None = None  # of the file's log, by the thread that writes

    def succeed(self, old: Ledger) -> None:
        """Go on with what another ledger of the same store holds, written or not."""
        old.join()
        self._keep(old._stored.values())
        self._stored_permanent = old._stored_permanent
        self.records.update(old.records)
        self._touched = set(self.records)
        self.cycles.update(old.cycles)
        self.identifiers.update(old.identifiers)
        self._facts, self._permanent = old._facts, old._permanent
        self.interventions, self.vehicle = old.interventions, old.vehicle
        self._dirty |= old._dirty
        self._new = self._new - old.records.keys() | old._new
        kept = self._pending.kept_recordings
        self._pending, self._more = old._pending, old._more
        self._pending.kept_recordings = kept
        self._outgoing_bytes = old._outgoing_bytes
        self._buses, self._described = old._buses, old._described
        self.outage, self.commits = old.outage, old.commits

    # Changes

    def add(self, record: Record) -> None:
        """Add the record of a fault that the store does not know; it is written when it changes."""
        self.records[record.id] = record
        self._keep([record.copy()])
        self._new.add(record.id)
        self._touched.add(record.id)

    def touch(self, fault: str) -> None:
        """Note that a record has changed."""
        self._dirty.add(fault)
        self._touched.add(fault)

    def take_touched(self) -> set[str]:
        """Return ids of the records that were added, or may have changed, since the last call."""
        touched, self._touched = self._touched, set()
        return touched

    def complete(self, records: Sequence[Record], statuses: Sequence[int]) -> None:
        """Have the tests of records be complete; of a record that the store has, nothing else is written."""
        new, waiting = self._new, self._pending.statuses
        for record, before in zip(records, statuses, strict=True):
            status = before & PASSED
            if status == before:
                continue
            record.status = status
            if new and record.id in new:
                self._dirty.add(record.id)
            else:
                waiting[record.id] = status

    def note_cycle(self, name: str, cycle: Cycle) -> None:
        """Note the state of an operation cycle."""
        self.cycles[name] = cycle
        self._pending.cycles = {**self._pending.cycles, name: cycle}
        self._more = True

    def fact(self, name: str) -> int:
        """Return a number by its name, 0 before it was set."""
        return self._facts.get(name, 0)

    def set_fact(self, name: str, value: int) -> None:
        """Set a number by its name."""
        if self._facts.get(name) != value:
            self._facts[name] = value
            self._pending.facts = {**self._pending.facts, name: value}
            self._more = True

    def next_in_order(self) -> int:
        """Return the next place in the order of all failures and confirmations."""
        self.set_fact(SEQUENCE, self.fact(SEQUENCE) + 1)
        return self._facts[SEQUENCE]

    @property
    def permanent(self) -> PermanentDtcs:
        """The permanent DTCs; tell :meth:`note_permanent` of changes."""
        return self._permanent

    def note_permanent(self, changed: bool) -> None:
        """Note that the permanent DTCs have changed, if they have."""
        if changed:
            self._pending.permanent = self._permanent.all()
            self._more = True

    def add_recordings(self, recordings: Iterable[Recording]) -> None:
        """Add recordings of faults that have an entry."""
        kept = [r for r in recordings if self.records[r.fault].occurrence]
        if kept:
            self._pending.recordings = [*self._pending.recordings, *kept]
            self._more = True

    def drop_recordings(self, faults: Iterable[str]) -> None:
        """Give up recordings of cleared faults that were not written yet."""
        gone = set(faults)
        self._pending.recordings = [r for r in self._pending.recordings if r.fault not in gone]

    def note_clear(self, group: int) -> None:
        """Note that a DTC or a group was cleared."""
        self._pending.cleared = [*self._pending.cleared, group]
        self._more = True

    def set_identifier(self, did: int, data: bytes) -> None:
        """Set what a tester wrote."""
        self.identifiers[did] = data
        self._pending.identifiers = {**self._pending.identifiers, did: data}
        self._more = True

    def note_intervention(self, new: Intervention) -> Intervention | None:
        """Note what a tester did; returns the record that has it, None if it is one of many refusals alike.

        Such are counted, and written with other changes: refused requests cannot wear the disk out.
        """
        made, gone = self.interventions.note(new)
        waiting = {**self._pending.interventions, made.number: made}
        if gone:  # bounded, also while nothing can be written
            kept = [each.number for each in self.interventions.all()]
            waiting = {number: waiting[number] for number in kept if number in waiting}
            self._pending.kept_interventions = kept
        self._pending.interventions = waiting
        told = made.outcome == DONE or made.count & (made.count - 1) == 0
        self._more = self._more or told
        return made if told else None

    def note_ecu_dtcs(self, told: DtcAnswer, t_ns: int) -> list[tuple[EcuDtc, str]]:
        """Note what an answer says of the DTCs of another ECU; returns what to tell of it."""
        changed, events = self.vehicle.take(told, t_ns)
        if changed:
            self._pending.ecu_dtcs = {**self._pending.ecu_dtcs, **changed}
            self._more = True
        return events

    def note_outgoing(self, events: Sequence[Outgoing], arrived: Iterable[int], most: int) -> None:
        """Note events for the fleet, and which have arrived there, for a queue of this size [byte]."""
        self._pending.outgoing, self._pending.outgoing_bytes = [*self._pending.outgoing, *events], most
        self._pending.arrived = {*self._pending.arrived, *arrived}
        self._outgoing_bytes += sum(len(event.body) for event in events)
        if self._outgoing_bytes > most:  # bounded, also while nothing can be written
            self._pending.outgoing, gone = fitting(self._pending.outgoing, most)
            self._pending.dropped = Tally(*map(add, self._pending.dropped, gone))
            self._outgoing_bytes -= gone.dropped_bytes
        self._more = True

    def note_buses(self, states: Sequence[Mapping[str, Any]]) -> None:
        """Note how the buses do."""
        self._buses = self._pending.buses = states
        self._more = True

    def describe(self, described: Mapping[str, Description]) -> None:
        """Note what faults are called; others that the store describes stay."""
        self._described = {**self._described, **described}
        self._pending.described = self._described
        self._more = True

    def answer(self, request: int, done: int) -> None:
        """Answer the request of another process."""
        self._pending.answered = {**self._pending.answered, request: done}
        self._more = True

    # Contents for readers

    @property
    def shown(self) -> dict[str, Record]:
        """Records as last written; once it is told that nothing can be, or where others see them first, as they are."""
        return self.records if self._shows_all else self._stored

    @property
    def _shows_all(self) -> bool:
        return self._ahead or self.outage.is_open

    def shown_failed(self) -> list[Record]:
        """Return those of :attr:`shown` that have failed since they were cleared; in no order."""
        return self.failed() if self._shows_all else _with_entry(self._stored, self._failed)

    def failed(self) -> list[Record]:
        """Return the records that have failed since they were cleared, as they are; in no order."""
        under_way = () if self._write is None else (record.id for record in self._write.changes.records)
        return _with_entry(self.records, self._failed.union(self._dirty, under_way))

    def count_failed(self, mask: int) -> int:
        """Return how many of :meth:`shown_failed` have any of these status bits: the short way, for each change."""
        if self._shows_all:
            return sum(1 for record in self.failed() if record.status & mask)
        return sum(count for status, count in self._counts.items() if status & mask)

    def _count(self, record: Record | None, more: int) -> None:
        """Count a record that is shown among those that have failed (``more``: 1), or no more (-1)."""
        if record is not None and record.occurrence:
            self._counts[record.status] = self._counts.get(record.status, 0) + more

    def _keep(self, stored: Iterable[Record]) -> None:
        """Take records as they are written."""
        for record in stored:
            self._count(self._stored.get(record.id), -1)
            self._stored[record.id] = record
            self._count(record, 1)
            if record.occurrence:
                self._failed.add(record.id)
            else:
                self._failed.discard(record.id)

    @property
    def shown_permanent(self) -> list[Permanent]:
        """The permanent DTCs as last written, or as they are; the oldest first."""
        return self._permanent.all() if self._shows_all else self._stored_permanent

    # Writing

    @property
    def unsaved(self) -> int:
        """Changes that are not written: records, and one for all else; 0: none."""
        under_way = 0 if self._write is None else max(self._write.changes.faults, 1)
        return len(self._dirty) + len(self._pending.statuses) + self._more + under_way

    @property
    def clean(self) -> bool:
        """Whether nothing is unsaved: asked for each batch."""
        return not (self._dirty or self._more or self._write or self._pending.statuses)

    def commit(self, t_ns: int, *, final: bool = False) -> bool:
        """Write all changes; returns whether all is durable now.

        Changes that cannot be written stay, and later calls try again, after waits that grow.

        Args:
            t_ns: now, of the engine's clock.
            final: try in any case.
        """
        self.join()
        if not self.unsaved:
            return True
        if not final and not self.outage.is_due(t_ns):
            return False
        try:
            self.write(t_ns)
        except StoreError:
            return False
        return True

    def write(self, t_ns: int, *, alone: bool = True) -> None:
        """Write all changes now.

        Args:
            t_ns: now, of the engine's clock.
            alone: False within a transaction of the caller's.

        Raises:
            StoreError: they could not be written; nothing of them was.
        """
        self.join()
        self._pending.records = self._changed()
        try:
            self.store.save(self._pending, self._whole if alone else None)
        except StoreError as error:
            self.outage.failed(t_ns, error.reason)
            raise
        if alone:
            self.written()

    def _changed(self) -> list[Record]:
        """Return copies of the records that have changed; of these nothing else waits."""
        for name in self._dirty.intersection(self._pending.statuses):
            del self._pending.statuses[name]
        return [self.records[name].copy() for name in sorted(self._dirty)]

    def written(self) -> None:
        """Note that all changes are written."""
        self.outage.ended()
        self._show(self._pending, self._permanent.all())
        self._start_anew()

    def _show(self, changes: Changes, permanent: list[Permanent]) -> None:
        self.commits += 1
        self._keep(changes.records)
        if self._new:
            self._new.difference_update(record.id for record in changes.records)
        for fault, status in changes.statuses.items():
            record = self._stored[fault]
            if record.occurrence:
                self._count(record, -1)
                record.status = status
                self._count(record, 1)
            else:  # as nearly all: a car's first seconds complete thousands
                record.status = status
        self._stored_permanent = permanent

    def _start_anew(self) -> None:
        self._dirty = set()
        self._pending = Changes(kept_recordings=self._pending.kept_recordings)
        self._more, self._outgoing_bytes = False, 0

    # Writing beside

    def begin(self, t_ns: int, writer: Writer, *, anew: bool = False) -> None:
        """Have all changes written by a thread; :meth:`join` ends it.

        Args:
            t_ns: now, of the engine's clock.
            writer: the thread.
            anew: whether the file may have to be replaced by a new one with all there is, as in an outage.
        """
        copied = self._copy_of_all() if anew or self.outage.reason else None
        whole = None if copied is None else lambda: copied
        changes = self._pending
        changes.records = self._changed()
        self._start_anew()
        self._write = _Write(writer.submit(self.store.save, changes, whole), t_ns, changes, self._permanent.all())

    def under_way(self, patience_s: float = 0.0) -> bool:
        """Return whether a thread is at the file still, after waiting this time at most [s]."""
        work = self._tending if self._write is None else self._write.work
        if work is None:
            return False
        if patience_s > 0:
            with suppress(TimeoutError):
                work.exception(patience_s)
        return not work.done()

    def tend(self, writer: Writer, work: Callable[[], None]) -> None:
        """Have a thread take care of the file's log between writes; :meth:`under_way` tells how long it takes."""
        if not self.under_way():
            self._tending = writer.submit(work)

    def join(self) -> bool:
        """Wait for the thread that writes; its failed changes are still to be written. Returns whether one did."""
        if self._tending is not None:
            self._tending.result()
            self._tending = None
        if self._write is None:
            return False
        write, self._write = self._write, None
        try:
            write.work.result()
        except StoreError as error:
            self.outage.failed(write.t_ns, error.reason)
            self._pending = _joined(write.changes, self._pending)
            self._outgoing_bytes = sum(len(event.body) for event in self._pending.outgoing)
            self._dirty |= {record.id for record in write.changes.records} | write.changes.statuses.keys()
            self._more = True
        else:
            self.outage.ended()
            self._show(write.changes, write.permanent)
        return True

    def rewrite(self) -> None:
        """Have everything written by the next commit: the file is gone."""
        self.join()
        self._more = True
        self._dirty |= self.records.keys()

    def _whole(self) -> Changes:
        """Return all there is, for a file that has none of it."""
        whole = copy(self._pending)
        whole.records, whole.statuses = list(self.records.values()), {}
        whole.cycles = self.cycles
        whole.permanent = self._permanent.all()
        whole.identifiers = {
            **self._pending.identifiers,
            **self.identifiers,
        }  # with those that are to go
        whole.facts = self._facts
        whole.interventions = {each.number: each for each in self.interventions.all()}
        whole.ecu_dtcs = {each.key: each for each in self.vehicle.all()}
        whole.buses, whole.described = self._buses, self._described
        return whole

    def _copy_of_all(self) -> Changes:
        """Return all there is, as it is now."""
        whole = self._whole()
        whole.records = [record.copy() for record in whole.records]
        whole.cycles, whole.facts = dict(whole.cycles), dict(whole.facts)
        whole.identifiers = dict(whole.identifiers)
        return whole

    @contextmanager
    def undoing(self) -> Iterator[None]:
        """Undo what is done within, if it cannot be written.

        Records are replaced within, not changed. A commit that failed may have reached the disk all the same: its
        changes are to be written again as they were.
        """
        self.join()
        records, identifiers = dict(self.records), dict(self.identifiers)
        facts, permanent = dict(self._facts), self._permanent.all()
        dirty, pending = set(self._dirty), copy(self._pending)
        try:
            yield
        except StoreError:
            self.records.clear()
            self.records.update(records)
            self.identifiers.clear()
            self.identifiers.update(identifiers)
            self._facts, self._permanent = facts, PermanentDtcs(permanent)
            undone, self._pending = self._pending, pending
            self._dirty |= dirty
            self._more = True
            back = {did: identifiers.get(did) for did in undone.identifiers}
            pending.identifiers = {**pending.identifiers, **back}
            pending.facts = {**pending.facts, **{n: facts.get(n, 0) for n in undone.facts}}
            if undone.permanent is not None:
                pending.permanent = permanent
            raise

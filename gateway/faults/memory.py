"""The fault memory: qualified verdicts become status bytes, entries, freeze frames, permanent DTCs.

Changes take effect in two steps: :meth:`FaultMemory.apply` and its like change the memory,
:meth:`FaultMemory.commit` makes that durable. Only then may anyone outside be told: what is read of the memory is as it
was last written. While the file cannot be written there is a third state, told as such: known here, not stored.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from gateway.engine.events import FDC_REACHED, QUALIFIED_FAILED, QUALIFIED_PASSED
from gateway.errors import InputError
from gateway.faults import freeze_frames
from gateway.faults import status as transition
from gateway.faults.catalogue import Catalogue, FaultDefinition
from gateway.faults.displacement import victim
from gateway.faults.dtc import ALL_DTCS, Dtc, in_group
from gateway.faults.entries import DtcChange
from gateway.faults.failures import (
    Failure,
    Observed,
    Snapshot,
    failure_of,
    finite,
    known,
    latest_signals,
)
from gateway.faults.interventions import Intervention
from gateway.faults.ledger import OVERFLOW, Ledger
from gateway.faults.outage import Outage
from gateway.faults.reading import Readable
from gateway.faults.records import Cycle, Description, FreezeFrame, Record, Recording
from gateway.faults.settings import POWER
from gateway.faults.status import CLEARED, STATUS, Cycles, Status
from gateway.faults.store import Store, StoreError

#: The occurrence counter stops here.
MOST_OCCURRENCES = 255

_TEST_FAILED, _CONFIRMED = int(Status.TEST_FAILED), int(Status.CONFIRMED_DTC)
#: The bit that stores a freeze frame when it rises; a counter's value stands for testFailed.
_FREEZE_FRAME_AT: dict[str | int, int] = {
    "pending": int(Status.PENDING_DTC),
    "confirmed": _CONFIRMED,
}


#: Takes a fault's place in the catalogue, returns near misses and greatest detection counter since the last call.
Statistics = Callable[[int], tuple[int, int]]


def _cycles(record: Record) -> Cycles:
    return Cycles(record.failed_cycles, record.passed_cycles, record.aged_cycles)


def _set(record: Record, status: Status, cycles: Cycles) -> None:
    record.status = int(status)
    record.failed_cycles, record.passed_cycles = cycles.failed, cycles.passed
    record.aged_cycles = cycles.aged


class FaultMemory(Readable):
    """Status, entries and freeze frames of every fault of a catalogue.

    Entries of faults that are no longer in the catalogue are kept and listed until cleared.

    Args:
        catalogue: the faults, in the engine's order.
        store: where they are kept.
        size: entries there is room for; None: for all.
        recordings: recordings kept of each fault.
        statistics: of the faults' debounce.
    """

    def __init__(
        self,
        catalogue: Catalogue,
        store: Store,
        *,
        size: int | None = None,
        recordings: int = 1,
        statistics: Statistics | None = None,
    ) -> None:
        self.catalogue = catalogue
        self._size = size
        self._statistics = statistics
        self._held = Ledger(store, recordings)
        self._records = self._held.records
        self._prestored: dict[str, FreezeFrame] = {}
        self._refused: dict[str, Failure] = {}
        self._room = False  # whether an entry has gone since the refused ones were tried again
        self._now_ns = 0
        self._define()
        self.identifiers = self._held.identifiers
        self._asked = store.watch()

    def _define(self) -> None:
        """Have a definition and a record of every fault, monitored or only stored."""
        self._definitions = {definition.id: definition for definition in self.catalogue}
        for definition in self.catalogue:
            if definition.id not in self._records:
                self._held.add(Record(definition.id, definition.dtc.value, int(CLEARED)))
            for view in (self._records, self._held.shown):
                view[definition.id].dtc = definition.dtc.value
        for record in self._records.values():  # no longer in the catalogue: usual rules
            self._definitions.setdefault(record.id, FaultDefinition(record.id, Dtc(record.dtc), "no longer monitored"))

    def succeed(self, old: FaultMemory) -> None:
        """Go on with what another memory of the same store knows, written or not."""
        self._held.succeed(old._held)
        self._prestored |= old._prestored
        self._refused |= old._refused
        self._room = True  # there may be more of it now
        self._now_ns = old._now_ns
        self._define()

    # Operation cycles

    def start_cycle(self, t_ns: int, name: str = POWER) -> None:
        """Start an operation cycle at a time of the wall clock; one that was never ended (kill -9) is ended first.

        The start of the power cycle ends whatever the last process left open.
        """
        if name == POWER:
            self._end_all(t_ns)
        elif self._is_open(name):
            self._end(t_ns, name)
        for record in self._records.values():
            if self._definitions[record.id].cycle == name:
                record.status = int(transition.on_cycle_start(STATUS[record.status]))
                self._held.touch(record.id)
                self._refused.pop(record.id, None)  # it is tested again
        last = self._held.cycles.get(name)
        self._held.note_cycle(name, Cycle(last.number + 1 if last else 1, True, t_ns))
        self.commit()

    def end_cycle(self, t_ns: int, name: str = POWER) -> None:
        """End an operation cycle; the end of the power cycle ends all of them."""
        if name == POWER:
            self._end_all(t_ns)
        elif self._is_open(name):
            self._end(t_ns, name)
        self.commit()

    def _is_open(self, name: str) -> bool:
        return name in self._held.cycles and self._held.cycles[name].open

    def _counts(self, definition: FaultDefinition) -> bool:
        """Tell whether a result of a fault counts: its operation cycle has begun, and is not over.

        The power cycle is there from the start, also where nobody begins it.
        """
        name = definition.cycle
        return self._is_open(name) or (name == POWER and not self.cycle_number())

    def _end_all(self, t_ns: int) -> None:
        for name in sorted(self._held.cycles, key=lambda name: name == POWER):
            if self._is_open(name):
                self._end(t_ns, name)

    def _end(self, t_ns: int, name: str) -> None:
        self.fold_statistics()
        for record in self._records.values():
            definition = self._definitions[record.id]
            rules = definition.rules
            if definition.aging_cycle == name and record.occurrence:
                status, cycles, aged = transition.on_aging_cycle_end(STATUS[record.status], _cycles(record), rules)
                _set(record, status, cycles)
                self._held.touch(record.id)
                if aged:
                    self._remove_entry(record)
            if definition.cycle == name:
                status, cycles = transition.on_cycle_end(STATUS[record.status], _cycles(record), rules)
                _set(record, status, cycles)
                self._held.touch(record.id)
                self._held.note_permanent(self._held.permanent.on_cycle_end(definition, status))
        self._held.note_cycle(name, Cycle(self._held.cycles[name].number, False, t_ns))

    def cycle_number(self, name: str = POWER) -> int:
        """Return the number of an operation cycle, from 1; 0 before the first."""
        return self._held.cycles[name].number if name in self._held.cycles else 0

    # Verdicts

    def apply(self, event: np.void, snapshot: Snapshot) -> list[DtcChange]:
        """Take an event; one that is neither a verdict nor reaches for a freeze frame changes nothing.

        Nor does one of a fault outside its operation cycle (AUTOSAR DEM: results of a cycle that is not started do not
        count).

        Args:
            event: of EVENT.
            snapshot: called for a failure, at once.

        Returns:
            the status bytes that changed. They are durable after :meth:`commit`.
        """
        kind = int(event["kind"])
        if kind not in (QUALIFIED_FAILED, QUALIFIED_PASSED, FDC_REACHED):
            return []
        definition = self.catalogue[int(event["fault"])]
        if not self._counts(definition):
            return []
        record = self._records[definition.id]
        old = STATUS[record.status]
        if kind == FDC_REACHED:
            content = finite(snapshot(definition).frame)
            self._prestored[definition.id] = FreezeFrame(0, int(event["t_ns"]), content)
        elif kind == QUALIFIED_FAILED:
            self._fail(definition, record, failure_of(definition, event, snapshot))
        else:
            record.status = int(transition.on_passed(old))
            self._prestored.pop(definition.id, None)
            self._refused.pop(definition.id, None)
        return self._changed(definition, record, old, int(event["fdc"]), int(event["t_ns"]))

    def _changed(
        self, definition: FaultDefinition, record: Record, old: Status, fdc: int, t_ns: int
    ) -> list[DtcChange]:
        """Return the change of a status byte, if it has changed."""
        new = STATUS[record.status]
        if new == old:
            return []
        self._held.touch(record.id)
        evidence = dict(record.evidence) if record.status & _TEST_FAILED else {}
        return [DtcChange(definition, old, new, fdc, record.occurrence, t_ns, evidence)]

    @property
    def room(self) -> bool:
        """Whether an entry has gone since the refused ones were tried again."""
        return self._room

    def admit_refused(self, t_ns: int) -> list[DtcChange]:
        """Enter failures that a full memory refused, or whose entries gave way, if there is room for them now.

        The most important come first, of these the oldest; a fault that has passed meanwhile, or whose operation cycle
        is over, is not entered.

        Returns:
            the status bytes that changed. They are durable after :meth:`commit`.
        """
        if not self._room:
            return []
        self._room = False
        changes = []
        waiting = [(self._definitions[fault], failure) for fault, failure in self._refused.items()]
        for definition, failure in sorted(waiting, key=lambda w: (w[0].priority, w[1].t_ns)):
            if not self._has_room():
                break
            if not self._counts(definition):
                continue
            record = self._records[definition.id]
            old = STATUS[record.status]
            del self._refused[definition.id]
            self._fail(definition, record, failure)
            changes += self._changed(definition, record, old, 127, t_ns)
        return changes

    def _fail(self, definition: FaultDefinition, record: Record, failure: Failure) -> None:
        """Take one qualified failure: the only way by which a DTC becomes pending or confirmed."""
        old = STATUS[record.status]
        if not record.occurrence:  # what was refused earlier in this cycle has not been counted
            old &= ~(Status.TEST_FAILED | Status.TEST_FAILED_THIS_CYCLE)
        status, cycles = transition.on_failed(old, _cycles(record), definition.rules)
        if not record.occurrence and not self._make_room(definition):
            _set(record, transition.on_displaced(status), Cycles())
            seen = failure.observe()
            self._refused[record.id] = replace(failure, observe=lambda: seen)
            return
        _set(record, status, cycles)
        risen = int(status) & ~int(old)
        if risen & _TEST_FAILED:
            self._note_failure(record, failure)
        if risen & _CONFIRMED:
            record.last_confirmed = self._held.next_in_order()
            if record.first_confirmed is None:
                record.first_confirmed = record.last_confirmed
        if risen & _FREEZE_FRAME_AT.get(definition.freeze_frame_at, _TEST_FAILED):
            prestored = self._prestored.pop(definition.id, None)
            frame = prestored or FreezeFrame(0, failure.t_ns, finite(failure.observe().frame))
            freeze_frames.keep(record.freeze_frames, frame, definition.freeze_frames)
        became = self._held.permanent.on_failed(definition, status, failure.t_ns)
        self._held.note_permanent(became)

    def _note_failure(self, record: Record, failure: Failure) -> None:
        sequence = self._held.next_in_order()
        record.occurrence = min(record.occurrence + 1, MOST_OCCURRENCES)
        record.first_ns = failure.t_ns if record.first_ns is None else record.first_ns
        record.last_ns = failure.t_ns
        record.first_failed = sequence if record.first_failed is None else record.first_failed
        record.last_failed = sequence
        record.evidence = failure.evidence
        record.inputs = finite(failure.observe().inputs)

    def _stored(self) -> list[Record]:
        return [record for record in self._records.values() if record.occurrence]

    def _has_room(self) -> bool:
        return self._size is None or len(self._stored()) < self._size

    def _make_room(self, definition: FaultDefinition) -> bool:
        """Make room for one entry; False if all that is there is more important."""
        if self._has_room():
            return True
        found = victim(definition, [(self._definitions[r.id], r) for r in self._stored()])
        self._held.set_fact(OVERFLOW, 1)
        if found is None:
            return False
        if found.status & Status.TEST_FAILED and self.catalogue.get(found.id) is not None:
            seen = Observed(latest_signals(found), known(found.inputs))
            self._refused[found.id] = Failure(found.last_ns or 0, found.evidence, lambda: seen)
        found.status = int(transition.on_displaced(Status(found.status)))
        self._remove_entry(found)
        self._room = False  # the newcomer takes it
        return True

    def _remove_entry(self, record: Record) -> None:
        """Remove what is stored of a fault; its status byte stays."""
        fresh = Record(record.id, record.dtc, record.status)
        fresh.peak_fdc, fresh.near_misses = record.peak_fdc, record.near_misses
        record.__dict__.update(fresh.__dict__)
        self._room = True
        self._held.touch(record.id)

    # Durability

    @property
    def outage(self) -> Outage:
        """Since when, and why, the file cannot be written."""
        return self._held.outage

    @property
    def unsaved(self) -> int:
        """How many faults have changes that are not durable, and one for all else."""
        return self._held.unsaved

    @property
    def clean(self) -> bool:
        """Whether there is nothing unsaved."""
        return self._held.clean

    @property
    def commits(self) -> int:
        """How often changes were written."""
        return self._held.commits

    def commit(self, t_ns: int | None = None, *, final: bool = False) -> bool:
        """Make all changes durable; returns whether they are.

        What cannot be written stays here, and later calls try it again (see :class:`Outage`).

        Args:
            t_ns: now, of the engine's clock; default: the latest time heard of.
            final: try in any case.
        """
        self._now_ns = max(self._now_ns, t_ns or 0)
        return self._held.commit(self._now_ns, final=final)

    def begin(self, t_ns: int, executor: Executor, *, anew: bool = False) -> None:
        """Have all changes made durable by a thread (see :meth:`under_way`), in a new file if need be."""
        self._now_ns = max(self._now_ns, t_ns)
        self._held.begin(self._now_ns, executor, anew=anew)

    def under_way(self, patience_s: float = 0.0) -> bool:
        """Tell whether a thread writes still, after waiting so long at most [s]."""
        return self._held.under_way(patience_s)

    def join(self) -> None:
        """Wait for the thread that writes, if one does: the store is for this one then."""
        self._held.join()

    def rewrite(self) -> None:
        """Have everything written by the next commit: the file is gone."""
        self._held.rewrite()

    def add_recordings(self, recordings: Iterable[Recording]) -> None:
        """Keep frames recorded around failures, unless their fault was cleared meanwhile."""
        self._held.add_recordings(recordings)

    def note_buses(self, states: Sequence[Mapping[str, Any]]) -> None:
        """Keep how the buses do, with the next commit."""
        self._held.note_buses(states)

    def note_intervention(self, intervention: Intervention) -> Intervention | None:
        """Keep what a tester did, with the next commit; returns what to tell of it, None: nothing."""
        return self._held.note_intervention(intervention)

    def interventions(self) -> list[Intervention]:
        """Return what testers did, the oldest first."""
        return self._held.interventions.all()

    def note_descriptions(self) -> None:
        """Keep what the faults are called, with the next commit, for readers without the configuration."""
        self._held.describe({d.id: Description(d.description, d.severity, d.remedy) for d in self.catalogue})

    def write_identifier(self, did: int, data: bytes) -> None:
        """Keep what a tester wrote; durable on return.

        Raises:
            StoreError: it could not be written; the value is what it was.
        """
        with self._held.undoing():
            self._held.set_identifier(did, data)
            self._held.write(self._now_ns)

    def attempts(self, level: int) -> int:
        """Return how many wrong keys a security level has had since the last right one."""
        return self._held.fact(f"attempts.{level}")

    def keep_attempts(self, level: int, wrong: int) -> None:
        """Keep how many wrong keys a security level has had; durable on return, if anything can be written."""
        self._held.set_fact(f"attempts.{level}", wrong)
        with suppress(StoreError):  # it is tried again, and counts in this process in any case
            self._held.write(self._now_ns)

    def fold_statistics(self) -> None:
        """Take over what the debounce has counted since the last time."""
        if self._statistics is None:
            return
        for index, definition in enumerate(self.catalogue):
            near, peak = self._statistics(index)
            record = self._records[definition.id]
            if near or peak > record.peak_fdc:
                record.near_misses += near
                record.peak_fdc = max(record.peak_fdc, peak)
                self._held.touch(record.id)

    # Clearing

    def clear(self, group: int = ALL_DTCS) -> list[str]:
        """Clear one DTC, a group, or all (ISO 14229-1, 0x14); durable on return, or nothing is cleared.

        Permanent DTCs stay until their test has passed; those of faults that nobody tests any more go.

        Args:
            group: a DTC's 24 bits, or a group (see :func:`gateway.faults.dtc.in_group`).

        Returns:
            ids of the faults cleared; the engine's debounce of these must be reset too.

        Raises:
            StoreError: it could not be written; nothing was cleared.
        """
        with self._held.undoing():
            cleared = self._clear(group)
            self._held.write(self._now_ns)
        self._forget(cleared)
        return cleared

    def knows(self, group: int) -> bool:
        """Tell whether a clear of this DTC or group would mean any fault."""
        return group == ALL_DTCS or any(self._is_in(record, group) for record in self._records.values())

    def _is_in(self, record: Record, group: int) -> bool:
        related = self._definitions[record.id].emission_related
        return in_group(record.dtc, group, emission_related=related)

    def _clear(self, group: int) -> list[str]:
        self.fold_statistics()
        cleared = []
        for record in list(self._records.values()):
            if self._is_in(record, group):
                self._records[record.id] = Record(record.id, record.dtc, int(CLEARED))
                self._held.touch(record.id)
                cleared.append(record.id)
                if len(self.catalogue) and self.catalogue.get(record.id) is None:
                    # No test is left that could pass.
                    self._held.note_permanent(self._held.permanent.give_up(record.id))
        self._held.drop_recordings(cleared)
        if group == ALL_DTCS and self._held.fact(OVERFLOW):
            self._held.set_fact(OVERFLOW, 0)
        return cleared

    def _forget(self, cleared: Iterable[str]) -> None:
        """Give up what waits of cleared faults; their entries leave room for others."""
        for fault in cleared:
            self._prestored.pop(fault, None)
            self._refused.pop(fault, None)
            self._room = True

    def serve_requests(self, before: Callable[[], None] = lambda: None) -> list[str]:
        """Do what other processes asked for (clearing); returns ids of the faults cleared.

        Args:
            before: called first, if somebody did.
        """
        if self._held.under_way():  # they are served the next time
            return []
        self._held.join()
        if not self._asked():
            return []
        cleared: list[str] = []
        try:
            if not self._held.store.requests():  # something else was written
                return []
            before()
            with self._held.undoing(), self._held.store.transaction():
                # Within it nobody can withdraw a request that is being done.
                for request, kind, argument in self._held.store.requests():
                    done = 0
                    if kind == "clear":
                        group = int(argument)
                        done = sum(1 for r in self._stored() if self._is_in(r, group))
                        cleared += self._clear(group)
                    self._held.answer(request, done)
                self._held.write(self._now_ns, alone=False)
        except (StoreError, InputError):  # whoever asked is told that nothing was done
            return []
        self._held.written()
        self._forget(cleared)
        return cleared

    def status_now(self, fault: str) -> Status:
        """Return the status byte of a fault, written or not: not for others."""
        return Status(self._records[fault].status)

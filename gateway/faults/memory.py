"""The fault memory: qualified verdicts become status bytes, entries, freeze frames, permanent DTCs.

Changes take effect in two steps: :meth:`FaultMemory.apply` and its like change the memory,
:meth:`FaultMemory.commit` makes that durable. Only then may anyone outside be told.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

from gateway.engine.events import FDC_REACHED, QUALIFIED_FAILED, QUALIFIED_PASSED, Events
from gateway.faults import freeze_frames
from gateway.faults import status as transition
from gateway.faults.catalogue import Catalogue, FaultDefinition
from gateway.faults.displacement import victim
from gateway.faults.dtc import ALL_DTCS, Dtc, in_group
from gateway.faults.entries import DtcChange, Entry, entry_of
from gateway.faults.permanent import PermanentDtcs
from gateway.faults.records import Changes, Cycle, FreezeFrame, Permanent, Record, Recording
from gateway.faults.settings import POWER
from gateway.faults.status import CLEARED, Cycles, Status
from gateway.faults.store import Store

#: The occurrence counter stops here.
MOST_OCCURRENCES = 255

#: Number in the store: how many failures and confirmations the memory has put in order; whether an entry had to be given up.
SEQUENCE, OVERFLOW = "sequence", "overflow"


class Observed(NamedTuple):
    """What is seen at a failure: the signals of its freeze frame, the inputs of its monitor."""

    frame: Mapping[str, float] = {}
    inputs: Mapping[str, float] = {}


#: Takes a fault, returns what is seen of it now.
Snapshot = Callable[[FaultDefinition], Observed]
#: Takes a fault's place in the catalogue, returns near misses and greatest detection counter since the last call.
Statistics = Callable[[int], tuple[int, int]]


def _finite(values: Mapping[str, float]) -> dict[str, float | None]:
    return {name: float(value) if math.isfinite(value) else None for name, value in values.items()}


def _cycles(record: Record) -> Cycles:
    return Cycles(record.failed_cycles, record.passed_cycles, record.aged_cycles)


def _set(record: Record, status: Status, cycles: Cycles) -> None:
    record.status = int(status)
    record.failed_cycles, record.passed_cycles = cycles.failed, cycles.passed
    record.aged_cycles = cycles.aged


class FaultMemory:
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
        self._store = store
        self._size = size
        self._statistics = statistics
        self._records = {record.id: record for record in store.load()}
        self._definitions = {definition.id: definition for definition in catalogue}
        for definition in catalogue:
            record = self._records.setdefault(
                definition.id, Record(definition.id, definition.dtc.value, int(CLEARED))
            )
            record.dtc = definition.dtc.value
        for record in self._records.values():  # no longer in the catalogue: usual rules
            self._definitions.setdefault(
                record.id, FaultDefinition(record.id, Dtc(record.dtc), "no longer monitored")
            )
        self._cycles = store.cycles()
        self._facts = store.facts()
        self._permanent = PermanentDtcs(store.permanent())
        self.identifiers = store.identifiers()
        self._prestored: dict[str, FreezeFrame] = {}
        self._dirty: set[str] = set()
        self._pending = Changes(kept_recordings=recordings)
        self._asked = store.watch()

    # Operation cycles

    def start_cycle(self, t_ns: int, name: str = POWER) -> None:
        """Start an operation cycle; one that was never ended (power loss, kill -9) is ended first.

        The start of the power cycle ends whatever the last process left open.
        """
        if name == POWER:
            self._end_all(t_ns)
        elif self._is_open(name):
            self._end(t_ns, name)
        for record in self._records.values():
            if self._definitions[record.id].cycle == name:
                record.status = int(transition.on_cycle_start(Status(record.status)))
                self._dirty.add(record.id)
        last = self._cycles.get(name)
        self._note_cycle(name, Cycle(last.number + 1 if last else 1, True, t_ns))
        self.commit()

    def end_cycle(self, t_ns: int, name: str = POWER) -> None:
        """End an operation cycle; the end of the power cycle ends all of them."""
        if name == POWER:
            self._end_all(t_ns)
        elif self._is_open(name):
            self._end(t_ns, name)
        self.commit()

    def _is_open(self, name: str) -> bool:
        return name in self._cycles and self._cycles[name].open

    def _end_all(self, t_ns: int) -> None:
        for name in sorted(self._cycles, key=lambda name: name == POWER):
            if self._is_open(name):
                self._end(t_ns, name)

    def _end(self, t_ns: int, name: str) -> None:
        self.fold_statistics()
        for record in self._records.values():
            definition = self._definitions[record.id]
            rules = definition.rules
            if definition.aging_cycle == name and record.occurrence:
                status, cycles, aged = transition.on_aging_cycle_end(
                    Status(record.status), _cycles(record), rules
                )
                _set(record, status, cycles)
                self._dirty.add(record.id)
                if aged:
                    self._remove_entry(record)
            if definition.cycle == name:
                status, cycles = transition.on_cycle_end(
                    Status(record.status), _cycles(record), rules
                )
                _set(record, status, cycles)
                self._dirty.add(record.id)
                self._note_permanent(self._permanent.on_cycle_end(definition, status))
        self._note_cycle(name, Cycle(self._cycles[name].number, False, t_ns))

    def _note_cycle(self, name: str, cycle: Cycle) -> None:
        self._cycles[name] = cycle
        self._pending.cycles = {**self._pending.cycles, name: cycle}

    def cycle_number(self, name: str = POWER) -> int:
        """Return the number of an operation cycle, from 1; 0 before the first."""
        return self._cycles[name].number if name in self._cycles else 0

    # Verdicts

    def apply(self, events: Events, snapshot: Snapshot) -> list[DtcChange]:
        """Take events in order; those that are neither verdicts nor reach for a freeze frame are passed over.

        Args:
            events: shape (n,) of EVENT.
            snapshot: called for each failure, at once.

        Returns:
            the status bytes that changed. They are durable after :meth:`commit`.
        """
        changes = []
        for event in events:
            if event["kind"] not in (QUALIFIED_FAILED, QUALIFIED_PASSED, FDC_REACHED):
                continue
            definition = self.catalogue[int(event["fault"])]
            record = self._records[definition.id]
            old = Status(record.status)
            if event["kind"] == FDC_REACHED:
                content = _finite(snapshot(definition).frame)
                self._prestored[definition.id] = FreezeFrame(0, int(event["t_ns"]), content)
            elif event["kind"] == QUALIFIED_FAILED:
                self._fail(definition, record, event, snapshot)
            else:
                record.status = int(transition.on_passed(old))
                self._prestored.pop(definition.id, None)
            new = Status(record.status)
            if new != old:
                self._dirty.add(record.id)
                changes.append(
                    DtcChange(
                        definition,
                        old,
                        new,
                        int(event["fdc"]),
                        record.occurrence,
                        int(event["t_ns"]),
                        dict(record.evidence) if new & Status.TEST_FAILED else {},
                    )
                )
        return changes

    def _fail(
        self, definition: FaultDefinition, record: Record, event: Any, snapshot: Snapshot
    ) -> None:
        """Take one qualified failure: the only way by which a DTC becomes pending or confirmed."""
        old = Status(record.status)
        status, cycles = transition.on_failed(old, _cycles(record), definition.rules)
        if not record.occurrence and not self._make_room(definition):
            _set(record, transition.on_displaced(status), Cycles())
            return
        _set(record, status, cycles)
        risen = status & ~old
        t_ns = int(event["t_ns"])
        if risen & Status.TEST_FAILED or not record.occurrence:
            self._note_failure(definition, record, event, snapshot)
            risen |= Status.TEST_FAILED
        if risen & Status.CONFIRMED_DTC:
            record.last_confirmed = self._next_in_order()
            if record.first_confirmed is None:
                record.first_confirmed = record.last_confirmed
        at = definition.freeze_frame_at
        wanted = {"pending": Status.PENDING_DTC, "confirmed": Status.CONFIRMED_DTC}
        if risen & wanted.get(str(at), Status.TEST_FAILED):
            prestored = self._prestored.pop(definition.id, None)
            frame = prestored or FreezeFrame(0, t_ns, _finite(snapshot(definition).frame))
            freeze_frames.keep(record.freeze_frames, frame, definition.freeze_frames)
        self._note_permanent(self._permanent.on_failed(definition, status, t_ns))

    def _note_failure(
        self, definition: FaultDefinition, record: Record, event: Any, snapshot: Snapshot
    ) -> None:
        t_ns = int(event["t_ns"])
        sequence = self._next_in_order()
        record.occurrence = min(record.occurrence + 1, MOST_OCCURRENCES)
        record.first_ns = t_ns if record.first_ns is None else record.first_ns
        record.last_ns = t_ns
        record.first_failed = sequence if record.first_failed is None else record.first_failed
        record.last_failed = sequence
        names = ("value", "threshold", *definition.evidence)
        values = (event["value"], event["threshold"], *event["evidence"])
        record.evidence = _finite(dict(zip(names, values, strict=False)))
        record.inputs = _finite(snapshot(definition).inputs)

    def _make_room(self, definition: FaultDefinition) -> bool:
        """Make room for one entry; False if all that is there is more important."""
        stored = [record for record in self._records.values() if record.occurrence]
        if self._size is None or len(stored) < self._size:
            return True
        found = victim(definition, [(self._definitions[r.id], r) for r in stored])
        self._set_fact(OVERFLOW, 1)
        if found is None:
            return False
        found.status = int(transition.on_displaced(Status(found.status)))
        self._remove_entry(found)
        return True

    def _next_in_order(self) -> int:
        self._set_fact(SEQUENCE, self._facts.get(SEQUENCE, 0) + 1)
        return self._facts[SEQUENCE]

    def _set_fact(self, name: str, value: int) -> None:
        self._facts[name] = value
        self._pending.facts = {**self._pending.facts, name: value}

    def _remove_entry(self, record: Record) -> None:
        """Remove what is stored of a fault; its status byte stays."""
        fresh = Record(record.id, record.dtc, record.status)
        fresh.peak_fdc, fresh.near_misses = record.peak_fdc, record.near_misses
        record.__dict__.update(fresh.__dict__)
        self._dirty.add(record.id)

    def _note_permanent(self, changed: bool) -> None:
        if changed:
            self._pending.permanent = self._permanent.all()

    # Durability

    def commit(self) -> None:
        """Make all changes durable; returns when they are.

        Raises:
            GatewayError: they could not be written; a later commit tries them again.
        """
        if self._dirty or self._pending != Changes(kept_recordings=self._pending.kept_recordings):
            self._save()
            self._saved()

    def _save(self) -> None:
        self._pending.records = [self._records[name] for name in sorted(self._dirty)]
        self._store.save(self._pending)

    def _saved(self) -> None:
        self._dirty.clear()
        self._pending = Changes(kept_recordings=self._pending.kept_recordings)

    def add_recordings(self, recordings: Iterable[Recording]) -> None:
        """Keep frames recorded around failures, unless their fault was cleared meanwhile."""
        kept = [r for r in recordings if self._records[r.fault].occurrence]
        self._pending.recordings = [*self._pending.recordings, *kept]

    def write_identifier(self, did: int, data: bytes) -> None:
        """Keep what a tester wrote; durable on return."""
        self.identifiers[did] = data
        self._pending.identifiers = {**self._pending.identifiers, did: data}
        self.commit()

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
                self._dirty.add(record.id)

    # Clearing

    def clear(self, group: int = ALL_DTCS) -> list[str]:
        """Clear one DTC, a group, or all (ISO 14229-1, 0x14); durable on return.

        Permanent DTCs stay until their test has passed; those of faults that nobody tests any more go.

        Args:
            group: a DTC's 24 bits, or a group (see :func:`gateway.faults.dtc.in_group`).

        Returns:
            ids of the faults cleared; the engine's debounce of these must be reset too.
        """
        cleared = self._clear(group)
        self.commit()
        return cleared

    def knows(self, group: int) -> bool:
        """Tell whether a clear of this DTC or group would mean any fault."""
        return group == ALL_DTCS or any(
            self._is_in(record, group) for record in self._records.values()
        )

    def _is_in(self, record: Record, group: int) -> bool:
        related = self._definitions[record.id].emission_related
        return in_group(record.dtc, group, emission_related=related)

    def _clear(self, group: int) -> list[str]:
        self.fold_statistics()
        cleared = []
        for record in self._records.values():
            if self._is_in(record, group):
                self._records[record.id] = Record(record.id, record.dtc, int(CLEARED))
                self._prestored.pop(record.id, None)
                self._dirty.add(record.id)
                cleared.append(record.id)
                if len(self.catalogue) and self.catalogue.get(record.id) is None:
                    # No test is left that could pass.
                    self._note_permanent(self._permanent.give_up(record.id))
        self._pending.recordings = [r for r in self._pending.recordings if r.fault not in cleared]
        if group == ALL_DTCS and self._facts.get(OVERFLOW):
            self._set_fact(OVERFLOW, 0)
        return cleared

    def serve_requests(self) -> list[str]:
        """Do what other processes asked for (clearing); returns ids of the faults cleared."""
        if not self._asked():
            return []
        cleared: list[str] = []
        with self._store.transaction():  # nobody can withdraw a request that is being done
            for request, kind, argument in self._store.requests():
                done = 0
                if kind == "clear":
                    group = int(argument)
                    done = sum(
                        1 for r in self._records.values() if r.occurrence and self._is_in(r, group)
                    )
                    cleared += self._clear(group)
                self._pending.answered = {**self._pending.answered, request: done}
            self._save()
        self._saved()
        return cleared

    # Reading

    def entries(self) -> list[Entry]:
        """Return every DTC that has failed since it was cleared, in order of DTC."""
        found = [entry_of(r) for r in self._records.values() if r.occurrence > 0]
        return sorted(found, key=lambda entry: (entry.dtc, entry.fault))

    def supported(self) -> list[Entry]:
        """Return every DTC of the catalogue, and those that are still stored, in order of DTC."""
        found = [
            entry_of(r)
            for r in self._records.values()
            if r.occurrence or self.catalogue.get(r.id) is not None
        ]
        return sorted(found, key=lambda entry: (entry.dtc, entry.fault))

    def entry(self, fault: str) -> Entry:
        """Return what is known of one fault, also when it has not failed since it was cleared."""
        return entry_of(self._records[fault])

    def definition(self, fault: str) -> FaultDefinition:
        """Return the definition of a fault, also of one that is only stored any more."""
        return self._definitions[fault]

    def by_status_mask(self, mask: int) -> list[Entry]:
        """Return the entries with any of the mask's bits set."""
        return [entry for entry in self.entries() if entry.status & mask]

    def count_by_status_mask(self, mask: int) -> int:
        """Return how many entries :meth:`by_status_mask` finds."""
        return sum(1 for r in self._records.values() if r.occurrence > 0 and r.status & mask)

    def status(self, fault: str) -> Status:
        """Return the status byte of a fault."""
        return Status(self._records[fault].status)

    def permanent(self) -> list[Permanent]:
        """Return the permanent DTCs, the oldest first."""
        return self._permanent.all()

    def in_order(self, what: str) -> list[Entry]:
        """Return faults in order of ``first_failed``, ``last_failed``, ``first_confirmed``, ``last_confirmed``."""
        known = [r for r in self._records.values() if getattr(r, what) is not None]
        return [entry_of(r) for r in sorted(known, key=lambda r: getattr(r, what))]

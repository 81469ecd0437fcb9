"""The fault memory: qualified verdicts become status bytes, occurrences, freeze frames.

Changes take effect in two steps: :meth:`FaultMemory.apply` and its like change the memory,
:meth:`FaultMemory.commit` makes that durable. Only then may anyone outside be told.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from gateway.engine.events import QUALIFIED_FAILED, QUALIFIED_PASSED, Events
from gateway.faults import status as transition
from gateway.faults.catalogue import Catalogue, FaultDefinition
from gateway.faults.dtc import ALL_DTCS, Dtc
from gateway.faults.status import CLEARED, NOT_COMPLETED, Status
from gateway.faults.store import Cycle, FreezeFrame, Record, Store

#: The occurrence counter stops here.
MOST_OCCURRENCES = 255
FIRST_FAILURE, LATEST_FAILURE = 1, 2

#: Takes a fault, returns its freeze frame: {signal: value}.
Snapshot = Callable[[FaultDefinition], Mapping[str, float]]


@dataclass(frozen=True)
class DtcChange:
    """A status byte that changed."""

    definition: FaultDefinition
    old_status: Status
    new_status: Status
    fdc: int
    occurrence: int
    t_ns: int
    evidence: Mapping[str, float | None]

    @property
    def dtc(self) -> Dtc:
        """The fault's DTC."""
        return self.definition.dtc

    @property
    def concerns_fault(self) -> bool:
        """Whether more changed than that the test is complete now."""
        return bool((self.old_status ^ self.new_status) & ~NOT_COMPLETED)


@dataclass(frozen=True)
class Entry:
    """What the memory knows of one DTC, for readers."""

    dtc: Dtc
    fault: str
    status: Status
    occurrence: int
    first_ns: int | None
    last_ns: int | None
    evidence: Mapping[str, float | None]
    freeze_frames: tuple[FreezeFrame, ...]


def entry_of(record: Record) -> Entry:
    """Return a stored record as an entry."""
    return Entry(
        Dtc(record.dtc),
        record.id,
        Status(record.status),
        record.occurrence,
        record.first_ns,
        record.last_ns,
        record.evidence,
        tuple(record.freeze_frames.values()),
    )


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


class FaultMemory:
    """Status, occurrences and freeze frames of every fault of a catalogue.

    Entries of faults that are no longer in the catalogue are kept and listed until cleared.

    Args:
        catalogue: the faults, in the engine's order.
        store: where they are kept.
    """

    def __init__(self, catalogue: Catalogue, store: Store) -> None:
        self.catalogue = catalogue
        self._store = store
        self._records = {record.id: record for record in store.load()}
        for definition in catalogue:
            record = self._records.setdefault(
                definition.id, Record(definition.id, definition.dtc.value, int(CLEARED))
            )
            record.dtc = definition.dtc.value
        self._cycle = store.cycle()
        self._dirty: set[str] = set()
        self._cycle_changed = False
        self._answers: dict[int, int] = {}
        self._asked = store.watch()

    def start_cycle(self, t_ns: int) -> None:
        """Start an operation cycle; one that was never ended (power loss, kill -9) is ended first."""
        if self._cycle.open:
            self._end(t_ns)
        for record in self._records.values():
            record.status = int(transition.on_cycle_start(Status(record.status)))
            self._dirty.add(record.id)
        self._cycle = Cycle(self._cycle.number + 1, True, t_ns)
        self._cycle_changed = True
        self.commit()

    def end_cycle(self, t_ns: int) -> None:
        """End the operation cycle."""
        self._end(t_ns)
        self.commit()

    def _end(self, t_ns: int) -> None:
        for record in self._records.values():
            status, record.failed_cycles = transition.on_cycle_end(
                Status(record.status), record.failed_cycles
            )
            record.status = int(status)
            self._dirty.add(record.id)
        self._cycle = Cycle(self._cycle.number, False, t_ns)
        self._cycle_changed = True

    def apply(self, events: Events, snapshot: Snapshot) -> list[DtcChange]:
        """Take qualified events in order; others are passed over.

        Args:
            events: shape (n,) of EVENT.
            snapshot: called for each failure, at once.

        Returns:
            the status bytes that changed. They are durable after :meth:`commit`.
        """
        changes = []
        for event in events:
            definition = self.catalogue[int(event["fault"])]
            record = self._records[definition.id]
            old = Status(record.status)
            if event["kind"] == QUALIFIED_FAILED:
                self._fail(definition, record, event, snapshot)
            elif event["kind"] == QUALIFIED_PASSED:
                record.status = int(transition.on_passed(old))
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
        self, definition: FaultDefinition, record: Record, event: object, snapshot: Snapshot
    ) -> None:
        old = Status(record.status)
        status, record.failed_cycles = transition.on_failed(
            old,
            record.failed_cycles,
            confirm_cycles=definition.confirm_cycles,
            indicator=definition.indicator,
        )
        record.status = int(status)
        if old & Status.TEST_FAILED:
            return
        t_ns = int(event["t_ns"])  # type: ignore[index]
        record.occurrence = min(record.occurrence + 1, MOST_OCCURRENCES)
        record.first_ns = t_ns if record.first_ns is None else record.first_ns
        record.last_ns = t_ns
        names = ("value", "threshold", *definition.evidence)
        values = (event["value"], event["threshold"], *event["evidence"])  # type: ignore[index]
        record.evidence = {name: _finite(value) for name, value in zip(names, values, strict=False)}
        content = {name: _finite(value) for name, value in snapshot(definition).items()}
        number = LATEST_FAILURE if FIRST_FAILURE in record.freeze_frames else FIRST_FAILURE
        record.freeze_frames[number] = FreezeFrame(number, t_ns, content)

    def commit(self) -> None:
        """Make all changes durable; returns when they are.

        Raises:
            GatewayError: they could not be written; a later commit tries them again.
        """
        if self._dirty or self._cycle_changed or self._answers:
            self._save()
            self._saved()

    def _save(self) -> None:
        self._store.save(
            [self._records[name] for name in sorted(self._dirty)],
            self._cycle if self._cycle_changed else None,
            self._answers,
        )

    def _saved(self) -> None:
        self._dirty.clear()
        self._cycle_changed = False
        self._answers.clear()

    def clear(self, group: int = ALL_DTCS) -> list[str]:
        """Clear one DTC, or all (ISO 14229-1, 0x14); durable on return.

        Args:
            group: a DTC's 24 bits, or ALL_DTCS.

        Returns:
            ids of the faults cleared; the engine's debounce of these must be reset too.
        """
        cleared = self._clear(group)
        self.commit()
        return cleared

    def _clear(self, group: int) -> list[str]:
        cleared = []
        for record in self._records.values():
            if group in (ALL_DTCS, record.dtc):
                self._records[record.id] = Record(record.id, record.dtc, int(CLEARED))
                self._dirty.add(record.id)
                cleared.append(record.id)
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
                    done = sum(group in (ALL_DTCS, entry.dtc.value) for entry in self.entries())
                    cleared += self._clear(group)
                self._answers[request] = done
            self._save()
        self._saved()
        return cleared

    def entries(self) -> list[Entry]:
        """Return every DTC that has failed since it was cleared, in order of DTC."""
        found = [entry_of(r) for r in self._records.values() if r.occurrence > 0]
        return sorted(found, key=lambda entry: (entry.dtc, entry.fault))

    def entry(self, fault: str) -> Entry:
        """Return what is known of one fault, also when it has not failed since it was cleared."""
        return entry_of(self._records[fault])

    def by_status_mask(self, mask: int) -> list[Entry]:
        """Return the entries with any of the mask's bits set."""
        return [entry for entry in self.entries() if entry.status & mask]

    def status(self, fault: str) -> Status:
        """Return the status byte of a fault."""
        return Status(self._records[fault].status)

    @property
    def cycle_number(self) -> int:
        """Number of the operation cycle, from 1."""
        return self._cycle.number

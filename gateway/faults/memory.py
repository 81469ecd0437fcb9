"""The fault memory: qualified verdicts become status bytes, entries, freeze frames, permanent DTCs.

Changes take effect in two steps: :meth:`FaultMemory.apply` and its like change the memory,
:meth:`FaultMemory.commit` makes that durable. Only then may anyone outside be told, unless the configuration wants it
first: readers get the memory as it was last written. While the file cannot be written there is a third state, told as
such: known here, not stored.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Sequence
from contextlib import suppress
from itertools import compress

from gateway.engine.events import FDC_REACHED, QUALIFIED_FAILED, QUALIFIED_PASSED, Event
from gateway.faults import status as transition
from gateway.faults.catalogue import Catalogue, FaultDefinition
from gateway.faults.clearing import Clearing, Judge
from gateway.faults.dtc import ALL_DTCS, Dtc
from gateway.faults.entries import DtcChange, Foreseen
from gateway.faults.event_memory import EventMemory
from gateway.faults.explanation import HELD, Cause
from gateway.faults.failures import Snapshot, failure_of, finite
from gateway.faults.fleet import FleetParams, FleetQueue
from gateway.faults.interventions import Intervention
from gateway.faults.journal_file import name_of
from gateway.faults.ledger import Ledger
from gateway.faults.mil import is_mil_on, lights_mil
from gateway.faults.operation_cycles import OperationCycles
from gateway.faults.performance import Performance
from gateway.faults.reading import Readable
from gateway.faults.records import Description, FreezeFrame, Record
from gateway.faults.recovery import Recovered, event_of, unseen
from gateway.faults.restarts import Restarts
from gateway.faults.retry_policy import RetryPolicy
from gateway.faults.settings import POWER
from gateway.faults.status import CLEARED, STATUS, Status
from gateway.faults.store import Store, StoreError
from gateway.faults.usage import Usage, UsageParams
from gateway.faults.vehicle import VehicleMemory
from gateway.faults.writer_thread import Writer
from gateway_fdi.common.log import get_logger

log = get_logger(__name__)

_TEST_FAILED = int(Status.TEST_FAILED)
#: Takes a fault's place in the catalogue, returns near misses and greatest detection counter since the last call.
Statistics = Callable[[int], tuple[int, int]]


class FaultMemory(Readable):
    """Status, entries and freeze frames of every fault of a catalogue.

    Entries of faults that are no longer in the catalogue are kept and listed until cleared.

    Args:
        catalogue: the faults, in the engine's order.
        store: where they are kept.
        size: entries there is room for; None: for all.
        recordings: recordings kept of each fault.
        statistics: of the faults' debounce.
        usage: signals of the vehicle's use; None: there are none.
        ahead: whether others see what is not written yet.
        fleet: that the car is in; None: in none.

    Attributes:
        ledger: its contents in memory, and their way to the file.
        cycles: operation cycles.
        restarts: starts after the death of a process.
        performance: how often monitors have run.
        usage: how far and how long the vehicle was driven.
        recovered: verdicts that an earlier process told, and did not come to write.
        fleet: events that wait for the fleet.
    """

    def __init__(
        self,
        catalogue: Catalogue,
        store: Store,
        *,
        size: int | None = None,
        recordings: int = 1,
        statistics: Statistics | None = None,
        usage: UsageParams | None = None,
        ahead: bool = False,
        fleet: FleetParams | None = None,
    ) -> None:
        self.catalogue = catalogue
        self._statistics = statistics
        self.ledger = Ledger(store, recordings, ahead=ahead)
        self._records = self.ledger.records
        self._definitions: dict[str, FaultDefinition] = {}
        self._now_ns = 0
        self._define()
        self.identifiers = self.ledger.identifiers
        self._entries = EventMemory(self.ledger, self._definitions, catalogue, size)
        self.cycles = OperationCycles(self.ledger, self._definitions, self._entries, self.fold_statistics)
        self.restarts = Restarts(self.ledger, self.cycles)
        self.fleet = FleetQueue(self.ledger, fleet)
        asked = usage or UsageParams()
        self.usage = Usage(self.ledger, distances=bool(asked.speed or asked.odometer), times=bool(asked.running))
        self.performance = Performance(self.ledger, self.cycles, catalogue, asked.counted_cycle)
        self._clearing = Clearing(
            self.ledger, self._definitions, catalogue, self._entries, self.fold_statistics, self.usage
        )
        self.recovered = self._recover()

    def _define(self) -> None:
        """Have a definition and a record of every fault, monitored or only stored."""
        self._definitions.update({definition.id: definition for definition in self.catalogue})
        for definition in self.catalogue:
            if definition.id not in self._records:
                self.ledger.add(Record(definition.id, definition.dtc.value, int(CLEARED)))
            for view in (self._records, self.ledger.shown):
                view[definition.id].dtc = definition.dtc.value
        for record in self._records.values():  # no longer in the catalogue: usual rules
            self._definitions.setdefault(record.id, FaultDefinition(record.id, Dtc(record.dtc), "no longer monitored"))
        self._ids = [definition.id for definition in self.catalogue]
        self._cycle_of = [definition.cycle for definition in self.catalogue]
        self._lamps = [fault for fault, definition in self._definitions.items() if lights_mil(definition)]
        self._put_in_order()

    def succeed(self, old: FaultMemory) -> None:
        """Go on with what another memory of the same store knows, written or not."""
        self.ledger.succeed(old.ledger)
        self._entries.succeed(old._entries)
        self.cycles.succeed(old.cycles)
        self.restarts.succeed(old.restarts)
        self.usage.succeed(old.usage)
        self._now_ns = old._now_ns
        self._define()

    # Operation cycles

    def start_cycle(self, t_ns: int, name: str = POWER) -> None:
        """Start an operation cycle at a time of the wall clock (see :meth:`OperationCycles.start`)."""
        if self.cycles.start(t_ns, name):
            self.performance.began(name)
        self.commit()

    def end_cycle(self, t_ns: int, name: str = POWER) -> None:
        """End an operation cycle; the end of the power cycle ends all of them."""
        self.cycles.end(t_ns, name)
        self.commit()

    def cycle_number(self, name: str = POWER) -> int:
        """Return the number of an operation cycle, from 1; 0 before the first."""
        return self.cycles.number(name)

    # Verdicts

    def apply(self, event: Event, snapshot: Snapshot) -> list[DtcChange]:
        """Take an event; one that is neither a verdict nor reaches for a freeze frame changes nothing.

        Nor does one of a fault outside its operation cycle (AUTOSAR DEM: results of a cycle that is not started do not
        count).

        Args:
            event: of the engine.
            snapshot: called for a failure, at once.

        Returns:
            the status bytes that changed. They are durable after :meth:`commit`.
        """
        kind = event.kind
        if kind not in (QUALIFIED_FAILED, QUALIFIED_PASSED, FDC_REACHED):
            return []
        return self._apply(self.catalogue[event.fault], event, snapshot)

    def _apply(self, definition: FaultDefinition, event: Event, snapshot: Snapshot) -> list[DtcChange]:
        kind = event.kind
        if not self.cycles.counts(definition.cycle):
            return []
        record = self._records[definition.id]
        old = STATUS[record.status]
        if kind != FDC_REACHED:
            self.performance.completed(definition.id)
        if kind == FDC_REACHED:
            content = finite(snapshot(definition).frame)
            self._entries.prestore(definition.id, FreezeFrame(0, event.t_ns, content))
        elif kind == QUALIFIED_FAILED:
            self._entries.fail(definition, record, failure_of(definition, event, snapshot))
            self.fleet.judged(definition.id)
        else:
            record.status = int(transition.on_passed(old))
            self._entries.give_up(record)
        return self._changed(definition, record, old, event.fdc, event.t_ns)

    def foresee(self, fault: str) -> Foreseen:
        """Return what the next verdict of a fault of the catalogue will make of its DTC; nothing changes.

        It holds until the ledger names the fault as touched.
        """
        definition = self._definitions[fault]
        if not self.cycles.counts(definition.cycle):
            return Foreseen()
        return self._entries.foresee(definition, self._records[fault])

    def _recover(self) -> Recovered:
        """Take the verdicts that were told, and that a power cut kept from the file; returns what became of them.

        Their status byte is the one that was told, also where the configuration has other rules now.
        """
        waiting = self.ledger.store.take_waiting()
        known = {name_of(fault): definition for fault, definition in self._definitions.items()} if waiting else {}
        faults, lost = [], 0
        for verdict in waiting:
            definition = known.get(verdict.fault)
            if definition is None:
                lost += 1
                continue
            # One that was told as not confirmed may wait for what explains it.
            self._entries.explained = () if verdict.status & Status.CONFIRMED_DTC else (definition.id,)
            self._apply(definition, event_of(verdict), unseen)
            record = self._records[definition.id]
            if record.occurrence == verdict.occurrence:
                record.status = verdict.status
                self.ledger.touch(record.id)
                faults.append(record.id)
            else:
                lost += 1
        self._entries.explained = ()
        if waiting:
            self.commit()
            log.warning("verdicts recovered that were told last", faults=faults, lost=lost)
        return Recovered(tuple(faults), lost)

    def complete(self, places: Sequence[int]) -> bool:
        """Take tests that have passed of faults that are not there, by their places: they are complete, no more.

        Returns:
            whether it was so; else nothing was taken, and each is to be told by :meth:`apply`.
        """
        # A car's first seconds have thousands: maps take them with fewer steps of Python.
        records = [*map(self._records.__getitem__, map(self._ids.__getitem__, places))]
        statuses = [record.status for record in records]
        if any(map(_TEST_FAILED.__and__, statuses)):
            return False
        if not all(map(self.cycles.counts, set(map(self._cycle_of.__getitem__, places)))):
            counting = [self.cycles.counts(self._cycle_of[place]) for place in places]
            records, statuses = [*compress(records, counting)], [*compress(statuses, counting)]
        self.ledger.complete(records, statuses)
        if self.performance.offered or self._entries.waits:
            for record in records:
                self.performance.completed(record.id)
                self._entries.give_up(record)
        return True

    def _changed(
        self, definition: FaultDefinition, record: Record, old: Status, fdc: int, t_ns: int
    ) -> list[DtcChange]:
        """Return the change of a status byte, if it has changed."""
        new = STATUS[record.status]
        if new == old:
            return []
        self.ledger.touch(record.id)
        evidence = dict(record.evidence) if record.status & _TEST_FAILED else {}
        return [DtcChange(definition, old, new, fdc, record.occurrence, t_ns, evidence)]

    # Explanations

    def wait_for_causes(self, faults: Container[str]) -> None:
        """Have failures of these faults wait for :meth:`hold` or :meth:`confirm` before they are confirmed."""
        self._entries.explained = faults

    def record(self, fault: str) -> Record:
        """Return what is known of a fault now, written or not: not for others, and not to be changed."""
        return self._records[fault]

    def unsettled(self) -> list[Record]:
        """Return the records whose confirmation waits, or is held, in order of their ids; not to be changed."""
        return sorted((record for record in self.ledger.failed() if record.hold), key=lambda record: record.id)

    def explain(self, fault: str, cause: Cause) -> None:
        """Keep what explains an entry; nothing becomes of its status byte."""
        self._records[fault].cause = cause
        self.ledger.touch(fault)

    def hold(self, fault: str) -> None:
        """Keep a DTC that waits from being confirmed: a proven cause explains it."""
        self._records[fault].hold = HELD
        self.ledger.touch(fault)

    def confirm(self, fault: str, fdc: int, t_ns: int) -> list[DtcChange]:
        """Confirm a DTC that has waited or was held; returns what changed (see :meth:`apply`).

        Args:
            fault: its id.
            fdc: its detection counter now.
            t_ns: now, of the wall clock.
        """
        definition, record = self._definitions[fault], self._records[fault]
        old = STATUS[record.status]
        self._entries.wait_no_longer(definition, record, t_ns)
        return self._changed(definition, record, old, fdc, t_ns)

    @property
    def room(self) -> bool:
        """Whether an entry has gone since the refused ones were tried again."""
        return self._entries.room

    def admit_refused(self, t_ns: int) -> list[DtcChange]:
        """Enter failures that a full memory refused, or whose entries gave way, if there is room for them now.

        The most important come first, of these the oldest; a fault that has passed meanwhile, or whose operation cycle
        is over, is not entered.

        Returns:
            the status bytes that changed. They are durable after :meth:`commit`.
        """
        changes = []
        for definition, record, old in self._entries.admit_refused(self.cycles.counts):
            changes += self._changed(definition, record, old, 127, t_ns)
        return changes

    # Durability

    @property
    def outage(self) -> RetryPolicy:
        """Since when, and why, the file cannot be written."""
        return self.ledger.outage

    @property
    def unsaved(self) -> int:
        """How many faults have changes that are not durable, and one for all else."""
        return self.ledger.unsaved

    @property
    def clean(self) -> bool:
        """Whether there is nothing unsaved."""
        return self.ledger.clean

    @property
    def commits(self) -> int:
        """How often changes were written."""
        return self.ledger.commits

    def commit(self, t_ns: int | None = None, *, final: bool = False) -> bool:
        """Make all changes durable; returns whether they are.

        Changes that cannot be written stay here, and later calls try again (see :class:`RetryPolicy`).

        Args:
            t_ns: now, of the engine's clock; default: the latest time heard of.
            final: try in any case.
        """
        self._now_ns = max(self._now_ns, t_ns or 0)
        return self.ledger.commit(self._now_ns, final=final)

    def begin(self, t_ns: int, writer: Writer, *, anew: bool = False) -> None:
        """Have all changes made durable by a thread (``ledger.under_way`` tells), in a new file if need be."""
        self._now_ns = max(self._now_ns, t_ns)
        self.ledger.begin(self._now_ns, writer, anew=anew)

    def join(self) -> bool:
        """Wait for the thread that writes: the store is for this one then. Returns whether one did."""
        return self.ledger.join()

    @property
    def vehicle(self) -> VehicleMemory:
        """The DTCs of other ECUs."""
        return self.ledger.vehicle

    def interventions(self) -> list[Intervention]:
        """Return what testers did, the oldest first."""
        return self.ledger.interventions.all()

    def note_descriptions(self) -> None:
        """Keep what the faults are called, with the next commit, for readers without the configuration."""
        self.ledger.describe({d.id: Description(d.description, d.severity, d.remedy) for d in self.catalogue})

    def write_identifier(self, did: int, data: bytes) -> None:
        """Keep what a tester wrote; durable on return.

        Raises:
            StoreError: it could not be written; the value is what it was.
        """
        with self.ledger.undoing():
            self.ledger.set_identifier(did, data)
            self.ledger.write(self._now_ns)

    def attempts(self, lock: str) -> int:
        """Return how many wrong attempts a lock of testers has had since the last right one."""
        return self.ledger.fact(f"attempts.{lock}")

    def keep_attempts(self, lock: str, wrong: int) -> None:
        """Keep how many wrong attempts a lock has had; durable on return, if anything can be written."""
        self.ledger.set_fact(f"attempts.{lock}", wrong)
        with suppress(StoreError):  # it is tried again, and counts in this process in any case
            self.ledger.write(self._now_ns)

    def proven(self, rule: str) -> int:
        """Return the digest of a checksum's rule that was proven last, by its name; 0: none."""
        return self.ledger.fact(f"proven.{rule}")

    def keep_proven(self, rule: str, digest: int) -> None:
        """Keep the digest of a rule that has been proven, with the next commit; 0: none."""
        self.ledger.set_fact(f"proven.{rule}", digest)

    def freshness(self, rule: str) -> int:
        """Return the least freshness value that is new by a rule of SecOC, as it was kept last; 0: none was."""
        return self.ledger.fact(f"freshness.{rule}") & 0xFFFFFFFFFFFFFFFF

    def keep_freshness(self, rule: str, least: int) -> None:
        """Keep the least freshness value that is new, of 64 bits, with the next commit."""
        self.ledger.set_fact(f"freshness.{rule}", least - (least >> 63 << 64))

    def spoken(self, ecu: str) -> int:
        """Return the number of the protocol that another ECU answered; 0: it is not known."""
        return self.ledger.fact(f"speaks.{ecu}")

    def keep_spoken(self, ecu: str, number: int) -> None:
        """Keep the number of the protocol that another ECU answers, with the next commit."""
        self.ledger.set_fact(f"speaks.{ecu}", number)

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
                self.ledger.touch(record.id)

    # Clearing

    def clear(self, group: int = ALL_DTCS) -> list[str]:
        """Clear one DTC, a group, or all (ISO 14229-1, 0x14); durable on return, or nothing is cleared.

        Permanent DTCs stay until their test has passed; those of faults without a test go.

        Args:
            group: a DTC's 24 bits, or a group (see :func:`gateway.faults.dtc.in_group`).

        Returns:
            ids of the faults cleared; the engine's debounce of these must be reset too.

        Raises:
            StoreError: it could not be written; nothing was cleared.
        """
        return self._clearing.clear(group, self._now_ns)

    def knows(self, group: int) -> bool:
        """Return whether a clear of this DTC or group would mean any fault."""
        return self._clearing.knows(group)

    def serve_requests(self, before: Callable[[], None] = lambda: None, judge: Judge = lambda asked: 0) -> list[str]:
        """Do what other processes asked for (clearing); returns ids of the faults cleared.

        Args:
            before: called first, if there is a request.
            judge: says why one of them may not, as a negative response code; 0: it may.
        """
        return self._clearing.serve_requests(self._now_ns, before, judge)

    def is_mil_on_now(self) -> bool:
        """Return whether a DTC asks for the MIL, written or not: not for others."""
        return is_mil_on((self._records[fault] for fault in self._lamps), self._definitions)

    def status_now(self, fault: str) -> Status:
        """Return the status byte of a fault, written or not: not for others."""
        return Status(self._records[fault].status)

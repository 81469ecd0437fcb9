"""What the fault memory holds in this process, what of it is not written yet, and how it gets written."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from copy import copy

from gateway.faults.outage import Outage
from gateway.faults.permanent import PermanentDtcs
from gateway.faults.records import Changes, Cycle, Permanent, Record, Recording
from gateway.faults.store import Store, StoreError

#: Number in the store: how many failures and confirmations the memory has put in order; whether an entry had to be given up.
SEQUENCE, OVERFLOW = "sequence", "overflow"


class Ledger:
    """Records, cycles, numbers and identifiers, as read from a store, with what has changed since.

    A write that fails loses nothing: what was to be written stays here, and goes with a later one.

    Args:
        store: where they are kept.
        recordings: recordings kept of each fault.

    Attributes:
        records: by fault id.
        cycles: the last operation cycle of each name.
        identifiers: values that testers wrote, by data identifier.
        outage: of the store.
        commits: how many transactions were written.
    """

    def __init__(self, store: Store, recordings: int = 1) -> None:
        self.store = store
        self.records: dict[str, Record] = {record.id: record for record in store.load()}
        self.cycles: dict[str, Cycle] = store.cycles()
        self.identifiers: dict[int, bytes] = store.identifiers()
        self.outage = Outage()
        self.commits = 0
        self._facts = store.facts()
        self._permanent = PermanentDtcs(store.permanent())
        self._pending = Changes(kept_recordings=recordings)
        self._dirty: set[str] = set()
        self._more = False  # whether anything waits beside records

    def succeed(self, old: Ledger) -> None:
        """Go on with what another ledger of the same store holds, written or not."""
        self.records.update(old.records)
        self.cycles.update(old.cycles)
        self.identifiers.update(old.identifiers)
        self._facts, self._permanent = old._facts, old._permanent
        self._dirty |= old._dirty
        kept = self._pending.kept_recordings
        self._pending, self._more = old._pending, old._more
        self._pending.kept_recordings = kept
        self.outage, self.commits = old.outage, old.commits

    # Changes

    def touch(self, fault: str) -> None:
        """Note that a record has changed."""
        self._dirty.add(fault)

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

    def set_identifier(self, did: int, data: bytes) -> None:
        """Set what a tester wrote."""
        self.identifiers[did] = data
        self._pending.identifiers = {**self._pending.identifiers, did: data}
        self._more = True

    def answer(self, request: int, done: int) -> None:
        """Answer the request of another process."""
        self._pending.answered = {**self._pending.answered, request: done}
        self._more = True

    # Writing

    @property
    def unsaved(self) -> int:
        """Changes that are not written: records, and one for all else; 0: none."""
        return len(self._dirty) + self._more

    def commit(self, t_ns: int, *, final: bool = False) -> bool:
        """Write all changes; returns whether all is durable now.

        What cannot be written stays, and is tried again by later calls, after waits that grow.

        Args:
            t_ns: now, of the engine's clock.
            final: try in any case.
        """
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
        self._pending.records = [self.records[name] for name in sorted(self._dirty)]
        try:
            self.store.save(self._pending, self._whole if alone else None)
        except StoreError as error:
            self.outage.failed(t_ns, error.reason)
            raise
        self.commits += 1
        if alone:
            self.written()

    def written(self) -> None:
        """Note that all changes are written."""
        self.outage.ended()
        self._dirty.clear()
        self._pending = Changes(kept_recordings=self._pending.kept_recordings)
        self._more = False

    def rewrite(self) -> None:
        """Have everything written by the next commit: the file is gone."""
        self._dirty |= self.records.keys()

    def _whole(self) -> Changes:
        """Return all there is, for a file that has none of it."""
        whole = copy(self._pending)
        whole.records = list(self.records.values())
        whole.cycles = self.cycles
        whole.permanent = self._permanent.all()
        whole.identifiers = self.identifiers
        whole.facts = self._facts
        return whole

    @contextmanager
    def undoing(self) -> Iterator[None]:
        """Undo what is done within, if it cannot be written.

        Records are replaced within, not changed.
        """
        records, identifiers = dict(self.records), dict(self.identifiers)
        facts, permanent = dict(self._facts), self._permanent.all()
        dirty, more, pending = set(self._dirty), self._more, copy(self._pending)
        try:
            yield
        except StoreError:
            self.records.clear()
            self.records.update(records)
            self.identifiers.clear()
            self.identifiers.update(identifiers)
            self._facts, self._permanent = facts, PermanentDtcs(permanent)
            self._dirty, self._more, self._pending = dirty, more, pending
            raise

    def kept_permanent(self) -> list[Permanent]:
        """Return the permanent DTCs, the oldest first."""
        return self._permanent.all()

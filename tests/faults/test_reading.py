"""What the fault memory keeps in order for quick answers is what a look through all its records finds."""

from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress

from fault_examples import AtOnce, catalogue, event, nothing
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.faults.entries import DtcStatus, entry_of
from gateway.faults.memory import FaultMemory
from gateway.faults.records import Record
from gateway.faults.store import Store, StoreError

FAULTS = 4


class Failing(Store):
    """A store that cannot be written at times, with a fault of an earlier configuration in it."""

    down = False

    def load(self):
        old = Record("gone.fault", 0x123456, 0x2F)
        old.occurrence, old.first_failed, old.last_failed = 2, 1, 2
        return [old]

    def save(self, changes, whole=None):
        if self.down:
            raise StoreError(self.path, "down")
        super().save(changes, whole)


def looked_through(memory):
    """What there is, by looking at every record."""
    shown = memory.ledger.shown.values()
    failed = sorted((entry_of(r) for r in shown if r.occurrence), key=lambda entry: (entry.dtc, entry.fault))
    known = sorted(
        DtcStatus(r.dtc, r.id, r.status) for r in shown if r.occurrence or memory.catalogue.get(r.id) is not None
    )
    return failed, known


action = st.one_of(
    st.tuples(st.sampled_from(["fail", "heal"]), st.integers(0, FAULTS - 1)),
    st.tuples(st.sampled_from(["commit", "begin", "join", "down", "up", "cycle", "room"]), st.just(0)),
    st.tuples(st.just("clear"), st.sampled_from([0xFFFFFF, 0x030011, 0x030111, 0x123456])),
)


@settings(max_examples=80)
@given(st.lists(action, max_size=30), st.sampled_from([None, 1, 2]))
def test_entries_and_dtcs_are_those_of_all_records(actions, size):
    store = Failing(None)
    memory = FaultMemory(catalogue(confirm=(1,) * FAULTS), store, size=size)
    with ThreadPoolExecutor(1) as executor:
        for t_ns, (what, which) in enumerate(actions, start=1):
            if what in ("fail", "heal"):
                memory.apply(event(which, what == "fail", t_ns), nothing)
            elif what == "commit":
                memory.commit(t_ns * 10**10)
            elif what == "begin":
                memory.join()
                memory.begin(t_ns * 10**10, executor)
            elif what == "join":
                memory.join()
            elif what in ("down", "up"):
                memory.join()
                store.down = what == "down"
            elif what == "cycle":
                memory.start_cycle(t_ns)
            elif what == "room":
                memory.admit_refused(t_ns)
            else:
                with suppress(StoreError):
                    memory.clear(which)
            failed, known = looked_through(memory)
            assert memory.entries() == failed
            assert memory.supported() == known
            stored = {r.id for r in memory.ledger.records.values() if r.occurrence}
            assert {r.id for r in memory.ledger.failed()} == stored
            assert size is None or len(stored) <= size
            for mask in (0x01, 0x08, 0x50, 0xFF):
                assert memory.supported(mask) == [dtc for dtc in known if dtc.status & mask]
                assert memory.count_by_status_mask(mask) == sum(1 for entry in failed if entry.status & mask)
            for dtc in (0x030011, 0x030111, 0x123456, 0x999999):
                found = memory.entry_of_dtc(dtc)
                assert (None if found is None else found.fault) == next((k.fault for k in known if k.dtc == dtc), None)
        memory.join()


def test_room_for_one_is_given_to_one():
    memory = AtOnce(catalogue(confirm=(1,) * FAULTS), Store(None), size=1)
    for fault in range(3):
        memory.apply(event(fault, True, fault + 1), nothing)
    assert [entry.fault for entry in memory.entries()] == ["m.f0"]
    memory.clear(0x030011)
    memory.admit_refused(9)
    assert [entry.fault for entry in memory.entries()] == ["m.f1"]

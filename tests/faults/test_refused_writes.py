"""A disk that refuses to be written: nothing stops, nothing is lost, and attempts grow rare."""

import itertools
import sqlite3

import pytest
from fault_examples import event, frame, nothing
from stored_memories import kept, listed

from gateway.faults.retry_policy import FIRST_NS, LONGEST_NS, RetryPolicy
from gateway.faults.store import Store, StoreError
from gateway.faults.write_throttle import WriteThrottle

S = 1_000_000_000


class BrokenDisk:
    """Lets every write of a store fail, as long as it is broken."""

    def __init__(self, monkeypatch):
        self.broken = False
        self.attempts = 0
        write = Store.save

        def save(store, changes, whole=None):
            self.attempts += 1
            if self.broken:
                raise StoreError(store.path, "disk I/O error")
            write(store, changes, whole)

        monkeypatch.setattr(Store, "save", save)


@pytest.fixture
def disk(monkeypatch):
    return BrokenDisk(monkeypatch)


@pytest.mark.evidence("AUTOSAR DEM: NVRAM")
def test_what_cannot_be_written_stays_and_is_written_later(tmp_path, disk):
    store, memory = kept(tmp_path / "f.sqlite")
    memory.start_cycle(0)
    disk.broken = True
    for k in range(3):
        memory.apply(event(k, True, k), nothing)
        assert memory.commit(k) is False
    assert memory.unsaved == 4, "three faults, and the order of their failures"
    assert memory.outage.reason == "disk I/O error"
    assert [e.fault for e in memory.entries()] == ["m.f0", "m.f1", "m.f2"], "known, if not stored"
    assert listed(store.path) == {}
    disk.broken = False
    assert memory.commit(FIRST_NS - 1) is False, "not before its time"
    assert memory.commit(FIRST_NS) is True
    assert listed(store.path) == {"m.f0": 1, "m.f1": 1, "m.f2": 1}
    assert memory.outage.reason == ""
    store.close()


def test_what_was_refused_and_reached_the_disk_all_the_same_is_written_back(tmp_path, monkeypatch):
    """A commit may fail after its work is done: the tester was told that nothing was cleared, and so it shall be."""
    store, memory = kept(tmp_path / "f.sqlite")
    memory.start_cycle(0)
    for k in range(2):
        memory.apply(event(k, True, k), nothing)
    memory.write_identifier(0xF190, b"VIN")
    memory.commit(1)
    save = Store.save

    def late(store, changes, whole=None):
        save(store, changes, whole)
        raise StoreError(store.path, "disk I/O error")

    with monkeypatch.context() as patch:
        patch.setattr(Store, "save", late)
        with pytest.raises(StoreError):
            memory.clear()
        assert listed(store.path) == {}, "the disk has it"
        for did, data in ((0xF190, b"other"), (0xF191, b"new")):
            with pytest.raises(StoreError):
                memory.write_identifier(did, data)
    assert store.identifiers()[0xF191] == b"new"
    assert memory.commit(FIRST_NS * 20) is True
    assert listed(store.path) == {"m.f0": 1, "m.f1": 1}
    assert store.identifiers() == memory.identifiers == {0xF190: b"VIN"}
    store.close()


def test_attempts_grow_rare_and_never_end(tmp_path, disk):
    _, memory = kept(tmp_path / "f.sqlite")
    memory.start_cycle(0)
    memory.apply(event(0, True), nothing)
    disk.broken = True
    disk.attempts, tried = 0, []
    for t_ns in range(0, 100 * S, 10_000_000):
        before = disk.attempts
        memory.commit(t_ns)
        if disk.attempts > before:
            tried.append(t_ns)
    waits = [b - a for a, b in itertools.pairwise(tried)]
    assert waits[0] == FIRST_NS
    assert all(b == min(2 * a, LONGEST_NS) for a, b in itertools.pairwise(waits))
    assert waits[-1] == LONGEST_NS
    assert len(tried) < 20
    assert memory.outage.failures == len(tried)


def test_a_clock_that_goes_back_does_not_put_an_attempt_off_for_ever():
    outage = RetryPolicy()
    outage.failed(1000 * S, "full")
    assert not outage.is_due(1000 * S)
    assert outage.is_due(0)


@pytest.mark.evidence("ISO 14229-1: 0x14 72")
def test_nothing_is_cleared_and_nothing_written_that_cannot_be_made_durable(tmp_path, disk):
    store, memory = kept(tmp_path / "f.sqlite", recordings=2)
    memory.start_cycle(0)
    memory.apply(event(0, True), frame({"x": 1.0}))
    memory.write_identifier(0xF190, b"old")
    disk.broken = True
    with pytest.raises(StoreError):
        memory.clear()
    with pytest.raises(StoreError):
        memory.write_identifier(0xF190, b"new")
    with pytest.raises(StoreError):
        memory.write_identifier(0xF191, b"more")
    assert [e.fault for e in memory.entries()] == ["m.f0"]
    assert int(memory.status("m.f0")) == 0x2F
    assert memory.entry("m.f0").freeze_frames[0].content == {"x": 1.0}
    assert memory.identifiers == {0xF190: b"old"}
    disk.broken = False
    memory.commit(final=True)
    assert listed(store.path) == {"m.f0": 1}
    assert memory.clear() == ["m.f0", "m.f1", "m.f2"]
    assert listed(store.path) == {}
    assert store.identifiers() == {0xF190: b"old"}
    store.close()


def test_another_process_that_asks_for_a_clear_that_fails_is_not_told_it_was_done(tmp_path, monkeypatch):
    store, memory = kept(tmp_path / "f.sqlite")
    memory.start_cycle(0)
    memory.apply(event(0, True), nothing)
    memory.commit()
    asking = Store(store.path, write=False)
    request = asking.request("clear", str(0xFFFFFF))

    def fail(*_):
        raise sqlite3.OperationalError("disk I/O error")

    monkeypatch.setattr("gateway.faults.rows.write", fail)
    assert memory.serve_requests() == []
    assert asking.answer(request) is None
    assert [e.fault for e in memory.entries()] == ["m.f0"]
    monkeypatch.undo()
    asking.request("none", "")  # wakes the writer again
    assert memory.serve_requests() == ["m.f0", "m.f1", "m.f2"]
    assert asking.answer(request) == 1
    asking.close()
    store.close()


def test_a_storm_is_written_in_groups_and_a_single_change_at_once():
    pace = WriteThrottle(burst=4, interval_ns=10)
    assert [pace.allows(0) for _ in range(6)] == [True] * 4 + [False] * 2
    assert sum(pace.allows(t) for t in range(1, 1001)) == 100
    assert [pace.allows(2000) for _ in range(6)] == [True] * 4 + [False] * 2
    pace = WriteThrottle(burst=1, interval_ns=10)
    assert [t for t in range(200) if pace.allows(t, 16)] == list(range(0, 200, 30)), (
        "sixteen faults in each write: a third as often"
    )
    pace = WriteThrottle(burst=2, interval_ns=10)
    assert [pace.allows(2000) for _ in range(3)] == [True] * 2 + [False]
    assert not pace.allows(0), "a clock that goes back gives no leave"
    assert pace.allows(10), "and takes none away"

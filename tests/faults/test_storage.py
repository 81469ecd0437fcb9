"""A memory that cannot be written, is damaged, deleted or replaced: nothing stops, nothing is lost, all of it
is said.
"""

import itertools
import os
import random
import sqlite3
from pathlib import Path

import pytest
from fault_examples import AtOnce, catalogue, event, frame, nothing

from gateway.errors import InputError
from gateway.faults import service
from gateway.faults.kept import KeptStore
from gateway.faults.lock import is_unsaved
from gateway.faults.memory import FaultMemory
from gateway.faults.outage import FIRST_NS, LONGEST_NS, Outage
from gateway.faults.pace import Pace
from gateway.faults.records import Recording
from gateway.faults.salvage import salvage
from gateway.faults.status import Status
from gateway.faults.store import DamagedError, Store, StoreError

S = 1_000_000_000


def connect(*arguments, **options):
    """Connect as SQLite's driver does at the time of the call: a test may have changed it since the store was made."""
    return sqlite3.connect(*arguments, **options)


def kept(path, count=3, **settings):
    store = KeptStore(path, connect=connect)
    return store, FaultMemory(catalogue((1,) * count), store, **settings)


def listed(path):
    return {e["fault"]: e["occurrence"] for e in service.list_entries(path)}


def fill(path, count=3):
    """A memory with so many failures, closed."""
    store, memory = kept(path, count)
    memory.start_cycle(0)
    for k in range(count):
        memory.apply(event(k, True, k + 1), frame({"x": float(k)}))
    memory.add_recordings([Recording(f"m.f{k}", k, 1, 0, b"log") for k in range(count)])
    memory.write_identifier(0xF190, b"VIN")
    memory.commit()
    store.close()


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
    outage = Outage()
    outage.failed(1000 * S, "full")
    assert not outage.is_due(1000 * S)
    assert outage.is_due(0)


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


# Files that go, or that others put there


def test_a_file_that_is_deleted_is_written_anew_with_everything(tmp_path):
    path = tmp_path / "f.sqlite"
    fill(path)
    store, memory = kept(path)
    memory.start_cycle(5)
    for file in tmp_path.glob("f.sqlite*"):
        file.unlink()
    assert store.look() is False
    memory.apply(event(0, False, 6), nothing)
    memory.apply(event(0, True, 7), nothing)
    assert memory.commit(7) is True
    assert listed(path) == {"m.f0": 2, "m.f1": 1, "m.f2": 1}
    (mishap,) = store.mishaps()
    assert (mishap.kind, mishap.aside) == ("deleted", None)
    assert store.mishaps() == []
    reader = Store(path, write=False)
    assert [r.fault for r in reader.recordings()] == ["m.f0", "m.f1", "m.f2"], "and the recordings"
    assert reader.identifiers() == {0xF190: b"VIN"}
    assert reader.cycles()["power"].number == 2
    reader.close()
    with pytest.raises(InputError, match="another gateway keeps"):
        Store(path)
    store.close()


def test_a_file_that_is_deleted_within_a_commit_is_noticed(tmp_path, monkeypatch):
    path = tmp_path / "f.sqlite"
    store, memory = kept(path)
    memory.start_cycle(0)
    write = Store.save

    def delete_and_save(store, changes, whole=None):
        if path.exists() and changes.records:
            path.unlink()
            monkeypatch.setattr(Store, "save", write)
        write(store, changes, whole)

    monkeypatch.setattr(Store, "save", delete_and_save)
    memory.apply(event(1, True), nothing)
    assert memory.commit(1) is True
    assert listed(path) == {"m.f1": 1}
    store.close()


def test_a_file_put_in_its_place_is_put_aside_and_kept(tmp_path):
    path, other = tmp_path / "f.sqlite", tmp_path / "other.sqlite"
    fill(path)
    fill(other, 1)
    store, memory = kept(path)
    memory.start_cycle(5)
    other.rename(path)
    assert store.look() is False
    memory.rewrite()
    assert memory.commit(6) is True
    (mishap,) = store.mishaps()
    assert mishap.kind == "replaced"
    assert listed(mishap.aside) == {"m.f0": 1}
    assert listed(path) == {"m.f0": 1, "m.f1": 1, "m.f2": 1}
    store.close()


def test_a_memory_that_another_gateway_has_taken_is_left_to_it(tmp_path):
    path = tmp_path / "f.sqlite"
    store, memory = kept(path)
    memory.start_cycle(0)
    memory.apply(event(0, True), nothing)
    for file in tmp_path.glob("f.sqlite*"):
        file.unlink()
    other, theirs = kept(path)
    theirs.start_cycle(0)
    store.look()
    assert memory.commit(1) is False
    assert "another gateway keeps" in memory.outage.reason
    assert [e.fault for e in memory.entries()] == ["m.f0"]
    assert theirs.commit(2), "and it is not disturbed"
    other.close()
    store.close()


# Damage


def damaged(path, rng):
    """Damage one place of a file in one of many ways; returns what was done."""
    content = bytearray(path.read_bytes())
    way = rng.choice(["bits", "page", "cut", "zero", "text", "header"])
    if way == "bits":
        for _ in range(30):
            content[rng.randrange(100, len(content))] ^= 1 << rng.randrange(8)
    elif way == "page":
        at = 4096 * rng.randrange(1, len(content) // 4096)
        content[at : at + 4096] = rng.randbytes(4096)
    elif way == "cut":
        del content[rng.randrange(1, len(content)) :]
    elif way == "zero":
        content.clear()
    elif way == "text":
        content[:] = b"nothing of the kind\n" * 50
    else:
        content[:100] = rng.randbytes(100)
    path.write_bytes(content)
    return way


@pytest.mark.parametrize("seed", range(40))
def test_any_damage_is_survived_and_said(tmp_path, seed):
    """Whatever has happened to a file, a gateway starts, and either nothing is missing or it says what it did."""
    rng = random.Random(seed)
    print("seed", seed)
    path = tmp_path / "f.sqlite"
    fill(path, 9)
    way = damaged(path, rng)
    store, memory = kept(path, 9)
    memory.start_cycle(10)
    memory.apply(event(3, True, 11), nothing)
    assert memory.commit(11) is True
    mishaps = store.mishaps()
    found = {e.fault: e for e in memory.entries()}
    print(way, mishaps, sorted(found))
    if not mishaps:
        assert len(found) == 9
        assert all(len(found[f"m.f{k}"].freeze_frames) >= 1 for k in range(9))
    else:
        assert mishaps[0].kind == "damaged"
        assert mishaps[0].aside.exists()
        assert mishaps[0].lost or mishaps[0].recovered
    assert "m.f3" in listed(path), "and it keeps what comes"
    store.close()
    again = KeptStore(path)
    assert again.mishaps() == []
    again.close()


def test_what_can_be_read_of_a_damaged_file_is_recovered(tmp_path):
    """One page of many is destroyed: most of the records come through, with their freeze frames and recordings."""
    path = tmp_path / "f.sqlite"
    fill(path, 90)
    db = sqlite3.connect(path)
    (root,) = db.execute("SELECT rootpage FROM sqlite_schema WHERE name = 'fault'").fetchone()
    (size,) = db.execute("PRAGMA page_size").fetchone()
    db.close()
    content = bytearray(path.read_bytes())
    leaf = int.from_bytes(content[(root - 1) * size + 12 : (root - 1) * size + 14], "big")
    child = int.from_bytes(content[(root - 1) * size + leaf :][:4], "big")
    content[(child - 1) * size : child * size] = b"\xa5" * size
    path.write_bytes(content)
    found = salvage(path)
    assert 40 < len(found.records) < 90
    assert found.lost >= 1
    assert all(r.freeze_frames for r in found.records)
    assert found.identifiers == {0xF190: b"VIN"}
    with pytest.raises(DamagedError, match=r"f\.sqlite: a damaged fault memory.*puts it aside"):
        service.list_entries(path)
    with pytest.raises(DamagedError):
        service.clear(path)
    store, memory = kept(path, 90)
    assert len(memory.entries()) == len(found.records)
    (mishap,) = store.mishaps()
    assert mishap.recovered == found.recovered
    assert ".damaged-20" in mishap.aside.name
    assert len(store.recordings()) == len(found.records)
    store.close()


def test_a_name_that_one_flipped_bit_has_changed_is_damage_not_a_traceback(tmp_path):
    path = tmp_path / "f.sqlite"
    fill(path)
    db = sqlite3.connect(path)
    db.execute("UPDATE fault SET id = 'm.f8' WHERE id = 'm.f1'")
    db.commit()
    db.close()
    with pytest.raises(DamagedError, match="freeze"):
        service.list_entries(path)
    store, memory = kept(path)
    assert len(store.mishaps()) == 1
    assert {e.fault for e in memory.entries()} == {"m.f0", "m.f2", "m.f8"}
    store.close()


def test_a_file_damaged_while_it_is_open_is_begun_anew_with_everything(tmp_path):
    path = tmp_path / "f.sqlite"
    fill(path)
    store, memory = kept(path)
    memory.start_cycle(5)
    store._db.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    with path.open("r+b") as file:
        file.seek(100)
        file.write(os.urandom(path.stat().st_size - 100))
    store._db.execute("PRAGMA cache_size = 0")  # else SQLite goes on with what it has read
    memory.apply(event(0, False, 6), nothing)
    t_ns = 6
    while not memory.commit(t_ns):
        t_ns += FIRST_NS
        assert t_ns < 10 * S
    assert listed(path) == {"m.f0": 1, "m.f1": 1, "m.f2": 1}
    assert [m.kind for m in store.mishaps()] == ["damaged"]
    store.close()


def test_a_file_that_was_never_a_fault_memory_is_not_touched(tmp_path):
    path = tmp_path / "notes.txt"
    path.write_text("mine\n" * 100)
    with pytest.raises(InputError, match="no SQLite file"):
        KeptStore(path)
    assert path.read_text() == "mine\n" * 100
    with pytest.raises(InputError, match="folder"):
        KeptStore(tmp_path)


# Without a file from the start


def unwritable(monkeypatch):
    """Let SQLite find the disk read-only, also for root."""
    driver = sqlite3.connect

    def read_only(path, **options):
        if str(path) == ":memory:" or "/dev/shm" in str(path):
            return driver(path, **options)
        raise sqlite3.OperationalError("attempt to write a readonly database")

    monkeypatch.setattr(sqlite3, "connect", read_only)


def test_a_memory_that_cannot_be_opened_is_read_kept_here_and_written_later(tmp_path, monkeypatch):
    path = tmp_path / "f.sqlite"
    fill(path)
    unwritable(monkeypatch)
    store, memory = kept(path)
    assert "readonly" in store.detached
    assert [e.fault for e in memory.entries()] == ["m.f0", "m.f1", "m.f2"]
    memory.start_cycle(0)
    memory.apply(event(0, False, 1), nothing)
    memory.apply(event(0, True, 2), nothing)
    assert memory.commit(2) is False
    monkeypatch.undo()
    assert memory.commit(2 + LONGEST_NS) is True
    assert store.detached == ""
    assert listed(path) == {"m.f0": 2, "m.f1": 1, "m.f2": 1}
    assert len(store.recordings()) == 3, "what the file had is there still"
    store.close()


def test_a_file_that_could_not_be_read_is_never_overwritten(tmp_path, monkeypatch):
    path = tmp_path / "f.sqlite"
    fill(path)
    unwritable(monkeypatch)
    monkeypatch.setattr("gateway.faults.salvage.shutil.copyfile", lambda *_: (_ for _ in ()).throw(OSError()))
    store, memory = kept(path)
    assert memory.entries() == []
    memory.start_cycle(0)
    memory.apply(event(1, True), nothing)
    monkeypatch.undo()
    assert memory.commit(LONGEST_NS) is True
    assert listed(path) == {"m.f1": 1}
    (mishap,) = store.mishaps()
    assert listed(mishap.aside) == {"m.f0": 1, "m.f1": 1, "m.f2": 1}
    store.close()


def test_other_processes_see_that_the_file_is_not_up_to_date(tmp_path):
    path = tmp_path / "f.sqlite"
    store = KeptStore(path)
    assert not is_unsaved(path)
    store.note_unsaved(True)
    assert is_unsaved(path)
    assert service.daemon_state(path)["stored"] is False
    store.note_unsaved(False)
    assert not is_unsaved(path)
    store.note_unsaved(True)
    store.close()
    assert not is_unsaved(path), "nobody keeps it any more"


# A full memory


def failing(memory, *faults):
    for fault in faults:
        memory.apply(event(fault, True, fault), frame({"x": float(fault)}))


def test_what_a_full_memory_refused_is_entered_when_there_is_room():
    memory = AtOnce(
        catalogue((1,) * 4, emission_related=(False,) * 4, priority=(5, 5, 7, 6)),
        Store(None),
        size=2,
    )
    memory.start_cycle(0)
    failing(memory, 0, 1, 2, 3)
    assert [e.fault for e in memory.entries()] == ["m.f0", "m.f1"]
    assert memory.admit_refused(9) == [], "there is no room"
    memory.clear(memory.catalogue[1].dtc.value)
    (change,) = memory.admit_refused(10)
    assert change.definition.id == "m.f3", "the more important of the two"
    assert (int(change.old_status), int(change.new_status), change.t_ns) == (0x23, 0x2F, 10)
    entry = memory.entry("m.f3")
    assert (entry.occurrence, entry.first_ns) == (1, 3), "as it was when it failed"
    assert entry.freeze_frames[0].content == {"x": 3.0}
    memory.apply(event(2, False, 11), nothing)
    memory.clear()
    assert memory.admit_refused(12) == [], "the other has passed meanwhile"


def test_what_gave_way_comes_back_when_there_is_room():
    memory = AtOnce(catalogue((1,) * 2, emission_related=(False,) * 2, priority=(9, 1)), Store(None), size=1)
    memory.start_cycle(0)
    failing(memory, 0, 1)
    assert [e.fault for e in memory.entries()] == ["m.f1"]
    memory.clear(memory.catalogue[1].dtc.value)
    assert [c.definition.id for c in memory.admit_refused(5)] == ["m.f0"]
    assert memory.status("m.f0") & Status.CONFIRMED_DTC
    assert memory.entry("m.f0").freeze_frames[0].content == {"x": 0.0}


def test_an_earlier_cycles_failure_is_not_entered_as_one_of_this_cycle():
    memory = AtOnce(catalogue((1,) * 2, emission_related=(False,) * 2), Store(None), size=1)
    memory.start_cycle(0)
    failing(memory, 0, 1)
    memory.start_cycle(5)
    memory.clear(memory.catalogue[0].dtc.value)
    assert memory.admit_refused(6) == [], "it is tested again in this one"


def test_a_fault_refused_and_healed_is_confirmed_when_it_fails_again_in_the_same_cycle():
    memory = AtOnce(catalogue((1,) * 2, emission_related=(False,) * 2), Store(None), size=1)
    memory.start_cycle(0)
    failing(memory, 0, 1)
    memory.apply(event(1, False), nothing)
    memory.clear(memory.catalogue[0].dtc.value)
    failing(memory, 1)
    assert memory.status("m.f1") & Status.CONFIRMED_DTC


# A storm


def test_a_storm_is_written_in_groups_and_a_single_change_at_once():
    pace = Pace(burst=4, interval_ns=10)
    assert [pace.allows(0) for _ in range(6)] == [True] * 4 + [False] * 2
    assert sum(pace.allows(t) for t in range(1, 1001)) == 100
    assert [pace.allows(2000) for _ in range(6)] == [True] * 4 + [False] * 2
    pace = Pace(burst=1, interval_ns=10)
    assert [t for t in range(200) if pace.allows(t, 16)] == list(range(0, 200, 30)), (
        "sixteen faults in each write: a third as often"
    )
    pace = Pace(burst=2, interval_ns=10)
    assert [pace.allows(2000) for _ in range(3)] == [True] * 2 + [False]
    assert not pace.allows(0), "a clock that goes back gives no leave"
    assert pace.allows(10), "and takes none away"


def test_the_path_of_the_store_may_be_a_link(tmp_path):
    (tmp_path / "real").mkdir()
    link = tmp_path / "link"
    link.symlink_to(tmp_path / "real")
    store, memory = kept(link / "f.sqlite")
    memory.start_cycle(0)
    memory.apply(event(0, True), nothing)
    assert memory.commit(1)
    assert store.mishaps() == []
    assert Path(tmp_path / "real" / "f.sqlite").exists()
    store.close()


def test_a_file_that_cannot_be_opened_again_leaves_what_is_read_meanwhile(tmp_path):
    """A request of another process came after a retry: the connection was closed, and the daemon ended."""
    broken = False

    class Connection(sqlite3.Connection):
        def execute(self, sql, *parameters):
            if broken and "journal_mode" in sql:
                raise sqlite3.OperationalError("disk I/O error")
            return super().execute(sql, *parameters)

    def connect(*arguments, **options):
        return sqlite3.connect(*arguments, factory=Connection, **options)

    store = KeptStore(tmp_path / "f.sqlite", connect=connect)
    memory = FaultMemory(catalogue((1,)), store)
    memory.start_cycle(0)
    memory.apply(event(0, True, S), nothing)
    memory.commit(S)
    broken = True
    for file in tmp_path.glob("f.sqlite*"):
        file.unlink()
    for k in range(2, 6):
        memory.rewrite()
        assert not memory.commit(k * 100 * S)
        with store.transaction():
            assert store.requests() == []
    broken = False
    assert memory.commit(1000 * S)
    store.close()
    assert listed(tmp_path / "f.sqlite") != {}

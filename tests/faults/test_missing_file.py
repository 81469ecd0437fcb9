"""A file that is deleted, replaced, taken by another or cannot be opened: all of it is written anew, and said."""

import sqlite3
from pathlib import Path

import pytest
from fault_examples import catalogue, event, nothing
from stored_memories import fill, kept, listed

from gateway.faults import service
from gateway.faults.lock import is_unsaved
from gateway.faults.memory import FaultMemory
from gateway.faults.resilient_store import ResilientStore
from gateway.faults.retry_policy import LONGEST_NS
from gateway.faults.store import Store
from gateway_fdi.errors import InputError

S = 1_000_000_000


@pytest.mark.evidence("Durability: deleted")
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
    (incident,) = store.incidents()
    assert (incident.kind, incident.aside) == ("deleted", None)
    assert store.incidents() == []
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
    memory.ledger.rewrite()
    assert memory.commit(6) is True
    (incident,) = store.incidents()
    assert incident.kind == "replaced"
    assert listed(incident.aside) == {"m.f0": 1}
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
    (incident,) = store.incidents()
    assert listed(incident.aside) == {"m.f0": 1, "m.f1": 1, "m.f2": 1}
    store.close()


def test_other_processes_see_that_the_file_is_not_up_to_date(tmp_path):
    path = tmp_path / "f.sqlite"
    store = ResilientStore(path)
    assert not is_unsaved(path)
    store.note_unsaved(True)
    assert is_unsaved(path)
    assert service.daemon_state(path)["stored"] is False
    store.note_unsaved(False)
    assert not is_unsaved(path)
    store.note_unsaved(True)
    store.close()
    assert not is_unsaved(path), "nobody keeps it any more"


def test_the_path_of_the_store_may_be_a_link(tmp_path):
    (tmp_path / "real").mkdir()
    link = tmp_path / "link"
    link.symlink_to(tmp_path / "real")
    store, memory = kept(link / "f.sqlite")
    memory.start_cycle(0)
    memory.apply(event(0, True), nothing)
    assert memory.commit(1)
    assert store.incidents() == []
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

    store = ResilientStore(tmp_path / "f.sqlite", connect=connect)
    memory = FaultMemory(catalogue((1,)), store)
    memory.start_cycle(0)
    memory.apply(event(0, True, S), nothing)
    memory.commit(S)
    broken = True
    for file in tmp_path.glob("f.sqlite*"):
        file.unlink()
    for k in range(2, 6):
        memory.ledger.rewrite()
        assert not memory.commit(k * 100 * S)
        with store.transaction():
            assert store.requests() == []
    broken = False
    assert memory.commit(1000 * S)
    store.close()
    assert listed(tmp_path / "f.sqlite") != {}

"""The log of the fault memory's file: as long as it will be, copied between commits, and nothing of it is lost."""

import shutil
import sqlite3
from pathlib import Path

import pytest
from told import watched_rigs

from gateway.faults import write_ahead
from gateway.faults.records import Changes, FreezeFrame, Record
from gateway.faults.resilient_store import ResilientStore
from gateway.faults.store import Store


@pytest.fixture
def store(tmp_path):
    made = ResilientStore(tmp_path / "f.sqlite")
    yield made
    made.close()


@pytest.fixture
def make(tmp_path):
    yield from watched_rigs(tmp_path)


def record(number, occurrence=1):
    frames = {k: FreezeFrame(k, 100 * occurrence + k, {"M.A": k / 3}) for k in (1, 2)}
    return Record(f"m.f{number}", number, 0x2F, occurrence=occurrence, evidence={"value": 1.5}, freeze_frames=frames)


def log_of(store):
    return Path(f"{store.path}-wal")


def copied(store, folder, *, log=True):
    """Return what is in the files at this moment, as after kill -9; without the log: what was copied of it."""
    folder.mkdir()
    for suffix in ("", "-wal") if log else ("",):
        shutil.copyfile(f"{store.path}{suffix}", folder / f"g.sqlite{suffix}")
    found = Store(folder / "g.sqlite")
    try:
        return {r.id: (r.occurrence, r.freeze_frames) for r in found.load()}
    finally:
        found.close()


def told(*records):
    return {r.id: (r.occurrence, r.freeze_frames) for r in records}


def test_a_log_that_has_its_length_is_not_made_longer_by_commits(store):
    store.save(Changes(records=[record(1)]))
    assert log_of(store).stat().st_size < write_ahead.LENGTH
    store.tend_log()
    assert log_of(store).stat().st_size == write_ahead.LENGTH
    while not store.log_is_due:
        store.save(Changes(records=[record(2)]))
    assert log_of(store).stat().st_size == write_ahead.LENGTH


def test_what_is_written_before_and_after_is_there_after_a_kill(store, tmp_path):
    store.save(Changes(records=[record(1)]))
    store.tend_log()
    assert copied(store, tmp_path / "tended") == told(record(1))
    store.save(Changes(records=[record(2)]))
    assert copied(store, tmp_path / "written") == told(record(1), record(2))
    for _ in range(write_ahead.PAGES):  # round and round the log
        store.save(Changes(records=[record(1, 2)]))
        if store.log_is_due:
            store.tend_log()
    assert copied(store, tmp_path / "again") == told(record(1, 2), record(2))


@pytest.mark.evidence("Durability: log length")
def test_a_kill_while_the_log_gets_its_length_loses_nothing(store, tmp_path):
    store.save(Changes(records=[record(1)]))
    size = log_of(store).stat().st_size
    store.tend_log()
    whole = log_of(store).read_bytes()
    for k, length in enumerate((size, size + 1, size + 4119, size + 4120, size + 70_000)):
        folder = tmp_path / f"at{k}"
        folder.mkdir()
        shutil.copyfile(store.path, folder / "a.sqlite")
        (folder / "a.sqlite-wal").write_bytes(whole[:length])
        found = Store(folder / "a.sqlite")
        assert [r.id for r in found.load()] == ["m.f1"]
        found.save(Changes(records=[record(2)]))
        found.close()
        found = Store(folder / "a.sqlite", write=False)
        assert [r.id for r in found.load()] == ["m.f1", "m.f2"]
        found.close()


def test_what_is_long_is_copied_into_the_database(store, tmp_path):
    store.tend_log()
    assert not store.log_is_due
    store.save(Changes(records=[record(1)]))
    assert copied(store, tmp_path / "before", log=False) == {}
    while not store.log_is_due:
        store.save(Changes(records=[record(2)]))
    store.tend_log()
    assert copied(store, tmp_path / "after", log=False) == told(record(1), record(2))


def test_nobody_can_write_while_the_log_is_made_longer(store, monkeypatch):
    """Else the zeros would fall upon what he appends."""
    tried = []
    put = write_ahead._zeros

    def zeros(*arguments):
        other = sqlite3.connect(store.path, isolation_level=None, timeout=0)
        with pytest.raises(sqlite3.OperationalError, match="locked"):
            other.execute("BEGIN IMMEDIATE")
        other.close()
        tried.append(arguments)
        return put(*arguments)

    store.save(Changes(records=[record(1)]))
    monkeypatch.setattr(write_ahead, "_zeros", zeros)
    store.tend_log()
    assert tried
    store.save(Changes(records=[record(2)]))
    assert [r.id for r in store.load()] == ["m.f1", "m.f2"]


def test_others_read_while_the_log_is_tended_and_see_what_they_began_with(store):
    store.save(Changes(records=[record(1)]))
    reader = sqlite3.connect(store.path, isolation_level=None)
    reader.execute("BEGIN")
    assert reader.execute("SELECT occurrence FROM fault").fetchall() == [(1,)]
    store.save(Changes(records=[record(1, 2)]))
    store.tend_log()
    assert reader.execute("SELECT occurrence FROM fault").fetchall() == [(1,)]
    reader.execute("COMMIT")
    assert reader.execute("SELECT occurrence FROM fault").fetchall() == [(2,)]
    reader.close()


def test_a_disk_that_is_nearly_full_keeps_its_room(store, monkeypatch):
    free = shutil.disk_usage(store.path.parent)._replace(free=write_ahead.ROOM - 1)
    monkeypatch.setattr(write_ahead.shutil, "disk_usage", lambda path: free)
    store.save(Changes(records=[record(1)]))
    before = log_of(store).stat().st_size
    store.tend_log()
    assert log_of(store).stat().st_size == before
    assert not store.log_is_due, "it is not tried again and again"


@pytest.mark.parametrize("which", ["deleted", "replaced", "another log"])
def test_nothing_is_done_to_files_that_are_not_ours(store, which):
    store.save(Changes(records=[record(1)]))
    log = log_of(store)
    for file in (store.path, log) if which != "another log" else (log,):
        file.rename(f"{file}.old")
        if which != "deleted":
            file.write_bytes(b"of somebody else")
    store.tend_log()
    if which == "deleted":
        assert not store.path.exists()
        assert not log.exists()
    else:
        assert log.read_bytes() == b"of somebody else"


def test_unchanged_freeze_frames_are_left_and_gone_ones_go(store):
    store.save(Changes(records=[record(1, 2)]))
    store.save(Changes(records=[record(1, 2)]))
    fewer = record(1, 3)
    del fewer.freeze_frames[2]
    store.save(Changes(records=[fewer]))
    (found,) = store.load()
    assert found == fewer
    store.save(Changes(records=[Record("m.f1", 1, 0x50)]))
    assert store.load() == [Record("m.f1", 1, 0x50)]


def test_a_live_gateway_tends_the_log(make):
    rig = make()
    rig.gateway.write_beside()
    rig.wait(50)
    rig.gateway.memory.ledger.under_way(60.0)
    rig.wait(20)
    log = log_of(rig.gateway.store)
    assert log.stat().st_size < write_ahead.LENGTH
    rig.gateway.serve_requests()
    assert not rig.gateway.memory.ledger.under_way(60.0)
    assert log.stat().st_size == write_ahead.LENGTH
    rig.fail(0)
    rig.gateway.memory.ledger.under_way(60.0)
    rig.wait(20)
    assert rig.gateway.stored
    assert log.stat().st_size == write_ahead.LENGTH

"""A memory's file that went back: its log lost, a backup put back, another file there; and what is none of it."""

import os
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest
from fault_examples import catalogue, event, nothing
from journalled import Telling
from stored_memories import fill, kept, listed

from gateway.faults import chain, lock, service
from gateway.faults.journal_file import path_of, records
from gateway.faults.lock import noted
from gateway.faults.memory import FaultMemory
from gateway.faults.resilient_store import ResilientStore
from gateway.faults.store import OlderError, Store, last_links

ALL = ("", "-wal", "-verdicts", "-lock")


def image(path, folder, suffixes=ALL):
    """Return a copy of the files as they are now, as after kill -9."""
    folder.mkdir()
    for suffix in suffixes:
        if Path(f"{path}{suffix}").exists():
            shutil.copyfile(f"{path}{suffix}", folder / f"f.sqlite{suffix}")
    return folder / "f.sqlite"


def died(tmp_path, folder="died"):
    """Return the files of a memory that was killed: its log has commits that the file has not, its journal one more."""
    path = tmp_path / f"{folder}.sqlite"
    fill(path)
    telling = Telling(path, catalogue((1, 1, 1)))
    telling.memory.start_cycle(5)
    telling.store.tend_log()
    for k in range(4):
        telling.verdicts((k % 3, False), (k % 3, True))
        telling.commit()
    telling.verdicts((0, False))
    found = image(path, tmp_path / folder)
    telling.close()
    telling.bus.close()
    return found


def started(path):
    """Start once, and end; returns the mishaps, and the faults that were recovered from the journal."""
    store = ResilientStore(path, displacing=True)
    memory = FaultMemory(catalogue((1, 1, 1)), store)
    incidents, recovered = store.incidents(), memory.recovered
    store.close()
    return incidents, recovered


def swapped(log):
    content = bytearray(log.read_bytes())
    one, two = (slice(32 + k * 4120, 32 + (k + 1) * 4120) for k in (0, 1))
    content[one], content[two] = content[two], content[one]
    log.write_bytes(content)


def flipped(log):
    content = bytearray(log.read_bytes())
    content[32 + 24 + 100] ^= 4
    log.write_bytes(content)


WAYS = {
    "removed": Path.unlink,
    "emptied": lambda log: log.write_bytes(b""),
    "a bit early in it": flipped,
    "two pages swapped": swapped,
    "cut": lambda log: os.truncate(log, 32 + 4120 * 3),
}


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("without", ["", "-lock", "-verdicts"])
def test_a_log_that_is_lost_is_told_and_what_is_left_is_kept(tmp_path, way, without):
    """It was silent: the memory was that of an earlier commit, and whole."""
    path = died(tmp_path)
    if without:
        Path(f"{path}{without}").unlink()
    WAYS[way](Path(f"{path}-wal"))
    found = service.verify(path)
    assert not found["whole"]
    assert "it is older than what was kept here: links " in found["broken"][0]["text"]
    with pytest.raises(OlderError, match=r"links \d+ to \d+ are missing"):
        Store(path)
    (incident,), recovered = started(path)
    assert (incident.kind, incident.lost) == ("older", 0)
    assert incident.aside.name.startswith("f.sqlite.older-")
    assert recovered == ((), 0), "verdicts of a time that is lost are no news"
    assert listed(path) == listed(incident.aside)
    assert service.verify(path)["whole"]
    assert started(path) == ([], ((), 0)), "it is told once"


def test_a_death_is_no_loss(tmp_path):
    path = died(tmp_path)
    incidents, recovered = started(path)
    assert incidents == []
    assert recovered.faults == ("m.f0",)
    assert service.verify(path)["whole"]


@pytest.mark.parametrize("way", ["backup of SQLite", "copy of the file", "backup without lock"])
def test_a_backup_that_is_put_back_is_told_and_gets_no_later_verdicts(tmp_path, way):
    """A DTC that came after the backup, and was cleared, was back: the journal has it after the backup's last link."""
    path = tmp_path / "f.sqlite"
    fill(path)
    backup = tmp_path / "backup"
    telling = Telling(path, catalogue((1, 1, 1)))
    telling.memory.start_cycle(5)
    telling.store.tend_log()
    if way == "copy of the file":
        shutil.copyfile(path, backup)
    else:
        with closing(sqlite3.connect(path)) as ours, closing(sqlite3.connect(backup)) as copy:
            ours.backup(copy)
    assert telling.verdicts((2, False), (2, True)) == 2
    telling.commit()
    telling.memory.clear()
    telling.close()
    telling.bus.close()
    for suffix in ("-wal", "-shm", *(["-lock"] if way == "backup without lock" else [])):
        Path(f"{path}{suffix}").unlink(missing_ok=True)
    shutil.copyfile(backup, path)
    assert "a backup was put back" in service.verify(path)["broken"][0]["text"]
    (incident,), recovered = started(path)
    assert incident.kind == "older"
    assert recovered == ((), 0)
    assert listed(path) == {"m.f0": 1, "m.f1": 1, "m.f2": 1}
    assert records(path_of(path).read_bytes()) != []
    store = ResilientStore(path)
    store.begin_journal()
    store.close()
    assert records(path_of(path).read_bytes()) == [], "they are of another file"


@pytest.mark.parametrize("without", ["", "-lock", "-verdicts"])
def test_the_file_of_another_memory_is_told(tmp_path, without):
    path, other = died(tmp_path), died(tmp_path, "other")
    for suffix in ("", "-wal"):
        shutil.copyfile(f"{other}{suffix}", f"{path}{suffix}")
    if without:
        Path(f"{path}{without}").unlink()
    assert "not the file that was kept here last" in service.verify(path)["broken"][0]["text"]
    (incident,), _ = started(path)
    assert incident.kind == "older"


def test_a_file_that_went_on_elsewhere_is_told(tmp_path):
    path = died(tmp_path)
    elsewhere = tmp_path / "elsewhere.sqlite"
    shutil.copyfile(path, elsewhere)
    store, memory = kept(elsewhere)
    for k in range(40):
        memory.apply(event(k % 3, k % 2 == 0, k), nothing)
        memory.commit()
    store.close()
    Path(f"{path}-wal").unlink()
    shutil.copyfile(elsewhere, path)
    (broken,) = service.verify(path)["broken"]
    assert "is another one" in broken["text"]
    (incident,), _ = started(path)
    assert incident.kind == "older"


def test_a_file_that_is_deleted_while_nothing_runs_is_told(tmp_path):
    path = tmp_path / "f.sqlite"
    fill(path)
    path.unlink()
    (incident,), _ = started(path)
    assert incident.kind == "deleted"
    assert started(path)[0] == []


def test_all_files_of_an_earlier_time_cannot_be_told(tmp_path):
    """docs/limits.md says so."""
    path = died(tmp_path)
    earlier = image(path, tmp_path / "earlier")
    started(path)
    for suffix in ALL:
        Path(f"{path}{suffix}").unlink(missing_ok=True)
        if Path(f"{earlier}{suffix}").exists():
            shutil.copyfile(f"{earlier}{suffix}", f"{path}{suffix}")
    assert service.verify(path)["whole"]


def test_what_is_beside_may_be_of_before(tmp_path, monkeypatch):
    """After a power cut: it is not synchronised. Links that the chain has let go are of before, too."""
    path = tmp_path / "f.sqlite"
    fill(path)
    before = image(path, tmp_path / "before")
    monkeypatch.setattr(chain, "MOST", 40)
    store, memory = kept(path)
    memory.start_cycle(0)
    for k in range(150):
        memory.apply(event(k % 3, k % 2 == 0, k), nothing)
        memory.commit()
    store.close()
    db = sqlite3.connect(path)
    assert db.execute("SELECT min(number) FROM link").fetchone()[0] > max(link.number for link in noted(before))
    db.close()
    shutil.copyfile(f"{before}-lock", f"{path}-lock")
    assert service.verify(path)["whole"]
    assert started(path)[0] == []


def test_a_file_that_is_begun_may_be_cut_off_at_any_moment(tmp_path, monkeypatch):
    """Its generation is on the disk before the file has it."""
    path = tmp_path / "f.sqlite"
    fill(path)
    with path.open("r+b") as file:
        file.truncate(4096)
    images = []
    for name in ("note", "sync"):
        before = getattr(lock, name)

        def and_image(*arguments, before=before, name=name):
            images.append(image(path, tmp_path / f"{len(images)} {name}"))
            before(*arguments)
            images.append(image(path, tmp_path / f"{len(images)} after"))

        monkeypatch.setattr(lock, name, and_image)
    store = ResilientStore(path)
    assert [m.kind for m in store.incidents()] == ["damaged"]
    store.close()
    monkeypatch.undo()
    assert len(images) >= 6
    for each in images:
        store = ResilientStore(each)
        told = [m.reason.rpartition(": ")[2] for m in store.incidents()]
        assert told in ([], ["it is empty"], ["its file was deleted"]), each  # the damaged one was put aside
        store.close()


def test_the_lock_knows_the_last_link_after_each_commit(tmp_path):
    path = tmp_path / "f.sqlite"
    store, memory = kept(path)
    for k in range(5):
        memory.apply(event(k % 3, k % 2 == 0, k), nothing)
        memory.commit()
        links = noted(path)
        assert max(link.number for link in links) == store.verify().head.number
        assert {link.generation for link in links} == {store.generation}
    content = bytearray(Path(f"{path}-lock").read_bytes())
    content[10] ^= 1
    Path(f"{path}-lock").write_bytes(content)
    assert len(noted(path)) == 1, "one that is torn leaves the other"
    assert [link for link in last_links(path) if link.number] == noted(path)
    store.close()

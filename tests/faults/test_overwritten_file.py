"""A memory's file that somebody changes in place while it is open: told at the next commit, and nothing is lost."""

import os
import random
import shutil
import sqlite3
import subprocess
import sys
from pathlib import Path

import pytest
from amount import amount
from fault_examples import event, frame, nothing
from stored_memories import fill, kept, listed

from gateway.faults import service
from gateway.faults.interventions import Intervention
from gateway.faults.records import Recording
from gateway.faults.resilient_store import ResilientStore
from gateway.faults.retry_policy import LONGEST_NS
from gateway.faults.store import Store, StoreError
from gateway_fdi.errors import InputError

COUNT = 6


def of_another_program(path):
    db = sqlite3.connect(path)
    db.execute("CREATE TABLE song (title TEXT)")
    db.execute("INSERT INTO song VALUES ('mine')")
    db.commit()
    db.close()
    return path


def over(path, content):
    """Overwrite a file in place, as cp does."""
    with path.open("r+b") as file:
        file.write(content)
        file.truncate()


def as_found(path, folder):
    """Return what whoever opens copies of the files finds: verdict of the chain, and occurrences."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    for suffix in ("", "-wal"):
        shutil.copyfile(f"{path}{suffix}", folder / f"g.sqlite{suffix}")
    return service.verify(folder / "g.sqlite"), listed(folder / "g.sqlite")


def change_in_place(path, backup, other, rng):
    """Change a file, or its log, in one of many ways; returns what was done."""
    way = rng.choice(["bits", "page", "zeros", "cut", "emptied", "text", "header", "database", "backup", "memory"])
    log = Path(f"{path}-wal")
    target = log if way in ("bits", "page", "zeros", "cut", "emptied") and rng.random() < 0.4 else path
    content = bytearray(target.read_bytes())
    if way == "bits":
        for _ in range(rng.choice([1, 30])):
            content[rng.randrange(len(content))] ^= 1 << rng.randrange(8)
    elif way in ("page", "zeros") and len(content) >= 4096:
        at = rng.randrange(len(content) - 4095)
        content[at : at + 4096] = rng.randbytes(4096) if way == "page" else bytes(4096)
    elif way == "cut":
        del content[rng.randrange(len(content)) :]
    elif way == "text":
        content[:] = b"nothing of the kind\n" * 50
    elif way == "header":
        content[:100] = rng.randbytes(100)
    elif way == "database":
        content[:] = other.read_bytes()
    elif way in ("backup", "memory"):
        content[:] = backup.read_bytes()
    else:
        content.clear()
    before = target.stat()
    over(target, content)
    if rng.random() < 0.3:  # and he does not want it to be seen
        os.utime(target, ns=(before.st_atime_ns, before.st_mtime_ns))
    return f"{way} of {target.name}"


@pytest.mark.evidence("Durability: overwritten")
@pytest.mark.parametrize("part", range(amount(20, 4, 1)))
def test_whatever_is_changed_in_place_is_noticed_or_harmless(tmp_path, part):
    """Within one commit; ten changes each."""
    other = of_another_program(tmp_path / "songs.sqlite")
    for seed in range(10 * part, 10 * part + 10):
        rng = random.Random(seed)
        path = tmp_path / f"f{seed}.sqlite"
        store, memory = kept(path, COUNT)
        memory.start_cycle(0)
        for step in range(1, rng.randrange(3, 30)):
            memory.apply(event(rng.randrange(COUNT), rng.random() < 0.6, step), frame({"x": rng.random()}))
            memory.ledger.add_recordings(
                [Recording("m.f1", step, 1, 0, rng.randbytes(3000))] if rng.random() < 0.3 else []
            )
            memory.ledger.note_intervention(Intervention(step, "uds", "pt", step, "clear"))
            memory.commit()
            if step == 2:
                shutil.copyfile(path, tmp_path / "backup")
            if rng.random() < 0.2:
                store.tend_log()
        assert store.incidents() == [], seed
        recordings = store.recordings()
        way = change_in_place(path, tmp_path / "backup", other, rng)
        memory.apply(event(0, False, 100), nothing)
        memory.apply(event(0, True, 101), frame({"x": 0.5}))
        assert memory.commit(101) is True, (seed, way)
        incidents = store.incidents()
        verdict, found = as_found(path, tmp_path / "found")
        told = [(m.kind, m.reason, m.recovered, m.lost) for m in incidents]
        assert verdict["broken"] == [], (seed, way, told)
        assert found == {e.fault: e.record.occurrence for e in memory.entries()}, (seed, way, told)
        assert verdict["counted"]["intervention"] == len(memory.interventions()), (seed, way, told)
        lost = sum(m.lost for m in incidents)
        assert len(store.recordings()) + lost >= len(recordings), (seed, way, told)
        assert set(store.recordings()) <= set(recordings)
        assert all(m.kind == "overwritten" and m.aside.exists() for m in incidents), (seed, way, told)
        if f"of {path.name}" in way and not way.endswith("-wal"):
            assert len(incidents) == 1 or "bits" not in way, (seed, way)
        store.close()
        again = ResilientStore(path)
        assert again.incidents() == [], (seed, way)
        again.close()


@pytest.mark.parametrize("way", ["cut off", "another program's database", "no SQLite file", "changed in place"])
def test_what_was_done_is_said_and_what_was_found_is_kept(tmp_path, way):
    path = tmp_path / "f.sqlite"
    fill(path)
    shutil.copyfile(path, tmp_path / "backup")
    store, memory = kept(path)
    memory.start_cycle(5)
    store.tend_log()
    content = {
        "cut off": b"",
        "another program's database": of_another_program(tmp_path / "songs").read_bytes().ljust(200_000, b"\0"),
        "no SQLite file": b"mine\n" * 40_000,
        "changed in place": (tmp_path / "backup").read_bytes().ljust(path.stat().st_size, b"\0"),
    }[way]
    over(path, content)
    memory.apply(event(1, False, 6), nothing)
    memory.apply(event(1, True, 7), nothing)
    assert memory.commit(7) is True
    (incident,) = store.incidents()
    assert way in incident.reason
    assert incident.aside.name.startswith("f.sqlite.overwritten-20")
    assert incident.aside.read_bytes() == content
    assert Path(f"{incident.aside}.log").exists()
    assert not Path(f"{incident.aside}-wal").exists(), "else SQLite would copy our log into another's file"
    assert (incident.recovered, incident.lost) in ((3, 0), (0, 3)), "of recordings"
    assert len(store.recordings()) == incident.recovered
    store.close()
    assert listed(path) == {"m.f0": 1, "m.f1": 2, "m.f2": 1}


def test_what_is_harmless_is_nothing_to_tell(tmp_path):
    path = tmp_path / "f.sqlite"
    fill(path)
    store, memory = kept(path)
    memory.start_cycle(5)
    os.utime(path)
    os.utime(f"{path}-wal")
    os.link(path, tmp_path / "link")
    over(path, path.read_bytes())
    assert store.doubtful
    memory.apply(event(1, False, 6), nothing)
    assert memory.commit(6) is True
    assert not store.doubtful
    reader = Store(path, write=False)
    number = reader.request("clear", "0")
    assert store.doubtful, "somebody has written to the log"
    assert memory.serve_requests() == []
    assert reader.answer(number) == 0
    reader.withdraw(number)
    reader.close()
    memory.apply(event(1, True, 7), nothing)
    assert memory.commit(7) is True
    assert store.incidents() == []
    store.tend_log()
    assert not store.doubtful
    store.close()


def test_a_clear_of_another_process_is_not_done_in_a_file_that_was_changed(tmp_path):
    path = tmp_path / "f.sqlite"
    fill(path)
    store, memory = kept(path)
    memory.start_cycle(5)
    store.tend_log()
    reader = Store(path, write=False)
    number = reader.request("clear", str(0xFFFFFF))
    with path.open("r+b") as file:
        file.truncate(8192)
    assert memory.serve_requests() == []
    assert reader.answer(number) is None
    reader.close()
    memory.ledger.rewrite()
    assert memory.commit(LONGEST_NS) is True
    assert [m.kind for m in store.incidents()] == ["overwritten"]
    store.close()
    assert len(listed(path)) == 3


def test_nothing_is_told_as_stored_in_a_file_that_is_cut_off_meanwhile(tmp_path, monkeypatch):
    """A thread that has nothing but the changes cannot begin another file: it says so, the next attempt can."""
    path = tmp_path / "f.sqlite"
    store, memory = kept(path)
    memory.start_cycle(5)
    write = Store.save

    def cut_and_save(self, changes, whole=None):
        monkeypatch.setattr(Store, "save", write)
        over(path, b"")
        write(self, changes, whole)

    monkeypatch.setattr(Store, "save", cut_and_save)
    memory.apply(event(1, True, 7), nothing)
    changes = memory.ledger._pending
    with pytest.raises(StoreError, match="cut off in place: 0 of"):
        store.save(changes)
    assert memory.commit(LONGEST_NS) is True
    assert listed(path) == {"m.f1": 1}
    store.close()


def test_another_programs_database_is_put_aside_by_a_daemon_and_refused_by_others(tmp_path):
    path = of_another_program(tmp_path / "f.sqlite")
    content = path.read_bytes()
    with pytest.raises(InputError, match="another program's database"):
        ResilientStore(path)
    assert path.read_bytes() == content
    store = ResilientStore(path, displacing=True)
    (incident,) = store.incidents()
    assert (incident.kind, incident.lost) == ("foreign", 0)
    assert incident.aside.read_bytes() == content
    assert store.detached == ""
    store.close()
    assert service.verify(path)["whole"]


def test_our_log_is_not_copied_into_what_somebody_else_put_there(tmp_path):
    """SQLite does so when the last connection is closed."""
    path = tmp_path / "f.sqlite"
    store, memory = kept(path)
    memory.start_cycle(5)
    memory.apply(event(1, True, 7), nothing)
    memory.commit()
    content = of_another_program(tmp_path / "songs").read_bytes()
    over(path, content)
    store.close()
    assert path.read_bytes() == content
    assert Path(f"{path}-wal").stat().st_size > 0


@pytest.mark.parametrize("way", ["emptied", "header", "frame", "deleted"])
@pytest.mark.parametrize("asked", [False, True])
def test_a_log_that_is_changed_in_place_is_noticed(tmp_path, way, asked):
    """Also if another process has asked for something meanwhile, which changes the log, too."""
    path = tmp_path / "f.sqlite"
    fill(path)
    store, memory = kept(path)
    memory.start_cycle(5)
    log = Path(f"{path}-wal")
    if asked:
        reader = Store(path, write=False)
        reader.request("clear", "0")
        assert memory.serve_requests() == []
        reader.request("clear", "0")
    if way == "deleted":
        log.unlink()
    else:
        at = {"emptied": 0, "header": 8, "frame": 32 + 24 + 4000}[way]
        with log.open("r+b") as file:
            file.seek(at)
            file.write(b"\xa5" * 8)
            if way == "emptied":
                file.truncate(0)
    if asked:
        memory.serve_requests()
        reader.close()
    memory.apply(event(1, True, 7), nothing)
    memory.ledger.rewrite()
    assert memory.commit(LONGEST_NS) is True
    (incident,) = store.incidents()
    assert incident.kind in ("overwritten", "damaged")
    verdict, found = as_found(path, tmp_path / "found")
    assert verdict["whole"]
    assert found == {"m.f0": 1, "m.f1": 1, "m.f2": 1}
    store.close()


def test_the_next_write_leaves_another_time_however_soon_it_comes(tmp_path):
    """Where the times of files go on in steps of some milliseconds."""
    path = tmp_path / "f.sqlite"
    store, memory = kept(path)
    memory.start_cycle(5)
    store.tend_log()
    for file in (path, Path(f"{path}-wal")):
        found = file.stat()
        assert 9.0 < found.st_ctime - found.st_mtime < 11.0
    store.close()


def test_a_log_that_cannot_be_copied_is_looked_at_again(tmp_path, monkeypatch):
    path = tmp_path / "f.sqlite"
    store, memory = kept(path)
    memory.start_cycle(5)
    os.utime(f"{path}-wal")

    def full(*_, **__):
        raise OSError("No space left on device")

    monkeypatch.setattr("gateway.faults.tamper_check.shutil.copyfile", full)
    assert store.examine()
    assert store.doubtful
    monkeypatch.undo()
    assert store.examine()
    assert not store.doubtful
    store.close()
    assert store.incidents() == []


#: Another process that has the memory open, as the page has, and looks at it by new connections, too.
READER = """
import sys
from pathlib import Path
from gateway.faults import service
path = Path(sys.argv[1])
held = service.open_reader(path)
held.load()
print(flush=True)
sys.stdin.readline()
print(*(e["fault"] for e in service.list_entries(path)), flush=True)
"""


@pytest.mark.parametrize("way", ["deleted", "replaced"])
def test_a_log_whose_index_is_gone_does_not_leave_other_processes_behind(tmp_path, way):
    """SQLite goes on with the index that it has open. Others made a new one, and saw the memory as it was for ever."""
    path = tmp_path / "f.sqlite"
    store, memory = kept(path)
    memory.start_cycle(5)
    memory.apply(event(0, True, 6), nothing)
    memory.commit(6)
    index = Path(f"{path}-shm")
    if way == "deleted":
        index.unlink()
    else:
        shutil.copyfile(index, tmp_path / "copy")
        (tmp_path / "copy").replace(index)
    assert store.doubtful
    command = [sys.executable, "-c", READER, str(path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as reader:
        assert reader.stdout.readline() == "\n"
        memory.apply(event(1, True, 7), nothing)
        memory.ledger.rewrite()
        assert memory.commit(LONGEST_NS) is True
        found, _ = reader.communicate("\n", 60)
    assert found.split() == ["m.f0", "m.f1"]
    (incident,) = store.incidents()
    assert (incident.kind, incident.reason) == ("overwritten", "the index of its log (-shm) was deleted or replaced")
    assert store.examine()
    assert service.verify(path)["whole"]
    store.close()


def test_the_log_is_watched_where_the_path_is_a_link(tmp_path):
    """SQLite keeps the log beside the file itself."""
    (tmp_path / "disk").mkdir()
    path = tmp_path / "f.sqlite"
    path.symlink_to(tmp_path / "disk" / "f.sqlite")
    store, memory = kept(path)
    memory.start_cycle(5)
    log = tmp_path / "disk" / "f.sqlite-wal"
    over(log, b"nothing of the kind\n" * 50)
    assert store.doubtful
    assert not store.examine()
    store.close()

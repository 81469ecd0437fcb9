"""A memory's file that is damaged: what can be read is recovered, the rest is said, and the file is put aside."""

import os
import random
import sqlite3

import pytest
from fault_examples import event, nothing
from stored_memories import fill, kept, listed

from gateway.faults import rows, service
from gateway.faults.records import PLACES
from gateway.faults.resilient_store import ResilientStore
from gateway.faults.retry_policy import FIRST_NS
from gateway.faults.salvage import _record, salvage
from gateway.faults.store import DamagedError
from gateway_fdi.errors import InputError

S = 1_000_000_000


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


@pytest.mark.evidence("Durability: damaged file")
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
    incidents = store.incidents()
    found = {e.fault: e for e in memory.entries()}
    print(way, incidents, sorted(found))
    if not incidents:
        assert len(found) == 9
        assert all(len(found[f"m.f{k}"].freeze_frames) >= 1 for k in range(9))
    else:
        assert incidents[0].kind == "damaged"
        assert incidents[0].aside.exists()
        assert incidents[0].lost or incidents[0].recovered
    assert "m.f3" in listed(path), "and it keeps what comes"
    store.close()
    again = ResilientStore(path)
    assert again.incidents() == []
    again.close()


@pytest.mark.evidence("Durability: recovered")
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
    (incident,) = store.incidents()
    assert incident.recovered == found.recovered
    assert ".damaged-20" in incident.aside.name
    assert len(store.recordings()) == len(found.records)
    store.close()


def test_a_name_of_a_table_that_is_no_text_any_more_is_damage_and_recovered_from(tmp_path):
    """Found by scripts/fuzz: the driver could not say what SQLite says of it, and ended in a traceback."""
    path = tmp_path / "f.sqlite"
    fill(path, 5)
    content = path.read_bytes()
    at = content.index(b"CREATE TABLE")
    name = content.rindex(b"table", 0, at)
    path.write_bytes(content[: name + 5] + b"\x81" + content[name + 6 : at] + b"CREATE TUBLE" + content[at + 12 :])
    with pytest.raises(DamagedError):
        listed(path)
    store, _ = kept(path, 5)
    assert [incident.kind for incident in store.incidents()] == ["damaged"]
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
    assert len(store.incidents()) == 1
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
    assert [m.kind for m in store.incidents()] == ["overwritten"]
    store.close()


def test_a_file_that_was_never_a_fault_memory_is_not_touched(tmp_path):
    path = tmp_path / "notes.txt"
    path.write_text("mine\n" * 100)
    with pytest.raises(InputError, match="no SQLite file"):
        ResilientStore(path)
    assert path.read_text() == "mine\n" * 100
    with pytest.raises(InputError, match="folder"):
        ResilientStore(tmp_path)


@pytest.mark.parametrize(
    "statement",
    [
        "UPDATE operation_cycle SET name = CAST(x'ff' AS TEXT)",
        "UPDATE link SET subject = CAST(x'ff' AS TEXT) WHERE number = 3",
        "UPDATE freeze_frame SET content = CAST(x'ff' AS TEXT)",
    ],
)
def test_a_text_that_is_not_utf_8_any_more_is_damage(tmp_path, statement):
    """One bit is enough. It was taken for a disk that cannot be read now, and no gateway started any more."""
    path = tmp_path / "f.sqlite"
    fill(path)
    db = sqlite3.connect(path)
    db.execute(statement)
    db.commit()
    db.close()
    store, memory = kept(path)
    (incident,) = store.incidents()
    assert incident.kind == "damaged"
    assert {e.fault for e in memory.entries()} == {"m.f0", "m.f1", "m.f2"}
    store.close()


def test_numbers_of_a_row_are_those_that_sqlite_keeps():
    """64 bits with their sign; what is more is damage."""
    row = dict.fromkeys(rows.COLUMNS, 0) | {"id": "b.fault"}
    for value in (2**63 - 1, -(2**63)):
        record = _record(*(row | dict.fromkeys(PLACES, value)).values())
        assert {getattr(record, name) for name in PLACES} == {value}
    with pytest.raises(ValueError, match=str(2**63)):
        _record(*(row | dict.fromkeys(PLACES, 2**63)).values())

"""The chain of a memory's file: whatever somebody else changes in it shows, and nothing that the gateway does."""

import random
import sqlite3

import pytest
from amount import amount
from fault_examples import event, frame, nothing
from stored_memories import fill, kept, listed
from typer.testing import CliRunner

from gateway.cli import app
from gateway.faults import chain, service
from gateway.faults.explanation import Cause, Ranked
from gateway.faults.interventions import MOST, Intervention
from gateway.faults.records import Changes, Cycle, Permanent, Recording
from gateway.faults.salvage import salvage
from gateway.faults.schema import APPLICATION_ID, MIGRATIONS
from gateway.faults.store import Store
from gateway_fdi.errors import InputError


def change(path, *statements):
    db = sqlite3.connect(path, isolation_level=None)
    for statement in statements:
        db.execute(statement)
    db.close()


def whole(path):
    found = service.verify(path)
    assert found["broken"] == []
    return found


def filled(path):
    """A memory with something of each kind."""
    fill(path)
    store, memory = kept(path)
    memory.start_cycle(10)
    memory.clear(0x030111)
    for k, action in enumerate(("clear", "reset", "routine")):
        memory.ledger.note_intervention(Intervention(k, "uds", "pt", 0x7E0, action, b"\x14\xff"))
    memory.commit()
    store.save(Changes(permanent=[Permanent("m.f0", 0x030011, 5)]))
    store.close()


def test_what_the_gateway_writes_is_whole(tmp_path):
    path = tmp_path / "f.sqlite"
    filled(path)
    counted = whole(path)["counted"]
    assert counted.pop("number") >= 1
    assert counted == {
        "fault": 3, "recordings": 2, "cycle": 1, "permanent": 1, "identifier": 1, "intervention": 3, "clear": 1,
    }  # fmt: skip


@pytest.mark.evidence("Durability: chain")
@pytest.mark.parametrize(
    ("statement", "first"),
    [
        ("UPDATE fault SET occurrence = 9 WHERE id = 'm.f0'", "fault m.f0 (link "),
        ("UPDATE fault SET evidence = '{}' WHERE id = 'm.f2'", "fault m.f2 (link "),
        ("DELETE FROM freeze_frame WHERE fault = 'm.f2'", "fault m.f2 (link "),
        ("UPDATE freeze_frame SET t_ns = t_ns + 1 WHERE fault = 'm.f0'", "fault m.f0 (link "),
        ("UPDATE recording SET log = x'00' WHERE fault = 'm.f0'", "recordings m.f0 (link "),
        ("DELETE FROM intervention WHERE number = 2", "intervention 2 (link "),
        ("UPDATE intervention SET address = 0 WHERE number = 3", "intervention 3 (link "),
        ("UPDATE operation_cycle SET number = 1", "cycle power (link "),
        ("DELETE FROM permanent", "permanent m.f0 (link "),
        ("UPDATE identifier SET data = x'00'", f"identifier {0xF190} (link "),
        ("UPDATE fact SET value = value + 1 WHERE name = 'sequence'", "number sequence (link "),
        ("INSERT INTO fact VALUES ('attempts.1', 0)", "number attempts.1 (no link): was not written"),
        ("DELETE FROM link WHERE kind = 'clear'", ": links "),
        ("UPDATE link SET subject = 'FFFFFF' WHERE kind = 'clear'", "clear FFFFFF (link "),
        ("DELETE FROM link WHERE number = 1", ": links 1 to 1 are gone"),
        ("UPDATE link SET digest = x'00' WHERE number = 4", "(link 4): the link is not"),
        ("UPDATE link SET digest = 'text' WHERE number = 4", "(link 4): the link is not"),
        ("UPDATE link SET digest = 5 WHERE number = (SELECT max(number) FROM link)", ": the link is not"),
        ("DELETE FROM link", "its links are gone"),
    ],
)
def test_what_somebody_else_changes_is_named(tmp_path, statement, first):
    path = tmp_path / "f.sqlite"
    filled(path)
    change(path, statement)
    found = service.verify(path)
    assert not found["whole"]
    assert first in found["broken"][0]["text"]
    store, memory = kept(path)
    (incident,) = store.incidents()
    assert incident.kind == "damaged"
    assert first in incident.reason, "and the next gateway tells it"
    assert {e.fault for e in memory.entries()} == {"m.f0", "m.f2"}
    store.close()
    assert not service.verify(incident.aside)["whole"], "what was changed can be looked at still"
    whole(path)


@pytest.mark.evidence("Durability: chain random")
@pytest.mark.parametrize("seed", range(amount(60, 6, 2)))
def test_random_changes_are_whole_at_each_commit_and_one_changed_row_is_found(tmp_path, seed, monkeypatch):
    monkeypatch.setattr(chain, "MOST", 40)
    rng = random.Random(seed)
    print("seed", seed)
    path = tmp_path / "f.sqlite"
    store, memory = kept(path, 5)
    memory.start_cycle(0)
    for step in range(1, 60):
        fault = rng.randrange(5)
        memory.apply(event(fault, rng.random() < 0.6, step), frame({"x": rng.random()}))
        if rng.random() < 0.3:
            memory.ledger.add_recordings([Recording(f"m.f{fault}", step, 1, 0, rng.randbytes(5))])
        if rng.random() < 0.2:
            memory.clear(rng.choice([0xFFFFFF, 0x030011 + (fault << 8)]))
        memory.ledger.note_intervention(Intervention(step, "uds", "pt", 0x7E0, rng.choice(["clear", "reset"])))
        memory.commit()
        verdict = store.verify()
        assert verdict.broken == []
        assert verdict.links <= 200
    assert verdict.links < verdict.head.number, "links were let go"
    kind = rng.choice(["fault", "intervention", "fact"])
    column, key = {"fault": ("peak_fdc", "id"), "intervention": ("t_ns", "number"), "fact": ("value", "name")}[kind]
    subject = rng.choice([row[0] for row in store._db.execute(f"SELECT {key} FROM {kind}")])
    store.close()
    db = sqlite3.connect(path, isolation_level=None)
    db.execute(f"UPDATE {kind} SET {column} = {column} + 1 WHERE {key} = ?", (subject,))
    db.close()
    (broken,) = service.verify(path)["broken"]
    assert broken["subject"] == str(subject)


def test_interventions_that_had_to_go_are_no_loss(tmp_path):
    store, memory = kept(tmp_path / "f.sqlite")
    for k in range(MOST + 20):
        memory.ledger.note_intervention(Intervention(k, "uds", "pt", k, "clear"))
        if k % 7 == 0:
            memory.commit()
    memory.commit()
    verdict = store.verify()
    assert verdict.broken == []
    assert verdict.counted["intervention"] == MOST
    store.close()


def test_a_cause_that_somebody_changes_shows(tmp_path):
    path = tmp_path / "f.sqlite"
    store, memory = kept(path)
    memory.apply(event(1, True, 99), nothing)
    fault = memory.catalogue[1].id
    memory.explain(fault, Cause("cause", (Ranked(("signal a.B.c",), 0.97),), fault, "U0100-00", 99))
    memory.commit()
    store.close()
    assert service.verify(path)["whole"]
    (entry,) = [entry for entry in service.list_entries(path) if entry["fault"] == fault]
    assert entry["cause"]["ranked"] == [{"components": ["signal a.B.c"], "probability": 0.97}]
    db = sqlite3.connect(path)
    with db:
        db.execute("UPDATE cause SET content = replace(content, 'signal', 'ecu')")
    db.close()
    (broken,) = service.verify(path)["broken"]
    assert (broken["kind"], broken["subject"]) == ("fault", fault)
    assert salvage(path).records[0].cause is not None


def test_what_is_undone_leaves_no_link(tmp_path):
    store = Store(tmp_path / "f.sqlite")
    before = chain.head(store._db)
    with pytest.raises(RuntimeError), store.transaction():
        store.save(Changes(cycles={"power": Cycle(1, True, 0)}))
        raise RuntimeError
    assert chain.head(store._db) == before
    assert store.verify().broken == []
    store.close()


def test_a_file_without_a_chain_gets_one_and_keeps_all(tmp_path):
    new, old = tmp_path / "new.sqlite", tmp_path / "old.sqlite"
    filled(new)
    db = sqlite3.connect(old, isolation_level=None)
    db.executescript("".join(MIGRATIONS[:5]) + f"PRAGMA application_id = {APPLICATION_ID}; PRAGMA user_version = 5;")
    db.execute("ATTACH ? AS new", (str(new),))
    for (table,) in db.execute("SELECT name FROM sqlite_schema WHERE type = 'table'").fetchall():
        db.execute(f"INSERT OR REPLACE INTO {table} SELECT * FROM new.{table}")
    db.close()
    with pytest.raises(InputError, match="earlier gateway"):
        service.verify(old)
    store, memory = kept(old)
    assert store.incidents() == []
    other = Store(new, write=False)
    assert store.load() == other.load()
    assert store.interventions() == other.interventions()
    assert store.recordings() == other.recordings()
    assert (store.cycles(), store.facts(), store.permanent()) == (other.cycles(), other.facts(), other.permanent())
    other.close()
    memory.apply(event(1, True, 99), nothing)
    memory.commit()
    store.close()
    assert listed(old) == {"m.f0": 1, "m.f1": 1, "m.f2": 1}
    assert {**whole(old)["counted"], "clear": 1} == whole(new)["counted"], "the clear was before the chain began"


def test_the_command_says_what_is_whole(tmp_path):
    path = tmp_path / "f.sqlite"
    filled(path)
    run = CliRunner()
    done = run.invoke(app, ["faults", "verify", "--memory", str(path)])
    assert done.exit_code == 0, done.output
    assert done.output.startswith("whole: 1 clear, 3 fault")
    assert service.verify(path)["digest"] in done.output
    change(path, "UPDATE intervention SET address = 0 WHERE number = 3", "DELETE FROM permanent")
    done = run.invoke(app, ["faults", "verify", "--memory", str(path)])
    assert done.exit_code == 1
    assert done.output.startswith("NOT WHOLE, first: intervention 3 (link ")
    assert "then: permanent m.f0" in done.output
    assert run.invoke(app, ["faults", "verify", "--memory", str(path), "--json"]).exit_code == 1
    path.write_bytes(b"")
    done = run.invoke(app, ["faults", "verify", "--memory", str(path)])
    assert done.exit_code == 1
    assert isinstance(run.invoke(app, ["faults", "verify", "--memory", str(tmp_path / "no")]).exception, InputError)

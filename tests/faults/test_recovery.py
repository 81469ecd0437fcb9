"""What was told last is there at the next start, wherever the power went."""

import shutil
import tempfile
from pathlib import Path

import pytest
from amount import amount
from fault_examples import catalogue, event, nothing
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule
from journalled import Bus, Telling
from told import of, watched_rigs

from gateway.engine.events import QUALIFIED_FAILED
from gateway.faults import service
from gateway.faults.catalogue import Catalogue
from gateway.faults.explanation import WAITING
from gateway.faults.journal_file import path_of
from gateway.faults.journal_steps import journal_put
from gateway.faults.memory import FaultMemory
from gateway.faults.resilient_store import ResilientStore
from gateway.faults.status import Status
from gateway.faults.store import Store, StoreError
from gateway_commands import faults
from gateway_fdi.jit import bound

FROZEN = {"freeze_frame": (("a.B.C",), ("a.B.C",), ("a.B.C",))}


@pytest.fixture
def telling(tmp_path):
    made = Telling(tmp_path / "0.sqlite", catalogue(**FROZEN))
    made.memory.start_cycle(0)
    made.note_told()
    yield made
    made.close()
    made.bus.close()


class ToldAndKilled(RuleBasedStateMachine):
    """Random lives of three faults that are told by the journal or when they are stored, killed at any point."""

    steps = told = 0

    def __init__(self):
        super().__init__()
        fast = Path("/dev/shm")
        self.folder = Path(tempfile.mkdtemp(dir=fast if fast.is_dir() else None))
        self.one = Telling(self.folder / "0.sqlite", catalogue(**FROZEN))
        self.images = 0
        self.start()

    def teardown(self):
        self.one.close()
        self.one.bus.close()
        shutil.rmtree(self.folder)

    @rule(found=st.lists(st.tuples(st.integers(0, 2), st.booleans()), min_size=1, max_size=4))
    def verdicts(self, found):
        ToldAndKilled.told += self.one.verdicts(*found)

    @rule()
    def commit(self):
        self.one.commit()

    @rule()
    def start(self):
        self.one.memory.start_cycle(self.one.t_ns)
        self.one.note_told()

    @rule(place=st.integers(0, 3))
    def clear(self, place):
        self.one.memory.clear(0xFFFFFF if place == 3 else self.one.catalogue[place].dtc.value)
        self.one.note_told()

    @rule()
    def kill(self):
        self.images += 1
        self.one.kill(self.folder / f"{self.images}.sqlite")
        reader = Store(self.one.path, write=False)
        shown = {record.id: (record.status, record.occurrence) for record in reader.load()}
        reader.close()
        self.one.open()
        assert shown == {f: (self.one.told[f], self.one.memory.record(f).occurrence) for f in self.one.told}
        found = {fault: self.one.memory.status_now(fault) for fault in self.one.told}
        assert found == self.one.told
        assert self.one.store.waiting() == [], "they are in the file now"
        assert self.one.store.verify().broken == []

    @rule(place=st.integers(0, 2))
    def kill_and_clear_one_from_outside(self, place):
        self.images += 1
        self.one.kill(self.folder / f"{self.images}.sqlite")
        service.clear(self.one.path, str(self.one.catalogue[place].dtc))
        self.one.open()
        for k, definition in enumerate(self.one.catalogue):
            if k != place:
                assert self.one.memory.status_now(definition.id) == self.one.told[definition.id], definition.id
        self.one.note_told()

    @invariant()
    def count(self):
        ToldAndKilled.steps += 1


@pytest.mark.evidence("Durability: journal")
@pytest.mark.long
def test_after_a_kill_at_any_point_each_status_is_the_one_told_last():
    ToldAndKilled.steps = ToldAndKilled.told = 0
    ToldAndKilled.TestCase.settings = settings(
        max_examples=amount(1000, 40, 8), stateful_step_count=30, deadline=None, derandomize=True
    )
    ToldAndKilled.TestCase().runTest()
    print(f"{ToldAndKilled.steps} steps, {ToldAndKilled.told} told by the journal")
    assert ToldAndKilled.told >= amount(2000, 100, 10)


def test_what_is_recovered_has_no_values_and_says_so(telling, tmp_path):
    assert telling.verdicts((0, True), (1, True)) == 2
    telling.kill(tmp_path / "1.sqlite")
    telling.open()
    assert telling.memory.recovered == (("m.f0", "m.f1"), 0)
    entry = telling.memory.entry("m.f0")
    assert int(entry.status) == 0x2F
    assert (entry.record.occurrence, entry.record.first_ns, entry.record.last_ns) == (1, 1, 1)
    assert set(entry.record.evidence.values()) == {None}
    assert [frame.content for frame in entry.freeze_frames] == [{"a.B.C": None}]
    telling.kill(tmp_path / "2.sqlite")
    telling.open()
    assert telling.memory.recovered == ((), 0), "once"


def test_a_commit_that_failed_leaves_the_verdict_to_the_journal(telling, tmp_path, monkeypatch):
    assert telling.verdicts((0, True)) == 1

    def no_room(*_):
        raise StoreError(telling.path, "full", full=True)

    monkeypatch.setattr(Store, "save", no_room)
    assert not telling.memory.commit()
    assert telling.verdicts((1, True)) == 0, "while it cannot be written, the journal takes nothing"
    monkeypatch.undo()
    telling.kill(tmp_path / "1.sqlite")
    telling.open()
    assert telling.memory.recovered.faults == ("m.f0",)
    assert telling.memory.status_now("m.f1") == telling.told["m.f1"]


def test_the_status_is_the_one_that_was_told_also_by_other_rules(telling, tmp_path):
    telling.verdicts((0, True), (1, True))
    telling.kill(tmp_path / "1.sqlite")
    telling.catalogue = catalogue((3,))  # m.f0 is confirmed later now, m.f1 is known no more
    telling.open()
    told = {name: telling.memory.status_now(name) for name in ("m.f0", "m.f1")}
    assert told == {"m.f0": telling.told["m.f0"], "m.f1": telling.told["m.f1"]}
    assert told["m.f0"] & Status.CONFIRMED_DTC


def test_a_dtc_that_was_told_while_its_confirmation_waits_waits_on(telling, tmp_path):
    telling.memory.wait_for_causes({"m.f0"})
    telling.verdicts((0, True), (0, False), (0, True))
    telling.kill(tmp_path / "1.sqlite")
    telling.open()
    assert telling.memory.status_now("m.f0") == telling.told["m.f0"] == 0x27
    assert [(record.id, record.hold) for record in telling.memory.unsettled()] == [("m.f0", WAITING)]
    assert telling.memory.confirm("m.f0", 127, 9)


def test_a_new_file_at_the_place_of_another_takes_nothing_of_its_journal(telling, tmp_path):
    telling.verdicts((0, True))
    telling.close()
    for suffix in ("", "-wal", "-shm"):
        Path(f"{telling.path}{suffix}").unlink(missing_ok=True)
    assert path_of(telling.path).exists()
    telling.open()
    assert telling.memory.recovered == ((), 0)
    assert telling.memory.entries() == []


def test_a_damaged_file_is_recovered_with_what_was_told_last(telling, tmp_path):
    telling.verdicts((0, True))
    telling.commit()
    telling.verdicts((0, False), (2, True))
    told = dict(telling.told)
    image = tmp_path / "1.sqlite"
    telling.kill(image)
    store = Store(image)  # its log is copied
    store._db.execute("PRAGMA foreign_keys = OFF")
    store._db.execute("INSERT INTO freeze_frame VALUES ('nobody', 1, 0, '{}')")
    store.close()
    telling.open()
    assert [incident.kind for incident in telling.store.incidents()] == ["damaged"]
    assert telling.memory.recovered == (("m.f0", "m.f2"), 0)
    assert {name: telling.memory.status_now(name) for name in told} == told


def test_a_fault_that_no_file_knows_is_counted_as_lost(telling, tmp_path):
    telling.verdicts((2, True))
    telling.kill(tmp_path / "1.sqlite")
    store = ResilientStore(telling.path)
    store.load = lambda: []
    assert FaultMemory(Catalogue(()), store).recovered == ((), 1)
    store.close()
    telling.open()


def test_without_a_journal_all_goes_on_as_without(tmp_path, monkeypatch):
    path = tmp_path / "m.sqlite"
    path_of(path).mkdir()
    store = ResilientStore(path)
    memory = FaultMemory(catalogue(), store)
    store.begin_journal()
    assert store.journal is None
    store.arm_journal(True)
    store.settle_journal()
    store.look_at_journal()
    memory.start_cycle(0)
    memory.apply(event(0, True), nothing)
    assert memory.commit()
    assert store.waiting() == []
    store.close()


def test_readers_say_that_verdicts_wait_for_the_next_start(telling, tmp_path, capsys):
    telling.verdicts((0, True))
    assert service.waiting(telling.path) == 0, "its gateway runs"
    telling.kill(tmp_path / "1.sqlite")
    assert service.waiting(telling.path) == 1
    assert faults.list_faults(None, memory=telling.path, json=False) == 0
    told = capsys.readouterr()
    assert "1 verdicts that were told right before" in told.err
    assert "P0300-11" in told.out
    (entry,) = service.list_entries(telling.path)
    assert (entry["status"], entry["occurrence"], entry["first_ns"], entry["evidence"]) == (0x2F, 1, 1, {})
    telling.open()


def test_a_gateway_tells_what_it_recovered(tmp_path):
    maker = watched_rigs(tmp_path)
    make = next(maker)
    rig = make()
    rig.gateway.write_beside()
    rig.wait(50)
    assert rig.gateway.memory.commit(rig.now, final=True)
    known, bus = [d.id for d in rig.gateway.catalogue], Bus()
    assert rig.gateway.quiet().idle
    put = bound(journal_put, rig.gateway.journal, rest=(*[0] * 6, Bus.wire(0), 0, 0))
    assert put(known.index("b.M1.length"), QUALIFIED_FAILED, 7, 0x2F, 1, 127, Bus.wire(1), 16, bus.inside.fileno())
    assert bus.next() == 1
    rig.close()  # as a kill would leave it: nothing is written, the cycle is open
    again = make()
    again.wait(50)
    (told,) = of(again, "memory")
    assert (told["state"], told["faults"], told["lost"]) == ("recovered", ["b.M1.length"], 0)
    assert again.gateway.memory.status("b.M1.length") & Status.CONFIRMED_DTC
    maker.close()
    bus.close()

"""A disk that takes its time: a thread writes, testers are answered, and nothing is told before it is stored."""

import threading

import pytest
from due import due_ns
from rig import Tester
from told import FRAMES, of, stored, told, told_of, watched_rigs

from gateway.faults.store import Store, StoreError
from gateway.runtime.app import Gateway
from gateway.runtime.assemble import prepare
from gateway.runtime.persistence import NOTHING, Noted

NOT_WRITTEN, DAMAGED = "gateway.memory_not_written", "gateway.memory_damaged"


@pytest.fixture
def make(tmp_path):
    yield from watched_rigs(tmp_path)


class SlowDisk:
    """Writes of a store in another thread wait until they are let go; they may fail then."""

    def __init__(self, monkeypatch):
        self._gate = threading.Event()
        self._gate.set()
        self.fails = self.full = False
        write = Store.save

        def save(store, changes, whole=None):
            if threading.current_thread() is not threading.main_thread():
                assert self._gate.wait(60)
                if self.fails:
                    raise StoreError(store.path, "no", full=self.full)
            write(store, changes, whole)

        monkeypatch.setattr(Store, "save", save)

    def stall(self):
        self._gate.clear()

    def let_go(self):
        self._gate.set()

    def go_on(self, rig):
        """Let writes go on, and wait for the one under way as the gateway would find it done."""
        self._gate.set()
        rig.gateway.memory.ledger.under_way(60.0)


@pytest.fixture
def slow(monkeypatch):
    return SlowDisk(monkeypatch)


def writing(make, slow):
    """Return a gateway whose thread writes a failure, which the disk holds up."""
    rig = make()
    rig.gateway.write_beside()
    rig.wait(50)
    slow.stall()
    rig.fail(0)
    return rig


def test_the_journal_takes_verdicts_only_between_writes_and_each_by_the_latest_commit(make, slow):
    rig = make()
    rig.gateway.write_beside()
    state, digests = rig.gateway.journal.state[0], set()
    for k in range(3):
        while not state.armed:
            rig.gateway.memory.ledger.under_way(60.0)
            rig.wait(10)
            rig.gateway.quiet()
        assert bytes(state.digest) == chain_head(rig)
        digests.add(bytes(state.digest))
        slow.stall()
        rig.fail(k)
        rig.gateway.quiet()
        assert not state.armed, "a later commit may be without it"
        slow.let_go()
    assert len(digests) == 3


def chain_head(rig):
    store = Store(rig.gateway.store.path, write=False)
    digest = store.verify().head.digest
    store.close()
    return digest


def test_a_write_that_was_looked_at_between_tells_nothing_of_the_next_one(make, slow):
    """Its count of events stayed: as many of later ones were told before they were written."""
    rig = writing(make, slow)
    slow.go_on(rig)
    rig.gateway.serve_requests()
    rig.wait(20)
    assert [e["fault"] for e in of(rig, "dtc")] == ["b.M0.length"]
    assert rig.gateway.memory.clean
    assert not rig.gateway.memory.ledger.under_way(60.0), "the log is looked after"
    slow.stall()
    rig.gateway.memory.ledger.note_buses([])
    may = rig.gateway._upkeep.settle(rig.gateway.engine.now_ns, Noted(1, 1), lambda events: None)
    assert may == NOTHING, "the disk has not answered"
    slow.go_on(rig)


@pytest.mark.evidence("Durability: slow disk")
def test_while_a_disk_takes_its_time_testers_are_answered_and_nothing_is_told_early(make, slow):
    rig = make(extra=FRAMES + "[output.uds]\n")
    rig.gateway.write_beside()
    tester = Tester(rig)
    rig.wait(50)
    slow.stall()
    rig.fail(0)
    rig.fail(1)
    assert tester.ask("3E00").hex() == "7e00"
    assert tester.ask("190208").hex()[:6] == "5902ff"
    assert len(tester.ask("190208")) == 3, "what is not stored is not shown"
    assert told(rig) == [] or told(rig) == [("P0000-00", False)]
    assert of(rig, "dtc") == []
    slow.go_on(rig)
    rig.wait(50)
    assert [d for d, _ in told(rig) if d[:5] != "P0000"] == ["P1000-11", "C1001-11"]
    assert [e["stored"] for e in of(rig, "dtc")] == [True, True]
    assert set(stored(rig)) == {"b.M0.length", "b.M1.length"}
    assert len(tester.ask("190208")) == 3 + 2 * 4


def test_while_something_waits_to_be_written_it_is_due_at_once(make, slow):
    rig = make()
    rig.gateway.write_beside()
    rig.wait(50)
    assert due_ns(rig.gateway) > rig.gateway.engine.now_ns, "nothing but time is waited for"
    slow.stall()
    rig.fail(0)
    assert due_ns(rig.gateway) < 0
    slow.go_on(rig)
    rig.wait(50)
    assert due_ns(rig.gateway) > rig.gateway.engine.now_ns


@pytest.mark.parametrize("full", [False, True])
def test_what_a_thread_could_not_write_is_told_as_such_and_written_later(make, slow, full):
    rig = make()
    slow.full = full
    rig.gateway.write_beside()
    rig.wait(50)
    slow.stall()
    slow.fails = True
    rig.fail(0)
    rig.fail(1)
    slow.go_on(rig)
    rig.wait(20)
    assert told(rig)[-3:] == [("U3000-44", True), ("P1000-11", True), ("C1001-11", True)]
    slow.fails = False
    rig.wait(500)
    for _ in range(2):  # what was waiting, then that writing works again
        slow.go_on(rig)
        rig.wait(20)
    assert set(stored(rig)) == {"b.M0.length", "b.M1.length", NOT_WRITTEN}
    assert told(rig)[-1] == ("U3000-44", False)


def test_attempts_that_take_long_hold_nobody_up_and_all_is_written_at_their_end(make, slow):
    rig = make(extra=FRAMES + "[output.uds]\n")
    rig.gateway.write_beside()
    tester = Tester(rig)
    rig.wait(50)
    slow.fails = True
    rig.fail(0)
    slow.go_on(rig)
    rig.wait(20)
    assert told(rig)[-2:] == [("U3000-44", True), ("P1000-11", True)]
    failures = rig.gateway.memory.outage.failures
    for _ in range(3):  # as many attempts, each of which takes as long as it likes
        slow.stall()
        rig.wait(1000)
        assert rig.gateway.memory.ledger.under_way()
        assert tester.ask("3E00").hex() == "7e00"
        slow.go_on(rig)
        failures += 1
        rig.wait(20)
        assert rig.gateway.memory.outage.failures >= failures
    slow.stall()
    rig.wait(2000)
    rig.fail(1)
    assert told(rig)[-1] == ("C1001-11", True), "told while an attempt is under way"
    assert of(rig, "dtc")[-1]["stored"] is False
    assert len(tester.ask("190208")) == 3 + 3 * 4
    slow.fails = False
    while not rig.gateway.stored:
        slow.go_on(rig)
        rig.wait(50)
    assert set(stored(rig)) == {"b.M0.length", "b.M1.length", NOT_WRITTEN}
    assert told(rig)[-1] == ("U3000-44", False)
    assert rig.gateway.stored


def test_a_successor_is_made_without_waiting_for_the_disk(make, slow):
    rig = writing(make, slow)
    assert rig.gateway.writing, "a reload waits for this one"
    slow.go_on(rig)
    rig.wait(20)
    assert not rig.gateway.writing
    slow.stall()
    old = rig.gateway
    old._upkeep.pause()  # as finish does first
    rig.fail(1)
    old.finish(rig.now)
    assert not old.writing, "nothing is begun that the successor would have to wait for"
    successor = Gateway(old.config, parts=prepare(old.config), store=old.store)
    successor.succeed(old)
    rig.gateway = successor
    slow.go_on(rig)
    rig.wait(100)
    assert set(stored(rig)) == {"b.M0.length", "b.M1.length"}
    assert [e["fault"] for e in of(rig, "dtc")] == ["b.M0.length", "b.M1.length"]


def test_one_that_has_finished_without_a_successor_writes_again(make, slow):
    rig = make()
    rig.gateway.write_beside()
    rig.wait(50)
    rig.gateway.finish(rig.now)
    rig.fail(0)
    assert stored(rig) == {}
    rig.gateway.go_on()
    rig.wait(50)
    slow.go_on(rig)
    rig.wait(20)
    assert set(stored(rig)) == {"b.M0.length"}


def test_a_file_deleted_while_a_thread_writes_is_written_anew(make, slow):
    rig = writing(make, slow)
    for file in rig.gateway.store.path.parent.glob("m.sqlite*"):
        file.unlink()
    for _ in range(3):  # the write under way, the one into the new file, the one of what that tells
        slow.go_on(rig)
        rig.wait(50)
    assert set(stored(rig)) == {"b.M0.length", DAMAGED}


def test_a_clear_waits_for_the_thread_and_what_it_wrote_does_not_come_back(make, slow):
    rig = writing(make, slow)
    timer = threading.Timer(0.05, slow.let_go)
    timer.start()
    assert rig.gateway.controls.clear(0xFFFFFF)
    timer.join()
    rig.wait(50)
    assert stored(rig) == {}
    assert rig.status(0) == 0x50


@pytest.mark.parametrize("by", ["tester", "process"])
def test_what_waits_to_be_told_is_told_before_it_is_cleared_not_after(make, slow, by):
    """Told later it would be set for whoever listens, and nothing would ever take it back."""
    rig = make(extra=FRAMES + "[output.uds]\nclear = {}\n")
    tester = Tester(rig)
    rig.gateway.write_beside()
    rig.wait(50)
    slow.stall()
    rig.fail(0)
    rig.fail(1)  # waits for the write that is under way
    assert of(rig, "dtc") == []
    if by == "tester":
        timer = threading.Timer(0.05, slow.let_go)
        timer.start()
        assert tester.ask("14FFFFFF").hex() == "54"
        timer.join()
        place = [k for k, (_, data) in enumerate(rig.sent) if bytes(data[:2]) == b"\x01\x54"][-1]
        assert ("C1001-11", True) in told_of(rig.sent[:place])
    else:
        slow.go_on(rig)
        other = Store(rig.gateway.store.path, write=False)
        request = other.request("clear", str(0xFFFFFF))
        rig.gateway.serve_requests()
        assert other.answer(request) == 2
        other.close()
    assert [e["fault"] for e in of(rig, "dtc")] == ["b.M0.length", "b.M1.length"]
    assert all(e["stored"] for e in of(rig, "dtc"))
    (clear,) = of(rig, "clear")
    assert clear["faults"] == ["b.M0.length", "b.M1.length"]
    assert rig.events.index(clear) > rig.events.index(of(rig, "dtc")[-1])
    place = len(rig.sent)
    rig.wait(500)
    assert len(of(rig, "dtc")) == 2
    if by == "tester":
        assert ("C1001-11", True) not in told_of(rig.sent[place:])
    assert stored(rig) == {}


def test_the_end_waits_for_the_thread(make, slow):
    rig = writing(make, slow)
    timer = threading.Timer(0.05, slow.let_go)
    timer.start()
    rig.gateway.stop(rig.now)
    timer.join()
    assert rig.gateway.stored
    assert set(stored(rig)) == {"b.M0.length"}
    assert [e["fault"] for e in of(rig, "dtc")] == ["b.M0.length"]


def test_told_first_a_dtc_does_not_wait_for_the_disk_and_says_when_it_is_stored(make, slow):
    rig = make(extra=FRAMES + '[output.uds]\n[memory]\ntell = "first"\n')
    rig.gateway.write_beside()
    tester = Tester(rig)
    rig.wait(50)
    slow.stall()
    rig.fail(0)
    assert told(rig)[-1] == ("P1000-11", True)
    assert [e["stored"] for e in of(rig, "dtc")] == [False]
    assert len(tester.ask("190208")) == 3 + 4, "testers read what was told"
    rig.fail(1)
    assert told(rig)[-1] == ("C1001-11", True), "while a write is under way"
    assert of(rig, "stored") == []
    assert not {"b.M0.length", "b.M1.length"} & set(stored(rig))
    for _ in range(3):  # the write under way, and those of what came meanwhile
        slow.go_on(rig)
        rig.wait(50)
    assert [fault for e in of(rig, "stored") for fault in e["faults"]] == ["b.M0.length", "b.M1.length"]
    assert set(stored(rig)) == {"b.M0.length", "b.M1.length"}
    assert len(of(rig, "dtc")) == 2, "each is told once"
    assert rig.gateway.summary(1.0)["counters"]["memory_not_stored"] == 0


@pytest.mark.evidence("Durability: told first")
def test_told_first_an_outage_counts_what_is_not_stored(make, slow):
    rig = make(extra=FRAMES + '[memory]\ntell = "first"\n')
    rig.gateway.write_beside()
    rig.wait(50)
    slow.fails = True
    rig.fail(0)
    rig.wait(20)
    slow.go_on(rig)
    rig.wait(20)
    assert told(rig)[-2:] == [("P1000-11", True), ("U3000-44", True)]
    assert of(rig, "stored") == []
    assert rig.gateway.summary(1.0)["counters"]["memory_not_stored"] >= 1

"""A gateway whose fault memory cannot be written: it goes on, tells, says so, and stores everything when it can."""

import threading

import pytest
from rig import MS, Rig, Tester, write_config

from gateway.bus.frames import EXTENDED
from gateway.common.resources import shipped
from gateway.config.load import load_config
from gateway.faults import service
from gateway.faults.dtc import Dtc
from gateway.faults.store import Store, StoreError
from gateway.runtime.app import Gateway, prepare
from gateway.servers.dtc_frame import message_of

FRAMES = "[output.dtc_frame]\nmin_interval_ms = 0\ncycle_ms = 60000.0\n"
NOT_WRITTEN, DAMAGED = "gateway.memory_not_written", "gateway.memory_damaged"
MESSAGE = message_of(shipped("dbc/gateway.dbc"))


@pytest.fixture
def disk(monkeypatch):
    """A disk that can be broken: ``disk["broken"] = True``."""
    state = {"broken": False}
    write = Store.save

    def save(store, changes, whole=None):
        if state["broken"]:
            raise StoreError(store.path, "database or disk is full", full=True)
        write(store, changes, whole)

    monkeypatch.setattr(Store, "save", save)
    return state


@pytest.fixture
def make(tmp_path):
    rigs = []

    def build(messages=3, name="m.sqlite", **options):
        options.setdefault("extra", FRAMES)
        rigs.append(Rig(write_config(tmp_path, messages, **options), tmp_path / name, watched=True))
        return rigs[-1]

    yield build
    for rig in rigs:
        rig.close()


def told(rig):
    """DTCs of the DTC frames sent so far, each with whether it fails."""
    return told_of(rig.sent)


def told_of(sent):
    """The same of frames."""
    found = []
    for can_id, data in sent:
        if can_id == MESSAGE.frame_id:
            values = MESSAGE.decode(bytes(data), decode_choices=False)
            found.append((str(Dtc(values["Dtc"])), bool(values["Status"] & 1)))
    return found


def of(rig, kind):
    return [e for e in rig.events if e["event"] == kind]


def stored(rig):
    return {e["fault"]: e for e in service.list_entries(rig.gateway.store.path)}


def test_a_fault_met_by_a_full_disk_is_told_and_stored_when_there_is_room(make, disk):
    rig = make()
    rig.wait(100)
    assert int(rig.gateway.memory.status(NOT_WRITTEN)) == 0, "tested, and good"
    disk["broken"] = True
    rig.fail(0)
    assert told(rig)[-2:] == [("U3000-44", True), ("P1000-11", True)], "how far it can be trusted first"
    dtcs = {e["fault"]: e for e in of(rig, "dtc")}
    assert dtcs["b.M0.length"]["stored"] is False
    (event,) = of(rig, "memory")
    assert (event["state"], event["reason"]) == ("not written", "database or disk is full")
    assert stored(rig) == {}
    rig.fail(1)
    rig.wait(60_000, step=1000)
    rig.heal(1)
    assert ("C1001-11", False) in told(rig), "monitoring and telling go on"
    assert rig.gateway.summary(1.0)["counters"]["memory_not_stored"] == 4
    assert rig.gateway.summary(1.0)["counters"]["memory_write_failures"] >= 8
    disk["broken"] = False
    rig.wait(11_000, step=100)
    assert [e["state"] for e in of(rig, "memory")] == ["not written", "written"]
    assert told(rig)[-1] == ("U3000-44", False)
    kept = stored(rig)
    assert set(kept) == {"b.M0.length", "b.M1.length", NOT_WRITTEN}
    assert kept["b.M0.length"]["confirmed"]
    assert kept[NOT_WRITTEN]["status"] == 0x2E
    assert [e["stored"] for e in of(rig, "dtc")].count(False) == 4
    assert of(rig, "dtc")[-1]["stored"] is True


def test_events_are_told_after_they_are_stored(make):
    rig = make()
    seen = []

    def listen(event):
        if event["event"] == "dtc":
            seen.append(stored(rig)[event["fault"]]["occurrence"] >= event["occurrence"])

    rig.gateway.listen(listen)
    for _ in range(40):
        rig.fail(0)
        rig.heal(0)
    assert len(seen) == 80
    assert all(seen)


def test_testers_are_not_told_that_something_was_stored_or_cleared_that_was_not(make, disk):
    rig = make(
        extra=FRAMES + "[output.uds]\n[output.obd]\n[output.j1939]\naddress = 0x80\n[[did]]\nid = 0xF190\n"
        'name = "vin"\ntext = "ABC"\nwritable = true\n'
    )
    tester = Tester(rig)

    def ask(request):
        return tester.ask(request).hex()

    rig.wait(300)  # its address is claimed
    rig.fail(0)
    disk["broken"] = True
    assert ask("1003").startswith("5003")
    assert ask("14FFFFFF") == "7f1472"
    assert ask("2EF190" + b"XYZ".hex()) == "7f2e72"
    assert ask("22F190") == "62f190" + b"ABC".hex()
    assert ask("04") == "7f0422"
    rig.sent.clear()
    rig.feed((0x18EA80F9 | EXTENDED, bytes.fromhex("d3fe00")))  # DM11, asked of us alone
    assert (0x18E8FF80 | EXTENDED, bytes.fromhex("01fffffff9d3fe00")) in rig.sent, rig.sent
    assert rig.status(0) == 0x2F, "nothing was cleared"
    disk["broken"] = False
    assert of(rig, "clear") == []
    assert ask("14FFFFFF") == "54"
    assert stored(rig) == {}
    assert len(of(rig, "clear")) == 1
    assert ask("2EF190" + b"XYZ".hex()) == "6ef190"
    assert ask("22F190") == "62f190" + b"XYZ".hex()


def test_a_deleted_file_is_noticed_without_any_change(make):
    rig = make()
    rig.fail(0)
    for file in rig.gateway.store.path.parent.glob("m.sqlite*"):
        file.unlink()
    rig.gateway.serve_requests()
    rig.wait(50)
    assert set(stored(rig)) == {"b.M0.length", DAMAGED}
    assert [e["state"] for e in of(rig, "memory")] == ["deleted"]
    assert ("U3000-42", True) in told(rig)
    assert stored(rig)["b.M0.length"]["description"], "what faults are called is in the new file too"


def test_a_damaged_file_is_put_aside_recovered_and_told(make, tmp_path):
    rig = make()
    rig.fail(0)
    rig.gateway.stop(rig.now)
    path = rig.gateway.store.path
    rig.close()
    content = bytearray(path.read_bytes())
    at = content.index(b"b.M0.length")
    content[at : at + 4] = b"b.M7"
    path.write_bytes(content)
    rig = make()
    rig.wait(50)
    (event,) = of(rig, "memory")
    assert event["state"] == "damaged"
    assert event["recovered"] > 3
    assert (tmp_path / event["aside"]).exists()
    entry = rig.gateway.memory.entry(DAMAGED)
    assert entry.evidence["rows recovered"] == event["recovered"]
    assert str(entry.dtc) == "U3000-42"
    rig.gateway.stop(rig.now)
    rig.close()
    rig = make()
    rig.wait(50)
    assert int(rig.gateway.memory.status(DAMAGED)) & 1 == 0, "the next cycle finds it whole"
    assert of(rig, "memory") == []


def test_the_own_faults_can_be_switched_off_and_set_like_any(tmp_path, disk):
    config = write_config(tmp_path, 1, extra=FRAMES + "[memory]\nwatched = false\n")
    rig = Rig(config, tmp_path / "m.sqlite", watched=True)
    disk["broken"] = True
    rig.fail(0)
    assert [dtc for dtc, _ in told(rig) if dtc.startswith("U3")] == []
    assert [e["state"] for e in of(rig, "memory")] == ["not written"], "told all the same"
    disk["broken"] = False
    rig.close()
    extra = f'[fault."{NOT_WRITTEN}"]\ndtc = "U3001-44"\nconfirm_cycles = 2\n'
    config = load_config(write_config(tmp_path, 1, extra=extra))
    definition = prepare(config).catalogue.get(NOT_WRITTEN)
    assert (str(definition.dtc), definition.confirm_cycles) == ("U3001-44", 2)
    assert not definition.emission_related


def test_a_reload_while_nothing_can_be_written_loses_nothing(make, disk):
    rig = make()
    disk["broken"] = True
    rig.fail(0)
    rig.fail(1)
    old = rig.gateway
    successor = Gateway(old.config, parts=prepare(old.config), store=old.store)
    successor.succeed(old)
    rig.gateway = successor
    assert rig.status(0) & rig.status(1) & 0x08
    disk["broken"] = False
    rig.fail(2)
    rig.wait(11_000, step=100)
    assert {"b.M0.length", "b.M1.length", "b.M2.length"} <= set(stored(rig))
    assert rig.gateway.memory.outage.reason == ""


def test_what_a_full_memory_refused_is_told_when_there_is_room(make):
    """Its verdict does not change any more, but the room does."""
    rig = make(7, extra=FRAMES + "[memory]\nentries = 2\n")
    for k in (0, 1, 6):
        rig.fail(k)
    assert rig.status(6) == 0x23
    rig.gateway.controls.clear(rig.gateway.catalogue[1].dtc.value)
    rig.value(0, 1.0)
    assert rig.status(6) == 0x2F
    assert told(rig)[-1] == ("B1006-11", True)
    assert set(stored(rig)) == {"b.M0.length", "b.M6.length"}


DRIVING = """
[cycle.driving]
begins = { signal = "M2.Value", min = 10.0 }
ends = { signal = "M2.Value", max = 1.0 }
"""


def test_results_outside_the_operation_cycle_do_not_count(make):
    rig = make(
        extra=DRIVING + FRAMES,
        faults={
            0: 'cycle = "driving"\nconfirm_cycles = 2\n',
            1: 'caused_by = ["b.M0.length"]\n',
        },
    )
    rig.fail(0)
    assert rig.status(0) == 0x50, "before the first drive"
    assert rig.gateway.engine.fault_detection_counter(0) == 0
    rig.fail(1)
    assert rig.status(1) == 0x2F, "what is not tested holds nothing back"
    rig.value(2, 20.0)
    rig.fail(0)
    assert rig.status(0) == 0x27, "the first trip"
    rig.value(2, 0.5)
    rig.heal(0)
    rig.fail(0)
    assert rig.status(0) == 0x27, "engine stopped"
    rig.value(2, 20.0)
    rig.fail(0)
    assert rig.status(0) == 0x2F, "the second trip"


def test_a_time_debounce_does_not_ripen_after_its_cycle(make):
    rig = make(
        extra=DRIVING + FRAMES,
        faults={0: 'cycle = "driving"\ndebounce = { failed_ms = 100.0, passed_ms = 100.0 }\n'},
    )
    rig.value(2, 20.0)
    rig.fail(0)
    rig.value(2, 0.5)
    rig.wait(1000)
    assert rig.status(0) == 0x50
    rig.value(2, 20.0)
    rig.fail(0)
    rig.wait(200)
    assert rig.status(0) == 0x2F


def test_a_storm_is_written_in_groups_and_every_change_is_told(make):
    """Two changes a millisecond: a write in 8 ms, after the first ones; nothing is told before it is stored."""
    lines = "debounce = { failed_after = 1, passed_after = 1, jump_down = true }\n"
    rig = make(faults=dict.fromkeys(range(3), lines))
    rig.wait(50)
    before = rig.gateway.memory.commits
    begun = rig.now
    for k in range(500):
        rig.feed((256 + k % 3, b"\x01"), (256 + k % 3, bytes(8)))
        if k % 50 == 0:
            kept = stored(rig)
            for event in of(rig, "dtc"):
                assert kept[event["fault"]]["occurrence"] >= min(event["occurrence"], 255)
    rig.wait(100)
    assert len(of(rig, "dtc")) == 1000, "every change is an event"
    assert all(e["stored"] for e in of(rig, "dtc"))
    writes = rig.gateway.memory.commits - before
    assert 32 < writes <= 32 + (rig.now - begun) // (8 * MS) + 1
    assert {e["fault"]: e["occurrence"] for e in stored(rig).values()} == {
        "b.M0.length": 167,
        "b.M1.length": 167,
        "b.M2.length": 166,
    }


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
        rig.gateway.memory.under_way(60.0)


@pytest.fixture
def slow(monkeypatch):
    return SlowDisk(monkeypatch)


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
        assert rig.gateway.memory.under_way()
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
    slow.go_on(rig)
    rig.wait(50)
    assert set(stored(rig)) == {"b.M0.length", "b.M1.length", NOT_WRITTEN}
    assert told(rig)[-1] == ("U3000-44", False)
    assert rig.gateway.stored


def test_a_successor_is_made_without_waiting_for_the_disk(make, slow):
    rig = make()
    rig.gateway.write_beside()
    rig.wait(50)
    slow.stall()
    rig.fail(0)
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
    rig = make()
    rig.gateway.write_beside()
    rig.wait(50)
    slow.stall()
    rig.fail(0)
    for file in rig.gateway.store.path.parent.glob("m.sqlite*"):
        file.unlink()
    for _ in range(3):  # the write under way, the one into the new file, the one of what that tells
        slow.go_on(rig)
        rig.wait(50)
    assert set(stored(rig)) == {"b.M0.length", DAMAGED}


def test_a_clear_waits_for_the_thread_and_what_it_wrote_does_not_come_back(make, slow):
    rig = make()
    rig.gateway.write_beside()
    rig.wait(50)
    slow.stall()
    rig.fail(0)
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
    rig = make()
    rig.gateway.write_beside()
    rig.wait(50)
    slow.stall()
    rig.fail(0)
    timer = threading.Timer(0.05, slow.let_go)
    timer.start()
    rig.gateway.stop(rig.now)
    timer.join()
    assert rig.gateway.stored
    assert set(stored(rig)) == {"b.M0.length"}
    assert [e["fault"] for e in of(rig, "dtc")] == ["b.M0.length"]

"""A gateway whose fault memory cannot be written: it goes on, tells, says so, and stores everything when it can."""

import pytest
from rig import MS, Rig, Tester, write_config
from told import FRAMES, of, stored, told, watched_rigs

from gateway.bus.frames import EXTENDED
from gateway.config.load import load_config
from gateway.faults.store import Store, StoreError
from gateway.runtime.app import Gateway
from gateway.runtime.assemble import prepare

NOT_WRITTEN, DAMAGED = "gateway.memory_not_written", "gateway.memory_damaged"


@pytest.fixture
def make(tmp_path):
    yield from watched_rigs(tmp_path)


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


@pytest.mark.evidence("Durability: full disk")
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


@pytest.mark.evidence("Durability: full disk")
def test_a_write_that_failed_is_told_before_anybody_sees_what_it_did_not_store(make, disk):
    """Whoever joins the thread that writes (a clear, a look at the file) leaves it to be told."""
    rig = make()
    memory = rig.gateway.memory
    rig.fail(0)
    rig.heal(0)
    rig.gateway.write_beside(patience_s=0.0)
    disk["broken"] = True
    rig.fail(0)
    memory.join()
    assert memory.outage.reason, "it failed, and nothing was told yet"
    assert memory.state("b.M0.length").occurrence == 1, "as the DTC frame of the cyclic list has it"
    rig.wait(10)
    assert ("U3000-44", True) in told(rig)
    assert memory.state("b.M0.length").occurrence == 2


@pytest.mark.evidence("Durability: events")
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


@pytest.mark.evidence("ISO 14229-1: 0x14 72")
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


@pytest.mark.evidence("AUTOSAR DEM: NVRAM")
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
    assert entry.record.evidence["rows recovered"] == event["recovered"]
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


@pytest.mark.parametrize("beside", [False, True])
def test_a_file_that_is_emptied_in_place_is_told_with_a_dtc_and_written_again(make, tmp_path, beside):
    """It was silent: events said that they were stored, and the next start found nothing."""
    rig = make()
    if beside:
        rig.gateway.write_beside(patience_s=60.0)
    rig.fail(0)
    path = rig.gateway.store.path
    with path.open("r+b") as file:
        file.truncate(0)
    rig.fail(1)
    rig.wait(50)
    rig.gateway.memory.ledger.under_way(60.0)
    rig.wait(50)
    (event,) = of(rig, "memory")
    assert event["state"] == "overwritten"
    assert event["reason"].startswith("it was cut off in place: 0 of ")
    assert (tmp_path / event["aside"]).exists()
    assert ("U3000-42", True) in told(rig)
    assert set(stored(rig)) == {"b.M0.length", "b.M1.length", DAMAGED}
    assert stored(rig)["b.M0.length"]["description"]


def test_a_change_in_place_is_noticed_without_any_other_change(make):
    rig = make()
    rig.gateway.write_beside(patience_s=60.0)
    rig.fail(0)
    rig.wait(50)
    path = rig.gateway.store.path
    path.write_bytes(b"mine\n" * 1000)
    for _ in range(3):
        rig.gateway.serve_requests()
        rig.gateway.memory.ledger.under_way(60.0)
        rig.wait(50)
    assert [e["state"] for e in of(rig, "memory")] == ["overwritten"]
    assert set(stored(rig)) == {"b.M0.length", DAMAGED}

"""Entries, freeze frames, displacement, permanent DTCs, operation cycles: what a full life of a fault needs."""

import sqlite3
from collections import deque

import pytest
from fault_examples import AtOnce, catalogue, event, frame, nothing
from hypothesis import given
from hypothesis import strategies as st

from gateway.engine.events import FDC_REACHED
from gateway.faults import service
from gateway.faults.recorder import Recorder, RecorderParams
from gateway.faults.records import Recording
from gateway.faults.schema import APPLICATION_ID, MIGRATIONS
from gateway.faults.status import Status
from gateway.faults.store import Store
from gateway_testers.readiness import readiness


def fail(memory, fault, t_ns=0, seen=nothing):
    return memory.apply(event(fault, True, t_ns), seen)


def heal(memory, fault, t_ns=0):
    return memory.apply(event(fault, False, t_ns), nothing)


def again(memory, fault, t_ns=0, seen=nothing):
    heal(memory, fault, t_ns)
    return fail(memory, fault, t_ns, seen)


def stored(memory):
    return [entry.fault for entry in memory.entries()]


# Freeze frames and extended data


@pytest.mark.evidence("AUTOSAR DEM: freeze frames")
def test_records_are_the_first_failure_and_the_latest_ones():
    memory = AtOnce(catalogue(confirm=(1,), freeze_frames=(4,)), Store(None))
    for t in range(1, 7):
        again(memory, 0, t, frame({"x": float(t)}))
    entry = memory.entry("m.f0")
    assert [(f.number, f.t_ns, f.content["x"]) for f in entry.freeze_frames] == [
        (1, 1, 1.0),
        (2, 6, 6.0),
        (3, 5, 5.0),
        (4, 4, 4.0),
    ]


def test_with_one_record_the_first_stays():
    memory = AtOnce(catalogue(confirm=(1,), freeze_frames=(1,)), Store(None))
    for t in range(1, 4):
        again(memory, 0, t, frame({"x": float(t)}))
    assert [f.t_ns for f in memory.entry("m.f0").freeze_frames] == [1]


@pytest.mark.evidence("AUTOSAR DEM: freeze frame trigger")
@pytest.mark.parametrize(("at", "stored_at"), [("failed", [1, 2, 4]), ("pending", [1]), ("confirmed", [4])])
def test_what_stores_a_freeze_frame_can_be_chosen(at, stored_at):
    memory = AtOnce(catalogue(confirm=(2,), freeze_frame_at=(at,), freeze_frames=(9,)), Store(None))
    memory.start_cycle(0)
    again(memory, 0, 1)
    again(memory, 0, 2)
    memory.start_cycle(3)
    again(memory, 0, 4)
    assert sorted(f.t_ns for f in memory.entry("m.f0").freeze_frames) == stored_at


@pytest.mark.evidence("AUTOSAR DEM: freeze frame trigger")
def test_a_freeze_frame_asked_for_on_the_way_up_is_of_that_moment():
    memory = AtOnce(catalogue(confirm=(1,), freeze_frame_at=(60,)), Store(None))
    early = event(0, True, 5)
    early = early._replace(kind=FDC_REACHED, fdc=63)
    assert memory.apply(early, frame({"x": 5.0})) == [], "no status bit changes on the way"
    assert memory.entries() == []
    fail(memory, 0, 9, frame({"x": 9.0}))
    (kept,) = memory.entry("m.f0").freeze_frames
    assert (kept.t_ns, kept.content) == (5, {"x": 5.0})
    # What rose and fell again leaves nothing for the next failure.
    memory.apply(early, frame({"x": 5.0}))
    heal(memory, 0)
    fail(memory, 0, 20, frame({"x": 20.0}))
    assert memory.entry("m.f0").freeze_frames[-1].t_ns == 20


def test_evidence_and_inputs_are_of_the_latest_failure(tmp_path):
    store = Store(tmp_path / "f.sqlite")
    memory = AtOnce(catalogue(confirm=(1,)), store)
    fail(memory, 0, 1, frame({}, {"M.A": 1.0}))
    heal(memory, 0)
    memory.apply(event(0, True, 2, value=9.0), frame({}, {"M.A": 2.0, "M.B": float("inf")}))
    memory.commit()
    (entry,) = service.list_entries(tmp_path / "f.sqlite")
    assert entry["evidence"] == {"value": 9.0, "threshold": 1.0, "residual": 7.0, "tooth": 3.0}
    assert entry["inputs"] == {"M.A": 2.0, "M.B": None}
    assert (entry["first_ns"], entry["last_ns"], entry["occurrence"]) == (1, 2, 2)
    store.close()


@pytest.mark.evidence("AUTOSAR DEM: order of events")
def test_the_order_of_failures_and_confirmations():
    memory = AtOnce(catalogue(confirm=(1, 2, 1)), Store(None))
    memory.start_cycle(0)
    for fault in (2, 0, 1, 2):
        again(memory, fault, 7)  # one time for all: the order is not that of the clock
    ids = lambda what: [entry.fault for entry in memory.in_order(what)]  # noqa: E731
    assert ids("first_failed") == ["m.f2", "m.f0", "m.f1"]
    assert ids("last_failed") == ["m.f0", "m.f1", "m.f2"]
    assert ids("first_confirmed") == ["m.f2", "m.f0"]
    memory.start_cycle(1)
    fail(memory, 1)
    assert ids("last_confirmed")[-1] == "m.f1"
    memory.clear()
    assert ids("first_failed") == []


def test_a_recording_of_a_fault_that_is_cleared_before_it_is_written_is_not_kept():
    store = Store(None)
    memory = AtOnce(catalogue(confirm=(1, 1)), store)
    fail(memory, 0)
    fail(memory, 1)
    memory.ledger.add_recordings([Recording(f"m.f{k}", 0, 1, 0, b"x") for k in range(2)])
    memory.clear(memory.catalogue[0].dtc.value)
    assert [recording.fault for recording in store.recordings()] == ["m.f1"]
    memory.ledger.add_recordings([Recording("m.f0", 0, 1, 0, b"late")])
    memory.commit()
    assert [recording.fault for recording in store.recordings()] == ["m.f1"]


# Displacement


def full(size, count, **settings):
    memory = AtOnce(catalogue(confirm=(1,) * count, **settings), Store(None), size=size)
    memory.start_cycle(0)
    return memory


@pytest.mark.evidence("AUTOSAR DEM: displacement")
def test_a_full_memory_keeps_the_more_important():
    memory = full(2, 4, priority=(50, 100, 200, 100), emission_related=(False,) * 4)
    fail(memory, 1)
    fail(memory, 2)
    fail(memory, 0)
    assert stored(memory) == ["m.f0", "m.f1"], "the least important gave way"
    memory.commit()
    assert memory.ledger.store.facts()["overflow"] == 1
    assert int(memory.status("m.f2")) == 0x23, "no longer pending or confirmed; it still fails"
    fail(memory, 3)
    assert stored(memory) == ["m.f0", "m.f1"], "one of the same priority that failed in this cycle stays"
    assert not memory.status("m.f3") & Status.CONFIRMED_DTC, "what is not stored is not confirmed"
    assert memory.status("m.f3") & Status.TEST_FAILED


@pytest.mark.evidence("AUTOSAR DEM: displacement")
def test_of_the_same_priority_passive_goes_before_active_and_old_before_new():
    memory = full(3, 5, emission_related=(False,) * 5)
    for fault in (0, 1, 2):
        fail(memory, fault)
    heal(memory, 1)
    heal(memory, 2)
    memory.start_cycle(1)  # none of them has failed in this one
    fail(memory, 3)
    assert stored(memory) == ["m.f0", "m.f2", "m.f3"], "m.f1 was passive and older than m.f2"
    fail(memory, 4)
    assert stored(memory) == ["m.f0", "m.f3", "m.f4"]


@pytest.mark.evidence("AUTOSAR DEM: emission")
def test_an_emission_related_dtc_with_the_lamp_on_never_gives_way_to_a_lesser_one():
    memory = full(1, 3, priority=(100, 200, 1), emission_related=(False, True, False))
    fail(memory, 1)  # the second of the catalogue asks for the indicator
    fail(memory, 2)
    fail(memory, 0)
    assert stored(memory) == ["m.f1"]


@pytest.mark.evidence("AUTOSAR DEM: displacement back")
def test_a_displaced_fault_comes_back_when_there_is_room():
    memory = full(1, 2, priority=(1, 2), emission_related=(False, False))
    fail(memory, 1)
    fail(memory, 0)
    assert stored(memory) == ["m.f0"]
    memory.clear(memory.catalogue[0].dtc.value)
    memory.start_cycle(1)
    fail(memory, 1)
    assert stored(memory) == ["m.f1"]
    assert memory.status("m.f1") & Status.CONFIRMED_DTC


@given(st.lists(st.tuples(st.integers(0, 7), st.sampled_from("FPc")), max_size=80), st.integers(1, 4))
def test_a_bounded_memory_never_holds_more_and_never_less_important_than_it_could(steps, size):
    priority = (10, 20, 20, 30, 30, 30, 40, 50)
    memory = full(size, 8, priority=priority, emission_related=(False,) * 8)
    for t, (fault, what) in enumerate(steps):
        if what == "c":
            memory.start_cycle(t)
            continue
        before = set(stored(memory))
        (fail if what == "F" else heal)(memory, fault, t)
        now = set(stored(memory))
        assert len(now) <= size
        for gone in before - now:
            assert priority[int(gone[3])] >= priority[fault]
        for entry in memory.entries():
            assert entry.record.occurrence
        for definition in memory.catalogue:
            if memory.status(definition.id) & Status.CONFIRMED_DTC:
                assert definition.id in now, "confirmed means stored"


# Aging, permanent DTCs, other operation cycles


@pytest.mark.evidence("AUTOSAR DEM: aging")
def test_aging_goes_on_where_it_was_after_a_restart(tmp_path):
    path = tmp_path / "f.sqlite"

    def life(*results):
        store = Store(path)
        memory = AtOnce(catalogue(), store)
        memory.start_cycle(0)
        for failed in results:
            memory.apply(event(0, failed), nothing)
        memory.end_cycle(0)
        store.close()
        return memory

    life(True)
    life(False)  # ends the pending state
    for k in (1, 2):
        assert life(False).entry("m.f0").record.aged_cycles == (k if k < 2 else 0)
    assert life().entries() == []
    assert life(True, False).entry("m.f0").record.occurrence == 1


def permanent(memory):
    return [entry.fault for entry in memory.permanent()]


@pytest.mark.evidence("AUTOSAR DEM: permanent")
def test_a_permanent_dtc_survives_a_clear_until_its_test_has_passed_in_a_whole_cycle(tmp_path):
    path = tmp_path / "f.sqlite"
    store = Store(path)
    memory = AtOnce(catalogue(confirm=(1, 1), permanent=(False, True)), store)
    memory.start_cycle(0)
    fail(memory, 0)
    fail(memory, 1)
    assert permanent(memory) == ["m.f1"]
    memory.clear()
    assert memory.entries() == []
    assert permanent(memory) == ["m.f1"]
    store.close()
    store = Store(path)
    memory = AtOnce(catalogue(confirm=(1, 1), permanent=(False, True)), store)
    assert permanent(memory) == ["m.f1"], "and a restart"
    memory.start_cycle(1)
    memory.end_cycle(2)
    assert permanent(memory) == ["m.f1"], "a cycle without its test proves nothing"
    memory.start_cycle(3)
    heal(memory, 1)
    assert permanent(memory) == ["m.f1"], "not before the cycle's end"
    memory.end_cycle(4)
    assert permanent(memory) == []
    store.close()


def test_a_permanent_dtc_that_nobody_tests_any_more_goes_with_a_clear(tmp_path):
    path = tmp_path / "f.sqlite"
    store = Store(path)
    memory = AtOnce(catalogue(confirm=(1, 1), permanent=(False, True)), store)
    fail(memory, 1)
    memory.commit()
    store.close()
    assert service.clear(path) == 1
    store = Store(path)
    memory = AtOnce(catalogue(confirm=(1,)), store)
    assert permanent(memory) == ["m.f1"], "the command line does not know what is tested"
    memory.clear()
    assert permanent(memory) == []
    store.close()
    assert AtOnce(catalogue(confirm=(1,)), Store(path)).permanent() == []


def test_a_permanent_dtc_that_heals_by_itself_goes_with_its_lamp():
    memory = AtOnce(catalogue(permanent=(False, True, False)), Store(None))
    for results in ((True,), (True,), (False,)):
        memory.start_cycle(0)
        for failed in results:
            memory.apply(event(1, failed), nothing)
        memory.end_cycle(0)
    assert permanent(memory) == ["m.f1"], "one good cycle of the two that heal"
    memory.start_cycle(0)
    heal(memory, 1)
    memory.end_cycle(0)
    assert permanent(memory) == []


@pytest.mark.evidence("AUTOSAR DEM: cycles")
def test_each_fault_has_its_operation_cycle_and_its_aging_cycle():
    memory = AtOnce(
        catalogue(confirm=(1, 1), cycle=("power", "driving"), aging_cycle=("warm_up", "driving")),
        Store(None),
    )
    memory.start_cycle(0)
    memory.start_cycle(1, "driving")
    fail(memory, 0)
    fail(memory, 1)
    memory.end_cycle(2, "driving")
    memory.start_cycle(3, "driving")
    assert not memory.status("m.f1") & Status.TEST_FAILED_THIS_CYCLE
    assert memory.status("m.f0") & Status.TEST_FAILED_THIS_CYCLE, "the power cycle goes on"
    memory.end_cycle(4)
    memory.start_cycle(5)
    assert memory.cycle_number("driving") == 2
    assert memory.cycle_number() == 2
    heal(memory, 0)
    memory.end_cycle(6)
    memory.start_cycle(7)
    heal(memory, 0)
    for k in range(3):
        memory.start_cycle(8, "warm_up")
        memory.end_cycle(9, "warm_up")
        assert memory.entry("m.f0").record.aged_cycles == k + 1, "warm-up cycles age it, power cycles do not"


def test_the_power_cycle_ends_the_cycles_within_it_before_itself():
    def aged(*ends):
        memory = AtOnce(catalogue(confirm=(1,), cycle=("driving",), aging_cycle=("power",)), Store(None))
        found = []
        for k in range(4):
            memory.start_cycle(2 * k)
            memory.start_cycle(2 * k, "driving")
            (heal if k else fail)(memory, 0)
            for name in ends:
                memory.end_cycle(2 * k + 1, name)
            found.append((memory.status("m.f0"), memory.entry("m.f0").record.aged_cycles))
        return found

    assert aged("power") == aged("driving", "power")
    assert [count for _, count in aged("power")] == [0, 1, 2, 3]


def test_the_end_of_the_power_cycle_ends_what_a_killed_process_left_open(tmp_path):
    path = tmp_path / "f.sqlite"
    store = Store(path)
    memory = AtOnce(catalogue(confirm=(1,), cycle=("driving",)), store)
    memory.start_cycle(0)
    memory.start_cycle(0, "driving")
    fail(memory, 0)
    memory.start_cycle(1, "driving")
    heal(memory, 0)
    memory.commit()
    store.close()
    after = AtOnce(catalogue(confirm=(1,), cycle=("driving",)), Store(path))
    assert after.status("m.f0") & Status.PENDING_DTC
    after.start_cycle(2)
    assert after.status("m.f0") & Status.PENDING_DTC, "a death completes nothing"
    after.end_cycle(3)
    assert not after.status("m.f0") & Status.PENDING_DTC, "its driving cycle was complete and good"


# Statistics, readiness, migration


def test_near_misses_add_up_over_cycles_and_go_with_a_clear():
    told = deque([(2, 100), (1, 90), (0, 40)])
    memory = AtOnce(
        catalogue(confirm=(1,)),
        Store(None),
        statistics=lambda k: told.popleft() if told else (0, 0),
    )
    memory.start_cycle(0)
    memory.end_cycle(1)
    memory.fold_statistics()
    entry = memory.entry("m.f0")
    assert (entry.record.near_misses, entry.record.peak_fdc) == (3, 100)
    memory.clear()
    entry = memory.entry("m.f0")
    assert (entry.record.near_misses, entry.record.peak_fdc) == (0, 0)


@pytest.mark.evidence("AUTOSAR DEM: readiness")
def test_readiness_of_each_kind_of_monitor():
    memory = AtOnce(
        catalogue(
            confirm=(1,) * 4,
            readiness=("components", "components", "catalyst", "egr"),
            emission_related=(True, True, True, False),
        ),
        Store(None),
    )
    memory.start_cycle(0)
    assert readiness(memory).obd_bytes == bytes([0x44, 0x01, 0x01])
    heal(memory, 0)
    assert readiness(memory).obd_bytes == bytes([0x44, 0x01, 0x01]), "the other has not run yet"
    fail(memory, 1)
    heal(memory, 2)
    assert readiness(memory).obd_bytes == bytes([0x04, 0x01, 0x00])
    memory.start_cycle(1)
    assert readiness(memory).obd_bytes == bytes([0x04, 0x01, 0x00])
    assert readiness(memory, this_cycle=True).obd_bytes == bytes([0x44, 0x01, 0x01])


@pytest.mark.evidence("Durability: versions")
def test_a_file_of_the_first_version_is_brought_up_to_date_and_keeps_everything(tmp_path):
    path = tmp_path / "old.sqlite"
    db = sqlite3.connect(path)
    db.executescript(f"{MIGRATIONS[0]} PRAGMA application_id = {APPLICATION_ID}; PRAGMA user_version = 1;")
    rows = [("m.f0", 0x030011, 0x2E, 2, 5, 100, 900), ("m.f1", 0x030111, 0xAF, 1, 1, 50, 50)]
    for row in rows:
        db.execute("INSERT INTO fault VALUES (?, ?, ?, ?, ?, ?, ?, '{\"value\": 2.5}')", row)
    db.execute("INSERT INTO freeze_frame VALUES ('m.f0', 1, 100, '{\"x\": 1.0}')")
    db.execute("UPDATE cycle SET number = 7, open = 1, t_ns = 950")
    db.commit()
    db.close()
    listed = {entry["fault"]: entry for entry in service.list_entries(path)}
    assert listed["m.f0"]["occurrence"] == 5
    assert listed["m.f0"]["freeze_frames"] == [{"record": 1, "t_ns": 100, "signals": {"x": 1.0}}]
    memory = AtOnce(catalogue(confirm=(2, 1)), Store(path))
    assert (int(memory.status("m.f0")), memory.entry("m.f0").record.failed_cycles) == (0x2E, 2)
    assert memory.entry("m.f1").record.evidence == {"value": 2.5}
    assert [e.fault for e in memory.in_order("first_failed")] == ["m.f1", "m.f0"]
    assert [e.fault for e in memory.in_order("last_confirmed")] == ["m.f1", "m.f0"]
    memory.start_cycle(1000)
    assert memory.cycle_number() == 7, "the cycle that it left open goes on"


def test_values_that_testers_wrote_survive(tmp_path):
    path = tmp_path / "f.sqlite"
    store = Store(path)
    AtOnce(catalogue(), store).write_identifier(0xF190, b"VIN")
    store.close()
    assert AtOnce(catalogue(), Store(path)).identifiers == {0xF190: b"VIN"}


def test_groups_of_dtcs():
    memory = AtOnce(catalogue(confirm=(1,) * 3, emission_related=(True, False, True)), Store(None))
    for fault in range(3):
        fail(memory, fault)
    assert not memory.knows(0x000000)
    assert not memory.knows(0x400000)
    assert not memory.knows(0x123456)
    memory.clear(0xFFFF33)
    assert stored(memory) == ["m.f1"]
    memory.clear(0x000000)
    assert stored(memory) == ["m.f1"]


def test_the_cooldown_ends_when_it_says():
    recorder = Recorder(RecorderParams(after_ms=0.0, cooldown_s=2.0), ("b",))
    for t_s in (0, 1, 2, 3, 4):
        recorder.on_failure("m.f0", t_s * 10**9)
    assert recorder.refused == 2
    assert [r.t_ns for r in recorder.on_time(10**10)] == [0, 2 * 10**9, 4 * 10**9]

"""A memory without room: what it refused or displaced is entered when there is room."""

from fault_examples import AtOnce, catalogue, event, frame, nothing

from gateway.faults.status import Status
from gateway.faults.store import Store

S = 1_000_000_000


def failing(memory, *faults):
    for fault in faults:
        memory.apply(event(fault, True, fault), frame({"x": float(fault)}))


def test_what_a_full_memory_refused_is_entered_when_there_is_room():
    memory = AtOnce(
        catalogue((1,) * 4, emission_related=(False,) * 4, priority=(5, 5, 7, 6)),
        Store(None),
        size=2,
    )
    memory.start_cycle(0)
    failing(memory, 0, 1, 2, 3)
    assert [e.fault for e in memory.entries()] == ["m.f0", "m.f1"]
    assert memory.admit_refused(9) == [], "there is no room"
    memory.clear(memory.catalogue[1].dtc.value)
    (change,) = memory.admit_refused(10)
    assert change.definition.id == "m.f3", "the more important of the two"
    assert (int(change.old_status), int(change.new_status), change.t_ns) == (0x23, 0x2F, 10)
    entry = memory.entry("m.f3")
    assert (entry.record.occurrence, entry.record.first_ns) == (1, 3), "as it was when it failed"
    assert entry.freeze_frames[0].content == {"x": 3.0}
    memory.apply(event(2, False, 11), nothing)
    memory.clear()
    assert memory.admit_refused(12) == [], "the other has passed meanwhile"


def test_what_gave_way_comes_back_when_there_is_room():
    memory = AtOnce(catalogue((1,) * 2, emission_related=(False,) * 2, priority=(9, 1)), Store(None), size=1)
    memory.start_cycle(0)
    failing(memory, 0, 1)
    assert [e.fault for e in memory.entries()] == ["m.f1"]
    memory.clear(memory.catalogue[1].dtc.value)
    assert [c.definition.id for c in memory.admit_refused(5)] == ["m.f0"]
    assert memory.status("m.f0") & Status.CONFIRMED_DTC
    assert memory.entry("m.f0").freeze_frames[0].content == {"x": 0.0}


def test_an_earlier_cycles_failure_is_not_entered_as_one_of_this_cycle():
    memory = AtOnce(catalogue((1,) * 2, emission_related=(False,) * 2), Store(None), size=1)
    memory.start_cycle(0)
    failing(memory, 0, 1)
    memory.start_cycle(5)
    memory.clear(memory.catalogue[0].dtc.value)
    assert memory.admit_refused(6) == [], "it is tested again in this one"


def test_a_fault_refused_and_healed_is_confirmed_when_it_fails_again_in_the_same_cycle():
    memory = AtOnce(catalogue((1,) * 2, emission_related=(False,) * 2), Store(None), size=1)
    memory.start_cycle(0)
    failing(memory, 0, 1)
    memory.apply(event(1, False), nothing)
    memory.clear(memory.catalogue[0].dtc.value)
    failing(memory, 1)
    assert memory.status("m.f1") & Status.CONFIRMED_DTC

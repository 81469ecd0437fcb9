"""A small matrix of the diagnosis: faults that run fast, each of another kind; ``gateway evaluate cause`` has all."""

import pytest
from amount import amount

from gateway_fleet.study.cause.cases import alike, faults
from gateway_fleet.study.cause.matrix import Job, pair_of, run

SEED = 31
#: Plant -> its faults that are tried: sensors, actuators, plants, messages.
SOME = {
    "motor": ("f_w", "f_R"),
    "pedal": ("short_to_ground 1", "brake drift"),
    "signals": ("value Vehicle.Coolant", "freeze WheelSpeeds.RL"),
    "restbus": ("lost WheelSpeeds", "checksum Vehicle", "offset WheelSpeeds.FL"),
    "truck": ("machine_voltage_sensor",),
}


def some():
    every = amount(1, 0, 0)
    return [fault for fault in faults() if every or fault.name in SOME.get(fault.plant, ())]


@pytest.mark.parametrize("fault", some(), ids=lambda fault: f"{fault.plant} {fault.name}")
def test_a_single_fault_is_named_first_and_nobody_else_alone(fault):
    (row,) = run(Job(fault.plant, fault.name, SEED, (fault,)))
    print("seed", SEED, row)
    assert row.verdict.seen
    assert row.verdict.place == 1
    # A message without a counter may be frozen as a whole: no test of the bench tells that from one signal that stands.
    assert row.verdict.alone is not fault.name.startswith("freeze ")
    assert row.verdict.right == 1.0
    assert 0.0 < row.verdict.chance <= 1.0
    assert not row.verdict.healthy
    assert not row.verdict.before


@pytest.mark.parametrize(
    ("plant", "one", "other"),
    [
        ("signals", "value Vehicle.Coolant", "value WheelSpeeds.FL"),
        ("brake", "f_R", "f_F"),
        ("belt", "output_offset 2", "output_stuck 1"),  # of the plant linear
        ("truck", "battery_short", "machine_voltage_sensor"),
        ("steering", "wheel_angle_offset", "current_offset"),
        ("steering", "pinion_angle_offset", "wheel_angle_offset"),
    ],
)
def test_two_faults_are_both_in_the_first_diagnosis(plant, one, other):
    first, second = (next(f for f in faults() if (f.plant, f.name) == (plant, name)) for name in (one, other))
    (row,) = run(pair_of(first, second, SEED))
    print("seed", SEED, row)
    assert row.verdict.place == 1
    assert not row.verdict.healthy


@pytest.mark.parametrize(
    ("plant", "one", "other", "seed"),
    [
        ("battery", "f_R1", "f_I", 771003),
        ("brake", "f_s", "f_a", 560184),  # what alone tells of f_a passes once it has begun
    ],
)
def test_one_of_two_is_not_told_for_certain_where_it_does_not_fit_alone(plant, one, other, seed):
    named = {fault.name: fault for fault in faults() if fault.plant == plant}
    (row,) = run(pair_of(named[one], named[other], seed))
    print(row)
    assert row.verdict.right == 1.0 or row.verdict.chance < 0.99


@pytest.mark.parametrize("base", ["signals_faults", "restbus"])
def test_without_a_fault_nothing_is_told(base):
    (row,) = run(Job(base, "healthy", SEED, base=base))
    assert not row.verdict.before


def test_what_others_explain_as_well_is_known_by_the_structure():
    named = {(fault.plant, fault.name): fault for fault in faults()}
    motor = alike(named["motor", "f_R"], named["motor", "f_b"])
    assert len(motor) == 5, "each other pair of its four faults"
    assert alike(named["tanks", "f_p"], named["tanks", "f_2"]) == frozenset()
    short, offset = named["pedal", "short_to_ground 1"], named["pedal", "offset 2"]
    assert alike(short, offset) == {short.truth}, "beside a channel that is out of range the other one is not seen"

"""A small matrix: faults that run fast, each of another kind; the large one is ``gateway evaluate cause``."""

import pytest
from amount import amount

from gateway_fleet.study.cause.cases import faults
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
    assert row.verdict.alone
    assert not row.verdict.healthy
    assert not row.verdict.before


@pytest.mark.parametrize(
    ("plant", "one", "other"), [("signals", "value Vehicle.Coolant", "value WheelSpeeds.FL"), ("brake", "f_R", "f_F")]
)
def test_two_faults_are_both_in_the_first_diagnosis(plant, one, other):
    first, second = (next(f for f in faults() if (f.plant, f.name) == (plant, name)) for name in (one, other))
    (row,) = run(pair_of(first, second, SEED))
    print("seed", SEED, row)
    assert row.verdict.place == 1
    assert not row.verdict.healthy


@pytest.mark.parametrize("base", ["signals_faults", "restbus"])
def test_without_a_fault_nothing_is_told(base):
    (row,) = run(Job(base, "healthy", SEED, base=base))
    assert not row.verdict.before

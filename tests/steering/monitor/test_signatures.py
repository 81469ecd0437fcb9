"""The steering monitor's signature table: what sets of symptoms are called, and what may take whose place."""

import pytest

from gateway_fdi.isolation.table import OPEN
from gateway_fdi.jit import zeros
from gateway_plants.steering.monitor import decision, symptoms
from gateway_plants.steering.monitor.decision import NONE, SIGNATURES
from gateway_plants.steering.monitor.faults import (
    ANGLES,
    CURRENT,
    DRIFT,
    ELECTRIC,
    IMPLAUSIBLE,
    INTERMITTENT,
    NOISE,
    OFFSET,
    PAIRING,
    PINION,
    SCALE,
    STUCK,
    VOLTAGE,
    WHEEL,
)
from gateway_plants.steering.monitor.params import Params, Thresholds
from gateway_plants.steering.monitor.symptoms import (
    BOTH_SIGNS,
    ELECTRIC_MISFIT,
    EMF_CONSISTENT,
    EMF_CONTRADICTS,
    EXCEEDS,
    FREQUENT,
    GROWS_WITH_TIME,
    LASTING,
    NET_STEP,
    NIS_FIRST,
    PARITY_ALARM,
    RATE_CONSISTENT,
    RATE_CONTRADICTS,
    REPEATS,
    RETURNS,
    STEP_AT_ONCE,
    SUDDEN,
)


def lookup(on, found):
    """The fault whose signature a set of symptoms has, beside the one that stands; NONE without."""
    s, c = zeros(1, decision.State), zeros(1, decision.Const)
    decision.prepare(s[0], c[0], Params())
    s[0].on[0], s[0].found = on, found
    said = decision.lookup(s[0], c[0])
    return NONE if said == OPEN else said


def test_each_signature_is_found_by_its_own_symptoms():
    """No row is hidden behind one above it."""
    for row in SIGNATURES:
        for found in row.replaces:
            assert lookup(row.on, found) == row.fault


def test_each_fault_of_a_part_has_a_signature_and_an_alarm():
    assert {row.fault for row in SIGNATURES} == set(range(PAIRING)) == set(decision.ALARM_OF)


def test_no_symptom_is_required_and_forbidden_at_once():
    assert all(row.on & row.off == 0 and row.on for row in SIGNATURES)


def test_alarms_are_in_the_order_of_the_thresholds():
    names = [name.upper() for name in Thresholds.model_fields]
    assert [getattr(symptoms, name) for name in names] == list(range(symptoms.ALARMS))


@pytest.mark.parametrize(
    ("on", "fault"),
    [
        (0, NONE),
        (EXCEEDS | SUDDEN, OFFSET),
        (EXCEEDS | SUDDEN | RETURNS | BOTH_SIGNS, INTERMITTENT),
        (EXCEEDS | NET_STEP, OFFSET),
        (EXCEEDS | NET_STEP | NIS_FIRST, NONE),  # currents or voltages: the filter is wrong
        (EXCEEDS | FREQUENT | BOTH_SIGNS, NOISE),
        (EXCEEDS | FREQUENT | BOTH_SIGNS | REPEATS, STUCK),
        (ELECTRIC_MISFIT | STEP_AT_ONCE, CURRENT),
        (ELECTRIC_MISFIT | STEP_AT_ONCE | PARITY_ALARM, NONE),  # an angle upsets them
        (PARITY_ALARM, NONE),
        (PARITY_ALARM | LASTING, ANGLES),
        (PARITY_ALARM | LASTING | RATE_CONTRADICTS, WHEEL),
        (PARITY_ALARM | LASTING | EMF_CONSISTENT, ANGLES),
        (PARITY_ALARM | LASTING | EMF_CONSISTENT | RATE_CONSISTENT, PINION),
        (PARITY_ALARM | LASTING | EMF_CONTRADICTS, IMPLAUSIBLE),
        (EMF_CONTRADICTS | GROWS_WITH_TIME, DRIFT),
    ],
)
def test_what_a_set_of_symptoms_is_called(on, fault):
    assert lookup(on, NONE) == fault


@pytest.mark.parametrize(
    ("found", "on", "fault"),
    [
        (ANGLES, EMF_CONTRADICTS, IMPLAUSIBLE),
        (IMPLAUSIBLE, PARITY_ALARM | LASTING, NONE),
        (WHEEL, SUDDEN, OFFSET),
        (WHEEL, EMF_CONTRADICTS, NONE),
        (ELECTRIC, ELECTRIC_MISFIT | STEP_AT_ONCE, CURRENT),
        (ANGLES, ELECTRIC_MISFIT, NONE),
        (OFFSET, REPEATS, NONE),
        (SCALE, SUDDEN, NONE),
        (VOLTAGE, ELECTRIC_MISFIT | STEP_AT_ONCE, NONE),
    ],
)
def test_what_stands_is_replaced_by_what_is_known_better_alone(found, on, fault):
    assert lookup(on, found) == fault


def test_the_gear_tells_of_angles_alone():
    gear = {k for k in range(PAIRING) if decision.needs_gear(k)}
    assert gear == {DRIFT, SCALE, IMPLAUSIBLE, WHEEL, PINION, ANGLES}
    assert not decision.needs_gear(NONE)

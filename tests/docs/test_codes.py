"""docs/codes.md against the code: every fault is there, with the DTC that it has; base codes mean what they say."""

import re
from pathlib import Path

import pytest

from gateway.engine.checks import bus_health, clock_health, kinds, own_health
from gateway_fdi.common.resources import all_shipped
from gateway_plants.crank.monitor import faults as crank
from gateway_plants.steering.monitor import faults as steering
from gateway_plants.truck.monitor import faults as truck

ROOT = Path(__file__).parents[2]
KNOWN = {
    "crank": crank.FAULTS,
    "steering": steering.FAULTS,
    "truck": truck.faults_of(("t1_x",)),
    "check": [kind.fault for kind in kinds.KINDS],
    "bus": bus_health.FAULTS,
    "gateway": (*clock_health.OWN_FAULTS, *own_health.FAULTS),
}


def table():
    rows = re.findall(r"^\| (\w+) `(\w+)` \| ([PCBU]\w{4}-\w\w) \|", (ROOT / "docs/codes.md").read_text(), re.M)
    return {(owner, name): dtc for owner, name, dtc in rows}


def test_the_table_is_what_the_code_has():
    assert table() == {(owner, fault.name): fault.dtc for owner, faults in KNOWN.items() for fault in faults}


@pytest.mark.parametrize(("name", "dtc"), [("missed_pulse", "P0336-39"), ("added_pulse", "P0336-3A")])
def test_pulses_have_their_exact_failure_types(name, dtc):
    assert {fault.name: fault.dtc for fault in crank.FAULTS}[name] == dtc


@pytest.mark.parametrize(("name", "dtc"), [("motor_angle_drift", "C1A01-02"), ("motor_angle_scale", "C1A01-91")])
def test_a_motor_angle_that_is_off_is_neither_a_rate_of_change_nor_a_waveform(name, dtc):
    """Not -26 (rate of change below threshold), nor -25 (waveform): of an angle that moves, and is a number."""
    assert {fault.name: fault.dtc for fault in steering.FAULTS}[name] == dtc


def test_no_signal_is_only_said_where_there_is_none():
    silent = {name for (_, name), dtc in table().items() if dtc.endswith("-31")}
    assert silent == {"cam_silent", "bus_lost"}


def test_no_configuration_borrows_another_sensors_code():
    """P0A3F to P0A42 are the position sensor of drive motor A, whatever the belt's drive may have."""
    for file in all_shipped("configs", ".toml"):
        assert not re.search(r"P0A(3F|4[012])", file.read_text()), file.name

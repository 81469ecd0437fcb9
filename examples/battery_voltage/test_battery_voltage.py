"""The monitor by itself, and on a bus; the scenario is a test, too (pytest.ini). Fixtures: docs/bench.md."""

import pytest
from battery_voltage import MONITOR


def test_missing_random_and_extreme_inputs_do_no_harm(check_monitor):
    check_monitor(MONITOR)
    check_monitor(MONITOR, low=0.0, hysteresis=0.0)


def drained(virtual_ecu, volts):
    """Switch a battery on that has another voltage from 5 to 10 s."""
    fault = {"kind": "drained", "from_s": 5.0, "to_s": 10.0, "volts": volts}
    virtual_ecu("battery_ecu:ECU", faults=[fault], duration_s=20.0)


@pytest.mark.parametrize(("volts", "dtc"), [(10.5, "P0562-16"), (16.5, "P0563-17")])
def test_a_battery_that_is_too_low_or_too_high_is_named_and_heals(virtual_ecu, dtcs, volts, dtc):
    drained(virtual_ecu, volts)
    dtcs.expect(dtc, by=6.0, healed_by=12.0)


@pytest.mark.parametrize("volts", [11.2, 12.6, 15.2])
def test_a_good_battery_is_not_accused(virtual_ecu, dtcs, gateway_bench, volts):
    drained(virtual_ecu, volts)
    gateway_bench.run(15.0)
    dtcs.none()

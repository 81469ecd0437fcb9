"""The scenario as the gateway plays it, and single steps of the monitor."""

from pathlib import Path

import pytest

from gateway.config.load import load_config
from gateway.runtime.app import Gateway
from gateway.runtime.drive import drive
from gateway.vecu.player import Player
from gateway.vecu.scenario import load_scenario

HERE = Path(__file__).parent


def play(**fault):
    """Play the scenario with another fault; returns the DTCs that were set."""
    scenario = load_scenario(HERE / "drained.toml")
    faults = tuple(f.model_copy(update=fault) for f in scenario.fault)
    scenario = scenario.model_copy(update={"fault": faults})
    config = load_config(scenario.config)
    gateway, told = Gateway(config), []
    gateway.listen(told.append)
    drive(gateway, Player(scenario, {bus.name: k for k, bus in enumerate(config.bus)}))
    gateway.close()
    return [e["dtc"] for e in told if e["event"] == "dtc" and e["status"] & 1]


@pytest.mark.parametrize(("volts", "dtc"), [(10.5, "P0562-16"), (16.5, "P0563-17")])
def test_a_battery_that_is_too_low_or_too_high_is_named(volts, dtc):
    assert play(volts=volts) == [dtc]


@pytest.mark.parametrize("volts", [11.2, 12.6, 15.2])
def test_a_good_battery_is_not_accused(volts):
    assert play(volts=volts) == []

"""The scenario as the gateway plays it, and healthy drives that the monitor must not accuse."""

from pathlib import Path

import numpy as np
import pytest

from gateway.config.load import load_config
from gateway.runtime.app import Gateway
from gateway_bench.drive import drive
from gateway_bench.vecu.player import Player
from gateway_bench.vecu.scenario import load_scenario

HERE = Path(__file__).parent


def play(seed=1, faults=None, **ecu):
    """Play the scenario; returns the DTCs that were set, and the gateway."""
    scenario = load_scenario(HERE / "jam.toml")
    changes = {"ecu": tuple(e.model_copy(update=ecu) for e in scenario.ecu)}
    if faults is not None:
        changes["fault"] = faults
    scenario = scenario.model_copy(update=changes)
    config = load_config(scenario.config)
    gateway, told = Gateway(config), []
    gateway.listen(told.append)
    drive(gateway, Player(scenario, {bus.name: k for k, bus in enumerate(config.bus)}, seed=seed))
    gateway.close()
    return [e["dtc"] for e in told if e["event"] == "dtc" and e["status"] & 1], gateway


def test_a_jam_is_named():
    assert play()[0] == ["C1B41-72"]


@pytest.mark.parametrize("seed", range(5))
def test_a_healthy_drive_is_silent_and_its_load_is_found(seed):
    found, gateway = play(seed, faults=(), load=0.15)
    assert found == []
    assert gateway.engine.readout()["motor"]["load"] == pytest.approx(0.15, abs=0.05)
    assert np.isfinite(gateway.engine.readout()["motor"]["speed"])

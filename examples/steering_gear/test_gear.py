"""The paper's equation beside the gateway's own monitor, on the shipped scenarios."""

from pathlib import Path

import pytest

from gateway.config.load import load_config
from gateway.runtime.app import Gateway
from gateway_bench.drive import drive
from gateway_bench.vecu.player import Player
from gateway_bench.vecu.scenario import load_scenario
from gateway_fdi.common.resources import shipped

HERE = Path(__file__).parent


def failures(name):
    """Return when each fault of the two monitors was confirmed, in order [s]."""
    path = HERE / "gateway.toml"
    scenario = load_scenario(shipped(f"scenarios/steering/{name}.toml")).model_copy(update={"config": path})
    config, found = load_config(path), []
    gateway = Gateway(config, file=path)
    gateway.listen(found.append)
    drive(gateway, Player(scenario, {bus.name: k for k, bus in enumerate(config.bus)}, seed=4))
    gateway.close()
    return [(e["fault"], round(e["t_ns"] / 1e9, 1)) for e in found if e["event"] == "dtc" and e["status"] & 1]


def test_a_healthy_steering_is_silent():
    assert failures("steering_healthy") == []


@pytest.mark.parametrize(
    ("name", "times"),
    [("steering_parts", [4.1]), ("steering_angle", [4.1, 11.7])],
)
def test_it_sees_that_the_angles_do_not_fit_and_the_gateways_own_names_the_part(name, times):
    found = failures(name)
    assert [t_s for fault, t_s in found if fault == "gear.angles"] == pytest.approx(times, abs=0.1)
    own = [fault for fault, _ in found if fault.startswith("steering.")]
    assert len(own) >= 5

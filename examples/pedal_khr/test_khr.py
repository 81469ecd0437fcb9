"""The paper's voter beside the gateway's own, on the scenario pedal_faults."""

from pathlib import Path

from gateway.config.load import load_config
from gateway.runtime.app import Gateway
from gateway_bench.drive import drive
from gateway_bench.vecu.player import Player
from gateway_bench.vecu.scenario import load_scenario
from gateway_fdi.common.resources import shipped

HERE = Path(__file__).parent


def failures(faults=True):
    """Return when each fault of the two monitors was confirmed, in order [s]."""
    path = HERE / "gateway.toml"
    scenario = load_scenario(shipped("scenarios/pedal/pedal_faults.toml"))
    scenario = scenario.model_copy(update={"config": path} | ({} if faults else {"fault": (), "duration_s": 10.0}))
    config, found = load_config(path), []
    gateway = Gateway(config, file=path)
    gateway.listen(found.append)
    drive(gateway, Player(scenario, {bus.name: k for k, bus in enumerate(config.bus)}, seed=4))
    gateway.close()
    return [(e["fault"], e["t_ns"] / 1e9) for e in found if e["event"] == "dtc" and e["status"] & 1]


def test_a_healthy_pedal_is_silent():
    assert failures(faults=False) == []


def test_it_finds_what_differs_and_the_gateways_own_names_what_it_is():
    found = [(name, round(t_s, 1)) for name, t_s in failures() if t_s < 29.0]
    assert [one for one in found if one[0].startswith("khr")] == [
        ("khr.channel_1", 3.0), ("khr.channel_2", 7.0), ("khr.channel_2", 15.0), ("khr.channel_1", 24.2),
    ]  # fmt: skip
    assert [one for one in found if one[0].startswith("brake")] == [
        ("brake.channel_1_low", 3.0), ("brake.channel_2_high", 7.0), ("brake.channel_1_stuck", 11.0),
        ("brake.channel_2_implausible", 15.0), ("brake.channel_1_erratic", 19.0), ("brake.drift", 23.4),
    ]  # fmt: skip

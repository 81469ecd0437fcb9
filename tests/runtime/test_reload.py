"""A gateway that goes on with the configuration it had sees and says what it would have without the change."""

import random

import numpy as np
import pytest

from gateway.config.load import load_config
from gateway.runtime.app import Gateway
from gateway.runtime.assemble import prepare
from gateway_bench.vecu.player import Player
from gateway_bench.vecu.scenario import load_scenario
from gateway_fdi.common.resources import shipped

SCENARIOS = [
    "crank_missed_tooth",
    "crank_wire_corrupted",
    "crank_cam",
    "diagnostics",
    "pedal_three",
]


def frames_of(name, seconds):
    scenario = load_scenario(shipped(f"scenarios/{name}.toml"))
    config = load_config(scenario.config)
    buses = {bus.name: k for k, bus in enumerate(config.bus)}
    short = scenario.model_copy(update={"duration_s": min(scenario.duration_s, seconds)})
    return config, Player(short, buses).frames


def play(config, frames, cuts, change=lambda config: config):
    """Feed frames, changing over to a new gateway at each cut; returns events, sent frames and the last gateway."""
    gateway = Gateway(config)
    events, sent = [], []
    gateway.listen(events.append)
    gateway.start(0)
    for start, stop in zip([0, *cuts], [*cuts, len(frames)], strict=True):
        if start:
            new = change(config)
            sent.append(gateway.finish(gateway.engine.now_ns))
            successor = Gateway(new, parts=prepare(new), store=gateway.store)
            successor.succeed(gateway)
            gateway = successor
        for k in range(start, stop, 500):
            sent.append(gateway.feed(frames[k : min(k + 500, stop)]))
    return events, np.concatenate(sent), gateway


@pytest.mark.evidence("Live is replay: reload same")
@pytest.mark.parametrize("name", SCENARIOS)
def test_a_reload_of_the_same_configuration_changes_nothing(name):
    config, frames = frames_of(name, 8.0)
    seed = sum(map(ord, name))
    print("seed", seed)
    cuts = sorted(random.Random(seed).sample(range(1, len(frames)), 5))
    expected, sent, one = play(config, frames, [])
    found, again, last = play(config, frames, cuts)
    assert [e for e in expected if e["event"] == "dtc"], "or the test shows nothing"
    assert found == expected
    mine = sent[np.isin(sent["can_id"], one.engine.emitted)]
    also = again[np.isin(again["can_id"], last.engine.emitted)]
    np.testing.assert_array_equal(also, mine, "what monitors send, alive counters and all")
    assert last.engine.readout() == one.engine.readout()
    assert last.engine.counters() == one.engine.counters()
    assert last.memory.entries() == one.memory.entries()
    assert last.memory.cycle_number() == one.memory.cycle_number() == 1, "the same operation cycle"


@pytest.mark.parametrize("name", ["linear_belt_faults", "truck_healthy", "steering_healthy"])
def test_monitors_whose_parameters_keep_what_they_computed_go_on(name):
    """Arrays among the parameters have no truth value: a reload ended the daemon."""
    config, frames = frames_of(name, 2.0)
    _, _, one = play(config, frames, [])
    _, _, last = play(config, frames, [len(frames) // 2])
    assert last.engine.readout() == one.engine.readout()
    assert all(shown["steps"] for shown in one.engine.readout().values())


def test_what_changed_starts_anew_and_the_rest_goes_on():
    config, frames = frames_of("crank_missed_tooth", 6.0)

    def with_other_wheel(config):
        (monitor,) = config.monitor
        return config.model_copy(update={"monitor": (monitor.model_copy(update={"name": "other"}),), "fault": {}})

    cut = len(frames) // 2
    _, _, last = play(config, frames, [cut], with_other_wheel)
    steps = last.engine.readout()["other"]["steps"]
    assert 0 < steps < 0.6 * len(frames), "only since the change"
    assert last.engine.counters()["frames"] == len(frames), "the counters go on"
    assert last.memory.definition("crank.missed_pulse").description == "no longer monitored"


def test_the_frames_around_a_failure_are_kept_though_the_change_comes_between():
    """The recording is cut where the configuration changes: 0.1 s after the failure instead of 0.5 s."""
    config, frames = frames_of("crank_missed_tooth", 6.0)
    cut = int(np.searchsorted(frames["t_ns"], 4.1e9))
    _, _, last = play(config, frames, [cut])
    (recording,) = last.store.recordings("crank.missed_pulse")
    assert 300 < recording.frames < 600, "a second before, and what there was after"


def test_active_faults_stay_active_over_a_reload():
    config, frames = frames_of("crank_missed_tooth", 8.0)
    cut = int(np.searchsorted(frames["t_ns"], 4.3e9))
    gateway = Gateway(config)
    gateway.start(0)
    gateway.feed(frames[:cut])
    failing = [e.fault for e in gateway.memory.entries() if e.status & 1]
    assert failing == ["crank.missed_pulse"]
    fdc = gateway.controls.fault_detection_counter("crank.missed_pulse")
    assert fdc != 0
    gateway.finish(gateway.engine.now_ns)
    successor = Gateway(config, parts=prepare(config), store=gateway.store)
    successor.succeed(gateway)
    assert [e.fault for e in successor.memory.entries() if e.status & 1] == failing
    index = [slot.id for slot in successor.engine.faults].index("crank.missed_pulse")
    assert successor.engine.tables.debounces[index]["active"] == 1
    assert successor.engine.fault_detection_counter(index) == fdc

"""One wrong actuator: the daemon, a replay of the same frames, and a fleet of one log say the same of its cause."""

import json
import re

import pytest
from daemon_rig import TURN_NS, World
from shared_signal import frames as car_frames
from shared_signal import write as write_car

from gateway.bus.logs import open_writer
from gateway.config.load import load_config
from gateway.faults import service
from gateway_bench.vecu.player import Player
from gateway_bench.vecu.scenario import load_scenario
from gateway_fdi.common.resources import shipped
from gateway_fleet.fleet.run import Order, run
from gateway_fleet.fleet.verdicts import Verdicts
from gateway_logs.corpus import find
from gateway_replay.cli.replay import replay

URI = "virtual:a"


def aircraft(folder):
    """The rudder does something else than it is commanded; a configuration for a bus of the test."""
    scenario = load_scenario(shipped("scenarios/linear_aircraft_faults.toml"))
    text = scenario.config.read_text()
    text = re.sub(r'uri = "[^"]*"', f'uri = "{URI}"', text).replace('"../', f'"{scenario.config.parent.parent}/')
    (folder / "gateway.toml").write_text(text)
    config = load_config(folder / "gateway.toml")
    buses = {bus.name: k for k, bus in enumerate(config.bus)}
    return folder / "gateway.toml", Player(scenario.model_copy(update={"duration_s": 14.0}), buses).frames


def car(folder):
    """A speed that breaks three rules, whose symptoms are held."""
    path = write_car(folder, memory='symptoms = "hold"')
    path.write_text(re.sub(r'uri = "[^"]*"', f'uri = "{URI}"', path.read_text()))
    return path, car_frames(0.0, 8.0, Speed=40)


def lived(folder, config, frames):
    """Play the frames to a daemon; returns its events."""
    world = World()
    frames["t_ns"] += world.now_ns + world.ahead_ns + TURN_NS
    left = list(frames)

    def each(_turn):
        while left and left[0]["t_ns"] <= world.now_ns + world.ahead_ns:
            frame = left.pop(0)
            world.put(int(frame["can_id"]), bytes(frame["data"][: int(frame["length"])]))

    daemon = world.daemon(config, folder / "live.sqlite")
    world.play(daemon, world.wait((int(frames["t_ns"][-1] - frames["t_ns"][0])) / 1e9 + 0.01, each))
    daemon.close()
    return [event for _, event in world.events]


def said(events):
    """What is told of causes, by the time since the first diagnosis, and of DTCs."""
    told = [event for event in events if event["event"] in ("diagnosis", "symptoms")]
    begin = told[0]["t_ns"]
    return [{**event, "t_ns": event["t_ns"] - begin} for event in told]


def kept(path):
    return {
        entry["fault"]: (entry["status"], entry["hold"], {**entry["cause"], "t_ns": 0})
        for entry in service.list_entries(path)
        if entry["cause"]
    }


@pytest.mark.evidence("Live is replay: causes")
@pytest.mark.parametrize(
    ("make", "cause"), [(aircraft, "actuator flight.Aircraft_Command.Rudder"), (car, "signal can0.Speed.V")]
)
def test_live_replay_and_fleet_say_the_same(tmp_path, capsys, make, cause):
    config, frames = make(tmp_path)
    frames["t_ns"] -= frames["t_ns"] % TURN_NS
    live = lived(tmp_path, config, frames)
    log = tmp_path / "drive.log"
    with open_writer(log, interfaces={0: "can0"}) as writer:
        writer.write(frames)
    capsys.readouterr()
    replay(log, config, memory=tmp_path / "replay.sqlite", injections=[], json=True, fail_on_dtc=False)
    replayed = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert said(live) == said(replayed)
    assert kept(tmp_path / "live.sqlite") == kept(tmp_path / "replay.sqlite")
    run(Order(find([log]), config, tmp_path / "out", workers=0))
    rows = {row["fault"]: row for row in Verdicts(tmp_path / "out").rows("dtcs")}
    stored = kept(tmp_path / "live.sqlite")
    assert stored
    for fault, (status, _, found) in stored.items():
        row = rows[fault]
        assert (row["cause"], row["probability"], row["role"]) == (cause, found["probability"], found["role"])
        assert row["status"] == status

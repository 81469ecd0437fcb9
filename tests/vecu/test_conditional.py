"""Faults of a plant whose frames are made beforehand, by a condition on signals: as by the times when it holds."""

import numpy as np
import pytest

from gateway.config.load import load_config
from gateway.runtime.app import Gateway
from gateway_bench.drive import drive
from gateway_bench.scenario_session import player_of
from gateway_bench.vecu.scenario import load_scenario
from gateway_fdi.common.resources import shipped
from gateway_fdi.errors import GatewayError

HEAD = shipped("scenarios/linear_belt_faults.toml").read_text().partition("[[fault]]")[0]
HEAD = HEAD.replace("duration_s = 40.0", "duration_s = 12.0")
#: Of a motor whose voltage swings around 8 V with 3 s: each time it is above 11 V.
FAULT = '[[fault]]\nkind = "actuator_offset"\nplace = 1\nsize = 1.0\n'


def play(folder, more):
    """Return the DTCs that were set, what was injected, and all frames."""
    file = folder / "scenario.toml"
    file.write_text(HEAD + more)
    scenario = load_scenario(file)
    config = load_config(scenario.config)
    player = player_of(scenario, config)
    gateway, events = Gateway(config), []
    gateway.listen(events.append)
    frames = player.frames.copy()
    drive(gateway, player)
    gateway.close()
    return {e["dtc"] for e in events if e["event"] == "dtc" and e["status"] & 1}, player.truth, frames


@pytest.mark.long
def test_it_is_there_each_time_that_the_condition_holds(tmp_path):
    name = "Belt_Command.Voltage"
    dtcs, truth, frames = play(tmp_path, f'{FAULT}from_s = 2.0\nto_s = 11.0\nwhen = "{name} > 11"\n')
    times = [fact.t_ns / 1e9 for fact in truth]
    assert [fact.kind for fact in truth] == ["actuator_offset"] * 3, "8 + 4 sin(2 pi t / 3) in 2 s to 11 s"
    assert times == pytest.approx([3.4, 6.4, 9.4], abs=0.03)
    assert "P1A30-64" in dtcs
    spans = [(t, t + fact.count * 0.01) for t, fact in zip(times, truth, strict=True)]
    by_time = "".join(f"{FAULT}from_s = {a}\nto_s = {b}\n" for a, b in spans)
    same = play(tmp_path, by_time)
    assert dtcs == same[0]
    assert (frames["data"] == same[2]["data"]).mean() > 0.999, "a sample is of either where a span ends within it"
    healthy = play(tmp_path, "")
    assert healthy[0] == set()
    differs = frames["t_ns"][(frames["data"] != healthy[2]["data"]).any(axis=1)]
    assert times[0] < differs[0] / 1e9 < times[0] + 0.1


WRONG = {
    "Belt_Command.Volts > 11": "no signal 'Volts'",
    "Belt_Command.Voltage + 11": "compares",
    "Aircraft_Command.Rudder > 1": "no virtual ECU sends Aircraft_Command",
}


@pytest.mark.parametrize("when", WRONG)
def test_mistakes_are_one_line(when, tmp_path):
    with pytest.raises(GatewayError) as told:
        play(tmp_path, f'{FAULT}from_s = 1.0\n\n{FAULT}from_s = 2.0\nwhen = "{when}"\n')
    assert "fault[1].when" in str(told.value)
    assert WRONG[when] in str(told.value)
    assert len(str(told.value).splitlines()) == 1


def test_a_fault_that_has_no_times_has_no_condition(tmp_path):
    text = shipped("scenarios/crank_missed_tooth.toml").read_text()
    text = text.replace("../gateway.toml", str(shipped("gateway.toml")))
    before, _, after = text.partition("[[fault]]\n")
    (tmp_path / "crank.toml").write_text(f'{before}[[fault]]\nwhen = "CTW_PT4.FrameCnt > 3"\n{after}')
    with pytest.raises(GatewayError, match=r"fault\[0\]\.when.*goes by time only"):
        scenario = load_scenario(tmp_path / "crank.toml")
        player_of(scenario, load_config(scenario.config))


def test_the_same_seed_gives_the_same_run(tmp_path):
    more = f'{FAULT}from_s = 0.0\nwhen = "Belt_Command.Voltage > 11"\n'
    one, two = (play(tmp_path, more)[2] for _ in range(2))
    assert np.array_equal(one, two)

"""Faults of messages and signals of ECUs that know nothing of them: shipped ones, and one of a user."""

import pytest

from gateway.config.load import load_config
from gateway.runtime.app import Gateway
from gateway_bench.drive import drive
from gateway_bench.scenario_session import player_of
from gateway_bench.vecu.scenario import load_scenario
from gateway_fdi.common.resources import shipped
from gateway_fdi.errors import GatewayError

BATTERY = shipped("examples") / "battery_voltage"
CRANK = """
name = "crank"
duration_s = 4.0
seed = 5
config = "{config}"
[[ecu]]
wheel = "60-2"
speed = [[0, 1500], [4, 1500]]
"""
DRAINED = """
name = "battery"
duration_s = 6.0
seed = 5
config = "{config}"
[[ecu]]
type = "battery_ecu:ECU"
"""
#: ECU, fault -> DTCs.
TABLE = [
    ("crank", {"kind": "checksum", "message": "CTW_PT4"}, {"83"}),
    ("crank", {"kind": "counter", "message": "CTW_PT4"}, {"82"}),
    ("crank", {"kind": "lost", "message": "CTW_PT4"}, {"87"}),
    ("battery", {"kind": "offset", "signal": "BATT.Voltage", "size": -3}, {"16"}),
    ("battery", {"kind": "value", "signal": "BATT.Voltage", "size": 17}, {"17"}),
    ("battery", {"kind": "bus_off"}, {"87"}),
    ("battery", {"kind": "drift", "signal": "BATT.Voltage", "size": -1, "when": "BATT.Voltage > 5"}, {"16"}),
]


def play(folder, ecu, fault):
    """Return the failure types of the DTCs that were set, and what was injected."""
    config = shipped("gateway.toml") if ecu == "crank" else BATTERY / "gateway.toml"
    file = folder / "s.toml"
    if ecu == "battery":
        (folder / "battery_ecu.py").write_text((BATTERY / "battery_ecu.py").read_text())
        (folder / "battery.dbc").write_text((BATTERY / "battery.dbc").read_text())
    keys = "".join(f'{k} = "{v}"\n' if isinstance(v, str) else f"{k} = {v}\n" for k, v in fault.items())
    text = (CRANK if ecu == "crank" else DRAINED).format(config=config)
    file.write_text(text + (f"[[fault]]\nfrom_s = 2.0\n{keys}" if fault else ""))
    scenario = load_scenario(file)
    loaded = load_config(scenario.config)
    player = player_of(scenario, loaded)
    gateway, events = Gateway(loaded), []
    gateway.listen(events.append)
    drive(gateway, player)
    gateway.close()
    failed = {e["dtc"] for e in events if e["event"] == "dtc" and e["status"] & 1}
    return {dtc.partition("-")[2] for dtc in failed}, player.truth


@pytest.mark.parametrize("ecu", ["crank", "battery"])
def test_healthy_nothing_is_said(ecu, tmp_path):
    assert play(tmp_path, ecu, {}) == (set(), [])


@pytest.mark.parametrize(("ecu", "fault", "types"), TABLE)
def test_each_is_seen(ecu, fault, types, tmp_path):
    failed, truth = play(tmp_path, ecu, fault)
    assert failed == types
    assert [fact.kind for fact in truth] == [fault["kind"]]


def test_a_signal_that_the_protection_makes_is_refused(tmp_path):
    with pytest.raises(GatewayError, match=r"fault\[0\]\.signal = 'CTW_PT4\.Crc'.*kinds counter, checksum"):
        play(tmp_path, "crank", {"kind": "offset", "signal": "CTW_PT4.Crc", "size": 1})
    with pytest.raises(GatewayError, match=r"fault\[0\]\.message.*did you mean CTW_PT4"):
        play(tmp_path, "crank", {"kind": "lost", "message": "CTW_PT5"})

"""Plants of Fault Diagnosis Toolbox, simulated: faults are named as far as its analysis tells them apart."""

import warnings

import induction_data
import pytest
from amount import amount
from structural_config import named

from gateway.bus.logs import open_writer
from gateway.config.load import load_config
from gateway_bench.scenario_session import opened
from gateway_calibration.cusum import learn
from gateway_calibration.file import write
from gateway_calibration.logs import Reading
from gateway_fdi.jit import COMPILED

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    pytest.importorskip("faultdiagnosistoolbox")
    from faultdiagnosistoolbox.models._induction_motor_model import model as induction_motor
    from faultdiagnosistoolbox.models._three_tank_model import model as three_tanks

pytestmark = [pytest.mark.long, pytest.mark.skipif(not COMPILED, reason="tens of thousands of samples")]

DBC = """VERSION ""
NS_ :
BS_:
BU_: A B
BO_ 256 Tanks: 6 A
 SG_ Level : 0|16@1- (0.0001,0) [-3|3] "m" B
 SG_ Flow : 16|16@1- (0.0001,0) [-3|3] "m3/s" B
 SG_ Inflow : 32|16@1- (0.0001,0) [-3|3] "m3/s" B
"""
CONFIG = """
[clock]
watched = false
[[bus]]
name = "b"
uri = "virtual:x"
database = ["tanks.dbc"]
health = { watched = false }
[memory]
path = "faults.sqlite"
[[monitor]]
name = "tanks"
type = "structural"
model = "three_tanks.toml"
period_ms = 20.0
sample = "set"
settle_s = 20.0
confirm_s = 5.0
filter_bandwidth = 1.0
derivative_bandwidth = 1.0
signals = { y1 = "Tanks.Level", y2 = "Tanks.Flow", y3 = "Tanks.Inflow" }
"""
SCENARIO = """
name = "tanks"
duration_s = {seconds}
config = "gateway.toml"
[[ecu]]
type = "structural"
model = "three_tanks.toml"
rest = true
inputs = {{ y3 = {{ points = [[0, 0.5], [10, 0.5], [15, 0.8], [25, 0.8], [30, 0.5]], repeat_s = 40 }} }}
noise = {{ y1 = 0.002, y2 = 0.002, y3 = 0.002 }}
[[ecu.message]]
name = "Tanks"
period_ms = 20
signals = {{ Level = "y1", Flow = "y2", Inflow = "y3" }}
"""
FAULT = '[[fault]]\nkind = "value"\nname = "{name}"\nfrom_s = 40\nsize = 0.15\n'


def frames(folder, seconds, seed, fault=""):
    path = folder / "scenario.toml"
    path.write_text(SCENARIO.format(seconds=seconds) + (FAULT.format(name=fault) if fault else ""))
    return opened(path, seed)[2].frames


def test_three_tanks(tmp_path):
    (tmp_path / "tanks.dbc").write_text(DBC)
    config = tmp_path / "gateway.toml"
    config.write_text(CONFIG)
    log = tmp_path / "healthy.log"
    writer = open_writer(log)
    writer.write(frames(tmp_path, 200.0, 1001))
    writer.close()
    write(config, learn(load_config(config), [log], Reading(config)).tables, "healthy log")
    assert named(config, frames(tmp_path, 120.0, 2)) == []
    faults, together = list(three_tanks.f), three_tanks.IsolabilityAnalysis()
    for fault, row in zip(faults, together, strict=True):
        group = "_or_".join(g for g, too in zip(faults, row, strict=True) if too)
        for seed in range(3, 3 + amount(20, 1)):
            assert named(config, frames(tmp_path, 100.0, seed, fault)) == [group], (fault, seed)
    assert together.sum() == 3 + 9  # three are isolated, the last valves and the last leak one group


INDUCTION = """
[clock]
watched = false
[[bus]]
name = "b"
uri = "virtual:x"
database = ["motor.dbc"]
health = { watched = false }
[memory]
path = "faults.sqlite"
[[monitor]]
name = "motor"
type = "structural"
model = "induction_motor.toml"
period_ms = 1.0
sample = "set"
settle_s = 2.0
confirm_s = 1.0
signals = { u_a = "Voltages.Ua", u_b = "Voltages.Ub", y1 = "Sensors.Ia", y2 = "Sensors.Ib", y3 = "Sensors.Speed" }
"""


def test_induction_motor(tmp_path):
    """Its data from SciPy, by equations written down apart from the model."""
    (tmp_path / "motor.dbc").write_text(induction_data.DBC)
    config = tmp_path / "gateway.toml"
    config.write_text(INDUCTION)
    log = tmp_path / "healthy.log"
    writer = open_writer(log)
    writer.write(induction_data.frames_of(induction_data.drive(20.0, seed=1001)))
    writer.close()
    write(config, learn(load_config(config), [log], Reading(config)).tables, "healthy log")
    assert named(config, induction_data.frames_of(induction_data.drive(10.0, seed=2))) == []
    faults, together = list(induction_motor.f), induction_motor.IsolabilityAnalysis()
    for fault, row in zip(faults, together, strict=True):
        group = "_or_".join(g for g, too in zip(faults, row, strict=True) if too)
        for seed in range(3, 3 + amount(20, 1)):
            drive = induction_data.drive(8.0, seed=seed, onset=4.0, **{fault: 0.3})
            assert named(config, induction_data.frames_of(drive)) == [group], (fault, seed)
    assert together.sum() == 2  # both are isolated

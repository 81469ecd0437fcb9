"""An FMU and a Python class close a loop over the bus; a monitor of the linear type names what fails in it."""

import sys
from pathlib import Path

import numpy as np
import pytest
from fmus import CONTROLLER, PLANT, build

from gateway.config.load import load_config
from gateway.runtime.app import Gateway
from gateway_bench.drive import drive
from gateway_bench.scenario_session import player_of
from gateway_bench.vecu.scenario import load_scenario
from gateway_fdi.errors import GatewayError

DBC = """VERSION ""
BU_: C P
BO_ 256 Cmd: 8 C
 SG_ COUNTER : 0|4@1+ (1,0) [0|15] "" P
 SG_ U : 16|16@1- (0.001,0) [-32|32] "V" P
BO_ 257 Meas: 8 P
 SG_ COUNTER : 0|4@1+ (1,0) [0|15] "" C
 SG_ I : 16|16@1- (0.0005,0) [-16|16] "A" C
 SG_ W : 32|16@1- (0.0005,0) [-16|16] "rad/s" C
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 10000;
BA_DEF_DEF_ "GenMsgCycleTime" 20;
"""
CONFIG = """
[clock]
watched = false
[[bus]]
name = "can"
uri = "virtual:x"
database = ["loop.dbc"]
health = { watched = false }
[[bus.check]]
message = "Cmd"
timeout_ms = 100
protection = "auto"
lost = "U0110"
invalid = "U0410"
[[bus.check]]
message = "Meas"
timeout_ms = 100
protection = "auto"
lost = "U0111"
invalid = "U0411"
[[monitor]]
name = "motor"
type = "pi_bank"
sample_ms = 20
start_s = 1.0
a = [[-10.0, -5.0], [8.0, -1.0]]
b = [[10.0], [0.0]]
c = [[1.0, 0.0], [0.0, 1.0]]
states = ["current", "speed"]
state_noise = [0.003, 0.003]
[[monitor.input]]
name = "voltage"
signal = "Cmd.U"
threshold = 0.2
dtc = "P1A30-64"
[[monitor.output]]
name = "current"
signal = "Meas.I"
noise = 0.003
dtc = "P1A31-64"
[[monitor.output]]
name = "speed"
signal = "Meas.W"
noise = 0.003
dtc = "P1A32-64"
[output.dtc_frame]
"""
CLASSES = """
class Motor:
    def __init__(self, k=10.0):
        self.k, self.i, self.w, self.t = k, 0.0, 0.0, 0.0

    def step(self, t, inputs):
        said = {"i": self.i, "w": self.w}
        u, h = inputs["u"], 0.0005
        for _ in range(20):
            i, w = self.i, self.w
            a, b = i + h / 2 * (-10 * i - 5 * w + self.k * u), w + h / 2 * (8 * i - w)
            self.i, self.w = i + h * (-10 * a - 5 * b + self.k * u), w + h * (8 * a - b)
        return said


class Controller:
    def __init__(self, gain=1.5):
        self.gain = gain

    def step(self, t, inputs):
        wanted = 3.0 if int(t / 1.5) % 2 else 1.0
        return {"u": max(-20.0, min(20.0, self.gain * (wanted - inputs["w"]) + 0.7 * wanted))}
"""
SCENARIO = """
name = "loop"
duration_s = 6.0
seed = 1
config = "gateway.toml"
[[ecu]]
type = {controller}
name = "controller"
step_ms = 10
inputs = {{ w = "Meas.W" }}
outputs = {{ "Cmd.U" = "u" }}
parameters = {{ gain = 1.5 }}
[[ecu.message]]
name = "Cmd"
at_ms = 10
[[ecu]]
type = {plant}
name = "plant"
step_ms = 10
inputs = {{ u = "Cmd.U" }}
outputs = {{ "Meas.I" = "i", "Meas.W" = "w" }}
parameters = {{ k = 10.0 }}
"""
SENSOR = '[[fault]]\nkind = "offset"\necu = "plant"\nsignal = "Meas.W"\nfrom_s = 3.0\nto_s = 4.5\nsize = 0.4\n'
ACTUATOR = '[[fault]]\nkind = "actuator_offset"\necu = "plant"\ninput = "u"\nfrom_s = 3.0\nto_s = 4.5\nsize = 1.0\n'


@pytest.fixture(scope="module")
def fmus(tmp_path_factory):
    """Return a plant of FMI 2 and a controller of FMI 3."""
    folder = tmp_path_factory.mktemp("fmus")
    return {"plant": build(folder, PLANT, "2"), "controller": build(folder, CONTROLLER, "3")}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Return a folder with database, configuration and classes."""
    (tmp_path / "loop.dbc").write_text(DBC)
    (tmp_path / "gateway.toml").write_text(CONFIG)
    (tmp_path / "loop_classes.py").write_text(CLASSES)
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.delitem(sys.modules, "loop_classes", raising=False)
    return tmp_path


def write(folder, plant, controller, more=""):
    """Write a scenario of a class or an FMU (a path) each; returns its path."""

    def named(what):
        return f'"fmu"\nfile = "{what}"' if isinstance(what, Path) else f'"loop_classes:{what}"'

    path = folder / "loop.toml"
    path.write_text(SCENARIO.format(plant=named(plant), controller=named(controller)) + more)
    return path


def play(file):
    """Return the DTCs that were set, with their times [s], what was injected, and the frames."""
    from gateway_bench.vecu.registry import VIRTUAL_ECUS

    VIRTUAL_ECUS._known.clear()  # modules of this folder, not of the one before
    scenario = load_scenario(file)
    config = load_config(scenario.config)
    player = player_of(scenario, config)
    gateway, events, frames = Gateway(config), [], []
    gateway.listen(events.append)
    drive(gateway, player, on_frames=lambda batch: frames.append(batch.copy()))
    gateway.close()
    found = [(e["t_ns"] / 1e9, e["dtc"]) for e in events if e["event"] == "dtc" and e["status"] & 1]
    return found, player.truth, np.concatenate(frames)


PAIRS = {
    "an FMU as plant, FMI 2": lambda fmus: (fmus["plant"], "Controller"),
    "a Python plant, an FMU of FMI 3 controls it": lambda fmus: ("Motor", fmus["controller"]),
}


@pytest.mark.long
@pytest.mark.parametrize("pair", PAIRS)
def test_a_loop_of_an_fmu_and_a_class_is_healthy_and_its_faults_are_named(pair, folder, fmus):
    plant, controller = PAIRS[pair](fmus)
    healthy, truth, frames = play(write(folder, plant, controller))
    assert (healthy, truth) == ([], [])
    speed = frames[frames["can_id"] == 257]["data"][:, 4:6].copy().view("<i2")[:, 0] * 0.0005
    assert speed.max() > 2.0, "it is driven, or nothing is shown by silence"
    assert speed[np.argmax(speed) :].min() < 1.5
    for fault, dtc, kind in ((SENSOR, "P1A32-64", "offset"), (ACTUATOR, "P1A30-64", "actuator_offset")):
        found, truth, _ = play(write(folder, plant, controller, fault))
        assert [name for _, name in found] == [dtc]
        assert 3.0 < found[0][0] < 3.8
        assert [fact.kind for fact in truth] == [kind]
        assert truth[0].t_ns == pytest.approx(3e9, abs=21e6)


@pytest.mark.long
def test_a_class_an_fmu_of_fmi_2_and_one_of_fmi_3_are_the_same_plant(folder, fmus, tmp_path_factory):
    three = build(tmp_path_factory.mktemp("three"), PLANT, "3")
    runs = [play(write(folder, plant, "Controller"))[2] for plant in ("Motor", fmus["plant"], three)]
    for other in runs[1:]:
        assert len(other) == len(runs[0]) > 500
        assert (other["t_ns"] == runs[0]["t_ns"]).all()
        assert (other["data"] == runs[0]["data"]).all()


def test_the_same_seed_gives_the_same_run_and_the_order_of_ecus_does_not_matter(folder):
    file = write(folder, "Motor", "Controller")
    one, two = play(file)[2], play(file)[2]
    assert (one == two).all()
    head, first, second = file.read_text().split("[[ecu]]")
    file.write_text(head + "[[ecu]]" + second + "[[ecu]]" + first)
    other = play(file)[2]
    assert (np.sort(one, order=["t_ns", "can_id"]) == np.sort(other, order=["t_ns", "can_id"])).all()


WRONG = {
    'u = "Cmd.U"': ('u = "Cmd.V"', "ecu[1].inputs.u = 'Cmd.V'", "no signal 'V'"),
    '"Meas.W" = "w" }': ('"Meas.X" = "w" }', 'ecu[1].outputs."Meas.X"', "no signal 'X'"),
    '"Meas.I" = "i"': ('"Meas.I" = "j"', "ecu[1].outputs.\"Meas.I\" = 'j'", "the outputs are i, w"),
    "k = 10.0": ("kk = 10.0", "ecu[1].parameters.kk = 'kk'", "did you mean k?"),
    "gain = 1.5": ('gain = "high"', "ecu[0] = 'Controller': step at 0.0000 s", "loop_classes.py:2"),
    '"loop_classes:Motor"': ('"loop_classes:Moter"', "ecu[1].type = 'loop_classes:Moter'", "has no Moter"),
    '"Meas.I" = "i", ': ('"Meas.COUNTER" = "i", ', 'ecu[1].outputs."Meas.COUNTER"', "protection makes this signal"),
    "step_ms = 10\ninputs = { u": ("step_ms = 0\ninputs = { u", "ecu[1].step_ms = 0", "a number of 0.1 at least"),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_mistakes_are_one_line(wrong, folder):
    file = write(folder, "Motor", "Controller")
    text, place, why = WRONG[wrong]
    assert wrong in file.read_text()
    file.write_text(file.read_text().replace(wrong, text))
    with pytest.raises(GatewayError) as told:
        play(file)
    assert place in str(told.value)
    assert why in str(told.value)
    assert len(str(told.value).splitlines()) == 1


def test_what_is_no_fmu_is_told(folder, fmus):
    (folder / "no.fmu").write_text("no zip")
    for plant, why in ((Path("no.fmu"), "ecu[1].file"), (Path("none.fmu"), "there is no such file")):
        with pytest.raises(GatewayError, match="fmu") as told:
            play(write(folder, plant, "Controller"))
        assert why in str(told.value)
    with pytest.raises(GatewayError, match=r"ecu\[1\]\.parameters\.kk.*did you mean k\?"):
        file = write(folder, fmus["plant"], "Controller")
        file.write_text(file.read_text().replace("k = 10.0", "kk = 10.0"))
        play(file)


CONDITIONS = [  # when, more -> the first time that it holds, and the last [s]: each other 1.5 s it is asked for more
    ("Meas.W > 2.5", "", 1.5, 6.0),
    ("Meas.W > 2.5 and Meas.I > -100", "from_s = 3.5", 4.5, 6.0),
    ("Meas.W > 2.5", "from_s = 0.0\nto_s = 3.0", 1.5, 3.01),
]


@pytest.mark.parametrize(("when", "more", "after_s", "before_s"), CONDITIONS)
def test_a_fault_of_an_actuator_by_a_condition(when, more, after_s, before_s, folder):
    _, _, healthy = play(write(folder, "Motor", "Controller"))
    fault = ACTUATOR.replace("from_s = 3.0\nto_s = 4.5", f'when = "{when}"\n{more}')
    found, truth, frames = play(write(folder, "Motor", "Controller", fault))
    assert {name for _, name in found} == {"P1A30-64"}, "seen by its DTC, and by no other"
    assert {fact.kind for fact in truth} == {"actuator_offset"}
    differs = frames["t_ns"][(frames["data"] != healthy["data"]).any(axis=1)]
    assert after_s <= truth[0].t_ns / 1e9 < differs[0] / 1e9, "what it does is seen after it"
    assert truth[-1].t_ns / 1e9 + truth[-1].count * 0.01 <= before_s + 0.01
    # While it holds, by what the bus says: in the step after the frame that says so.
    speed = frames[frames["can_id"] == 257]
    value = speed["data"][:, 4:6].copy().view("<i2")[:, 0] * 0.0005
    first = speed["t_ns"][np.flatnonzero((value > 2.5) & (speed["t_ns"] >= (after_s - 0.5) * 1e9))[0]]
    assert 0 < truth[0].t_ns - first <= 20_000_000


def test_a_condition_of_an_actuator_that_is_none_is_refused(folder):
    wrong = SENSOR + ACTUATOR.replace("from_s = 3.0", 'from_s = 3.0\nwhen = "Meas.V > 2"')
    with pytest.raises(GatewayError, match=r"fault\[1\]\.when.*no signal 'V' in message 'Meas'") as told:
        play(write(folder, "Motor", "Controller", wrong))
    assert len(str(told.value).splitlines()) == 1
    with pytest.raises(GatewayError, match="when does it begin"):
        play(write(folder, "Motor", "Controller", ACTUATOR.replace("from_s = 3.0\n", "")))

"""The ECU of a model's equations: frames against cantools and the equations, faults, mistakes."""

import re
import subprocess
import sys

import cantools
import numpy as np
import pytest

from gateway_bench.scenario_session import opened
from gateway_fdi.common.resources import shipped
from gateway_fdi.errors import InputError, InputErrors

CONFIG = shipped("configs/motor.toml")

GOOD = f"""
name = "own"
duration_s = 6.0
seed = 4
config = "{CONFIG}"
[[ecu]]
type = "structural"
model = "motor.toml"
inputs = {{ u = {{ points = [[0, 9], [1, 9], [1.5, 7]], repeat_s = 3 }} }}
rest = true
noise = {{ w = 0.3 }}
[[ecu.message]]
name = "Drive"
period_ms = 10
signals = {{ Voltage = "u" }}
[[ecu.message]]
name = "Sensors"
period_ms = 20
signals = {{ Current = "i", Speed = "w" }}
"""
FAULT = """
[[fault]]
kind = "{kind}"
name = "{name}"
from_s = 2.0
to_s = 4.0
{more}
"""


def played(tmp_path, text, seed=None):
    path = tmp_path / "own.toml"
    path.write_text(text, encoding="utf-8")
    return opened(path, seed)[2]


def values(player):
    database = cantools.database.load_file(shipped("dbc/motor.dbc"))
    found = {}
    for frame in player.frames:
        message = database.get_message_by_frame_id(int(frame["can_id"]))
        for name, value in message.decode(bytes(frame["data"][: frame["length"]])).items():
            found.setdefault(name, []).append((frame["t_ns"] * 1e-9, float(value)))
    return {name: np.array(rows).T for name, rows in found.items()}


def test_frames_follow_the_equations(tmp_path):
    found = values(played(tmp_path, GOOD.replace("noise = { w = 0.3 }", "")))
    t, u = found["Voltage"]
    assert len(t) == 601
    assert np.abs(u - np.interp(t % 3.0, [0, 1, 1.5, 3], [9, 9, 7, 7])).max() < 1e-3 + 2e-6
    (t, i), (_, w) = found["Current"], found["Speed"]
    assert len(t) == 301
    voltage = np.interp(t % 3.0, [0, 1, 1.5, 3], [9, 9, 7, 7])
    flat = np.abs(t % 3.0) > 1e-6  # u jumps at 3 s: the current with it
    assert np.abs(voltage - 0.5 * i - 0.05 * w)[flat].max() < 3e-3
    assert w[0] == pytest.approx(150.0, abs=0.02)
    assert w.min() < 130.0


def test_a_seed_is_a_run(tmp_path):
    first, second, other = (played(tmp_path, GOOD, seed).frames for seed in (1, 1, 2))
    assert (first == second).all()
    assert (first != other).any()


@pytest.mark.parametrize(
    ("kind", "name", "more", "signal", "begin", "end"),
    [
        ("value", "f_i", "size = 0.5", "Current", 0.5, 0.5),
        ("ramp", "f_w", "size = 4.0\nramp_s = 2.0", "Speed", 0.0, 4.0),
    ],
)
def test_faults_of_the_model(tmp_path, kind, name, more, signal, begin, end):
    healthy = values(played(tmp_path, GOOD))[signal]
    faulty = values(played(tmp_path, GOOD + FAULT.format(kind=kind, name=name, more=more)))[signal]
    t, off = healthy[0], faulty[1] - healthy[1]
    inside = (t >= 2.0 - 1e-9) & (t < 4.0 - 1e-9)
    assert np.abs(off[~inside]).max() < 0.03
    assert off[inside] == pytest.approx(np.linspace(begin, end, inside.sum()), abs=0.05)


def test_a_value_that_freezes(tmp_path):
    player = played(tmp_path, GOOD + FAULT.format(kind="freeze", name="w", more=""))
    t, w = values(player)["Speed"]
    inside = (t >= 2.0 - 1e-9) & (t < 4.0 - 1e-9)
    assert len(set(w[inside])) == 1
    assert len(set(w)) > 100
    assert [(one.kind, one.count) for one in player.truth] == [("freeze", int(inside.sum()))]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('"motor.toml"', '"moter.toml"', r"ecu\[0\].model.*no such file beside the scenario.*did you mean motor"),
        ('"motor.toml"', '"own.toml"', "this file is a scenario, not a model"),
        ("inputs = { u", "inputs = { v", r"ecu\[0\].inputs.*without a derivative, are u, i, w, I, T"),
        ("inputs = { u", "inputs = { i = 1, u", r"ecu\[0\].model.*more equations than variables"),
        ("inputs = {", "# {", r"ecu\[0\].model.*equations too few"),
        ("[1.5, 7]]", "[0.5, 7]]", "times of the points must not fall"),
        ("[1.5, 7]]", "[3.5, 7]]", "lies behind repeat_s"),
        ("noise = { w", "noise = { y", r"ecu\[0\].noise"),
        ("rest = true", "start = { I = 1 }", r"ecu\[0\].start.*states are omega"),
        ("rest = true", "parameters = { RR = 1 }", r"ecu\[0\].parameters.*did you mean R"),
        ('Voltage = "u"', 'Voltage = "uu"', r"ecu\[0\].message\[0\].signals"),
        ('Voltage = "u"', 'Volt = "u"', r"ecu\[0\].message\[0\].*no such signal; it has Voltage"),
        ('Voltage = "u"', 'Voltage = "i"', r'message\[0\].signals.Voltage.*in "V", i of the model in "A"'),
        ('name = "Drive"', 'name = "Drove"', r"ecu\[0\].message\[0\]"),
        ("period_ms = 10", "period_ms = 0", r"message\[0\].period_ms"),
        ("", "[[fault]]\nkind = 'value'\nname = 'f_x'\nfrom_s = 1\nsize = 1", "faults are f_R, f_b"),
        ("", "[[fault]]\nkind = 'value'\nname = 'f_R'\nfrom_s = 1", "0 is no fault"),
        ("", "[[fault]]\nkind = 'freeze'\nname = 'T'\nfrom_s = 1", "variables that are sent are u, i, w"),
        ("", "[[fault]]\nkind = 'ramp'\nname = 'f_R'\nfrom_s = 1\nsize = 1", "ramp_s goes with"),
    ],
)  # fmt: skip
def test_mistakes_give_one_line(tmp_path, old, new, said):
    assert old in GOOD
    text = GOOD.replace(old, new, 1) if old else GOOD + new
    with pytest.raises((InputError, InputErrors)) as caught:
        played(tmp_path, text)
    message = str(caught.value)
    assert "\n" not in message.strip()
    assert re.search(said, message), message


@pytest.mark.long
def test_a_scenario_of_one_s_own_is_shown(tmp_path):
    """gateway demo, with nothing but a model: the winding's resistance is named."""
    path = tmp_path / "own.toml"
    text = GOOD.replace("duration_s = 6.0", "duration_s = 14.0").replace("seed = 4", 'seed = 4\nunexpected = "fail"')
    text = text.replace("noise = { w = 0.3 }", "noise = { i = 0.05, w = 0.3 }")
    text = text.replace("period_ms = 20", "period_ms = 10").replace("[1.5, 7]]", "[1.5, 7.5], [2.5, 9]]")
    fault = FAULT.format(kind="value", name="f_R", more="size = 0.5").replace("to_s = 4.0", "to_s = 10.0")
    path.write_text(text + fault + '[[expect]]\ndtc = "P1B10-64"\nafter_s = 2\nby_s = 8\n', encoding="utf-8")
    ended = subprocess.run(
        [sys.executable, "-c", "from gateway.cli import main; main()", "demo", str(path), "--speed", "0"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.returncode == 0, ended.stderr
    assert "as expected: P1B10-64" in ended.stdout
    assert "NOT as expected" not in ended.stdout

"""``gateway structure``: its text, its JSON contract, its pictures, its errors."""

import json
import re
import subprocess
import sys
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.image import imread
from typer.testing import CliRunner

from gateway.cli import app
from gateway_fdi.common.resources import shipped
from gateway_fdi.structure.analysis import analyse
from gateway_fdi.structure.file import load_model
from gateway_plants.structural.analysis.figures import draw


def run(*arguments, code=0):
    result = CliRunner().invoke(app, ["structure", *map(str, arguments)])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert result.exit_code == code, result.output
    return result.stdout


def test_json_contract():
    found = json.loads(run("truck", "--json"))
    assert (found["equations"], found["unknowns"], found["msos"], found["candidates"]) == (
        37,
        32,
        99,
        2677,
    )
    assert found["sizes"] == {
        "2": 1,
        "5": 1,
        "6": 2,
        "7": 4,
        "10": 3,
        "11": 3,
        "27": 5,
        "28": 32,
        "32": 48,
    }
    assert found["table"]["modified"]["unique"] == {
        "SDI": [94, 1374],
        "SI": [94, 334],
        "SD": [43, 70],
        "S": [6, 33],
    }
    assert found["table"]["original"]["realizable"]["SI"] == [99, 458]
    assert found["isolability"] == np.eye(5, dtype=int).tolist()
    assert found["isolability_of"]["SD"]["detectable"] == [0, 1, 1, 1, 1]
    assert found["redundancy"] == 5
    assert len(found["mtes"]) == 7
    assert len(found["fewest_tests"]) == 4
    t4 = found["tests"]["T4_ICDS"]
    assert (t4["consistency"], t4["causality"], t4["status"], len(t4["equations"])) == (
        "e32",
        "SI",
        "unique",
        32,
    )
    assert t4["faults"] == ["f_b_sc", "f_em_eta", "f_em_U_sens"]
    assert t4["sequence"].endswith("({T_d, T_r, T_net, omega_w}, {e25, e26, e29, e30})")
    assert found["tests"]["T3_MCDS"]["causality"] == "SDI"
    assert len(found["sets"]) == 99
    assert sum(one["unique SI"] for one in found["sets"]) == 334
    assert found["parts"]["just"] == [{"equations": ["e31"], "unknowns": ["v"]}]
    assert sorted(len(one["equations"]) for one in found["parts"]["classes"])[-2:] == [5, 21]


def test_text():
    text = run("truck")
    assert "99 MSO sets (1 of 2, 1 of 5, 2 of 6, 4 of 7, 3 of 10, 3 of 11, 5 of 27, 32 of 28, 48 of 32)" in text
    assert "334 (414)" in text
    assert "e1-e3 e9 e10 e12 e14-e30 e32 e35-e37" in text
    assert "not detectable" in text
    assert "T3_ICDS" in text


def test_models_without_faults_residuals_or_sets(tmp_path):
    assert "1 MSO sets (1 of 2), 2 candidates" in run("example_4")
    bare = tmp_path / "bare.toml"
    bare.write_text(
        '[unknown]\na = {}\nb = {}\n[fault]\nf = {}\n[equation.e1]\nunknowns = ["a", "b"]\nfaults = ["f"]\n'
    )
    assert "0 MSO sets (none), 0 candidates" in run(bare)
    found = json.loads(run(bare, "--json"))
    assert found["detectable"] == [0]
    assert found["parts"]["under"] == {"equations": ["e1"], "unknowns": ["a", "b"]}
    assert draw(tmp_path / "bare.png", analyse(load_model(bare))).exists()


def test_residual_by_name_and_by_set():
    text = run("truck", "--residual", "T2")
    assert "T2: e11 checked, 11 equations, SI, unique; sensitive to f_b_sc, f_em_R" in text
    assert "r = I_b - I_em*U_em/U_b  # e11" in text
    found = json.loads(run("machine", "--residual", "unique", "--json"))
    assert (found["causality"], found["status"]) == ("SD", "unique")
    assert "differentiates omega" in found["refused"]
    assert "d_omega" in found["source"]
    found = json.loads(run("truck", "--residual", "99:e5", "--json"))
    assert found["status"] == "none"
    assert found["source"] is None
    assert "cannot be solved" in found["refused"] or "algebraic loop" in found["refused"]


def test_sensor_places():
    found = json.loads(run("example_1", "--sensors", "x_1,x_2", "--json"))
    assert found["sensors"] == {"detect": [[]], "isolate": [[]]}
    assert "none: the model has enough" in run("example_1", "--sensors", "all")


def test_more_sets_than_the_limit():
    """Not an error: enough of them, and a line that says so."""
    found = json.loads(run("truck", "--limit", "50", "--json"))
    every = json.loads(run("truck", "--json"))
    assert (found["all"], every["all"]) == (False, True)
    assert found["isolability_of"]["SDI"] == every["isolability_of"]["SDI"]
    assert {tuple(one["equations"]) for one in found["sets"]} < {tuple(one["equations"]) for one in every["sets"]}
    assert found["mtes"] is None
    assert "there are more than 50 MSO sets" in run("truck", "--limit", "50")


@pytest.mark.long
@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (
            ["lorry"],
            "no such model; shipped: .*example_1, .*truck",
        ),
        (["nowhere.toml"], "nowhere.toml: No such file"),
        (["truck", "--plot", "x.gif"], "--plot = 'x.gif': a picture is .svg, .png, .pdf"),
        (["truck", "--residual", "T9"], "the model names T1, T2"),
        (["truck", "--residual", "1:e9"], "set 1 has e7, e34"),
        (["truck", "--sensors", "U_b,T_x"], '"T_x" is no unknown'),
    ],
)
def test_mistakes(arguments, said):
    ended = subprocess.run(
        [sys.executable, "-c", "from gateway.cli import main; main()", "structure", *arguments],
        capture_output=True,
        text=True,
        check=False,
    )
    assert ended.returncode == 2
    assert "Traceback" not in ended.stderr
    assert re.search(said, ended.stderr), ended.stderr


@pytest.mark.long
def test_picture_shows_the_numbers(tmp_path):
    """The SVG has a bar of each colour for each set: as high as the set's counts."""
    path = tmp_path / "truck.svg"
    run("truck", "--plot", path)
    root = ElementTree.parse(path).getroot()
    heights: dict[str, list[float]] = {"ffffff": [], "9a9a9a": [], "000000": []}
    for element in root.iter("{http://www.w3.org/2000/svg}path"):
        style = element.get("style") or ""
        if "stroke: #595959" in style:  # the edge of a bar
            fill = style.split("fill: #")[1][:6] if "fill: #" in style else "000000"
            ys = [float(y) for y in re.findall(r"[ML] [-\d.]+ ([-\d.]+)", element.get("d"))]
            heights[fill].append(max(ys) - min(ys))
    found = analyse(load_model(shipped("models/truck.toml")))
    shown = ("SDI", "SI", "SD")
    expected = {
        "ffffff": np.concatenate([found.msos.sum(1)] * 3),
        "9a9a9a": np.concatenate([found.counts(c, "realizable") for c in shown]),
        "000000": np.concatenate([found.counts(c, "unique") for c in shown]),
    }
    scale = heights["ffffff"][0] / expected["ffffff"][0]
    for colour, counts in expected.items():
        bars = np.array(heights[colour])[: len(counts) + 3]
        legend = len(bars) - len(counts)
        assert 0 <= legend <= 1
        assert any(
            np.allclose(np.delete(bars, k) if legend else bars, scale * counts, atol=0.05) for k in range(len(bars))
        ), colour


@pytest.mark.long
def test_picture_of_many_sets(tmp_path):
    model = load_model(shipped("models/truck.toml")).with_sensors(["U_b", "omega_w"])
    path = draw(tmp_path / "many.png", analyse(model))
    image = imread(path)
    assert image.shape[0] > 1000
    assert image[..., :3].std() > 0.05


def test_the_analysis_does_not_load_algebra():
    """Only a residual generator that is written needs SymPy."""
    names = [
        "file",
        "mso",
        "mtes",
        "candidates",
        "isolability",
        "selection",
        "sensors",
        "decomposition",
    ]
    modules = ", ".join(f"gateway_fdi.structure.{name}" for name in names)
    code = f"import {modules}, sys; print([m for m in ('sympy', 'scipy.optimize') if m in sys.modules])"
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ended.stdout.strip() == "[]"

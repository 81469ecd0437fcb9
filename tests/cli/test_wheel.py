"""The commands that print the wheel that they see."""

import json

import numpy as np
import pytest
from command import command

from gateway_fdi.common.resources import shipped

SEED = 7


@pytest.fixture
def capture(tmp_path):
    """A capture of a wheel of 36-1 at 1000 rpm, 40 turns, falling edges."""
    print(f"seed {SEED}")
    pitches = np.tile([1.0] * 34 + [2.0], 40)
    times = np.cumsum(pitches * 60e6 / 1000 / 36) + np.random.default_rng(SEED).normal(0, 15, len(pitches))
    return written(tmp_path / "engine.csv", times)


def written(path, times_us):
    rows = [f"{t / 1e6:.6f},0\n{t / 1e6 + 4e-4:.6f},1" for t in times_us]
    path.write_text("\n".join(["time_s,level", "0,1", *rows]) + "\n")
    return path


def test_convert_teeth_prints_the_wheel(capture, tmp_path, capsys, monkeypatch):
    log = tmp_path / "engine.log"
    ended = command(capsys, monkeypatch, "convert", "teeth", capture, log)
    assert ended.code == 0
    assert ended.out.splitlines()[1] == "wheel seen: 36-1 (35 pulses a turn, 38 turns)"
    ended = command(capsys, monkeypatch, "convert", "teeth", capture, log, "--json")
    (facts,) = ended.events
    assert facts["wheel"] == {"wheel": "36-1", "pulses": 35, "turns": 38, "without_gap": 34}


def test_convert_teeth_says_when_nothing_repeats(tmp_path, capsys, monkeypatch):
    capture = written(tmp_path / "few.csv", np.arange(1, 20) * 1e3)
    ended = command(capsys, monkeypatch, "convert", "teeth", capture, tmp_path / "few.log")
    assert ended.out.splitlines()[1] == "wheel seen: none that repeats"
    capture = written(tmp_path / "even.csv", np.arange(1, 402) * 1e3)
    ended = command(capsys, monkeypatch, "convert", "teeth", capture, tmp_path / "even.log")
    equal = "all pitches are equal, and how many a turn has is not told"
    assert ended.out.splitlines()[1] == f"wheel seen: no gap seen in 399 pulses: {equal}"


@pytest.mark.parametrize(("frame", "message"), [("classic", "CTW_PT4"), ("fd", "CTW_FD27")])
def test_learn_says_the_wheel_of_tooth_frames(frame, message, capture, tmp_path, capsys, monkeypatch):
    log, out = tmp_path / "engine.log", tmp_path / "car.toml"
    assert command(capsys, monkeypatch, "convert", "teeth", capture, log, "--frame", frame).code == 0
    asked = ("learn", shipped("dbc/crank.dbc"), log, "-o", out, "--hold-out", "0.3")
    ended = command(capsys, monkeypatch, *asked)
    assert ended.code == 0, ended.err
    line = next(each for each in ended.out.splitlines() if "wheel seen" in each)
    assert line.startswith(f"{message}: wheel seen: 36-1 (35 pulses a turn, ")
    assert f"{line}." in out.with_suffix(".md").read_text()
    ended = command(capsys, monkeypatch, *asked, "--force", "--json")
    assert json.loads(ended.out)["wheels"] == [line]


def test_lost_tooth_frames_make_no_other_wheel(capture, tmp_path, capsys, monkeypatch):
    log, fewer, out = tmp_path / "engine.log", tmp_path / "fewer.log", tmp_path / "car.toml"
    assert command(capsys, monkeypatch, "convert", "teeth", capture, log).code == 0
    lines = log.read_text().splitlines()
    rng = np.random.default_rng(SEED)
    fewer.write_text("\n".join(line for line in lines if rng.uniform() > 0.03) + "\n")
    ended = command(capsys, monkeypatch, "learn", shipped("dbc/crank.dbc"), fewer, "-o", out)
    assert ended.code == 0, ended.err
    line = next(each for each in ended.out.splitlines() if "wheel seen" in each)
    assert line.startswith("CTW_PT4: wheel seen: 36-1 (")

"""Real engines: logic-analyser captures through CAN frames, engine, monitor and fault memory.

The captures lie beside the project where they are available; a synthetic one is always tested.
"""

import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from gateway.cli import app
from gateway.fdi.wheel import Wheel
from gateway.resources import shipped
from gateway.vecu.crank import tooth_times

DATA = Path(__file__).parents[3] / "shared" / "data" / "crank"
needs_data = pytest.mark.skipif(not DATA.is_dir(), reason="the captures are not on this machine")


def invoke(*arguments):
    result = CliRunner().invoke(app, [str(a) for a in arguments])
    assert result.exit_code == 0, result.output
    return [json.loads(line) for line in result.stdout.splitlines() if line.startswith("{")]


def replayed(capture, tmp_path, wheel, edge="falling", channel="0", frame="classic"):
    """Convert and replay a capture with the commands; returns events and the monitor's readout."""
    log = tmp_path / "engine.log"
    result = CliRunner().invoke(
        app,
        ["convert", "teeth", str(capture), str(log), "--edge", edge, "--channel", channel,
         "--frame", frame, "--json"],
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    source = shipped("configs/crank_fd.toml" if frame == "fd" else "gateway.toml").read_text()
    config = tmp_path / "gateway.toml"
    config.write_text(
        source.replace('"60-2"', f'"{wheel}"')
        .replace('"../dbc/', f'"{shipped("dbc")}/')
        .replace('"dbc/', f'"{shipped("dbc")}/')
    )
    events = invoke("replay", log, "--config", config, "--json")
    return json.loads(result.stdout), events, events[-1]["monitors"]["crank"]


def edges(path, level, column=1):
    """Independent count: times of the changes to a level."""
    rows = np.genfromtxt(path, delimiter=",", skip_header=1)
    levels = rows[:, column]
    changed = np.concatenate([[False], levels[1:] != levels[:-1]])
    return rows[changed & (levels == level), 0]


def turns(times, gap):
    """Independent count: start of each turn, by intervals near ``gap`` times their neighbours."""
    pt = np.diff(times)
    around = np.sqrt(pt[:-2] * pt[2:])
    found = np.flatnonzero(pt[1:-1] / around > 0.8 * gap) + 2
    return times[found]


def crank_faults(events):
    return [
        e
        for e in events
        if e["event"] == "dtc" and e["status"] & 1 and e["fault"].startswith("crank")
    ]


@pytest.mark.parametrize("frame", ["classic", "fd"])
def test_a_synthetic_capture(tmp_path, frame):
    times = tooth_times(
        Wheel.parse("60-2"), [(0, 1500)], 4.0, jitter=0.003, rng=np.random.default_rng(8)
    )
    path = tmp_path / "c.csv"
    rows = [f"{t / 1e9:.9f},0\n{t / 1e9 + 2e-4:.9f},1" for t in np.delete(times, 58 * 50 + 20)]
    path.write_text("time_s,level\n0,1\n" + "\n".join(rows) + "\n")
    facts, events, crank = replayed(path, tmp_path, "60-2", frame=frame)
    assert facts["edges"] == len(times) - 1 == len(edges(path, 0))
    assert crank["revolutions"] == 99, "all but the one that synchronises"
    assert crank["speed_rpm"] == pytest.approx(1500, rel=0.005)
    assert [e["dtc"] for e in crank_faults(events)] == ["P0336-29"]


@needs_data
@pytest.mark.parametrize("edge", ["falling", "rising"])
def test_4b11_running(tmp_path, edge):
    capture = DATA / "mitsubishi-4b11-36-2-1-running.csv"
    times = edges(capture, 0 if edge == "falling" else 1)
    facts, events, crank = replayed(capture, tmp_path, "36-2-1", edge)
    assert facts["edges"] == len(times)
    starts = turns(times, 2.7)
    # The first gap synchronises; every later one ends a revolution.
    assert crank["revolutions"] == len(starts) - 1
    rpm = 60 / np.diff(starts)
    assert crank["slowest_rpm"] == pytest.approx(rpm.min(), rel=0.003)
    assert crank["fastest_rpm"] == pytest.approx(rpm.max(), rel=0.003)
    assert crank["speed_rpm"] == pytest.approx(rpm[-1], rel=0.003)
    assert crank_faults(events) == []


@needs_data
def test_4b11_with_a_doubled_edge(tmp_path):
    """Its authors doubled one edge: one added pulse, at the place where the teeth are too many."""
    capture = DATA / "4b11-running-doubled-edge.csv"
    times = edges(capture, 0)
    facts, events, crank = replayed(capture, tmp_path, "36-2-1")
    assert facts["edges"] == len(times)
    (event,) = crank_faults(events)
    assert (event["dtc"], event["evidence"]["count"]) == ("P0336-2F", 1)
    starts = turns(times, 2.7)
    counts = [int(((times >= a) & (times < b)).sum()) for a, b in pairwise(starts)]
    assert sorted(set(counts)) == [33, 34]
    wrong = counts.index(34)
    assert starts[wrong] < event["t_ns"] / 1e9 < starts[wrong + 2]
    assert crank["revolutions"] == len(starts) - 1


@needs_data
def test_vw_from_cranking_to_1690_rpm(tmp_path):
    """Speed and revolutions are right; alarms at constant-speed thresholds are the method's own."""
    capture = DATA / "vw-60-2-crank-start-to-1690rpm.csv"
    times = edges(capture, 0)
    facts, _events, crank = replayed(capture, tmp_path, "60-2")
    assert facts["edges"] == len(times) == 2577
    starts = turns(times, 2.2)
    full = np.array(
        [b - a for a, b in pairwise(starts) if ((times >= a) & (times < b)).sum() == 58]
    )
    # Synchronisation may come some turns late in cranking, but no turn is counted twice or dropped.
    assert len(full) - 12 <= crank["revolutions"] <= len(full)
    assert crank["fastest_rpm"] == pytest.approx(60 / full.min(), rel=0.01)
    assert crank["speed_rpm"] == pytest.approx(60 / full[-1], rel=0.01)
    assert crank["missed"] == crank["added"] == 0

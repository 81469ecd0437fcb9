"""Real engines: logic-analyser captures through CAN frames, engine, monitor and fault memory.

The captures lie beside the project where they are available; a synthetic one is always tested.
"""

import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from amount import amount
from typer.testing import CliRunner

from gateway.cli import app
from gateway_fdi.common.resources import shipped
from gateway_plants.crank.ecu.capture import read_capture
from gateway_plants.crank.ecu.kinematics import tooth_times
from gateway_plants.crank.monitor.faults import ADDED
from gateway_plants.crank.study.cases import Train
from gateway_plants.crank.study.follow import follower
from gateway_plants.crank.study.table import judge
from gateway_plants.crank.wheel import Wheel

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
    config.write_text(source.replace('"60-2"', f'"{wheel}"'))
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
    return [e for e in events if e["event"] == "dtc" and e["status"] & 1 and e["fault"].startswith("crank")]


@pytest.mark.parametrize("frame", ["classic", "fd"])
def test_a_synthetic_capture(tmp_path, frame):
    times = tooth_times(Wheel.parse("60-2"), [(0, 1500)], 4.0, jitter=0.003, rng=np.random.default_rng(8))
    path = tmp_path / "c.csv"
    rows = [f"{t / 1e9:.9f},0\n{t / 1e9 + 2e-4:.9f},1" for t in np.delete(times, 58 * 50 + 20)]
    path.write_text("time_s,level\n0,1\n" + "\n".join(rows) + "\n")
    facts, events, crank = replayed(path, tmp_path, "60-2", frame=frame)
    assert facts["edges"] == len(times) - 1 == len(edges(path, 0))
    assert crank["revolutions"] == 99, "all but the one that synchronises"
    assert crank["speed_rpm"] == pytest.approx(1500, rel=0.005)
    assert [e["dtc"] for e in crank_faults(events)] == ["P0336-39"]


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
    assert (event["dtc"], event["evidence"]["count"]) == ("P0336-3A", 1)
    starts = turns(times, 2.7)
    counts = [int(((times >= a) & (times < b)).sum()) for a, b in pairwise(starts)]
    assert sorted(set(counts)) == [33, 34]
    wrong = counts.index(34)
    inside = times[(times >= starts[wrong]) & (times < starts[wrong + 1])]
    split = int(np.argmin(np.diff(inside)))  # the shorter of the two parts of one interval
    assert event["evidence"]["tooth"] in (split - 1, split)
    assert starts[wrong] < event["t_ns"] / 1e9 < starts[wrong + 2]
    assert crank["revolutions"] == len(starts) - 1


@needs_data
def test_vw_from_cranking_to_1690_rpm(tmp_path):
    """Chatter, cranking, catch and run-up: no fault, every turn counted, its speed right."""
    capture = DATA / "vw-60-2-crank-start-to-1690rpm.csv"
    times = edges(capture, 0)
    facts, events, crank = replayed(capture, tmp_path, "60-2")
    assert facts["edges"] == len(times) == 2577
    starts = turns(times, 2.2)
    full = np.array([b - a for a, b in pairwise(starts) if ((times >= a) & (times < b)).sum() == 58])
    assert crank_faults(events) == []
    assert crank["revolutions"] in (len(full) - 1, len(full))
    assert crank["fastest_rpm"] == pytest.approx(60 / full.min(), rel=0.01)
    assert crank["speed_rpm"] == pytest.approx(60 / full[-1], rel=0.01)
    assert crank["missed"] == crank["added"] == 0


@needs_data
def test_vw_on_the_wrong_edge_is_the_wiring_fault_it_is(tmp_path):
    capture = DATA / "vw-60-2-crank-start-to-1690rpm.csv"
    _, events, crank = replayed(capture, tmp_path, "60-2", "rising")
    assert {e["dtc"] for e in crank_faults(events)} == {"P0335-64"}
    assert crank["sync"] < 2
    assert crank["missed"] == crank["added"] == 0


def tracked(name, wheel, edge="falling"):
    """The method alone on a capture: what it made of it, and its pulse times [us]."""
    times = read_capture(DATA / name, edge=edge).times_ns / 1e3
    return follower("adaptive", Wheel.parse(wheel))(times), times


def counted(result, pulses, whole=None):
    """Labels by counting alone, from the first label on: right where no pulse is missing or added."""
    first = int(np.argmax(result.proven))
    truth = (np.arange(len(result.teeth)) - first + result.teeth[first]) % pulses
    part = whole or pulses
    return (result.teeth % part == truth % part)[result.proven]


@needs_data
@pytest.mark.parametrize(
    ("name", "wheel", "edge"),
    [
        ("vw-60-2-crank-start-to-1690rpm.csv", "60-2", "falling"),
        ("mitsubishi-4b11-36-2-1-running.csv", "36-2-1", "falling"),
        ("mitsubishi-4b11-36-2-1-running.csv", "36-2-1", "rising"),
        ("noisy-36-2-a.csv", "36-2", "falling"),
        ("noisy-36-2-b.csv", "36-2", "falling"),
        ("nissan_vq40_cranking-1.csv", "9*1,3,9*1,3,9*1,3", "falling"),
        ("nissan_vq40_cranking-1.csv", "9*1,3,9*1,3,9*1,3", "rising"),
    ],
)
def test_no_pulse_is_missing_and_every_label_is_right(name, wheel, edge):
    result, times = tracked(name, wheel, edge)
    w = Wheel.parse(wheel)
    assert result.fault.tolist() == []
    assert counted(result, w.pulses).all()
    # The labels lie right on the wheel, not only at a constant distance: each clear gap is one.
    pt = np.diff(times)
    clear = np.flatnonzero(pt[1:-1] / np.sqrt(pt[:-2] * pt[2:]) > 0.8 * max(w.pitches)) + 1
    clear = clear[result.proven[clear]]
    gaps = np.array(w.pitches)[(result.teeth[clear] - 1) % w.pulses] == max(w.pitches)
    assert len(clear) >= 4
    assert gaps.mean() > (0.85 if "noisy" in name else 0.999)
    # Synchronised at the first gap there is (the VW's first 50 pulses are chatter at rest).
    begin = times[50:] if name.startswith("vw") else times
    starts = np.searchsorted(times, turns(begin, 0.75 * max(w.pitches))[0])
    assert np.argmax(result.teeth >= 0) + 1 <= starts + 2


@needs_data
@pytest.mark.parametrize(("wheel", "edge"), [("12+1", "falling"), ("12+1", "rising"), ("11*1,0.36,0.64", "rising")])
def test_civic_with_the_one_doubled_edge_that_it_has(wheel, edge):
    """At pulse 150 the sensor itself gives a second edge within 0.8 ms (0.06 ms on the rising edge)."""
    result, times = tracked("civic-K20-cranking.csv", wheel, edge)
    assert (result.fault.tolist(), result.count.tolist()) == ([ADDED], [1])
    double = int(np.argmin(np.diff(times[100:200]))) + 101
    # Of 12+1 it is told when the wheel is known: its own short pitch may be a pulse too many of another wheel.
    assert -2 <= result.pulse[0] - double <= (70 if wheel == "12+1" else 2)
    before, after = result.proven.copy(), result.proven.copy()
    before[double - 2 :] = False
    after[: double + 2] = False
    first = int(np.argmax(result.proven))
    place = np.arange(len(result.teeth)) - first + result.teeth[first]
    assert (result.teeth == place % 13)[before].all()
    assert (result.teeth == (place - 1) % 13)[after].all()
    assert before.sum() + after.sum() > (270 if wheel == "12+1" else 330)


@needs_data
@pytest.mark.parametrize(("kind", "count"), [("missed", 1), ("missed", 2), ("added", 1), ("added", 2)])
@pytest.mark.parametrize(
    ("name", "wheel"),
    [
        ("vw-60-2-crank-start-to-1690rpm.csv", "60-2"),
        ("mitsubishi-4b11-36-2-1-running.csv", "36-2-1"),
    ],
)
def test_faults_injected_into_real_engines(name, wheel, kind, count):
    """400 of each kind (80 in CI), anywhere once synchronisation is proven: named, and right within 4 pulses."""
    clean, times = tracked(name, wheel)
    w = Wheel.parse(wheel)
    follow = follower("adaptive", w)
    rng = np.random.default_rng(21)
    print("seed 21")
    runs = amount(400, 80)
    first = int(np.argmax(clean.proven)) + 1
    teeth = np.concatenate([[-1], clean.teeth])
    good = 0
    for at in rng.integers(first, len(times) - 3 * w.pulses, runs):
        if kind == "missed":
            keep = np.ones(len(times), bool)
            keep[at : at + count] = False
            train = Train(times[keep], teeth[keep], at)
        else:
            extra = np.sort(times[at] + rng.uniform(0.02, 0.98, count) * (times[at + 1] - times[at]))
            train = Train(np.insert(times, at + 1, extra), np.insert(teeth, at + 1, [-1] * count), at + 1)
        facts = judge(train, follow(train.times_us), kind, count, w.pulses)
        good += bool(facts["named"]) and bool(facts["labelled"])
    print(f"{good} of {runs}")
    assert good >= 0.985 * runs

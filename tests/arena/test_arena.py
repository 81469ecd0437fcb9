"""The arena in small: two plants, methods of each kind; how scores become figures; a method of a stranger's."""

import json
from dataclasses import replace

import numpy as np
import pytest
from amount import FULL
from typer.testing import CliRunner

from gateway.cli import app
from gateway_arena.contract import SAMPLES, SETTLE, Found, NotForThisPlantError
from gateway_arena.methods import METHODS, method
from gateway_arena.methods.courses import Courses
from gateway_arena.plants import NAMES, plant
from gateway_arena.plants.tennessee import is_there
from gateway_arena.score import judged, roc, threshold
from gateway_arena.trial import records, trial
from gateway_fdi.errors import InputError

SEED = 7
STRANGER = """
import numpy as np

class Range:
    \"\"\"How far a reading is outside of what it was.\"\"\"
    def fit(self, plant, healthy, faulty):
        assert not faulty
        values = np.concatenate([record.values for record in healthy])
        self.middle, self.half = values.mean(0), np.ptp(values, 0) / 2 + 1e-12
    def step(self, sample):
        return float(np.max(np.abs(sample - self.middle) / self.half))

class Prophet(Range):
    def run(self, record):
        from gateway_arena.contract import Found
        return Found(np.full(len(record.values), record.values[-1].sum()))

class Lame:
    pass
"""


@pytest.fixture(scope="module")
def motor():
    print("seed", SEED)
    made = plant("stiff_motor")
    return made, records(made, SEED, runs=1, healthy=9, train=4, off=0.0)


@pytest.mark.long
@pytest.mark.parametrize("name", ["structural", "courses", "pi_bank", "kalman"])
def test_methods_that_know_the_plant_see_its_faults(name, motor):
    row = trial(name, method(name), *motor, false_alarm=0.1)
    print(row)
    assert row.detected == row.runs == 4
    assert row.auc == 1.0
    if name in ("structural", "courses"):
        assert row.true > 0.9
        assert row.wrong == 0


@pytest.mark.parametrize("name", ["quad", *(["buck", "spring", "wind", "motor", "cooling"] if FULL else [])])
@pytest.mark.full("8 s")
def test_the_faults_of_a_plant_are_solved_within_the_budget_of_algebra(name):
    made = plant(name)
    found = trial(
        "structural", method("structural"), made, records(made, SEED, runs=1, healthy=9, train=4, off=0.0), 0.1
    )
    assert found.detected >= found.runs - 1
    assert found.wrong == 0


@pytest.mark.long
@pytest.mark.parametrize("name", ["pca", "svm", "forest", "selected"])
def test_methods_that_learn_see_faults_that_change_much(name, motor):
    made, given = motor

    def raised(some):
        size = 20 * given.learned[0].values.std(0)
        return tuple(replace(r, values=r.values + size * (np.arange(SAMPLES) >= r.onset)[:, None]) for r in some)

    row = trial(name, method(name), made, replace(given, seen=raised(given.seen), faulty=raised(given.faulty)), 0.1)
    print(row)
    assert row.detected >= 3


def test_a_gallery_plant_begins_its_fault_at_its_onset():
    tanks = plant("tanks")
    fine, bad = tanks.record(SEED), tanks.record(SEED, "f_1")
    onset, column = bad.onset, tanks.knowns.index("y1")
    assert np.allclose(fine.values[:onset], bad.values[:onset], atol=1e-6)
    assert bad.values[onset + 1 :, column] - fine.values[onset + 1 :, column] == pytest.approx(0.3, abs=1e-4)
    with pytest.raises(NotForThisPlantError):
        tanks.dynamics(np.zeros(1))


def test_a_threshold_is_the_rank_that_false_alarms_allow():
    largest = np.random.default_rng(SEED).permutation(19.0 - np.arange(19))
    assert threshold(largest, 0.05) == 19.0
    assert threshold(largest, 0.1) == 18.0
    assert threshold(largest[:18], 0.05) == np.inf


def test_roc_has_the_area_of_ranks():
    without, with_fault = np.array([1.0, 2.0, 3.0]), np.array([2.5, 4.0])
    x, y = np.array(roc(without, with_fault)).T
    assert np.trapezoid(y, x) == pytest.approx(5 / 6)


def test_an_alarm_before_the_fault_is_no_detection(motor):
    made, given = motor
    quiet = Found(np.zeros(SAMPLES))
    early, late = np.zeros(SAMPLES), np.zeros(SAMPLES)
    early[SETTLE], late[given.faulty[1].onset + 5] = 1.0, 1.0
    weights = np.tile([1.0, 0.0, 0.0, 0.0], (SAMPLES, 1))
    said = [Found(early, weights), Found(late, weights), *[Found(np.zeros(SAMPLES), weights)] * 2]
    row = judged(made, "x", given.healthy, given.faulty, ([quiet] * 9, [quiet] * 9, said), 0.1)
    assert (row.early, row.detected, row.delay, row.wrong, row.true) == (1, 1, 5, 1, 0.0)
    assert dict(row.missed) == {"f_R": 1, "f_i": 1, "f_w": 1}


def test_gains_that_have_run_away_are_of_no_fault():
    means, noise = np.ones((2, 3)), np.ones((2, 3))
    for gain in (1e200, 1e308, np.inf, np.nan, 0.0):
        assert Courses._unlike(means, noise, lambda size, gain=gain: np.full((2, 3), gain)) == np.inf
    assert Courses._unlike(means, noise, lambda size: np.ones((2, 3))) < 1e-6


def test_a_stranger_enters_by_one_file(tmp_path):
    file = tmp_path / "mine.py"
    file.write_text(STRANGER)
    options = [
        "--plant",
        "quad",
        "--runs",
        "1",
        "--healthy",
        "9",
        "--train",
        "4",
        "--false-alarm",
        "0.1",
        "--seed",
        "7",
    ]
    said = CliRunner().invoke(app, ["evaluate", "arena", *options, "--method", f"{file}:Range", "--json"])
    assert said.exit_code == 0, said.output
    (row,) = json.loads(said.stdout)["rows"]
    assert row["runs"] == 6
    assert row["true"] is None
    made = plant("quad")
    few = records(made, SEED, runs=1, healthy=1, train=1, off=0.0)
    with pytest.raises(InputError, match="later"):
        trial("x", method(f"{file}:Prophet"), made, few, 0.1)
    for wrong in (f"{file}:Lame", f"{file}:None", f"{tmp_path}/no.py:X", "no_such"):
        with pytest.raises(InputError):
            method(wrong)


def test_every_plant_tells_its_source_and_the_help_names_all():
    text = CliRunner().invoke(app, ["evaluate", "arena", "--help"], env={"COLUMNS": "200"}).output
    assert all(name in text for name in (*NAMES, *METHODS))
    for name in NAMES if is_there() else NAMES[:-1]:
        made = plant(name)
        assert made.source
        assert set(made.sizes) <= set(made.model.faults)
        assert set(made.knowns) == set(made.model.knowns)


@pytest.mark.parametrize("name", ["stiff_motor", "tanks"])
def test_faults_have_the_size_that_is_asked_for(name):
    made = plant(name)
    fault = {"stiff_motor": "f_i", "tanks": "f_1"}[name]
    column = made.knowns.index({"stiff_motor": "i", "tanks": "y1"}[name])
    fine, whole, half = (made.record(SEED, *given) for given in ((), (fault,), (fault, 0.0, 0.5)))
    end = (slice(-50, None), column)
    assert np.allclose(half.values[end] - fine.values[end], 0.5 * (whole.values[end] - fine.values[end]), atol=1e-4)
    assert not np.allclose(half.values[end], fine.values[end], atol=1e-2)

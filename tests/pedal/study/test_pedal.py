"""gateway evaluate pedal: the paper's numbers, what our voter promises, and what the command prints.

Seeds from 100000 on: no parameter was chosen on them.
"""

import json

import numpy as np
import paper_tables
import pytest
from amount import FULL, amount
from once import once
from typer.testing import CliRunner

from gateway.cli import app
from gateway_plants.pedal.arrays import Voted
from gateway_plants.pedal.study import paper
from gateway_plants.pedal.study.cases import IDEAL, NOISY, SPAN, TEN_BIT, UNCLIPPED, Case, make, oracle
from gateway_plants.pedal.study.follow import VOTERS, follow
from gateway_plants.pedal.study.outside import faults as outside
from gateway_plants.pedal.study.outside import sensors
from gateway_plants.pedal.study.table import (
    FAULTS,
    FIRST_SEED,
    ONSETS,
    RATES,
    T1,
    T2,
    VALUES,
    jobs,
    judge,
    longest,
    monte_carlo,
)

RUNS = amount(300, 100)
pytestmark = pytest.mark.long
#: Runs that may go wrong where one of 300 may.
FEW = 1 if FULL else 0
ENVIRONMENTS = (IDEAL, TEN_BIT, NOISY)
CLEAN, FIVE = Case("clean + impulses"), Case("impulses", 0.05, 0.10)


def errors(voter, case, environment, seeds):
    runs = (make(case, environment, seed) for seed in seeds)
    return np.array([np.abs(follow(voter, environment, run).value - run.truth).sum() for run in runs])


@pytest.fixture(scope="module")
def scores(tmp_path_factory):
    """Score by (environment, case, voter): all faults and both sweeps, as many runs of each."""
    print(f"seeds {FIRST_SEED} to {FIRST_SEED + RUNS - 1}")
    cases = tuple(dict.fromkeys((*FAULTS, *RATES[::5], *VALUES[::5], *paper.CASES)))
    work = jobs(cases, ENVIRONMENTS, "exponential", RUNS, FIRST_SEED)
    work += jobs((T1, T2), ENVIRONMENTS, "ramp", RUNS, FIRST_SEED)
    rows = once(tmp_path_factory, "voters", lambda: monte_carlo(work))
    return {(r.environment, r.case, r.voter, r.stroke): r for r in rows}


@pytest.fixture(scope="module")
def score(scores):
    def find(environment, case, voter="tracking", stroke="exponential"):
        return scores[environment.name, str(case), voter, stroke]

    return find


# What the paper says


@pytest.mark.parametrize(
    ("voter", "case", "value", "tolerance"),
    [("average", T1, 33.9, 1.7), ("average", T2, 35.1, 2.3), ("median", T1, 5.4, 1.1), ("median", T2, 3.7, 1.1)],
)  # fmt: skip
def test_the_simple_voters_are_reproduced(voter, case, value, tolerance):
    """Mean and spread of 300 runs; the tolerance is the spread of single runs."""
    print("seeds 0 to 299")
    found = errors(voter, case, UNCLIPPED, range(300))
    assert found.mean() == pytest.approx(value, rel=0.05)
    assert found.std() == pytest.approx(tolerance, rel=0.15)


@pytest.mark.parametrize(
    ("environment", "case", "of_300", "of_3000"),
    [(IDEAL, T1, 0.36, 0.334), (IDEAL, T2, 0.22, 0.210), (TEN_BIT, T1, 1.90, 1.88), (TEN_BIT, T2, 1.62, 1.62)],
)  # fmt: skip
def test_kalman_hybrid_redundancy_is_reproduced(environment, case, of_300, of_3000):
    print("seeds 0 to 299, 5000 to 7999")
    assert errors("KHR", case, environment, range(300)).mean() == pytest.approx(of_300, rel=0.10)
    held_out = errors("KHR", case, environment, range(5000, 8000)).mean()
    assert held_out == pytest.approx(of_3000, rel=0.10)


def test_the_papers_other_numbers_do_not_come_out():
    """8.524 for the median and 1.226 for KHR lie outside what nearly all single runs give; seeds 0 to 299."""
    assert (errors("median", T1, UNCLIPPED, range(300)) < 8.524).mean() > 0.98
    assert (errors("KHR", T2, TEN_BIT, range(300)) > 1.226).all()
    assert (errors("KHR", T2, IDEAL, range(300)) < 1.226).mean() > 0.95


@pytest.mark.skipif(FULL, reason="the page has 100 runs")
def test_the_table_of_the_paper_is_the_page_s(scores):
    paper_tables.check("pedal/paper.txt", "gateway evaluate pedal --seeds 100", paper.claims(list(scores.values())))


# What our voter promises (environment, case -> bounds), 300 runs each, or the first 100 of them


@pytest.mark.parametrize(("case", "times"), [(T1, 3.0), (T2, 3.0), (CLEAN, 1.0), (FIVE, 1.0)])
def test_without_noise_it_is_far_below_the_papers_scheme(score, case, times):
    ours, khr = score(IDEAL, case), score(IDEAL, case, "KHR")
    assert times * ours.iae <= khr.iae
    if times > 1:
        assert 4 * ours.median <= khr.median


@pytest.mark.parametrize("environment", [TEN_BIT, NOISY], ids=str)
def test_with_noise_it_is_below_the_repaired_scheme(score, environment):
    for case in (*RATES[::5], *VALUES[::5], CLEAN):
        ours, repaired = score(environment, case), score(environment, case, "KHR*")
        assert 1.25 * ours.iae <= repaired.iae, case
        assert ours.iae <= ours.oracle, case
    assert 1.5 * score(environment, T1).iae <= score(environment, T1, "KHR*").iae
    if environment is NOISY:
        assert 5 * score(environment, T1).iae <= score(environment, T1, "KHR").iae


@pytest.mark.parametrize("environment", [TEN_BIT, NOISY], ids=str)
def test_with_noise_on_a_straight_stroke(score, environment):
    ours, repaired = (score(environment, T1, voter, "ramp") for voter in ("tracking", "KHR*"))
    assert (1.25 if environment is TEN_BIT else 1.5) * ours.iae <= repaired.iae
    ours, repaired = (score(environment, T2, voter, "ramp") for voter in ("tracking", "KHR*"))
    assert 1.15 * ours.iae <= repaired.iae


@pytest.mark.parametrize("onset", [o for o in ONSETS if o])
def test_a_dead_channel_beside_one_with_impulses(score, onset):
    case = Case("dead", onset=onset)
    ours = score(NOISY, case)
    assert 100 * ours.iae <= score(NOISY, case, "KHR").iae
    assert 100 * ours.iae <= score(NOISY, case, "KHR*").iae
    assert ours.latched == 0
    assert ours.false_isolations == 0
    assert ours.isolations == RUNS


@pytest.mark.parametrize("environment", ENVIRONMENTS, ids=str)
def test_a_channel_that_is_dead_from_the_start(score, environment):
    ours = score(environment, Case("dead", onset=0))
    assert ours.iae < 4
    assert ours.latched == 0


@pytest.mark.parametrize("kind", ["stuck", "stuck on plateau", "stuck + impulses", "offset"])
def test_stuck_and_offset_channels(score, kind):
    ours = score(NOISY, Case(kind))
    assert ours.iae <= 2 * ours.oracle
    assert ours.latched == 0
    assert ours.false_isolations <= FEW
    assert ours.isolations >= RUNS - FEW


def test_an_offset_beside_impulses_does_not_isolate_the_healthy_channel(score):
    """In less than 0.1 % of 2000 runs each.

    Of two channels one is named only if it jumped and the other did not: beside impulses that is so in 55 to 76 % of
    the offsets (it was in 98 %, with up to 1 % wrong names); the others are told as drift or correlation.
    """
    print("seeds 110000 to 111999")
    case = Case("offset + impulses")
    for environment in ENVIRONMENTS:
        wrong = 0
        for seed in range(110_000, 112_000):
            isolated = follow("tracking", environment, make(case, environment, seed)).isolated
            wrong += bool((isolated >> 1 & 1).any())
        assert wrong <= 0.001 * 2000, environment
        assert score(environment, case).isolations > 0.4 * RUNS, environment
    assert score(NOISY, case).iae <= 3 * score(NOISY, case).oracle


@pytest.mark.parametrize("environment", [TEN_BIT, NOISY], ids=str)
def test_a_drift_is_flagged_and_the_output_is_the_mean(score, environment):
    """1 mV a sample; flagged at 50 mV; never off by more than half the drift, never the healthy one isolated."""
    ours = score(environment, Case("drift"))
    assert ours.drifts >= 0.99 * RUNS
    assert ours.delay < 70
    assert ours.false_isolations == 0
    assert ours.beyond <= (0 if environment is NOISY else 30)


def test_a_third_channel_tells_which_one_drifts(score):
    ours = score(NOISY, Case("drift"), "tracking of 3")
    assert ours.isolations >= 0.99 * RUNS
    assert ours.false_isolations == 0
    assert ours.iae <= ours.oracle


@pytest.mark.parametrize("environment", ENVIRONMENTS, ids=str)
def test_what_it_believes(score, environment):
    """Noise is what tells a frozen channel from a resting pedal; without it one run in some thousands goes wrong."""
    noisy = environment is NOISY
    healthy = score(environment, Case("none"))
    assert healthy.rejected < 1e-5
    assert healthy.false_isolations == healthy.drifts == 0
    for case in (T1, T2, FIVE, CLEAN):
        ours = score(environment, case)
        assert ours.rejected < (1e-3 if noisy else 2e-3), case
        assert ours.accepted < 5e-3, case
        assert ours.false_isolations <= (0 if noisy else FEW), case
        assert ours.drifts == ours.latched == 0, case


def isolated(case, environment, seeds):
    return [s for s in seeds if follow("tracking", environment, make(case, environment, s)).isolated.any()]


def test_hardly_any_false_isolation_with_impulses_on_both_channels():
    """3000 runs each: less than one in a thousand."""
    print("seeds 110000 to 112999")
    seeds = range(110_000, 113_000)
    assert len(isolated(T1, NOISY, seeds)) <= 2
    assert len(isolated(T1, TEN_BIT, seeds)) <= 2


def test_a_constant_channel_without_noise_is_not_taken_for_frozen():
    """10 bit, the other channel with impulses: only noise tells a frozen channel from a resting pedal."""
    print("seeds 110000 to 110599")
    assert isolated(CLEAN, TEN_BIT, range(110_000, 110_600)) == []


@pytest.mark.parametrize(("kind", "times"), [("both dead", 1.0), ("common mode", 1.1), ("both garbage", 2.0)])
def test_all_channels_failing_for_a_while(score, kind, times):
    ours = score(NOISY, Case(kind))
    assert ours.latched == 0
    assert ours.false_isolations == 0
    assert ours.iae < score(NOISY, Case(kind), "KHR*").iae
    assert ours.iae <= times * ours.oracle


# The study itself


def test_the_same_seed_gives_the_same_run_and_another_one_another():
    a, b, c = (make(T1, NOISY, seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(a.readings, b.readings)
    assert (a.readings != c.readings).any()


def test_the_fault_generator_keeps_to_rate_and_value():
    hits = [make(Case("impulses", 0.1, 0.15), UNCLIPPED, seed) for seed in range(50)]
    assert np.mean([run.faulty.mean() for run in hits]) == pytest.approx(0.1, abs=0.005)
    off = np.concatenate([(run.readings - run.truth[:, None])[run.faulty] for run in hits])
    assert np.abs(off).max() <= 0.15 * SPAN
    assert np.abs(off).mean() == pytest.approx(0.075 * SPAN, rel=0.05)


def test_the_judge_can_fail():
    run = make(Case("dead", onset=300), NOISY, 1)
    n = len(run.truth)
    ones = np.ones(n, np.int64)
    bad = judge(run, Voted(run.readings[:, 0], ones, 2 * ones, 0 * ones), 2, 0.002)
    assert bad["latched"]
    assert bad["false_isolations"]
    assert not bad["isolations"]
    assert bad["rejected"] > 0.5
    assert bad["accepted"] > 0.5
    good = judge(run, Voted(run.truth, 2 * ones, ones, 0 * ones), 2, 0.002)
    assert good["iae"] == 0
    assert not good["latched"]
    assert good["isolations"]
    assert longest(np.array([False, True, True, False, True])) == 2


def test_the_oracle_is_the_mean_of_the_healthy():
    run = make(CLEAN, IDEAL, 3)
    np.testing.assert_allclose(oracle(run), run.truth, atol=1e-9)


def test_faults_on_bad_roads_are_named_and_no_healthy_channel_is():
    """One drive a fault; `gateway evaluate pedal --seeds 0 --roads 40 --hours 10` is the long form."""
    print("seed 5100000")
    asked = CliRunner().invoke(
        app, ["evaluate", "pedal", "--seeds", "0", "--roads", "1", "--hours", "0.1", "--seed", "5100000", "--json"]
    )
    assert asked.exit_code == 0, asked.output
    rows = {row["fault"]: row for row in json.loads(asked.stdout)["roads"]}
    assert set(rows) == {*outside.FAULTS, "healthy"}
    assert sum(row["wrong"] for row in rows.values()) == 0
    seen = [row for row in rows.values() if row["visible"]]
    assert sum(row["visible_right"] for row in seen) >= len(seen) - 3
    assert rows["supply -10 %"]["right"] == 1


def test_what_can_be_seen_of_a_fault():
    """A drift that stays within what is usual cannot, nor can two that are bridged where both read the same."""
    plant = sensors.brake()
    effect = np.zeros((5000, 2))
    effect[2000:, 0] = 4e-5 * np.arange(3000)
    assert outside.visible(plant, effect, 2.0) == pytest.approx(2.0 + 0.096 / 0.04 + 0.2, abs=0.1)
    assert outside.visible(plant, 0.6 * effect, 2.0) is None
    jump = np.zeros((5000, 2))
    jump[2000:] = [0.2, -0.2]
    assert outside.visible(plant, jump, 2.0) == 2.0
    assert outside.visible(plant, 0.3 * jump, 2.0) is None


def test_the_command_prints_tables_json_and_pictures(tmp_path):
    runner = CliRunner()
    shown = runner.invoke(app, ["evaluate", "voters", "--seeds", "2", "--plot", str(tmp_path)])
    assert shown.exit_code == 0, shown.output
    assert "Figs. 11, 13" in shown.stdout
    assert "offset + impulses" in shown.stdout
    drawn = sorted(path.name for path in tmp_path.iterdir())
    assert [name.split("-")[0] for name in drawn] == [
        "fig10",
        "fig11",
        "fig12",
        "fig13",
        "fig14",
        "fig9",
    ]
    assert all(path.stat().st_size > 20_000 for path in tmp_path.iterdir())
    asked = runner.invoke(app, ["evaluate", "voters", "--seeds", "2", "--json"])
    document = json.loads(asked.stdout)
    assert (document["study"], document["seeds"]) == ("voters", 2)
    assert {row["voter"] for row in document["rows"]} == set(VOTERS)
    row = next(r for r in document["rows"] if r["case"] == "none" and r["voter"] == "tracking")
    assert row["runs"] == 2
    assert row["accepted"] is None

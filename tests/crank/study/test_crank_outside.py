"""gateway evaluate crank --outside: a healthy case, a defect, a dropout; the counts can be other than zero."""

import pytest

from gateway_fdi.jit import COMPILED
from gateway_plants.crank.study import outside
from gateway_plants.crank.study.outside import METHODS, MIXED, MIXED_RPM, WHEELS, WRONG_WHEEL, jobs, summed

#: Configured and real: a gap that differs by a tooth, a second gap, another one where the first fits, a filled one, two
#: turns in one, no regular interval, as many pitches in other places, a coarse wheel at the starter's speed.
PAIRS = [
    ("36-1", "36-2"), ("36-2", "36-2-1"), ("12-1", "36-2-1-1"), ("36-2", "36-1"), ("30-2", "60-2"), ("12-1", "24-1"),
    ("60-2", "4-2"), ("36-2-1-1", "36-2-2-2"), ("12-1", "12+1"), ("24-1", "12-1"), ("8-1", "36-1"), ("24-1", "6-1"),
]  # fmt: skip

pytestmark = pytest.mark.skipif(not COMPILED, reason="statistics need the compiled kernels")


def outcomes(group, case, wheel="60-2", runs=4):
    return {row.method: row for row in outside.outcomes((group, case, wheel, runs, 7))}


def test_a_healthy_idle_of_three_cylinders_has_no_report():
    found = outcomes("order, 850 rpm", "1.5 x 10 %")
    assert set(found) == set(METHODS)
    assert (found["adaptive"].runs, found["adaptive"].reports, found["adaptive"].wrong) == (4, 0, 0)
    assert 0 < found["adaptive"].unsynced < 0.1


def test_runout_of_5_percent_is_reported_and_of_1_percent_not():
    assert outcomes("runout", "5 %")["adaptive"].named == {"runout": 4}
    assert outcomes("runout", "1 %")["adaptive"].named == {}


def test_a_dropout_is_reported_by_all_and_wrong_by_some():
    found = outcomes("dropout 1 to 40", "1000 rpm", "36-1", 12)
    assert (found["adaptive"].reports, found["adaptive"].wrong) == (12, 0)
    assert found["ratio"].reports > 0
    assert found["threshold"].reports > 0


def test_there_is_a_job_for_each_case_and_wheel_and_a_sum_of_them():
    made = jobs(1, 3)
    wrong = [job for job in made if job[0] == WRONG_WHEEL]
    assert len(wrong) == len(MIXED) * (len(MIXED) - 1) * len(MIXED_RPM)
    assert len(made) - len(wrong) == len({job[:2] for job in made if job not in wrong}) * len(WHEELS)
    rows = [row for wheel in ("60-2", "36-1") for row in outside.outcomes(("runout", "1 %", wheel, 2, 3))]
    (ours,) = [row for row in summed(rows) if row.method == "adaptive"]
    assert ours.runs == 4
    assert ours.pulses == sum(row.pulses for row in rows if row.method == "adaptive")


@pytest.mark.parametrize(("told", "real"), PAIRS)
def test_another_wheel_is_named_and_nothing_before_it(told, real):
    for rpm in MIXED_RPM:
        ours = outcomes(WRONG_WHEEL, f"{real}, {rpm:.0f} rpm", told, 1)["adaptive"]
        assert (ours.named, ours.wrong) == ({"wrong_wheel": 1}, 0), ours

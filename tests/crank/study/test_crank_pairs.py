"""gateway evaluate crank --pairs: another wheel than the configured one is named; wheels that a defect makes alike."""

import numpy as np
import pytest

from gateway_fdi.jit import COMPILED
from gateway_plants.crank.monitor.faults import ADDED, WRONG_WHEEL
from gateway_plants.crank.study.follow import Followed
from gateway_plants.crank.study.pairs import SPEEDS_RPM, WHEELS, Outcome, _judge, jobs, outcomes

#: Of each kind: a gap that differs by a tooth, a second gap, another one where the first fits, a filled one, two turns
#: in one, no regular interval, as many pitches in other places, a coarse wheel at the starter's speed.
PAIRS = [
    ("36-1", "36-2"), ("36-2", "36-2-1"), ("12-1", "36-2-1-1"), ("36-2", "36-1"), ("30-2", "60-2"), ("12-1", "24-1"),
    ("60-2", "4-2"), ("36-2-1-1", "36-2-2-2"), ("12-1", "12+1"), ("24-1", "12-1"), ("8-1", "36-1"), ("24-1", "6-1"),
]  # fmt: skip


@pytest.mark.skipif(not COMPILED, reason="statistics need the compiled kernels")
@pytest.mark.parametrize(("told", "real"), PAIRS)
def test_another_wheel_is_named_and_nothing_before_it(told, real):
    print("seed 44071")
    for row in outcomes((told, real, 1, 44071)):
        assert (row.named, row.runs, row.proven) == (1, 1, 0), row


def test_what_is_not_named_alone_and_in_time_does_not_count():
    def judged(faults, pulses):
        row = Outcome("36-1", "60-2", 1500.0)
        none = np.zeros(len(faults), np.int64)
        _judge(row, Followed(none, none > 0, np.array(pulses), np.array(faults), none, none, 0))
        return row.named

    assert judged([WRONG_WHEEL], [58 * 30]) == 1
    assert judged([WRONG_WHEEL], [58 * 30 + 1]) == 0
    assert judged([ADDED, WRONG_WHEEL], [58, 58 * 6]) == 0
    assert judged([WRONG_WHEEL, ADDED], [58 * 6, 58 * 50]) == 0


def test_each_wheel_is_configured_with_each_other_one():
    assert len(jobs(1, 1)) * len(SPEEDS_RPM) == 546
    assert len(set(WHEELS)) == 14

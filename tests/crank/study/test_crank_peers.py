"""The peers against what their sources do with a fault, worked out by hand on a wheel at constant speed."""

import numpy as np

from gateway_plants.crank.study.follow import follower
from gateway_plants.crank.wheel import Wheel

WHEEL = Wheel.parse("36-1")
TEETH = np.arange(35 * 12) % 35
TIMES = (np.arange(12)[:, None] * 36 + np.array(WHEEL.positions)).ravel() * 2500.0


def train(at, kind):
    if kind == "missed":
        return np.delete(TIMES, at), np.delete(TEETH, at)
    return np.insert(TIMES, at + 1, TIMES[at] + 1500.0), np.insert(TEETH, at + 1, -1)


def states(method, at, kind, turns=2):
    """Pulses without synchronisation and pulses with a wrong tooth, behind the fault."""
    times, teeth = train(at, kind)
    found = follower(method, WHEEL)(times)
    behind = slice(at - 1, at + turns * 35)
    told, true = found.teeth[behind], teeth[1:][behind]
    return int((told < 0).sum()), int(((told >= 0) & (true >= 0) & (told != true)).sum())


def test_ratio_takes_the_next_gap_whatever_the_count():
    """36-1, tooth 20 missed: its interval is a gap of the wrong count; the true gap, 14 pulses on, restores."""
    unsynced, wrong = states("ratio", 35 * 6 + 20, "missed")
    assert (unsynced, wrong) == (14, 0)


def test_threshold_tolerates_one_pulse_too_few_at_the_gap():
    """36-1, the last tooth missed: one interval of three pitches, 34 pulses counted; nothing is lost."""
    assert states("threshold", 35 * 6 + 34, "missed") == (0, 0)


def test_threshold_takes_the_very_next_pulse_for_the_first_tooth():
    """36-1 at 667 rpm, tooth 20 missed: lost at tooth 21, tooth 22 taken for the first.

    At the true gap it is lost again for having too few, and is wrong by one up to the gap after that: more than a turn.
    """
    unsynced, wrong = states("threshold", 35 * 6 + 20, "missed")
    assert unsynced == 2
    assert wrong == 13 + 34

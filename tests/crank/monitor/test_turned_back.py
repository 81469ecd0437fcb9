"""Engines that turn back: nothing is held against the sensor, and pulses missed at a crawl are named all the same."""

import numpy as np
import pytest

from gateway_fdi.jit import COMPILED
from gateway_plants.crank.ecu.kinematics import tooth_times
from gateway_plants.crank.monitor.faults import FAULTS
from gateway_plants.crank.study import outside
from gateway_plants.crank.study.follow import follower
from gateway_plants.crank.wheel import Wheel

compiled = pytest.mark.skipif(not COMPILED, reason="statistics need the compiled kernels")
SEED = 271828


def turned_back(make, runs):
    """Runs of each wheel: how many there are, those with a report, those with a wrong tooth while proven."""
    print("seed", SEED)
    reported = wrong = 0
    for w, text in enumerate(outside.WHEELS):
        wheel = Wheel.parse(text)
        follow = follower("adaptive", wheel)
        for k in range(runs):
            times, teeth, _ = make(wheel, np.random.default_rng([SEED, w, k]), k)
            result = follow(times)
            reported += len(result.fault) > 0
            wrong += bool((result.proven & (result.teeth % wheel.repeats != teeth[1:] % wheel.repeats)).any())
    return runs * len(outside.WHEELS), reported, wrong


@compiled
@pytest.mark.parametrize(("make", "most"), [(outside._stop, 1), (outside._rock, 1), (outside._start, 5)])
def test_an_engine_that_turns_back_accuses_nobody(make, most):
    """12 runs of each of nine wheels; before, 6 of 108 stops, 14 restarts and 42 starts had a report."""
    runs, reported, wrong = turned_back(make, 12)
    print(f"{reported} of {runs} reported, {wrong} with a wrong tooth")
    assert reported <= most
    assert wrong <= 2 * most


def test_pulses_of_both_directions_are_where_the_angle_says():
    """Against a fine grid of the angle: each crossing of a tooth, forward by one edge, back by the other."""
    wheel = Wheel.parse("12-1")
    pieces = [(0.0, 0.3), (-2000.0, 0.25), (1500.0, 0.4)]
    times, teeth = outside.turning_times(wheel, pieces, 200.0, 0.4)
    t = np.arange(0, 0.95, 1e-6)
    acceleration = np.select([t < 0.3, t < 0.55], [0.0, -2000.0], 1500.0) / 60 * wheel.turn
    speed = 200 / 60 * wheel.turn + np.concatenate([[0], np.cumsum(acceleration[:-1]) * 1e-6])
    angle = np.concatenate([[0], np.cumsum((speed[:-1] + speed[1:]) / 2) * 1e-6])
    expected = []
    for turn in range(-3, 4):
        for tooth, place in enumerate(wheel.positions):
            forward = np.flatnonzero((angle[:-1] <= place + turn * 12) & (angle[1:] > place + turn * 12))
            back = np.flatnonzero((angle[:-1] >= place + turn * 12 + 0.4) & (angle[1:] < place + turn * 12 + 0.4))
            expected += [(t[k] * 1e6, tooth) for k in (*forward, *back)]
    expected.sort()
    assert (speed < 0).any()
    assert teeth.tolist() == [tooth for _, tooth in expected]
    np.testing.assert_allclose(times, [at for at, _ in expected], atol=30.0)


@pytest.mark.parametrize("wheel", ["60-2", "36-1"])
@pytest.mark.parametrize("rpm", [100.0, 60.0])
def test_a_pulse_missed_at_a_crawl_is_named_when_the_place_is_proven_again(wheel, rpm):
    """So slow an engine could have turned back in the interval: what follows says that it has not."""
    w = Wheel.parse(wheel)
    rng = np.random.default_rng(SEED)
    print("seed", SEED)
    for place in (5, 17, 29):
        times = tooth_times(w, [(0, rpm)], 16 * 60 / rpm, ripple=[(2, 0.03, 1.0)], jitter=0.01, rng=rng) / 1e3
        result = follower("adaptive", w)(np.delete(times, 8 * w.pulses + place))
        assert [FAULTS[k].name for k in result.fault] == ["missed_pulse"], place
        assert result.tooth.tolist() == [place]
        assert result.pulse[0] < 8 * w.pulses + place + 2.2 * w.pulses

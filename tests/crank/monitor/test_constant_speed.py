"""The paper's method against the paper's residuals and an independent observer."""

import numpy as np
import pytest
from amount import examples
from hypothesis import example, given, settings
from hypothesis import strategies as st

from gateway.monitors.contract import FAILED
from gateway_fdi.jit import zeros
from gateway_plants.crank.monitor.faults import ADDED, MISSED, SYNC_LOST
from gateway_plants.crank.monitor.monitor import MONITOR, Params
from gateway_plants.crank.study.constant_speed import TRACK, Const, State, prepare, tooth
from gateway_plants.crank.wheel import Wheel


class Bench:
    """The monitor alone, fed with intervals."""

    def __init__(self, wheel, gain=0.6, threshold=None, follow_speed=True):
        self.s, self.c, self.out = (zeros(1, kind) for kind in (State, Const, MONITOR.results))
        prepare(self.s[0], self.c[0], Wheel.parse(wheel), gain, threshold, follow_speed)
        self.failures = []

    def feed(self, intervals):
        for k, y in enumerate(intervals):
            self.out[0]["n"] = 0
            tooth(self.s[0], self.c[0], float(y), self.out[0])
            for r in self.out[0]["results"][: int(self.out[0]["n"])]:
                if r["result"] == FAILED:
                    self.failures.append((k, int(r["fault"]), r["cells"].tolist()))
        return self


def train(wheel, turns, alpha=100.0, rng=None, jitter=0.0):
    """Pulse times [us] of a wheel at constant speed."""
    w = Wheel.parse(wheel)
    places = np.concatenate([np.array(w.positions) + w.turn * k for k in range(turns)])
    times = places * alpha
    return times if rng is None else times + rng.normal(0, jitter * alpha, len(times))


# r / delta from the first non-zero sample on, D = 0.6, for a gap displaced by m: (4), (5) in (6), (8).
SHAPES = {
    1: [1.0, -1.6, 0.36, 0.144, 0.0576],
    2: [1.0, -0.6, -1.24, 0.504, 0.2016],
    3: [1.0, -0.6, -0.24, -1.096, 0.5616],
}


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_displaced_gap_has_the_papers_residual_and_names_direction_and_count(count, sign):
    """PTs as (1) with (4), (5): the gap comes ``count`` pulses early (missed) or late (added)."""
    wheel = Wheel.parse("60-2")
    clean = np.array(wheel.pitches) * 100.0
    turn = clean[count:] if sign > 0 else np.concatenate([[100.0] * count, clean])
    bench = Bench(wheel="60-2", follow_speed=False)
    bench.feed(np.concatenate([np.tile(clean, 5), turn, np.tile(clean, 3)]))
    (failure,) = bench.failures
    assert failure[1] == (MISSED if sign > 0 else ADDED)
    evidence = failure[2]
    assert evidence[0] == count
    residuals = np.array(evidence[3:8]) / 2.0  # delta is two pitches
    np.testing.assert_allclose(residuals, sign * np.array(SHAPES[count]), atol=1e-9)


@pytest.mark.costly
@settings(max_examples=examples(60), deadline=None)
@example("36-1", -1, 0.6875, 0, 7).via("a residual of just the threshold")
@given(
    st.sampled_from(["60-2", "36-1", "30-2"]),
    st.sampled_from([-2, -1, 1, 2]),
    st.floats(0.25, 0.75),
    st.integers(0, 2**31),
    st.integers(7, 100),
)
def test_a_fault_in_mid_turn_is_named_and_sync_is_kept(wheel, count, share, seed, tooth):
    """Missed or added pulses at constant speed, 0.3 % jitter, six pulses and more from the gap."""
    w = Wheel.parse(wheel)
    rng = np.random.default_rng(seed)
    times = train(wheel, 12, rng=rng, jitter=0.003)
    at = 5 * w.pulses + 7 + (tooth - 7) % (w.pulses - 15)
    if count > 0:
        times = np.delete(times, range(at, at + count))
    else:
        width = times[at + 1] - times[at]
        extra = times[at] + width * np.array([share] if count == -1 else [share / 2, share])
        times = np.sort(np.concatenate([times, extra]))
    bench = Bench(wheel=wheel).feed(np.diff(times))
    (failure,) = bench.failures
    assert (failure[1], failure[2][0]) == ((MISSED, count) if count > 0 else (ADDED, -count))
    assert bench.s[0]["phase"] == TRACK
    # Every label right again: the last interval fed was that before the last pulse of a turn.
    assert bench.s[0]["index"] == w.pulses - 1
    assert bench.s[0]["revolutions"] == 10


@pytest.mark.costly
@pytest.mark.parametrize("wheel", ["60-2", "36-1", "30-2", "36-2-1", "57*1,3"])
def test_a_healthy_wheel_makes_no_event_and_its_speed_is_right(wheel):
    rng = np.random.default_rng(5)
    w = Wheel.parse(wheel)
    alpha = 60e6 / 1500 / w.turn
    bench = Bench(wheel=wheel).feed(np.diff(train(wheel, 200, alpha, rng, 0.005)))
    assert bench.failures == []
    assert bench.s[0]["speed_rpm"] == pytest.approx(1500, rel=2e-3)
    assert bench.s[0]["revolutions"] == 198


def test_the_wrong_wheel_is_lost_sync_not_missed_pulses():
    bench = Bench(wheel="60-2").feed(np.diff(train("36-1", 40)))
    assert {fault for _, fault, _ in bench.failures} == {SYNC_LOST}


def test_the_residual_follows_an_independent_observer():
    """(6), (8) written down once more, for a train with ripple, jitter and a displaced gap."""
    rng = np.random.default_rng(9)
    w = Wheel.parse("36-1")
    y = np.diff(train("36-1", 8, rng=rng, jitter=0.004))
    y[5 * w.pulses + 9] += 60.0
    y[5 * w.pulses + 10] -= 60.0
    bench = Bench(wheel="36-1", follow_speed=False, threshold=50.0)
    a = np.array(w.pitches)
    bench.feed(y[: 3 * w.pulses])
    s = bench.s[0]
    x, alpha, i = float(s["x"]), float(s["alpha"]), int(s["index"])
    for value in y[3 * w.pulses :]:
        r = value - x
        x = x + alpha * (a[(i + 1) % w.pulses] - a[i]) + 0.6 * r
        i = (i + 1) % w.pulses
        bench.feed([value])
        assert s["x"] == pytest.approx(x, abs=1e-9)
        assert s["index"] == i


def test_the_papers_threshold_alarms_about_once_a_revolution_on_a_healthy_wheel():
    """gamma 0.16, alpha 2, D 0.6: 1.0 is 2.09 sigma of the residual, not 2.54."""
    rng = np.random.default_rng(1)
    print("seed 1")
    count = 400_000
    noise = rng.normal(0, 0.4, count)
    e, exceeded, squares = 0.0, 0, 0.0
    for n in noise:
        r = e + n
        exceeded += abs(r) > 1.0
        squares += r * r
        e = e - 0.6 * r
    assert np.sqrt(squares / count) == pytest.approx(np.sqrt(2 * 0.16 / 1.4), rel=0.01)
    assert exceeded / count * 28 == pytest.approx(1.02, abs=0.03)


def test_a_wrong_wheel_in_the_configuration_says_the_rule():
    with pytest.raises(ValueError, match="is not a wheel"):
        Params(wheel="sixty")

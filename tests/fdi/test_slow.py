"""Slow errors and lags: the filter against filterpy's, bounds, what is refused; the lag of what is filtered or late."""

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter

from gateway_fdi.jit import zeros
from gateway_fdi.slow import delay, lag
from gateway_fdi.slow import filter as slow

SEED = 4711


def filled(low, high, rate=1e-9, groups=None):
    c, s, b = zeros(1, slow.Const)[0], zeros(1, slow.State)[0], zeros(1, slow.Block)[0]
    c.count = len(low)
    c.low[: len(low)], c.high[: len(low)] = low, high
    c.rate[: len(low)] = rate
    c.prior[: len(low)] = high
    c.group[: len(low)] = range(len(low)) if groups is None else groups
    slow.prepare(s, c)
    return c, s, b


def feed(c, s, b, h, rest, variance=1.0, mode=slow.LEARNS):
    wide = np.zeros(slow.MOST)
    wide[: len(h)] = h
    slow.wait(s, 0.01)
    if slow.add(b, wide, rest, variance):
        slow.update(s, c, b, slow.COLOURED, mode)


def test_blocks_are_those_of_a_kalman_filter():
    print("seed", SEED)
    rng = np.random.default_rng(SEED)
    c, s, b = filled([-9.0] * 3, [9.0] * 3)
    other = KalmanFilter(dim_x=3, dim_z=1)
    other.x, other.P = np.zeros((3, 1)), np.diag([81.0] * 3)
    truth = np.array([1.0, -2.0, 0.5])
    for _ in range(60):
        hs = rng.normal(size=(slow.BLOCK, 3)) * [1.0, 0.3, 2.0]
        rests = hs @ truth + rng.normal(size=slow.BLOCK)
        for h, rest in zip(hs, rests, strict=True):
            feed(c, s, b, h, rest)
        noise = slow.COLOURED / slow.BLOCK
        other.update(np.array([[rests.mean()]]), R=np.array([[noise]]), H=hs.mean(axis=0)[None])
    assert s.error[:3] == pytest.approx(other.x[:, 0], rel=1e-3, abs=1e-4)
    assert s.p[:3, :3] == pytest.approx(other.P, rel=1e-3, abs=1e-5)
    assert np.abs(s.error[:3] - truth).max() < 3.0 * np.sqrt(np.diag(other.P)).max()
    wide = np.zeros(slow.MOST)
    wide[:3] = [1.0, 1.0, -1.0]
    assert slow.doubt(s, c, wide) == pytest.approx(np.sqrt(wide[:3] @ other.P @ wide[:3]), rel=1e-3)


def test_a_block_is_whole_from_its_size_on_until_it_is_dropped():
    block, h = zeros(1, slow.Block)[0], np.ones(slow.MOST)
    assert [bool(slow.add(block, h, 2.0, 0.5, 3)) for _ in range(5)] == [False, False, True, True, True]
    assert (block.sets, block.rest, block.variance, *block.h[:2]) == (5, 10.0, 2.5, 5.0, 5.0)
    slow.drop(block)
    assert (block.sets, block.rest, block.variance, block.h.any()) == (0, 0.0, 0.0, False)
    assert not slow.add(block, h, 2.0, 0.5, 3)


@pytest.mark.costly
def test_what_is_a_little_beyond_its_bound_is_left_and_what_is_far_beyond_is_not_taken():
    """Of a bound of 1: 1.02 is the bound; 2 is a fault, and nothing of it is taken, nor of its group."""
    for size, taken in ((0.5, [0.5, 0.3]), (1.02, [1.0, 0.3]), (2.0, [0.0, 0.0])):
        c, s, one = filled([-1.0, -1.0], [1.0, 1.0], groups=[7, 7])
        two = zeros(1, slow.Block)[0]
        for _ in range(500 * slow.BLOCK):
            feed(c, s, one, [1.0, 0.0], size, 0.01)
            feed(c, s, two, [0.0, 1.0], 0.3, 0.01)
        assert list(s.error[:2]) == pytest.approx([size, 0.3], abs=1e-3)
        assert list(s.taken[:2]) == pytest.approx(taken, abs=1e-3)


def test_what_no_equation_tells_apart_is_no_doubt_of_the_same_sum():
    """A gain and a parameter that add to the same: each is known to its prior's part, the sum to the noise."""
    c, s, b = filled([-0.02, -0.01], [0.02, 0.01])
    for _ in range(500 * slow.BLOCK):
        feed(c, s, b, [100.0, 100.0], 2.5, 1.0)
    assert s.taken[0] + s.taken[1] == pytest.approx(0.025, abs=1e-3)
    assert np.all(s.taken[:2] <= [0.02, 0.01])
    one, both = np.zeros(slow.MOST), np.zeros(slow.MOST)
    one[0], both[:2] = 100.0, 100.0
    assert slow.doubt(s, c, both) < 0.1
    assert slow.doubt(s, c, one) > 0.5


@pytest.mark.costly
def test_an_error_that_is_known_moves_by_its_rate_and_age_makes_a_test_doubt_by_it():
    c, s, b = filled([-1.0], [1.0], rate=1e-3)
    for _ in range(2000 * slow.BLOCK):
        feed(c, s, b, [1.0], 0.0, 1e-4)
    for _ in range(10 * slow.BLOCK):
        feed(c, s, b, [1.0], 0.9, 1e-4, mode=slow.FOLLOWING)
    assert 0.0 < s.taken[0] < 0.1, "one second"
    one = np.zeros(slow.MOST)
    one[0] = 1.0
    before = slow.GUARD * slow.doubt(s, c, one)
    for _ in range(100):
        slow.age(s, c, 1.0)
    assert slow.GUARD * slow.doubt(s, c, one) - before == pytest.approx(0.1, rel=1e-6)


@pytest.mark.costly
def test_a_gain_is_not_pulled_away_by_the_noise_of_its_own_sensor():
    """y = x (1 + g) + n, h = y: of single sets g comes out 0.2 too large, for h and n go together."""
    print("seed", SEED)
    c, s, b = filled([-1.0], [1.0])
    for n in 0.5 * np.random.default_rng(SEED).normal(size=2000 * slow.BLOCK):
        reading = 1.0 * (1.0 - 0.1) + n
        feed(c, s, b, [reading / 0.9], reading - 1.0, 0.25)
    assert s.error[0] == pytest.approx(-0.1, abs=0.04)


def test_an_error_that_is_held_moves_by_its_rate_and_becomes_no_surer():
    c, s, b = filled([-1.0, -1.0], [1.0, 1.0], rate=1e-3)

    def take(mode):
        b.h[:2], b.rest, b.variance, b.sets = [1.0, -2.0], 5.0, 0.01, 1
        slow.update(s, c, b, 1.0, mode)

    for k in range(1, 6):
        slow.wait(s, 0.5)
        take(slow.HELD)
        assert list(s.error[:2]) == pytest.approx([5e-4 * k, -5e-4 * k])
        assert list(s.taken[:2]) == pytest.approx(s.error[:2])
    assert list(np.diag(s.p)[:2]) == pytest.approx([1.0, 1.0])
    take(slow.LEARNS)
    assert abs(s.error[1]) > 0.5, "and is found at once when it is let go"
    h = np.zeros(slow.MOST)
    h[:2] = [1.0, -2.0]
    before = slow.doubt(s, c, h)
    slow.wait(s, 10.0)
    take(slow.HELD)
    most = 3.0 * 1e-3 * 10.0 / slow.GUARD  # h by rate and time: no walk, which would be 0.1 by now
    assert slow.doubt(s, c, h) < before + most


def moved(n, rng):
    """A command that ramps and jumps."""
    return np.cumsum(np.where(rng.random(n) < 0.05, rng.normal(0.0, 8.0, n), rng.normal(0.0, 0.4, n)))


@pytest.mark.costly
@pytest.mark.parametrize("late", [-2.0, -1.0, 0.0, 0.5, 1.0, 3.0])
@pytest.mark.parametrize("gain", [1.0, 0.5])
def test_a_lag_is_found_and_found_again(late, gain):
    print("seed", SEED)
    rng = np.random.default_rng(SEED)
    x = moved(20_000, rng)
    at = np.arange(len(x))
    y = gain * np.interp(at - late, at, x) + 3.0 + rng.normal(0.0, 0.5, len(x))
    s = zeros(1, lag.State)[0]
    for k in range(3000):
        lag.update(s, x[k], y[k], 3.0, 0.5)
    assert s.known == 1
    assert s.lag == pytest.approx(late, abs=0.1)
    assert s.left < 0.3
    y = np.interp(at - 1.0, at, x) + rng.normal(0.0, 0.5, len(x))
    for k in range(3000, len(x)):
        lag.update(s, x[k], y[k], 3.0, 0.5)
    assert s.lag == pytest.approx(1.0, abs=0.1)


@pytest.mark.costly
def test_what_does_not_move_together_has_no_lag():
    print("seed", SEED)
    rng = np.random.default_rng(SEED)
    s = zeros(1, lag.State)[0]
    for x, y in zip(moved(3000, rng), moved(3000, rng), strict=True):
        lag.update(s, x, y, 3.0, 0.5)
    assert s.known == 0
    assert s.lag == 0.0


def test_readings_of_one_time_lie_on_the_lines_between_samples():
    """Beside NumPy's interpolation; a sample that did not come lies on a line, a gap begins anew."""
    s, values, at = zeros(1, delay.State)[0], np.random.default_rng(SEED).normal(size=(60, 128)), [0]
    print("seed", SEED)
    delay.put(s, values[0], 0)
    assert delay.read(s, 3, 2.0 * delay.MOST) == values[0, 3]
    for k in range(1, 60):
        periods = 3 if k == 30 else 1
        delay.put(s, values[k], periods)
        at.append(at[-1] + periods)
        for back in (0.0, 0.25, 1.0, 5.7, 14.0):
            wanted = np.interp(at[-1] - back, at, values[: k + 1, 3])
            assert delay.read(s, 3, back) == pytest.approx(wanted)
        assert delay.read(s, 3, 99.0) == delay.read(s, 3, 14.0), "what is longer ago is not kept"

"""The paper's voters against filterpy, scipy, NumPy and the numbers of its text."""

import numpy as np
import pytest
import scipy.signal
from filterpy.kalman import KalmanFilter
from hypothesis import given
from hypothesis import strategies as st

from gateway_fdi.jit import zeros
from gateway_plants.pedal.ecu import strokes
from gateway_plants.pedal.study import hybrid, kalman_hybrid, predictive_hybrid
from gateway_plants.pedal.study.cases import IDEAL, SPAN, Case, Run, make
from gateway_plants.pedal.study.follow import VOTERS, follow
from gateway_plants.pedal.voting import simple

volts = st.floats(-10, 10)


def ready(module, channels=2, beta=0.3, lower=True, **predictor):
    s, c = zeros(1, module.State)[0], zeros(1, module.Const)[0]
    hybrid.prepare(c["hybrid"], channels, beta=beta, lower=lower)
    module.prepare(c, **predictor)
    return s, c


def stroke():
    return SPAN * strokes.exponential(np.arange(1000) * 1e-3)


def run_of(readings, truth=None):
    truth = stroke() if truth is None else truth
    readings = np.ascontiguousarray(np.column_stack([readings, truth])[:, :3])
    return Run(truth, readings, np.zeros(readings.shape, bool), -1, 0)


@given(st.lists(volts, min_size=2, max_size=3))
def test_average_and_median_are_numpys(y):
    s, c = zeros(1, simple.State)[0], zeros(1, simple.Const)[0]
    simple.prepare(c, len(y))
    readings = np.array([*y, 0.0])
    simple.average(s, c, readings)
    assert float(s["value"]) == pytest.approx(np.mean(y), abs=1e-12)
    assert int(s["used"]) == (1 << len(y)) - 1
    simple.median(s, c, readings)
    assert float(s["value"]) == pytest.approx(np.median(y), abs=1e-12)


def test_the_predictor_is_filterpys_kalman_filter():
    rng = np.random.default_rng(1)
    print("seed 1")
    observed = rng.exponential(0.02, 500)
    oracle = KalmanFilter(dim_x=1, dim_z=1)
    oracle.F, oracle.H, oracle.Q, oracle.R = (np.array([[v]]) for v in (1.0, 1.0, 1.0, 0.5))
    oracle.P[:] = 1.0
    s, c = ready(kalman_hybrid)
    s["p"] = 1.0
    for value in observed:
        oracle.predict()
        assert kalman_hybrid.predict(s, c) == pytest.approx(float(oracle.x[0, 0]), abs=1e-10)
        oracle.update(value)
        kalman_hybrid.correct(s, c, value)
    assert float(s["p"]) == pytest.approx(float(oracle.P[0, 0]), abs=1e-10)
    assert float(oracle.K[0, 0]) == pytest.approx(np.sqrt(3) - 1, abs=1e-12)


def test_the_gain_does_not_grow_with_the_number_of_iterations():
    """The paper's conclusion says it does; after four samples it stands at sqrt(3) - 1."""
    s, c = ready(kalman_hybrid)
    s["p"] = 1.0
    gains = []
    for _ in range(50):
        kalman_hybrid.predict(s, c)
        gains.append(float(s["p"]) / (float(s["p"]) + 0.5))
        kalman_hybrid.correct(s, c, 0.0)
    np.testing.assert_allclose(gains[4:], np.sqrt(3) - 1, atol=1e-4)


@pytest.mark.parametrize("alpha", [0.1, 0.3, 0.7])
def test_the_predictive_forecast_is_browns(alpha):
    """The change smoothed twice by scipy's filter, level and trend from that."""
    y = stroke()
    pair = np.ascontiguousarray(np.column_stack([y, y]))
    s, c = ready(predictive_hybrid, alpha=alpha)
    forecasts = []
    for row in pair:
        predictive_hybrid.vote(s, c, row)
        forecasts.append(float(s["hybrid"]["change"]))
    change = np.abs(np.diff(y))
    once = scipy.signal.lfilter([alpha], [1, alpha - 1], change)
    twice = scipy.signal.lfilter([alpha], [1, alpha - 1], once)
    expected = 2 * once - twice + alpha / (1 - alpha) * (once - twice)
    np.testing.assert_allclose(forecasts[2:], np.maximum(expected[:-1], 0), atol=1e-12)


def test_the_worked_example_of_the_text():
    """2.84, 1.45, 1.80 V on one channel, 0 V on the other, 746 to 748: 2.11, 2.10, 2.09 V."""
    y = np.column_stack([stroke(), stroke()])
    assert stroke()[42] == pytest.approx(1.80, abs=0.005)
    y[746:749, 0] = 2.84, 1.45, 1.80
    y[746:749, 1] = 0.0
    followed = follow("KHR", IDEAL, run_of(y))
    np.testing.assert_allclose(followed.value[746:749], [2.109, 2.098, 2.087], atol=0.001)
    np.testing.assert_allclose(followed.value[746:749], [2.11, 2.10, 2.09], atol=0.015)
    assert (followed.used[746:749] == 0).all(), "the exception handler made them"


def test_straight_ramps_contradict_the_samples_that_the_text_quotes():
    ramp = SPAN * strokes.ramp(np.arange(1000) * 1e-3)
    assert ramp[42] == pytest.approx(0.47, abs=0.01)
    assert ramp[746] == pytest.approx(3.04, abs=0.03)


def test_one_dead_channel_latches_the_scheme_at_600_ms():
    """One channel 0 V from 300 ms, the other clean: at 600 ms the change turns its sign, and it never recovers."""
    y = np.column_stack([stroke(), stroke()])
    y[300:, 0] = 0.0
    followed = follow("KHR", IDEAL, run_of(y))
    error = np.abs(followed.value - stroke())
    assert error[:600].sum() < 0.01
    assert (followed.used[610:] == 0).all(), "in the exception for ever"
    assert error.sum() == pytest.approx(1040, rel=0.02)
    assert np.abs(follow("tracking", IDEAL, run_of(y)).value - stroke()).sum() < 0.5


@pytest.mark.costly
def test_ten_microvolts_of_noise_latch_the_scheme_from_the_start():
    print("seeds 0 to 19")
    for seed in range(20):
        rng = np.random.default_rng(seed)
        y = stroke()[:, None] + rng.normal(0, 1e-5, (1000, 2))
        error = np.abs(follow("KHR", IDEAL, run_of(y)).value - stroke()).sum()
        assert error == pytest.approx(3088, rel=0.01)


def test_a_reading_that_moves_less_than_predicted_is_rejected_as_printed():
    s, c = zeros(1, hybrid.State)[0], zeros(1, hybrid.Const)[0]
    for lower, believed in ((True, 0b10), (False, 0b11)):
        hybrid.prepare(c, 2, beta=0.3, lower=lower)
        s["value"], s["before"], s["started"] = 1.0, 0.9, 1
        hybrid.vote(s, c, np.array([1.01, 1.1]), 0.1)
        assert int(s["used"]) == believed


def test_of_three_channels_those_that_agree_are_believed():
    y = stroke()
    three = np.ascontiguousarray(np.column_stack([y, y, y + 1.0]))
    three[:20, 2] = y[:20]
    s, c = ready(kalman_hybrid, channels=3)
    used = []
    for row in three:
        kalman_hybrid.vote(s, c, row)
        used.append(int(s["used"]))
    assert set(used[21:600]) == {0b011}


@pytest.mark.costly
def test_every_voter_gives_the_truth_of_perfect_channels():
    run = make(Case("none"), IDEAL, 0)
    for name in VOTERS:
        error = np.abs(follow(name, IDEAL, run).value - run.truth)
        assert error.max() < 1e-3, name

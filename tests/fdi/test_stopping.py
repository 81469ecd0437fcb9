"""Stopping rules against their definitions."""

import numpy as np
import pytest
from amount import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from gateway_fdi import stopping
from gateway_fdi.jit import zeros

values = st.lists(st.floats(-5, 5), min_size=1, max_size=150)


def run(x, rule, threshold=np.inf, **options):
    c, s = zeros(1, stopping.Const), zeros(1, stopping.State)
    stopping.prepare(c[0], rule, threshold, **options)
    found = []
    for value in x:
        alarm = stopping.update(s[0], c[0], value)
        found.append((s[0]["level"], alarm))
    return np.array([f[0] for f in found]), [f[1] for f in found], s[0]


@settings(max_examples=examples(40), deadline=None)
@given(values)
def test_direct_and_moving_average(x):
    level, _, s = run(x, "direct")
    np.testing.assert_allclose(level, np.abs(x))
    assert s["peak"] == max(level)
    mean, expected = 0.0, []
    for value in x:
        mean += 0.1 * (value - mean)
        expected.append(abs(mean))
    np.testing.assert_allclose(run(x, "gma", forget=0.9)[0], expected, atol=1e-12)


@settings(max_examples=examples(40), deadline=None)
@given(values, st.floats(0, 2))
def test_cusum_is_page_s_two_sided(x, drift):
    """The level is the largest sum of any stretch that ends here, of x - nu or of -x - nu."""
    level, _, _ = run(x, "cusum", drift=drift)
    for k in range(len(x)):
        sums = [0.0]
        for begin in range(k + 1):
            part = np.array(x[begin : k + 1])
            sums += [float((part - drift).sum()), float((-part - drift).sum())]
        assert level[k] == pytest.approx(max(sums), abs=1e-9)


@settings(max_examples=examples(40), deadline=None)
@given(values, st.floats(0.1, 2), st.floats(0.1, 2))
def test_the_sprt_that_starts_anew_at_zero_is_cusum(x, shift, sigma):
    weight = shift / sigma**2
    sprt, _, _ = run(x, "sprt", shift=shift, sigma=sigma, low=0.0)
    cusum, _, _ = run(x, "cusum", drift=shift / 2)
    np.testing.assert_allclose(sprt, weight * cusum, atol=1e-8)


def test_the_sprt_takes_its_time_to_accept():
    level, _, s = run([-0.5] * 3 + [1.0] * 3, "sprt", shift=1.0, sigma=1.0, low=-4.6)
    assert s["up"] == pytest.approx(3 * -1.0 + 3 * 0.5)
    assert run([-0.5] * 20, "sprt", shift=1.0, sigma=1.0, low=-4.6)[2]["up"] > -4.6
    assert max(level) >= 0.0


@settings(max_examples=examples(40), deadline=None)
@given(values, st.integers(1, 64))
def test_chi_square_is_a_sliding_sum(x, window):
    level, _, _ = run(x, "chi_square", window=window, sigma=2.0)
    for k in range(len(x)):
        part = np.array(x[max(k - window + 1, 0) : k + 1])
        assert level[k] == pytest.approx(float((part**2).sum()) / 4.0, abs=1e-9)


@pytest.mark.long
def test_chi_square_of_white_noise_alarms_as_often_as_asked():
    rng = np.random.default_rng(5)
    window, share, n = 20, 0.01, 200_000
    threshold = chi2.isf(share, window)
    level, _, _ = run(rng.normal(size=n), "chi_square", threshold, window=window)
    print("seed 5:", (level >= threshold).mean())
    assert (level >= threshold).mean() == pytest.approx(share, rel=0.2)


@settings(max_examples=examples(30), deadline=None)
@given(values, st.sampled_from(stopping.RULES), st.floats(0.01, 5))
def test_the_threshold_changes_no_level(x, rule, threshold):
    level, alarm, _ = run(x, rule, threshold)
    other, none, _ = run(x, rule)
    np.testing.assert_array_equal(level, other)
    assert alarm == [bool(one >= threshold) for one in level]
    assert not any(none)


def test_a_level_that_is_cut_off_comes_back_soon():
    x = [2.0] * 1000 + [0.0] * 10
    endless, _, _ = run(x, "cusum", 1.0, drift=0.5)
    level, alarm, s = run(x, "cusum", 1.0, drift=0.5, most=4.0)
    assert endless[-1] > 1000
    assert max(level) == 4.0
    assert not alarm[-1]
    stopping.reset(s)
    assert s["level"] == s["up"] == 0.0
    assert s["peak"] == 4.0


@pytest.mark.parametrize("window", [0, 65])
def test_windows_have_a_size(window):
    with pytest.raises(ValueError, match="1 to 64"):
        run([], "chi_square", window=window)

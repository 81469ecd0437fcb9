"""CUSUM of paper 004, tails of healthy maxima, and the likelihood ratio of a change, against their definitions."""

from math import inf, log

import numpy as np
import pytest
from amount import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway_fdi import cusum, likelihood, tails
from gateway_fdi.jit import zeros
from gateway_fdi.structure.units import differ

residuals = st.lists(st.floats(-5, 5), min_size=1, max_size=60)


@settings(max_examples=examples(40), deadline=None)
@given(residuals, st.floats(0, 2), st.floats(0.5, 20), st.floats(1, 5))
def test_cusum_is_equation_26_up_to_its_limit(r, nu, threshold, most):
    c, s = zeros(1, cusum.Const), zeros(1, cusum.State)
    cusum.prepare(c[0], nu, threshold, most)
    value, norms = 0.0, []
    for one in r:
        value = min(max(0.0, value + abs(one) - nu), most * threshold)
        norms.append(cusum.update(s[0], c[0], one))
        assert norms[-1] == pytest.approx(value / threshold, abs=1e-12)
    assert s[0]["peak"] == max(norms)
    assert s[0]["samples"] == len(r)
    np.testing.assert_allclose([s[0]["total"], s[0]["squares"]], [np.abs(r).sum(), np.square(r).sum()], atol=1e-12)


def test_nu_is_mean_and_deviation_of_the_moduli_and_the_largest_of_a_residual():
    rng = np.random.default_rng(3)
    print("seed 3")
    moduli = np.abs(rng.normal(size=(3, 100)) * [[1.0], [3.0], [2.0]])
    sums = np.array([[100.0] * 3, moduli.sum(1), (moduli**2).sum(1)])
    by_hand = moduli.mean(1) + moduli.std(1)
    assert cusum.nus(("a", "a", "b"), sums) == pytest.approx({"a": by_hand[:2].max(), "b": by_hand[2]})
    assert cusum.nus(("a", "", "b"), sums) == pytest.approx({"a": by_hand[0], "b": by_hand[2]}), "one without nu"
    sums[0, 2] = 99.0
    assert set(cusum.nus(("a", "a", "b"), sums)) == {"a"}, "too few samples"
    assert cusum.typical(100.0, 300.0, 900.0) == 3.0, "equal moduli: rounding makes no root of less than nothing"
    assert cusum.typical(100.0, 1e200, inf) == inf


def test_the_threshold_is_the_largest_healthy_level_over_the_margin_with_a_floor():
    assert cusum.threshold(40.0) == 80.0
    assert cusum.threshold(3.0) == cusum.threshold(0.0) == 50.0
    assert cusum.threshold(3.0, margin=0.25, floor=1.0) == 12.0


def test_exponential_maxima_exceed_the_continued_level_as_often_as_asked():
    """Of 400 logs of 200 blocks each; the level that unit exponentials exceed once in 10,000 is their logarithm."""
    rng = np.random.default_rng(11)
    levels = np.array([tails.exceeded_once(rng.exponential(size=200), 10_000.0) for _ in range(400)])
    print("seed 11:", levels.mean(), np.exp(-levels).mean() * 10_000)
    assert levels.mean() == pytest.approx(log(10_000), rel=0.05)


def test_a_tail_by_hand():
    maxima = np.arange(1.0, 101.0)  # the tenth above 90 has a mean excess of 5.5
    np.random.default_rng(0).shuffle(maxima)
    assert tails.exceeded_once(maxima, 100.0) == pytest.approx(90 + 5.5 * log(0.1 * 100))
    assert tails.exceeded_once(maxima, 100.0, floor=8.0) == pytest.approx(90 + 8.0 * log(10.0))
    assert tails.exceeded_once(maxima, 5.0) == 90.0, "less than the tail has: its threshold"
    assert tails.exceeded_once(np.arange(1.0, 11.0), 20.0) == pytest.approx(5 + 3.0 * log(10.0)), "five at least"
    assert tails.exceeded_once(np.array([2.0]), 50.0, floor=1.0) == pytest.approx(2 + log(250.0))


@pytest.mark.parametrize(("changes", "observed"), [(1, 1), (2, 3)])
def test_the_largest_ratio_is_that_of_least_squares(changes, observed):
    """The oracle fits the change of each beginning by numpy's lstsq."""
    rng = np.random.default_rng(17)
    print("seed 17")
    window = 8
    signature = np.zeros((window, observed, changes))
    signature[1:] = rng.normal(size=(window - 1, observed, changes))
    information = np.cumsum(np.einsum("dpi,dpj->dij", signature, signature), axis=0)
    inverse = np.zeros((window, changes, changes))
    for d in range(1, window):
        inverse[d] = np.linalg.pinv(information[d])
    weighted = np.ascontiguousarray(signature.transpose(0, 2, 1))
    begun = np.full((window, changes), 7.0)  # of a time before: each beginning starts from nothing
    seen = []
    for k in range(30):
        seen.append(rng.normal(size=observed))
        kept = min(k + 1, window)
        found = likelihood.largest(begun, weighted, inverse, seen[-1], k % window, kept, changes, observed)
        ratios = [0.0]
        for ago in range(1, kept):
            design = signature[1 : ago + 1].reshape(-1, changes)
            values = np.concatenate(seen[-ago:])
            fit = np.linalg.lstsq(design, values, rcond=None)[0]
            ratios.append(values @ values - np.sum((values - design @ fit) ** 2))
        assert found == pytest.approx(max(ratios), rel=1e-9, abs=1e-12)


def test_units_differ_but_in_their_spelling():
    for a, b in (("N m", "Nm"), ("m/s²", "m / s2"), ("N·m", "N*m"), ("1", "-"), ("", "V"), ("V", "-"), ("V", "V")):
        assert not differ(a, b), (a, b)
    assert differ("V", "A")

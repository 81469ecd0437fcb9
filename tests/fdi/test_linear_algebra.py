"""Sums of products and small systems inside kernels, against numpy."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway_fdi.linear_algebra import copy, decompose, dot, minus, plus, solve, square


@given(st.integers(0, 10_000), st.integers(1, 4))
def test_small_systems_are_solved(seed, m):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(m, m))
    j, b = np.zeros((4, 4)), np.zeros(4)
    j[:m, :m], b[:m] = root @ root.T + np.eye(m), rng.normal(size=m)
    factor, x = np.zeros((4, 4)), np.zeros(4)
    decompose(j, factor, m)
    square = solve(factor, b, x, m)
    expected = np.linalg.solve(j[:m, :m], b[:m])
    np.testing.assert_allclose(x[:m], expected, rtol=1e-9, atol=1e-12)
    assert square == pytest.approx(b[:m] @ expected)
    again = b.copy()
    solve(factor, again, again, m)  # in place
    np.testing.assert_array_equal(again[:m], x[:m])


def test_a_pivot_that_rounding_has_made_negative_leaves_numbers():
    j = np.array([[1.0, 1.0], [1.0, 1.0 - 1e-16]])
    factor = np.zeros((2, 2))
    decompose(j, factor, 2)
    decompose(j, j, 2)  # in place
    assert np.isfinite(factor).all()
    np.testing.assert_array_equal(np.tril(j), factor)


def test_sums_are_of_the_first_entries():
    rng = np.random.default_rng(1)
    a, b, weight = rng.normal(size=5), rng.normal(size=5), rng.normal(size=(5, 5))
    assert dot(a, b, 3) == pytest.approx(a[:3] @ b[:3])
    assert plus(2.0, a, b, 3) == pytest.approx(2.0 + a[:3] @ b[:3])
    assert minus(2.0, a, b, 3) == pytest.approx(2.0 - a[:3] @ b[:3])
    assert square(a, weight, 3) == pytest.approx(a[:3] @ weight[:3, :3] @ a[:3])
    copy(b, a, 3)
    np.testing.assert_array_equal(b[:3], a[:3])
    assert b[3] != a[3]

"""Matrices of a plant whose entries are off: SciPy's exponential, and its derivatives."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm, expm_frechet

from gateway_fdi.jit import zeros
from gateway_plants.linear.mathematics.plant import discretised
from gateway_plants.linear.mathematics.uncertainty import entries
from gateway_plants.linear.model_set import filters, matrices
from gateway_plants.linear.model_set.design import Told, isolable, prepare
from gateway_plants.linear.pi_bank.design import Noise

#: A servo's, with a fast current; norm of A T above a half, so that halvings are needed.
A = [[-180.0, -15.0, 0, 0], [300.0, -70.0, 66.0, -13000.0], [0, 22.0, -24.0, 4400.0], [0, 1.0, -1.0, 0]]
B = [[166.0], [0], [0], [0]]
C = [[0, 1.0, 0, 0], [0, 0, 1.0, 0], [1.0, 0, 0, 0]]


def told(period, *, discrete=False):
    plant = discretised(A, B, C, period, discrete=discrete)
    noise = Noise(np.full(3, 0.1), np.full(4, 0.1), np.full(1, 0.01))
    known = entries(A, B, 0.1, 0.1)
    return Told(
        plant, np.array(A), np.array(B), discrete, noise, known, np.full(1, 0.3), np.full(3, 1.0), isolable(plant),
        np.zeros(3), np.full(3, 0.2), np.full(1, 0.06), np.zeros(3), counted=False,
    )  # fmt: skip


def at(errors, given):
    """Return [A, B; 0, 0] T with these errors."""
    block = np.zeros((5, 5))
    block[:4] = np.hstack([A, B])
    block[given.entries.row, given.entries.column] += errors
    return block * given.plant.period


@pytest.mark.parametrize("period", [1e-4, 0.005, 0.02])
def test_matrices_and_derivatives_are_scipy_s(period):
    given = told(period)
    s, c = zeros(1, filters.State)[0], zeros(1, filters.Const)[0]
    prepare(c, given)
    print("seed 3")
    errors = np.random.default_rng(3).uniform(-1, 1, len(given.entries)) * given.entries.bound
    padded = np.zeros(matrices.MOST_ENTRIES)
    padded[: len(errors)] = errors
    matrices.derive(s.plant, c.plant, 2, padded)
    whole = at(errors, given)
    np.testing.assert_allclose(s.plant.now[2, :4, :5], expm(whole)[:4], rtol=1e-9, atol=1e-10)
    np.testing.assert_array_equal(s.plant.at[2, : len(errors)], errors)
    for k, (row, column) in enumerate(zip(given.entries.row, given.entries.column, strict=True)):
        unit = np.zeros((5, 5))
        unit[row, column] = period
        exact = expm_frechet(whole, unit, compute_expm=False)[:4]
        scale = np.abs(exact).max()
        np.testing.assert_allclose(s.plant.by_entry[2, k, :4, :5], exact, rtol=0.02, atol=2e-3 * scale)


def test_matrices_of_discrete_time_are_taken_as_they_are():
    given = told(0.005, discrete=True)
    s, c = zeros(1, filters.State)[0], zeros(1, filters.Const)[0]
    prepare(c, given)
    errors = np.zeros(matrices.MOST_ENTRIES)
    errors[0] = 0.25
    matrices.refresh(s.plant, c.plant, 0, errors)
    expected = np.hstack([A, B])
    expected[given.entries.row[0], given.entries.column[0]] += 0.25
    np.testing.assert_array_equal(s.plant.now[0, :4, :5], expected)


def test_a_filter_predicts_with_errors_that_its_matrices_do_not_have_yet():
    """An estimate that has moved by less than what makes the matrices anew counts at once."""
    given = told(0.005)
    s, c = zeros(1, filters.State)[0], zeros(1, filters.Const)[0]
    prepare(c, given)
    filters.ignorant(s, c, 0)
    moved = 0.5 * filters.FRESH * given.entries.bound
    x, u = np.array([1.5, 20.0, -10.0, 0.01]), np.array([6.0])
    s.z[0, :4] = x
    s.z[0, 4 : 4 + len(moved)] = moved
    filters.predict(s, c, 0, u, np.zeros(1, np.int64))
    exact = (expm(at(moved, given)) @ np.concatenate([x, u]))[:4]
    stale = (expm(at(0.0 * moved, given)) @ np.concatenate([x, u]))[:4]
    np.testing.assert_array_less(np.abs(s.z[0, :4] - exact), 0.02 * np.abs(stale - exact).max())


def test_a_sample_is_taken_as_an_extended_kalman_filter_does_with_gains_that_may_be_off():
    """Sensor by sensor, y = (1 + g) C x + s, against matrices; seed printed."""
    print("seed 17")
    rng = np.random.default_rng(17)
    given = replace(told(0.005), gains=np.full(3, 0.02))
    s, c = zeros(1, filters.State)[0], zeros(1, filters.Const)[0]
    prepare(c, given)
    size, first = int(c.total), 4 + len(given.entries) + 2
    assert size == first + 6
    root = rng.normal(size=(size, size)) * 0.1
    x, p = rng.normal(size=size), root @ root.T
    x[first + 3 :] *= 0.05
    s["z"][0, :size], s["cov"][0, :size, :size] = x, p
    y = np.array(C) @ x[:4] + rng.normal(size=3) * 0.05
    filters.correct(s, c, 0, np.pad(y, (0, 3)), True, False)
    for j in range(3):
        h = np.zeros(size)
        h[:4] = (1 + x[first + 3 + j]) * np.array(C)[j]
        h[first + j], h[first + 3 + j] = 1.0, np.array(C)[j] @ x[:4]
        expected = (1 + x[first + 3 + j]) * (np.array(C)[j] @ x[:4]) + x[first + j]
        gain = p @ h / (h @ p @ h + 0.01)
        x, p = x + gain * (y[j] - expected), p - np.outer(gain, h @ p)
    np.testing.assert_allclose(s["z"][0, :size], x, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(s["cov"][0, :size, :size], p, rtol=1e-7, atol=1e-10)

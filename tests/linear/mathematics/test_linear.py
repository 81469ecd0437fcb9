"""Linear plants and gains of their observers against scipy and filterpy."""

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from scipy.signal import cont2discrete

from gateway_plants.linear.mathematics.gains import from_noise
from gateway_plants.linear.mathematics.plant import discretised, unobservable


def random_plant(rng, n=4, m=2, p=3):
    return rng.normal(size=(n, n)), rng.normal(size=(n, m)), rng.normal(size=(p, n))


@pytest.mark.parametrize("seed", range(5))
def test_discretisation_is_scipy_s(seed):
    rng = np.random.default_rng(seed)
    a, b, c = random_plant(rng)
    plant = discretised(a, b, c, 0.1)
    phi, gamma, *_ = cont2discrete((a, b, c, np.zeros((3, 2))), 0.1)
    np.testing.assert_allclose(plant.phi, phi, atol=1e-12)
    np.testing.assert_allclose(plant.gamma, gamma, atol=1e-12)
    np.testing.assert_array_equal(discretised(a, b, c, 0.1, discrete=True).phi, a)
    np.testing.assert_array_equal(discretised(a, b, c, 0.1, discrete=True).gamma, b)
    assert (plant.states, plant.inputs, plant.outputs) == (4, 2, 3)


@pytest.mark.parametrize(
    ("a", "b", "c", "says"),
    [
        ([[1.0, 2.0]], [[1.0]], [[1.0]], "a is 1 x 2, not square"),
        ([[1.0]], [[1.0], [2.0]], [[1.0]], "b has 2 rows, a has 1"),
        ([[1.0]], [[1.0]], [[1.0, 0.0]], "c has 2 columns, a has 1"),
        ([[1.0], [1.0, 2.0]], [[1.0]], [[1.0]], "a: its rows are not of one length"),
        ([[float("nan")]], [[1.0]], [[1.0]], "a has entries that are no numbers"),
        ([1.0], [[1.0]], [[1.0]], "a is a matrix"),
    ],
)
def test_matrices_that_do_not_fit_are_refused(a, b, c, says):
    with pytest.raises(ValueError, match=says):
        discretised(a, b, c, 0.1)


def test_what_cannot_be_observed_is_said():
    phi = np.diag([0.5, 0.6, 0.7])
    assert unobservable(phi, np.array([[1.0, 1.0, 1.0]])) == ""
    assert unobservable(phi, np.array([[1.0, 0.0, 1.0]]), ("x", "y", "z")) == "1 y"
    twice = np.diag([0.5, 0.5, 0.7])
    assert "x1" in unobservable(twice, np.array([[1.0, 1.0, 1.0]]))
    # Scaling does not hide it, nor make it up.
    assert unobservable(phi * 1e-6, np.array([[1e-9, 1e-9, 1e-9]])) == ""


@pytest.mark.parametrize("seed", range(4))
def test_the_gain_from_noise_is_filterpy_s_in_the_long_run(seed):
    rng = np.random.default_rng(seed)
    a, b, c = random_plant(rng)
    plant = discretised(a, b, c, 0.1)
    q, r = np.diag(rng.uniform(0.01, 0.1, 4)), np.diag(rng.uniform(0.1, 1.0, 3))
    gain = from_noise(plant.phi, plant.c, q, r)
    kf = KalmanFilter(4, 3)
    kf.F, kf.H, kf.Q, kf.R = plant.phi, plant.c, q, r
    for _ in range(3000):
        kf.predict()
        kf.update(np.zeros(3))
    np.testing.assert_allclose(gain.gain, plant.phi @ kf.K, atol=1e-8)
    np.testing.assert_allclose(gain.innovation, kf.S, rtol=1e-8)
    np.testing.assert_allclose(gain.error, kf.P_prior, rtol=1e-7, atol=1e-10)


def test_no_filter_where_nothing_drives_what_grows_unseen():
    with pytest.raises(ValueError, match="no stationary Kalman filter"):
        from_noise(np.diag([1.2, 0.5]), np.array([[0.0, 1.0]]), np.eye(2), np.eye(1))

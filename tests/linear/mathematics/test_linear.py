"""Linear plants and gains of their observers against scipy and filterpy."""

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from scipy.signal import cont2discrete

from gateway_plants.linear.mathematics.gains import GONE, from_noise, from_poles, settling, with_noise
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
    np.testing.assert_allclose(with_noise(plant.phi, plant.c, gain.gain, q, r).error, gain.error, rtol=1e-7, atol=1e-10)


def test_no_filter_where_nothing_drives_what_grows_unseen():
    with pytest.raises(ValueError, match="no stationary Kalman filter"):
        from_noise(np.diag([1.2, 0.5]), np.array([[0.0, 1.0]]), np.eye(2), np.eye(1))


@pytest.mark.long
@pytest.mark.parametrize(
    "poles",
    [
        (0.9, 0.8, 0.7, 0.6),
        (0.9, 0.5, 0.6 + 0.3j, 0.6 - 0.3j),
        (0.2j, -0.2j, 0.5 + 0.1j, 0.5 - 0.1j),
    ],
)
@pytest.mark.parametrize("seed", range(3))
def test_poles_are_where_they_were_asked_for_and_the_rest_is_spent_on_noise(poles, seed):
    rng = np.random.default_rng(seed)
    a, b, c = random_plant(rng)
    plant = discretised(a, b, c, 0.1)
    q, r = 1e-6 * np.eye(4), np.diag([1.0, 0.01, 0.1])
    gain = from_poles(plant.phi, plant.c, poles, q, r)
    got = np.linalg.eigvals(plant.phi - gain.gain @ plant.c)
    key = lambda z: (round(z.real, 6), round(z.imag, 6))  # noqa: E731
    np.testing.assert_allclose(sorted(got, key=key), sorted(np.array(poles, complex), key=key), atol=1e-6)
    from scipy.signal import place_poles

    plain = place_poles(plant.phi.T, plant.c.T, poles).gain_matrix.T
    before = np.diag(with_noise(plant.phi, plant.c, plain, q, r).error)
    after = np.diag(gain.error)
    assert (after / before).sum() <= 4.0 + 1e-6
    assert (after / before).sum() < 3.6  # not only no worse


@pytest.mark.parametrize(
    ("poles", "says"),
    [
        ((0.5, 0.5), "4 poles are needed, 2 are given"),
        ((1.1, 0.5, 0.4, 0.3), "outside the unit circle"),
        ((0.5 + 0.1j, 0.5, 0.4, 0.3), "conjugate pairs"),
        ((0.5, 0.5, 0.5, 0.5), "cannot be placed"),
    ],
)
def test_poles_that_cannot_be_are_refused(poles, says):
    plant = discretised(*random_plant(np.random.default_rng(0)), 0.1)
    with pytest.raises(ValueError, match=says):
        from_poles(plant.phi, plant.c, poles, np.eye(4), np.eye(3))


def test_one_output_leaves_nothing_free():
    plant = discretised(*random_plant(np.random.default_rng(1), 3, 1, 1), 0.1)
    gain = from_poles(plant.phi, plant.c, (0.5, 0.6, 0.7), np.eye(3), np.eye(1))
    got = np.sort(np.linalg.eigvals(plant.phi - gain.gain @ plant.c).real)
    np.testing.assert_allclose(got, (0.5, 0.6, 0.7), atol=1e-8)


def test_an_observer_has_settled_when_an_error_is_small_beside_its_noise():
    """One state, by hand: the error's variance falls by (phi - l)^2 a sample, from 100 to a tenth of V."""
    phi, c = np.array([[0.9]]), np.array([[1.0]])
    gain = with_noise(phi, c, np.array([[0.4]]), np.array([[0.01]]), np.array([[0.04]]))
    expected = int(np.ceil(np.log(GONE * gain.innovation[0, 0] / 100.0) / np.log(0.25)))
    assert settling(phi, c, gain, np.array([[100.0]])) == expected
    assert settling(phi, c, gain, np.zeros((1, 1))) == 0


def test_what_does_not_show_at_first_is_waited_for():
    """The second state moves the sensor only later."""
    phi, c = np.array([[0.5, 1.0], [0.0, 0.9]]), np.array([[1.0, 0.0]])
    gain = from_noise(phi, c, 0.01 * np.eye(2), 0.01 * np.eye(1))
    assert settling(phi, c, gain, np.diag([0.0, 25.0])) > 1

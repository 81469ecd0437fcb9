"""Chi-square and least squares against SciPy."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear
from scipy.stats import chi2

from gateway_fdi.diagnosis.sizes import chi2_beyond, fit


def test_chi_square_is_that_of_scipy():
    for degrees in range(1, 60):
        for value in (1e-9, 0.1, 1.0, 7.3, 40.0, 300.0):
            assert chi2_beyond(value, degrees) == pytest.approx(chi2.sf(value, degrees), rel=1e-9, abs=1e-300)
    assert chi2_beyond(5.0, 0) == 1.0


def test_sizes_are_those_of_least_squares():
    rng = np.random.default_rng(7)
    gains, noise = rng.normal(size=(9, 2)), rng.uniform(0.5, 2.0, 9)
    residuals = gains @ [3.0, -2.0] + noise * rng.normal(size=9)
    found = fit(residuals, gains, noise, np.zeros(9))
    wanted = lsq_linear(gains / noise[:, None], residuals / noise)
    assert found.sizes == pytest.approx(wanted.x)
    assert found.misfit == pytest.approx(2.0 * wanted.cost)
    assert found.degrees == 7


def test_of_residuals_with_noise_only_the_chance_is_uniform():
    rng = np.random.default_rng(8)
    gains, noise = rng.normal(size=(6, 1)), np.full(6, 0.3)
    chances = [
        fit(noise * rng.normal(size=6) + 5.0 * gains[:, 0], gains, noise, np.zeros(6)).chance for _ in range(2000)
    ]
    assert np.mean(chances) == pytest.approx(0.5, abs=0.03)
    assert np.mean(np.array(chances) < 0.1) == pytest.approx(0.1, abs=0.03)

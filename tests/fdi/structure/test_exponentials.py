"""What states move in a step beside SciPy's exponential of a matrix; rows of very different sizes."""

import numpy as np
import pytest
from amount import amount
from scipy.linalg import expm

from gateway_fdi.structure.generator.runtime import advance


def functions(a):
    """phi1 and phi2 of a matrix, as blocks of one exponential."""
    n = len(a)
    one, none = np.eye(n), np.zeros((n, n))
    whole = expm(np.block([[a, one, none], [none, none, one], [none, none, none]]))
    return whole[:n, n : 2 * n], whole[:n, 2 * n :]


@pytest.mark.parametrize("seed", range(amount(200, 30, 8)))
def test_a_step_is_that_of_the_exponential(seed):
    rng = np.random.default_rng(seed)
    n, dt = 1 + seed % 4, 0.01
    rows = 10.0 ** rng.uniform(-2, 4, n)  # h J up to 100
    jacobian = rng.normal(0, 0.2, (n, n)) * rows[:, None] - np.diag(rows)
    f, c = rng.normal(0, 1, n), rng.normal(0, 1, n)
    slopes, hold = np.concatenate([f, c, np.zeros(n)]), np.zeros(6 * n * n)
    phi1, phi2 = functions(jacobian * dt)
    expected = dt * (phi1 @ f + phi2 @ c)
    for _ in range(2):  # the second step takes what is kept
        advance(jacobian.ravel(), slopes, hold, dt)
        assert slopes[2 * n :] == pytest.approx(expected, rel=1e-7, abs=1e-9 * np.abs(expected).max()), seed
    advance(0.5 * jacobian.ravel(), slopes, hold, dt)
    phi1, phi2 = functions(0.5 * jacobian * dt)
    assert slopes[2 * n :] == pytest.approx(dt * (phi1 @ f + phi2 @ c), rel=1e-7, abs=1e-9), seed

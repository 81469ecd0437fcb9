"""Quantiles against scipy.stats."""

import numpy as np
import pytest
from scipy.stats import chi2, norm

from gateway_fdi.quantiles import chi2_above, normal_above


@pytest.mark.parametrize("share", [0.4, 0.05, 1e-4, 1e-9])
def test_they_are_scipy_s(share):
    assert normal_above(share) == pytest.approx(norm.isf(share), rel=1e-12)
    degrees = np.array([1, 2, 7, 64])
    np.testing.assert_allclose(chi2_above(share, degrees), chi2.isf(share, degrees), rtol=1e-9)

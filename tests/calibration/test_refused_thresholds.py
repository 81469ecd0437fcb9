"""Thresholds that would keep a test silent for ever are refused, each with a line."""

import math

import pytest

from gateway_calibration.cusum import Quantity, _refuse_nu, _refuse_threshold
from gateway_fdi.cusum import typical
from gateway_fdi.errors import InputError


@pytest.mark.parametrize(
    ("nu", "said"),
    [(0.0, "nothing moves it"), (math.inf, "diverges"), (math.nan, "diverges"), (4.6e87, "4.6e.87.*diverges")],
)
def test_a_nu_that_is_none(nu, said):
    with pytest.raises(InputError, match=f'monitor "osc": the healthy residual of e3 .*{said}'):
        _refuse_nu("osc", "e3", nu)


def test_a_nu_of_sums_that_overflow_is_infinite():
    assert typical(100.0, 1e200, math.inf) == math.inf
    _refuse_nu("osc", "e3", typical(100.0, 1.0, 0.02))


@pytest.mark.parametrize("threshold", [math.inf, math.nan, 1e6])
def test_a_threshold_far_from_the_noise(threshold):
    def row(value):
        return Quantity("osc", "e3", "e3", 1000, None, 0.1, None, value / 2, value, floored=False)

    with pytest.raises(InputError, match='monitor "osc": e3 would need a threshold of .* far from the noise'):
        _refuse_threshold(row(threshold))
    _refuse_threshold(row(300.0))

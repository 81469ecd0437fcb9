"""Distances of the rotor's positions against their definitions."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway_plants.steering.study.symptoms import increments, leaky, wrapped


@given(st.floats(-30, 30), st.floats(-30, 30), st.integers(-5, 5))
def test_positions_differ_modulo_a_turn(a, b, turns):
    turn = np.pi / 2
    (off,) = wrapped(np.array([a - b - turns * turn]), turn)
    assert abs(off) <= turn / 2 + 1e-9
    assert np.cos(4 * (off - a + b)) == pytest.approx(1.0, abs=1e-6)


def test_increments_and_leaky_sums():
    turn = np.pi / 2
    measured = np.array([1.5, 1.5 + 0.06 - turn, 1.5 + 0.06 + 0.3])
    found = increments(measured, np.array([0.0, 60.0, 0.0]), 1e-3, turn)
    assert found == pytest.approx([0.0, 0.0, 0.3], abs=1e-12)
    assert leaky(np.full(2000, 0.01), 0.01)[-1] == pytest.approx(1.0)

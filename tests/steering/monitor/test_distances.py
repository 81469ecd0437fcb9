"""Distances of the rotor's positions against their definitions."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gateway_fdi.jit import zeros
from gateway_plants.steering import distances


@given(st.floats(-30, 30), st.floats(-30, 30), st.integers(-5, 5))
def test_positions_differ_modulo_a_turn(a, b, turns):
    turn = np.pi / 2
    off = distances.position(a, b + turns * turn, turn)
    assert abs(off) <= turn / 2 + 1e-9
    assert np.cos(4 * (off - a + b)) == pytest.approx(1.0, abs=1e-6)
    assert abs(distances.modulo_pi(a, b, 4.0)) <= np.pi / 8 + 1e-9


def test_increments_and_leaky_sums():
    s, leak = zeros(1, distances.Increment), zeros(1, distances.Leaky)
    turn = np.pi / 2
    assert distances.increment(s[0], 1.5, 0.0, 1e-3, turn) == 0.0
    assert distances.increment(s[0], 1.5 + 0.06 - turn, 60.0, 1e-3, turn) == pytest.approx(0.0, abs=1e-12)
    assert distances.increment(s[0], 1.5 + 0.06 + 0.3, 0.0, 1e-3, turn) == pytest.approx(0.3)
    for _ in range(2000):
        total = distances.leaky(leak[0], 0.01, 0.01)
    assert total == pytest.approx(1.0)

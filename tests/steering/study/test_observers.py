"""The study's observers against scipy, filterpy, and the equations they come from."""

import numpy as np
import pytest
from filter_reference import M, Reference, T, close, jacobian, pair
from filterpy.common import van_loan_discretization
from scipy.linalg import expm
from scipy.signal import cont2discrete

from gateway_plants.steering.study.filters import ekf_dq, luenberger, reduced_luenberger


def test_luenberger_is_the_exact_discrete_observer():
    a, b, c = M.linear
    a_d, b_d, k = luenberger.design(M, T)
    close(a_d, expm(a * T))
    close(b_d, cont2discrete((a, b, c, np.zeros((1, 1))), T)[1])
    poles = np.linalg.eigvals((np.eye(2) - k @ c) @ a_d)
    close(np.sort(poles), np.exp([-0.8, -0.7]), 1e-9)
    s, const = pair(luenberger, M, T)
    x, theta = np.zeros((2, 1)), 0.0
    rng = np.random.default_rng(1)
    for u, y in rng.normal(size=(300, 2)) * [3.0, 10.0]:
        luenberger.step(s, const, u, y)
        before = x[1, 0]
        x = a_d @ x + b_d * u
        x = x + k * (y - x[0, 0])
        theta += 0.5 * (before + x[1, 0]) * T
        close([s["current"], s["omega"], s["theta"]], [*x.ravel(), theta])


def constant_load(step, s, c, load, seconds=0.2):
    """Let the linear motor stand under a load, held by its current; returns the speed that an observer sees."""
    i_q = load / M.torque
    for _ in range(round(seconds / T)):
        step(s, c, M.resistance * i_q, i_q)
    return s["omega"]


def test_a_load_is_taken_for_speed():
    """Bias of the reduced observer -M/(J p); of the full one about -(M/J)(p1 + p2 - b/J)/(p1 p2)."""
    load = 0.6
    s, c = pair(reduced_luenberger, M, T)
    assert constant_load(reduced_luenberger.step, s, c, load) == pytest.approx(load / M.inertia / 700, rel=1e-3)
    s, c = pair(luenberger, M, T)
    continuous = load / M.inertia * (1500 - M.friction / M.inertia) / (700 * 800)
    assert constant_load(luenberger.step, s, c, load) == pytest.approx(continuous, rel=0.15)


def test_the_printed_reduced_observer_is_unstable():
    """(32) as printed: its pole lies at -b/J + c_M/L = +296 1/s; ours at -700."""
    assert -M.friction / M.inertia + M.emf / M.lq == pytest.approx(295.8, abs=0.1)
    _, c = pair(reduced_luenberger, M, T)
    assert np.log(c["a"]) / T == pytest.approx(-700)


def test_the_reduced_observer_is_the_exact_discrete_one():
    _, c = pair(reduced_luenberger, M, T)
    gain = (M.friction / M.inertia - 700) * M.lq / M.emf
    a = -M.friction / M.inertia + gain * M.emf / M.lq
    b = np.array([[a * gain + M.torque / M.inertia + gain * M.resistance / M.lq, -gain / M.lq]])
    a_d, b_d, *_ = cont2discrete((np.array([[a]]), b, np.eye(1), np.zeros((1, 2))), T)
    close([c["a"], c["current"], c["voltage"]], [a_d[0, 0], *b_d[0]])


def test_the_reduced_observer_finds_the_speed():
    """On the exact linear motor: the error dies out with its pole."""
    a, b, _ = M.linear
    a_d, b_d, *_ = cont2discrete((a, b, np.eye(2), np.zeros((2, 1))), 1e-5)
    s, c = pair(reduced_luenberger, M, 1e-4)
    x = np.array([[0.0], [40.0]])
    for _ in range(150):
        for _ in range(10):
            x = a_d @ x + b_d * 1.5
        reduced_luenberger.step(s, c, 1.5, x[0, 0])
    assert s["omega"] == pytest.approx(x[1, 0], rel=2e-3)


def dq_model(n, h):
    """Euler sub-step and its Jacobian, written once more from (12) to (14), corrected."""
    z, r, l, psi, j, b = M.pole_pairs, M.resistance, M.ld, M.flux, M.inertia, M.friction  # noqa: E741

    def f(x, u):
        i_d, i_q, w = x[:3]
        load = x[3] if n == 4 else 0.0
        slope = [
            (u[0] - r * i_d + z * w * l * i_q) / l,
            (u[1] - r * i_q - z * w * (l * i_d + psi)) / l,
            (1.5 * z * psi * i_q - b * w - load) / j,
        ]
        return x + h * np.array([*slope, 0.0][:n])

    return f


@pytest.mark.parametrize("load", [False, True])
@pytest.mark.parametrize("steps", [1, 8])
def test_ekf_dq_equals_filterpy(load, steps):
    n = 4 if load else 3
    s, c = pair(ekf_dq, M, T, load=load, steps=steps)
    q = np.array(c["q"][: n * n]).reshape(n, n)
    ref = Reference(n, dq_model(n, T / steps), steps, q, c["r"], c["start"][:n])
    rng = np.random.default_rng(2)
    for k in range(150):
        u, y = rng.normal(size=2) * 0.5, np.array([np.sin(0.1 * k), 5 * np.cos(0.05 * k)])
        ekf_dq.step(s, c, *u, *y)
        ref.take([u] * steps, y)
        close(s["x"][:n], ref.x)
        close(np.reshape(s["p"][: n * n], (n, n)), ref.P)
        assert s["nis"] == pytest.approx(ref.mahalanobis**2, rel=1e-8, abs=1e-12)


def test_printed_jacobian_is_wrong_in_row_three():
    """(40) printed: c_M T/J in the column of I_d, 0 in that of I_q."""
    f = jacobian(dq_model(3, T), np.array([1.0, 5.0, 20.0]), np.zeros(2))
    assert f[2, 0] == 0.0
    assert f[2, 1] == pytest.approx(1.5 * T * M.emf / M.inertia)


def test_process_noise_is_van_loans():
    s, c = pair(ekf_dq, M, T, load=True, steps=4, voltage=0.05, torque=0.2, wander=3.0)
    a = np.zeros((4, 4))
    a[0, 0] = a[1, 1] = -M.resistance / M.ld
    a[1, 2], a[2, 1] = -M.emf / M.lq, M.torque / M.inertia
    a[2, 2], a[2, 3] = -M.friction / M.inertia, -1 / M.inertia
    g = np.diag([0.05 / M.ld * T**0.5, 0.05 / M.lq * T**0.5, 0.2 / M.inertia * T**0.5, 3.0])
    close(np.reshape(c["q"][:16], (4, 4)), van_loan_discretization(a, g, T / 4)[1])
    assert s["started"] == 0

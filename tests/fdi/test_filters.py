"""Motor filters against scipy, filterpy, and the equations they come from."""

from math import atan2, pi

import numpy as np
import pytest
from amount import examples
from filterpy.common import van_loan_discretization
from filterpy.kalman import ExtendedKalmanFilter, KalmanFilter
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.signal import cont2discrete

from gateway_fdi.filters import ekf_alpha_beta, feedforward, gaussian, motor
from gateway_fdi.filters.motor import Motor
from gateway_fdi.filters.transforms import clarke, inverse_clarke, inverse_park, park, wrap
from gateway_fdi.jit import zeros
from gateway_plants.steering.study.filters import ekf_dq, luenberger, reduced_luenberger

M = Motor()
T = 1e-3
small = st.floats(-50, 50)
angles = st.floats(-20, 20)


def pair(module, *arguments, **options):
    c, s = zeros(1, module.Const), zeros(1, module.State)
    module.prepare(c[0], *arguments, **options)
    return s[0], c[0]


def close(ours, theirs, tolerance=1e-10):
    np.testing.assert_allclose(ours, theirs, rtol=tolerance, atol=tolerance)


@given(small, small, angles)
def test_transforms_undo_each_other(a, b, theta):
    close(inverse_park(*park(a, b, theta), theta), (a, b), 1e-9)
    close(clarke(*inverse_clarke(a, b)), (a, b), 1e-9)


@given(st.floats(0.1, 50), angles)
def test_clarke_keeps_the_amplitude(size, phi):
    """(5) to (7): a phase current I cos(phi) becomes I (cos, sin)(phi)."""
    close(
        clarke(size * np.cos(phi), size * np.cos(phi - 2 * pi / 3)),
        (size * np.cos(phi), size * np.sin(phi)),
        1e-9,
    )


@given(st.floats(-1e4, 1e4), st.floats(0.1, 10))
def test_wrap_stays_within_half_a_turn(angle, turn):
    wrapped = wrap(angle, turn)
    assert abs(wrapped) <= turn / 2 * (1 + 1e-9)
    assert abs((angle - wrapped) / turn - round((angle - wrapped) / turn)) < 1e-6


def test_torque_balances_power():
    """(14): I_q = 10 A, I_d = -3 A, 90 and 120 uH: 0.4554 N m from the power; the printed c_M I_q says 0.300."""
    m = Motor(ld=90e-6, lq=120e-6)
    c = zeros(1, motor.Const)
    motor.prepare(c[0], m)
    i_d, i_q, omega = -3.0, 10.0, 50.0
    u_d = m.resistance * i_d - m.pole_pairs * omega * m.lq * i_q
    u_q = m.resistance * i_q + m.pole_pairs * omega * (m.ld * i_d + m.flux)
    heat = 1.5 * m.resistance * (i_d**2 + i_q**2)
    power = 1.5 * (u_d * i_d + u_q * i_q) - heat
    assert motor.torque(c[0], i_d, i_q) == pytest.approx(power / omega, rel=1e-12)
    assert motor.torque(c[0], i_d, i_q) == pytest.approx(0.4554, abs=5e-5)
    assert m.emf * i_q == pytest.approx(0.300)


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


def ab_model(n, h):
    """The same in stator co-ordinates, (17), (18)."""
    z, r, l, psi, j, b = M.pole_pairs, M.resistance, M.ld, M.flux, M.inertia, M.friction  # noqa: E741

    def f(x, u):
        i_a, i_b, w, theta = x[:4]
        load = x[4] if n == 5 else 0.0
        s, c = np.sin(z * theta), np.cos(z * theta)
        slope = [
            (u[0] - r * i_a + psi * z * w * s) / l,
            (u[1] - r * i_b - psi * z * w * c) / l,
            (1.5 * z * psi * (i_b * c - i_a * s) - b * w - load) / j,
            w,
        ]
        return x + h * np.array([*slope, 0.0][:n])

    return f


def jacobian(f, x, u):
    """By complex steps: exact to rounding."""
    n = len(x)
    columns = []
    for k in range(n):
        moved = x.astype(complex)
        moved[k] += 1e-30j
        columns.append(f(moved, u).imag / 1e-30)
    return np.array(columns).T


class Reference(ExtendedKalmanFilter):
    """filterpy's filter with sub-steps of a model."""

    def __init__(self, n, f, steps, q, r, p):
        super().__init__(dim_x=n, dim_z=2)
        self.f, self.steps, self.q = f, steps, q
        self.x, self.R, self.P = np.zeros(n), np.eye(2) * r, np.diag(p)
        self.H2 = np.eye(2, n)

    def take(self, inputs, y):
        for u in inputs:
            jac = jacobian(self.f, self.x, u)
            self.x = self.f(self.x, u)
            self.P = jac @ self.P @ jac.T + self.q
        self.update(np.asarray(y), lambda _: self.H2, lambda x: self.H2 @ x)


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


@pytest.mark.parametrize("load", [False, True])
@pytest.mark.parametrize("steps", [1, 8])
def test_ekf_alpha_beta_equals_filterpy(load, steps):
    n = 5 if load else 4
    s, c = pair(ekf_alpha_beta, M, T, load=load, steps=steps)
    q = np.array(c["q"][: n * n]).reshape(n, n)
    ref = Reference(n, ab_model(n, T / steps), steps, q, c["r"], c["start"][:n])
    ekf_alpha_beta.begin(s, c, 0.3)
    ref.x[3] = 0.3
    rng = np.random.default_rng(3)
    for k in range(150):
        u, frame, turned = rng.normal(size=2) * 0.5, 0.02 * k, 0.02
        y = [3 * np.sin(0.02 * k), 3 * np.cos(0.02 * k)]
        ekf_alpha_beta.step(s, c, *u, frame, turned, *y)
        inputs = []
        for j in range(steps):
            at = frame + turned * (j + 0.5) / steps
            turn = np.array([[np.cos(at), -np.sin(at)], [np.sin(at), np.cos(at)]])
            inputs.append(turn @ u)
        ref.take(inputs, y)
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


@settings(max_examples=examples(50))
@given(st.integers(2, 5), st.integers(0, 2**31))
def test_corrections_equal_filterpy(n, seed):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(n, n))
    p, x, y, r = root @ root.T + np.eye(n), rng.normal(size=n), rng.normal(size=2), 0.3
    kf = KalmanFilter(dim_x=n, dim_z=2)
    kf.x, kf.P, kf.H, kf.R = x.copy(), p.copy(), np.eye(2, n), np.eye(2) * r
    kf.update(y)
    ours, flat, w = x.copy(), p.ravel().copy(), np.zeros(25)
    nis = gaussian.correct(ours, flat, w, *y, r, n)
    close(ours, kf.x, 1e-9)
    close(flat.reshape(n, n), kf.P, 1e-9)
    assert nis == pytest.approx(kf.mahalanobis**2, rel=1e-8)
    one = KalmanFilter(dim_x=n, dim_z=1)
    one.x, one.P, one.H, one.R = x.copy(), p.copy(), np.eye(1, n, n - 1), np.eye(1) * r
    one.update(y[:1])
    ours, flat = x.copy(), p.ravel().copy()
    gaussian.anchor(ours, flat, w, n - 1, y[0] - x[n - 1], r, n)
    close(ours, one.x, 1e-9)
    close(flat.reshape(n, n), one.P, 1e-9)


@settings(max_examples=examples(60), deadline=None)
@given(st.floats(-300, 300), st.floats(-30, 30), st.floats(0, 6.0), st.booleans())
def test_feedforward_finds_the_rotor_from_the_paper_s_own_equations(omega, i_q, theta0, printed):
    """(17), (18) with a current on q that turns with the rotor: the angle comes out, modulo half a turn."""
    if abs(omega) < 60.0:
        omega = 60.0 if omega >= 0 else -60.0
    h = 1e-6  # so fine that a step's mean is its middle
    s, c = pair(feedforward, M, h, held=0.0, printed=printed)
    w = M.pole_pairs * omega
    for k in range(3):
        at, middle = theta0 + w * h * k, theta0 + w * h * (k - 0.5)
        flux = M.lq * i_q
        # u = R i + d/dt (L i + psi), with i = i_q (-sin, cos)
        u_a = -M.resistance * i_q * np.sin(middle) - w * (flux * np.cos(middle) + M.flux * np.sin(middle))
        u_b = M.resistance * i_q * np.cos(middle) - w * (flux * np.sin(middle) - M.flux * np.cos(middle))
        feedforward.step(s, c, u_a, u_b, -i_q * np.sin(at), i_q * np.cos(at))
    error = s["theta_e"] - middle
    error -= pi * round(error / pi)
    # The printed sign turns the EMF (psi, 2 L I_q): by arctan(2 L I_q / psi).
    expected = atan2(2 * M.lq * i_q, M.flux) if printed else 0.0
    difference = abs(error) - abs(expected)
    difference -= pi * round(difference / pi)
    assert abs(difference) < 2e-3


def test_printed_feedforward_is_off_by_fifteen_degrees():
    assert np.degrees(np.arctan(2 * M.lq * 10.0 / M.flux)) == pytest.approx(14.93, abs=0.005)


def test_feedforward_holds_without_emf():
    s, c = pair(feedforward, M, T)
    for _ in range(3):
        feedforward.step(s, c, 0.1, 0.1, 0.0, 0.0)
    assert s["theta"] == 0.0
    feedforward.step(s, c, -1.0, 0.0, 0.0, 0.0)
    assert abs(s["theta"]) == pytest.approx(pi / 2 / M.pole_pairs)  # modulo half a turn


def test_the_anchor_holds_at_rest_alone():
    s, c = pair(ekf_alpha_beta, M, T, slow=15.0)
    ekf_alpha_beta.begin(s, c, 0.0)
    s["p"][18] = 1.0
    ekf_alpha_beta.hold(s, c, 0.2 + pi / 2, 1.0)  # an electrical turn further: the same
    assert s["held"] == 1
    assert s["x"][3] == pytest.approx(0.2, abs=1e-3)
    s["x"][2] = 20.0
    ekf_alpha_beta.hold(s, c, 0.0, 1.0)
    assert s["held"] == 0
    assert s["x"][3] == pytest.approx(0.2, abs=1e-3)


def test_copper_warms():
    assert motor.warm_resistance(0.06, 120.0) == pytest.approx(0.06 * 1.39)

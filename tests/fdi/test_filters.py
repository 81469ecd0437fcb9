"""Motor filters against scipy, filterpy, and the equations they come from."""

from math import atan2, pi

import numpy as np
import pytest
from amount import examples
from filter_reference import M, Reference, T, close, pair
from filterpy.kalman import KalmanFilter
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway_fdi.filters import ekf_alpha_beta, feedforward, gaussian, motor
from gateway_fdi.filters.motor import Motor
from gateway_fdi.filters.transforms import clarke, inverse_clarke, inverse_park, park, wrap
from gateway_fdi.jit import zeros

small = st.floats(-50, 50)
angles = st.floats(-20, 20)


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

"""The filters on a motor that nobody here wrote: gym-electric-motor's synchronous machine."""

import warnings
from functools import cache

import numpy as np
import pytest

from gateway_fdi.filters import ekf_alpha_beta, feedforward
from gateway_fdi.filters.motor import Motor
from gateway_fdi.jit import COMPILED, zeros

pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(not COMPILED, reason="30000 steps of five filters"),
]

TAU, STEPS = 1e-4, 30_000
MOTOR = Motor()


def profile(t):
    """Speed asked for [rad/s]: rest, 60, rest, -110, rest."""
    return np.interp(t, [0, 0.2, 0.6, 1.0, 1.3, 1.5, 2.0, 2.4, 2.7, 3.0], [0, 0, 60, 60, 0, 0, -110, -110, 0, 0])


@cache
def drive():
    """Return speed, angle (mechanical, counted), currents and voltages (dq, over the last step), shape (n, 7)."""
    from gym_electric_motor import physical_systems as physical
    from gym_electric_motor.physical_systems import solvers

    m = MOTOR
    limits = {"omega": 300.0, "torque": 5.0, "i": 100.0, "u": 12.0}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        system = physical.SynchronousMotorSystem(
            supply=physical.IdealVoltageSupply(u_nominal=24.0),
            converter=physical.ContB6BridgeConverter(tau=TAU),
            motor=physical.PermanentMagnetSynchronousMotor(
                motor_parameter={
                    "p": m.pole_pairs,
                    "l_d": m.ld,
                    "l_q": m.lq,
                    "j_rotor": 0.8 * m.inertia,
                    "r_s": m.resistance,
                    "psi_p": m.flux,
                },
                nominal_values=limits,
                limit_values=limits,
            ),
            load=physical.PolynomialStaticLoad(
                load_parameter={"a": 0.03, "b": m.friction, "c": 0.0, "j_load": 0.2 * m.inertia}
            ),
            ode_solver=solvers.EulerSolver(nsteps=10),
            tau=TAU,
            control_space="dq",
        )
        state = system.reset()
    names, scale = list(system.state_names), np.asarray(system.limits)
    place = {name: names.index(name) for name in names}
    rows = np.empty((STEPS, 7))
    held = np.zeros(2)
    wound, angle = 0.0, 0.0
    x = state * scale
    last = x[place["epsilon"]]
    for k in range(STEPS):
        omega, i_d, i_q = x[place["omega"]], x[place["i_sd"]], x[place["i_sq"]]
        lag = profile(k * TAU) - omega
        wound += lag * TAU
        wanted = np.clip(0.3 * lag + 6.0 * wound, -40.0, 40.0)
        error = np.array([-i_d, wanted - i_q])
        held += 1000.0 * m.resistance * error * TAU
        turning = m.pole_pairs * omega
        u = 1000.0 * m.ld * error + held
        u += [-turning * m.lq * i_q, turning * (m.ld * i_d + m.flux)]
        x = system.simulate(np.clip(u / 12.0, -1, 1)) * scale
        eps = x[place["epsilon"]]
        angle += (eps - last + np.pi) % (2 * np.pi) - np.pi
        last = eps
        rows[k] = [
            x[place["omega"]], angle / m.pole_pairs,
            x[place["i_sd"]], x[place["i_sq"]], x[place["u_sd"]], x[place["u_sq"]], eps,
        ]  # fmt: skip
    return rows


def follow(per, noise, rng, load=True):
    """Return the errors of EKF ab [rad, mechanical] with frames of ``per`` steps."""
    rows = drive()
    m, period = MOTOR, per * TAU
    c, s = zeros(1, ekf_alpha_beta.Const), zeros(1, ekf_alpha_beta.State)
    ekf_alpha_beta.prepare(c[0], m, period, load=load, slow=0.0)
    ekf_alpha_beta.begin(s[0], c[0], 0.0)
    theta = rows[:, 1] * m.pole_pairs
    before = np.concatenate([[0.0], theta[:-1]])
    u_a, u_b = inverse_park_all(rows[:, 4], rows[:, 5], 0.5 * (theta + before))
    i_a, i_b = inverse_park_all(rows[:, 2], rows[:, 3], theta)
    errors = []
    for k in range(per - 1, STEPS, per):
        mean_a, mean_b = u_a[k - per + 1 : k + 1].mean(), u_b[k - per + 1 : k + 1].mean()
        n = rng.normal(size=4) * noise
        ekf_alpha_beta.step(
            s[0],
            c[0],
            mean_a + 0.15 * n[0],
            mean_b + 0.15 * n[1],
            0.0,
            0.0,
            i_a[k] + n[2],
            i_b[k] + n[3],
        )
        errors.append(s[0]["x"][3] - rows[k, 1])
    return np.array(errors)


def inverse_park_all(d, q, theta):
    c, s = np.cos(theta), np.sin(theta)
    return d * c - q * s, d * s + q * c


@pytest.mark.full("5 s")
def test_the_filter_follows_a_motor_of_other_make():
    rms = {
        (per, noise): np.degrees(np.sqrt(np.mean(follow(per, noise, np.random.default_rng(1)) ** 2)))
        for per, noise in ((1, 0.0), (10, 0.0), (10, 0.2))
    }
    print(rms)
    assert rms[1, 0.0] <= 0.05
    assert rms[10, 0.0] <= 0.3
    assert rms[10, 0.2] <= 0.7


def test_the_emf_lies_where_the_rotor_is():
    rows = drive()
    m = MOTOR
    c, s = zeros(1, feedforward.Const), zeros(1, feedforward.State)
    printed_c, printed = zeros(1, feedforward.Const), zeros(1, feedforward.State)
    feedforward.prepare(c[0], m, TAU)
    feedforward.prepare(printed_c[0], m, TAU, printed=True)
    theta = rows[:, 1] * m.pole_pairs
    before = np.concatenate([[0.0], theta[:-1]])
    u_a, u_b = inverse_park_all(rows[:, 4], rows[:, 5], 0.5 * (theta + before))
    i_a, i_b = inverse_park_all(rows[:, 2], rows[:, 3], theta)
    off, off_printed = [], []
    for k in range(STEPS):
        for state, const in ((s, c), (printed, printed_c)):
            feedforward.step(state[0], const[0], u_a[k], u_b[k], i_a[k], i_b[k])
        if abs(rows[k, 0]) > 40.0:
            middle = 0.5 * (theta[k] + before[k])
            for state, errors in ((s, off), (printed, off_printed)):
                error = state[0]["theta_e"] - middle
                errors.append(abs(error - np.pi * np.rint(error / np.pi)))
    print(np.degrees(max(off)), np.degrees(max(off_printed)))
    assert np.degrees(max(off)) < 0.3
    assert max(off_printed) > 10 * max(off)

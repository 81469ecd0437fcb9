"""Bank of PI observers: what can be designed, its kernels against numpy and filterpy, decisions."""

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter

from gateway_fdi.jit import COMPILED, zeros
from gateway_plants.linear.ecu.params import LinearFault
from gateway_plants.linear.ecu.plant import simulate
from gateway_plants.linear.mathematics.plant import discretised
from gateway_plants.linear.pi_bank import bank, glr, isolation, start
from gateway_plants.linear.pi_bank.design import Noise, augmented, check, design
from gateway_plants.linear.pi_bank.masking import masked, stationary
from gateway_plants.linear.study import example
from gateway_plants.linear.study.bank import noise, observers, records, walk

PLANT = example.plant()
compiled = pytest.mark.skipif(not COMPILED, reason="thousands of steps of a whole bank")


def test_the_example_fulfils_theorem_1_and_fails_it_without_b12():
    check(PLANT)
    b = np.array(example.B)
    b[0, 1] = 0.0
    with pytest.raises(ValueError, match=r"i = 1 \(roll\).*rank is 5, not n \+ m = 6"):
        check(discretised(example.A, b, example.C, 0.1), ("roll", "p", "r"))


def test_what_cannot_be_isolated_is_refused():
    two = discretised(example.A, example.B, example.C[:2], 0.1)
    with pytest.raises(ValueError, match="2 sensors for 2 actuators"):
        check(two)
    hidden = discretised(np.diag([-1.0, -2.0]), [[1.0], [1.0]], [[1.0, 0.0], [0.0, 1.0]], 0.1)
    with pytest.raises(ValueError, match=r"without sensor 1 \(left\) the plant does not show 1 speed"):
        check(hidden, ("left", "right"), ("speed", "other"))


def test_the_bank_s_step_is_the_equation():
    found = design(PLANT, noise())
    s, c = zeros(1, bank.State), zeros(1, bank.Const)
    bank.prepare(c[0], PLANT, found)
    rng = np.random.default_rng(5)
    z = [np.zeros(6) for _ in range(4)]
    phi = augmented(PLANT)
    for _ in range(60):
        y, u = rng.normal(size=3), rng.normal(size=2)
        bank.step(s[0], c[0], y, u)
        for k, observer in enumerate(found):
            rows = observer.rows
            e = y[rows] - PLANT.c[rows] @ z[k][:4]
            np.testing.assert_allclose(s[0]["e"][k][rows], e, atol=1e-9)
            z[k] = phi @ z[k] + np.concatenate([PLANT.gamma @ u, [0, 0]]) + observer.gain.gain @ e
            np.testing.assert_allclose(s[0]["z"][k][:6], z[k], atol=1e-9)


def test_the_start_is_filterpy_s_kalman_filter():
    s, c, o = zeros(1, start.State), zeros(1, start.Const), zeros(1, bank.Const)
    bank.prepare(o[0], PLANT, observers())
    unknown = np.array([1.0, 2.0, 3.0, 4.0, 0.5, 0.6])
    start.prepare(c[0], PLANT, noise(), 40, unknown)
    start.anew(s[0], c[0])
    z = np.zeros((bank.BANK, bank.MOST))
    filters = []
    for k in range(4):
        rows = [j for j in range(3) if j != k - 1]
        kf = KalmanFilter(6, len(rows), 2)
        kf.x = np.zeros(6)
        kf.F, kf.B = augmented(PLANT), np.vstack([PLANT.gamma, np.zeros((2, 2))])
        kf.H = np.hstack([PLANT.c[rows], np.zeros((len(rows), 2))])
        kf.Q = np.diag(np.concatenate([noise().states, noise().faults]) ** 2 * 0.1)
        kf.R, kf.P = np.diag(noise().outputs[rows] ** 2), np.diag(unknown**2)
        filters.append((kf, rows))
    rng = np.random.default_rng(8)
    for t in range(40):
        y, u = rng.normal(size=3), rng.normal(size=2)
        assert start.step(s[0], c[0], o[0], z, y, u) == (t == 39)
        for k, (kf, rows) in enumerate(filters):
            kf.update(y[rows])
            kf.predict(u)
            np.testing.assert_allclose(z[k][:6], kf.x.ravel(), rtol=1e-6, atol=1e-7)
            np.testing.assert_allclose(s[0]["p"][k][:6, :6], kf.P, rtol=1e-6, atol=1e-9)


def test_stationary_gains_and_masked_regions_are_the_note_s():
    moved = stationary(PLANT)
    np.testing.assert_allclose(moved[0, 1], (0.16592, -1.0), atol=1e-5)
    np.testing.assert_allclose(moved[0, 2], (0.07624, -0.30960), atol=1e-5)
    np.testing.assert_allclose(moved[1, 0], (-0.07129, 0.42970), atol=1e-5)
    np.testing.assert_allclose(moved[1, 2], (0.58572, -3.38029), atol=1e-5)
    np.testing.assert_allclose(moved[2, 0], (0.01067, -0.04332), atol=1e-5)
    np.testing.assert_allclose(moved[2, 1], (0.19075, -1.10082), atol=1e-5)
    assert (moved[range(3), range(3)] == 0).all()
    found = {(h.actuator, h.sensor, h.observer): (h.low, h.high)
             for h in masked(PLANT, np.full(2, 0.05), np.full(2, 0.01))}  # fmt: skip
    assert found[0, 0, 1] == pytest.approx((0.561, 0.842), abs=1e-3)
    assert found[0, 1, 0] == pytest.approx((-0.362, -0.241), abs=1e-3)
    assert found[0, 2, 1] == pytest.approx((-0.102, -0.068), abs=1e-3)
    assert found[1, 0, 2] == pytest.approx((0.923, 1.385), abs=1e-3)
    assert found[1, 2, 0] == pytest.approx((0.129, 0.194), abs=1e-3)
    assert len(found) == 12


@pytest.mark.parametrize("age", [1, 5, 20])
@pytest.mark.parametrize("phase", range(glr.PHASES))
def test_a_jump_is_found_where_and_as_large_as_it_was(age, phase):
    """Innovations of each observer as its own error equation makes them, without noise."""
    s, c = records(1.0, known=True)
    o, size = c["bank"], np.array([0.07, -0.03])
    phi = augmented(PLANT)
    for k, observer in enumerate(observers()):
        rows = observer.rows
        left = np.hstack([PLANT.c[rows], np.zeros((len(rows), 2))])
        f, late = phi - observer.gain.gain @ left, np.vstack([np.zeros((4, 2)), np.eye(2)])
        theta = phase / glr.PHASES
        error = (1 - theta) * late @ size
        x = s["jump"]
        x["kept"], x["at"] = 30, 7
        x["r"][k] = 0.0
        for d in range(age + 1):
            x["r"][k][(7 - age + d) % glr.WINDOW][rows] = left @ error
            error = f @ error + (theta * late @ size if d == 0 else 0.0)
        assert glr.search(x, c["jump"], o, k)
        if age > 1:  # one sample alone cannot tell the share
            assert (x["age"][k], x["phase"][k]) == (age, phase)
            assert x["left"][k] < 1e-2
            glr.begin(x, c["jump"], o, k)
            e = np.zeros((bank.BANK, bank.MOST_OUTPUTS))
            e[k] = x["r"][k][7]
            glr.learn(x, c["jump"], o, k, e)
            np.testing.assert_allclose(x["a"][k][:2], size, atol=2e-3 if age > 5 else 0.03)


def healthy(sigma, seconds, seed):
    from gateway_plants.linear.study.bank import drive

    return simulate(drive(sigma, stable=True), (), seconds, np.random.default_rng(seed))


def flown(faults, seconds=40.0, seed=3, start_s=5.0):
    from gateway_plants.linear.study.bank import drive

    y, u = simulate(drive(0.01, stable=True), faults, seconds, np.random.default_rng(seed))
    return walk(*records(start_s, known=False), y, u), y


@compiled
@pytest.mark.parametrize("place", [1, 2])
def test_an_actuator_s_fault_is_sized(place):
    fault = LinearFault(kind="actuator_offset", place=place, from_s=10.0, to_s=25.0, size=-0.08)
    found, _ = flown((fault,), 45.0)
    other = 2 - place
    assert found.actuators[150:250, place - 1].all()
    assert not found.actuators[:100].any()
    assert not found.actuators[:, other].any()
    assert not found.sensors.any()
    np.testing.assert_allclose(found.fault[180:249, place - 1], -0.08, atol=0.015)
    assert not found.actuators[300:].any()


@compiled
@pytest.mark.parametrize("place", [1, 2, 3])
@pytest.mark.parametrize("kind", ["output_offset", "output_stuck", "output_drift"])
def test_a_sensor_s_fault_is_sized_and_heals(place, kind):
    fault = LinearFault(kind=kind, place=place, from_s=10.0, to_s=20.0, size=0.4)
    found, _ = flown((fault,))
    flags = found.sensors[:, place - 1]
    assert flags[100:199].any()
    first = int(np.flatnonzero(flags)[0])
    assert first >= 100
    assert not np.delete(found.sensors, place - 1, axis=1).any()
    assert not found.unexplained.any()
    if kind == "output_offset":
        assert first <= 102
        np.testing.assert_allclose(found.offset[first + 3 : 199, place - 1], 0.4, atol=0.1)
        assert not found.actuators.any()
    assert not flags[260:].any()


@compiled
def test_a_sensor_that_is_latched_in_doubt_is_released():
    """Its offset is not small, and never what counts: another cause left its observer alone with an explanation."""
    y, u = healthy(0.01, 30.0, 3)
    s, c = records(5.0, known=False)
    for k in range(100):
        isolation.step(s, c, y[k], u[k])
    y[:, 1] += 0.75 * c["sensor"][1]
    latched = []
    for k in range(100, 100 + isolation.PATIENCE + 3):
        if k == 100:
            isolation._latch_sensor(s, c, y[k], 2)
        isolation.step(s, c, y[k], u[k])
        latched.append(int(s["latched"]))
    assert latched[: isolation.PATIENCE] == [1] * isolation.PATIENCE
    assert isolation.NONE in latched[isolation.PATIENCE :]


@compiled
@pytest.mark.parametrize("rate", [0.1, 0.2, 0.4])
@pytest.mark.parametrize("place", [1, 2])
def test_an_actuator_that_drifts_blames_no_healthy_part(place, rate):
    """Before there were filters of free actuators 20 of these 24 runs named a healthy part."""
    named = 0
    for seed in range(625_000, 625_000 + 4):
        fault = LinearFault(kind="actuator_drift", place=place, from_s=10.0, size=rate * (-1) ** seed)
        found, _ = flown((fault,), seed=seed)
        print(f"seed {seed}")
        assert not found.sensors.any()
        assert not found.actuators[:, 2 - place].any()
        named += found.actuators[:, place - 1].any()
        assert found.actuators[:, place - 1].any() or found.unexplained.any()
    assert named >= 3


@compiled
def test_a_sensor_that_drifts_blames_no_actuator():
    for seed in range(625_100, 625_100 + 6):
        fault = LinearFault(kind="output_drift", place=2, from_s=10.0, size=0.01)
        found, _ = flown((fault,), seed=seed)
        print(f"seed {seed}")
        assert not found.actuators.any()
        assert not found.sensors[:, [0, 2]].any()


@compiled
def test_two_sensors_at_once_are_not_isolated_and_said_to_be_so():
    faults = tuple(LinearFault(kind="output_offset", place=k, from_s=10.0, to_s=20.0, size=0.5) for k in (1, 2))
    found, _ = flown(faults, 60.0)
    assert found.unexplained[130:200].any()
    assert not found.unexplained[-50:].any()


@pytest.mark.long
@compiled
def test_a_sample_that_is_missing_is_predicted():
    s, c = records(5.0, known=False)
    y, u = healthy(0.01, 60.0, 1)
    for t in range(len(y)):
        if t > 100 and t % 7 == 0:
            isolation.missing(s, c, u[t])
        else:
            isolation.step(s, c, y[t], u[t])
        assert not s["actuator"].any()
        assert s["latched"] == isolation.NONE
        assert not s["unexplained"]


@compiled
def test_the_start_finds_a_state_that_nobody_knows():
    y, u = healthy(0.01, 60.0, 4)
    found = walk(*records(5.0, known=False), y[200:], u[200:])
    assert not found.actuators.any()
    assert not found.sensors.any()
    assert not found.unexplained.any()


def test_a_plant_that_is_too_large_is_refused():
    n = bank.MOST_STATES + 1
    large = discretised(-np.eye(n), np.ones((n, 1)), np.eye(n)[:2], 0.1)
    with pytest.raises(ValueError, match=f"{n} states"):
        bank.prepare(zeros(1, bank.Const)[0], large, ())


def test_noise_is_what_the_innovations_have():
    """Innovations of 20 000 healthy samples have the covariance that the design says."""
    if not COMPILED:
        pytest.skip("20 000 steps")
    s, c = zeros(1, bank.State), zeros(1, bank.Const)
    bank.prepare(c[0], PLANT, observers())
    y, u = healthy(0.01, 2000.0, 6)
    seen = np.zeros((len(y), 3))
    for t in range(len(y)):
        bank.step(s[0], c[0], y[t], u[t])
        seen[t] = s[0]["e"][0][:3]
    expected = np.diag(observers()[0].gain.innovation)
    np.testing.assert_allclose(seen[2000:].var(axis=0), expected, rtol=0.06)


def test_noise_of_a_design_is_a_sample_s():
    plain = Noise(np.ones(3), np.ones(4), np.ones(2))
    from gateway_plants.linear.pi_bank.design import covariances

    q, r = covariances(PLANT, plain)
    np.testing.assert_allclose(np.diag(q), 0.1)
    np.testing.assert_allclose(r, np.eye(3))


@pytest.mark.parametrize("begun", [0, 1, 9])
def test_a_jump_of_one_sensor_more_is_found(begun):
    """Innovations of each observer behind an offset of each sensor that it takes, by its own error equation."""
    s, c = records(1.0, known=True)
    o, x = c["bank"], s["jump"]
    phi = augmented(PLANT)
    for k, observer in enumerate(observers()):
        rows = observer.rows
        left = np.hstack([PLANT.c[rows], np.zeros((len(rows), 2))])
        weight = np.linalg.inv(observer.gain.innovation)
        for one in range(len(rows)):
            moved, offset = np.zeros(6), 0.4 * np.eye(len(rows))[one]
            x["kept"], x["at"], x["r"][k] = 20, 5, 0.0
            energy = 0.0
            for d in range(begun + 1):
                r = offset - left @ moved
                x["r"][k][(5 - begun + d) % glr.WINDOW][rows] = r
                energy += r @ weight @ r
                moved = (phi - observer.gain.gain @ left) @ moved + observer.gain.gain @ offset
            # It takes all of it; of the sensor that the observer does not take nothing is said.
            assert glr.other_sensor(x, c["jump"], o, k) == pytest.approx(energy, rel=1e-9)

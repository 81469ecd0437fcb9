"""Mathematics of the tracker against closed forms and filterpy."""

import numpy as np
import pytest
from amount import examples
from filterpy.kalman import KalmanFilter
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.fdi.pulse_tracking import profile
from gateway.fdi.pulse_tracking.acquisition import WINDOW, Search, seek
from gateway.fdi.pulse_tracking.hypotheses import take
from gateway.fdi.pulse_tracking.motion import Q1, Q2, Hypothesis, correct, spread, travel
from gateway.fdi.pulse_tracking.tracker import MOST, Tracker, begin
from gateway.fdi.wheel import Wheel
from gateway.jit import COMPILED, zeros
from gateway.monitors.crank import place


def hypothesis(period=500.0, growth=0.0, **p):
    h = zeros(1, Hypothesis)
    h["period"], h["growth"] = period, growth
    for name, value in p.items():
        h[name] = value
    return h[0]


@given(st.floats(100, 20000), st.floats(-0.15, 0.3), st.floats(0.5, 5))
def test_prediction_is_exact_under_constant_torque(period, growth, span):
    """The time over an angle is the integral of dtheta / omega, omega^2 linear in the angle."""
    dt, q = travel(hypothesis(period, growth), span)
    angles = np.linspace(0, span, 20001)
    times = period / np.sqrt(1 + growth * angles)
    integral = float(np.sum((times[1:] + times[:-1]) / 2) * (angles[1] - angles[0]))
    assert dt == pytest.approx(integral, rel=1e-7)
    assert q == pytest.approx(period / times[-1], rel=1e-12)


@settings(max_examples=examples(100))
@given(st.data())
def test_correction_is_filterpys(data):
    """Gain, covariance and state of one step, at constant speed, where the model is linear."""
    rng = np.random.default_rng(data.draw(st.integers(0, 2**31), label="seed"))
    root = rng.normal(size=(3, 3))
    P = root @ root.T
    span = data.draw(st.sampled_from([1.0, 2.0, 3.0, 0.5]), label="span")
    variance, q3, step, jolt = 4e-4, 2e-5, 0.3, 0.7
    e = data.draw(st.floats(-0.01, 0.01), label="e")
    names = ("p11", "p12", "p13", "p22", "p23", "p33")
    places = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)]
    h = hypothesis(period=1.0, **{n: P[i] for n, i in zip(names, places, strict=True)})
    kf = KalmanFilter(dim_x=3, dim_z=1)
    kf.F = np.array([[1, span, -(span**2) / 4], [0, 1, -span / 2], [0, 0, 1]])
    kf.H = np.array([[1.0, 0, 0]])
    kf.P = P + np.diag([0, step, jolt])
    kf.R = np.array([[1.7]])
    kf.Q = (
        np.array(
            [
                [Q1 + Q2 * span**3 / 3, Q2 * span**2 / 2, 0],
                [Q2 * span**2 / 2, Q2 * span, 0],
                [0, 0, q3 * span],
            ]
        )
        / variance
    )
    kf.predict()
    kf.x = np.zeros((3, 1))
    kf.update(e)
    correct(h, span, e, 1.0, 1.7, step, jolt, 1 / variance, q3)
    np.testing.assert_allclose([h[n] for n in names], [kf.P[i] for i in places], atol=1e-9)
    gain = kf.K[:, 0]
    assert h["elapsed"] == pytest.approx(e * (1 - gain[0]), abs=1e-12)
    assert h["period"] == pytest.approx(np.exp(min(max(gain[1] * e, -0.6), 0.6)), rel=1e-3)
    assert h["growth"] == pytest.approx(min(max(gain[2] * e, -0.3), 0.3), abs=1e-9)


def test_the_variance_over_a_gap_is_the_predicted_one():
    h = hypothesis(p11=0.8, p12=0.1, p13=-0.05, p22=0.3, p23=-0.02, p33=0.1)
    P = np.array([[0.8, 0.1, -0.05], [0.1, 0.3, -0.02], [-0.05, -0.02, 0.1]])
    row = np.array([1, 3.0, -9 / 4])
    expected = row @ P @ row + (Q1 + Q2 * 9) / 1e-4
    assert spread(h, 3.0, 1e4) == pytest.approx(expected, rel=1e-12)


@settings(max_examples=examples(60))
@given(
    st.sampled_from(["60-2", "36-1", "30-2", "36-2-1", "36-2-2-2", "12+1"]),
    st.integers(0, 200),
    st.floats(100, 20000),
    st.floats(-0.02, 0.02),
)
def test_the_place_is_found_or_not_told(wheel, start, period, slope):
    """Whatever is found on a clean wheel with any speed and slope is right."""
    w = Wheel.parse(wheel)
    pitches = np.array(w.pitches)
    logs = np.zeros(128)
    logs[: w.pulses] = np.log(pitches)
    se = zeros(1, Search)[0]
    found = []
    for k in range(2 * w.pulses):
        at = (start + k) % w.pulses
        index = seek(se, logs, w.repeats, pitches[at] * period * np.exp(slope * k))
        if index >= 0:
            found.append(index)
            assert index == (at + 1) % w.pulses
    assert found
    assert se["seen"] >= WINDOW


@pytest.mark.skipif(not COMPILED, reason="half a minute")
def test_hypotheses_never_exceed_their_room():
    """Pulses that fit nothing: noise without a wheel."""
    tr = zeros(1, Tracker)[0]
    pitches = np.array(Wheel.parse("36-1").pitches)
    tr["pitches"][:35] = pitches
    tr["wander"] = 1e-5
    begin(tr, 3, 1000.0, 0.0, 0.01)
    rng = np.random.default_rng(1)
    for _ in range(3000):
        cost = take(tr, 35, 1800.0, 0.03, float(rng.uniform(50, 4000)))
        assert np.isfinite(cost)
        assert 1 <= tr["count"] <= MOST
        first = int(tr["bank"]) * MOST
        costs = [float(tr["banks"][first + k]["cost"]) for k in range(int(tr["count"]))]
        assert costs[0] == min(costs) == 0.0
        assert all(0 <= int(tr["banks"][first + k]["index"]) < 35 for k in range(len(costs)))
        assert all(np.isfinite(tr["banks"][first + k]["period"]) for k in range(len(costs)))


@pytest.mark.long
def test_ripple_learned_at_another_speed_is_brought_to_this_one():
    """10 % ripple while cranking, none at twice the speed: a quarter is believed at once, then less."""
    wheel = Wheel.parse("36-1")
    state, const = zeros(1, place.State), zeros(1, place.Const)
    place.prepare(state[0], const[0], wheel, 3000.0, 0.04, 30.0)
    pr, wh, pitches = state[0]["profile"], const[0]["wheel"], state[0]["tracker"]["pitches"]
    if not COMPILED:
        pr, wh = state[0].profile, const[0].wheel
    nominal = np.array(wheel.pitches)
    ripple = 0.1 * np.cos(2 * np.pi * 2 * np.array(wheel.positions) / wheel.turn)

    def turns(count, period, share):
        for _ in range(count):
            for slot in range(wheel.pulses):
                profile.note(pr, slot, float(period * nominal[slot] * np.exp(share * ripple[slot])))
            profile.end(pr)
            profile.turn(pr, wh, pitches, 0)

    turns(12, 8000.0, 1.0)
    plain = slice(3, 30)
    believed = np.log(np.array(pitches[:35]) / nominal)[plain]
    np.testing.assert_allclose(believed, ripple[plain], atol=0.012)
    pr["last_us"], pr["trend"] = 0.0, 0.0  # the speed has changed in between
    turns(2, 4000.0, 0.0)
    believed = np.log(np.array(pitches[:35]) / nominal)[plain]
    assert np.abs(believed).max() < 0.3 * np.abs(ripple[plain]).max()

"""Mathematics of the tracker against closed forms and filterpy."""

import numpy as np
import pytest
from amount import examples
from filterpy.kalman import KalmanFilter
from hypothesis import given, settings
from hypothesis import strategies as st
from tracked import tracked

from gateway_fdi.jit import COMPILED, zeros
from gateway_plants.crank.monitor import MONITOR, adaptive, sync_state
from gateway_plants.crank.pulse_tracking import profile
from gateway_plants.crank.pulse_tracking.acquisition import WINDOW, Search, seek
from gateway_plants.crank.pulse_tracking.hypotheses import take
from gateway_plants.crank.pulse_tracking.motion import Q1, Q2, Hypothesis, correct, spread, travel
from gateway_plants.crank.pulse_tracking.tracker import MOST, Tracker, begin
from gateway_plants.crank.wheel import Wheel


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
    state, const = zeros(1, sync_state.State), zeros(1, sync_state.Const)
    sync_state.prepare(state[0], const[0], wheel, 3000.0, 0.04, 30.0)
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


def numbers(value):
    """All numbers of a record, those of records in it, too."""
    if value.dtype.names:
        return np.concatenate([numbers(value[name]) for name in value.dtype.names])
    return np.ravel(value).astype(float)


@pytest.mark.costly
def test_regular_pulses_in_a_run_are_what_they_are_one_by_one():
    """But for rounding, whatever the length of the runs: a frame brings 4, 27, or the pulses of a whole log at once."""
    wheel = Wheel.parse("60-2")
    rng = np.random.default_rng(17)
    print("seed 17")
    y = np.tile(wheel.pitches, 20) * 350.0 * (1 + 0.01 * rng.normal(size=58 * 20))
    ends = []
    for longest in (1, 4, 27, len(y)):
        state, const, out = zeros(1, sync_state.State), zeros(1, sync_state.Const), zeros(1, MONITOR.results)
        sync_state.prepare(state[0], const[0], wheel, 3000.0, 0.04, 30.0)
        k = regular = 0
        while k < len(y):
            taken = adaptive.regular(state[0], const[0], y, k, min(k + longest, len(y)))
            assert taken <= longest
            regular += taken
            k += taken
            if taken == 0:
                tracked(state[0], const[0], out[0], y[k : k + 1])
                k += 1
        ends.append(numbers(state))
        assert state[0].index == len(y) % 58
        assert regular > 0.7 * len(y), "few were taken the short way"
    for end in ends[1:]:
        np.testing.assert_allclose(end, ends[0], rtol=1e-9, atol=1e-12)


def test_what_the_profile_says_of_the_wheel_is_what_its_pitches_say():
    """The tooth that is off most, the scatter of the others, the orders of the ripple: by numpy."""
    wheel = Wheel.parse("60-2")
    state, const = zeros(1, sync_state.State), zeros(1, sync_state.Const)
    sync_state.prepare(state[0], const[0], wheel, 3000.0, 0.04, 30.0)
    pr, wh = state[0].profile, const[0].wheel
    pitches = np.array(wheel.pitches)
    middle = 2 * np.pi * (np.array(wheel.positions) + pitches / 2) / wheel.turn
    rng = np.random.default_rng(18)
    late = 0.02 * rng.normal(size=58)
    late[31] = 0.3
    shown = (pitches + np.diff(np.append(late, late[0]))) * np.exp(0.03 * np.cos(2 * middle + 0.4))
    for _ in range(8):
        for slot in range(58):
            profile.note(pr, slot, float(400.0 * shown[slot]))
        profile.end(pr)
        profile.turn(pr, wh, state[0].tracker.pitches, 0)
    logs, ripple = np.array(pr.logs[:58]), np.array(pr.ripple[:58])
    orders = np.arange(1, wh.orders + 1)[:, None] * middle
    even, odd = (2 / wheel.turn * (pitches * logs * f(orders)).sum(1) for f in (np.cos, np.sin))
    np.testing.assert_allclose(ripple, even @ np.cos(orders) + odd @ np.sin(orders), atol=2e-4)
    own = pitches * (logs - ripple)
    off = 0.5 * (np.roll(own, 1) - own)
    gap = pitches > 1.3
    off[gap | np.roll(gap, 1) | np.roll(gap, 2)] = 0.0
    assert pr.bent == np.abs(off).argmax() == 31
    assert pr.off == pytest.approx(off[31], rel=1e-9)
    others = np.delete(np.abs(off), [30, 31, 32])
    assert pr.scatter == pytest.approx(1.25 * others.sum() / 55, rel=1e-9)
    assert pr.worst == np.abs(logs).argmax()

"""The lag of one channel behind another: found whatever is lost, with its deviation, and never for ever."""

import numpy as np
import pytest
from amount import amount, examples
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway_fdi.jit import COMPILED, kernel, zeros
from gateway_plants.pedal.study.outside import sensors
from gateway_plants.pedal.study.outside.foot import driving
from gateway_plants.pedal.voting.identification import lag
from gateway_plants.pedal.voting.movement import bent, filtered
from gateway_plants.pedal.voting.tracking import scale

NOISE, STEP = 0.05, 5 / 4096 / 0.04
compiled = pytest.mark.skipif(not COMPILED, reason="tens of thousands of samples")


@kernel
def _all(s, c, n, y, gaps, straight, variance, out):
    for k in range(y.shape[0]):
        smooth = lag.smooth(s, n, y[k], 0, straight, gaps[k])
        lag.align(s, c, n, y[k], smooth, 0.0, out)
        lag.learn(s, c, n, out, (1 << n) - 1, smooth, gaps[k], variance)


def learned(positions, numbers, s=None, most_ms=10.0):
    """Return the estimator's state after samples [%] with these numbers."""
    c, gates = zeros(1, lag.Const)[0], zeros(1, scale.Scale)[0]
    s = zeros(1, lag.State)[0] if s is None else s
    lag.prepare(c, period_ms=1.0, most_ms=most_ms)
    scale.measure(gates, NOISE, STEP, 100.0, 0.016)
    gaps = np.diff(numbers, prepend=numbers[0] - 1).astype(float)
    n = positions.shape[1]
    _all(
        s, c, n, np.ascontiguousarray(positions), gaps, float(gates["straight"]), float(gates["variance"]), np.zeros(n)
    )
    return s


def drive(seconds, rng, lags, kind="first"):
    """Positions [%] of the brake's two channels, each with its errors of slope and offset."""
    plant = sensors.brake(0.002, lags, kind, rng)
    volts = sensors.readings(plant, driving(seconds, rng), rng)
    return (volts - [0.5, 4.5]) / [0.04, -0.04]


@compiled
@settings(max_examples=examples(25), deadline=None, derandomize=True)
@given(
    st.integers(0, 2**32 - 1),
    st.integers(0, 100).map(lambda tenths: tenths / 10),
    st.booleans(),
    st.floats(0.0, 0.4),
    st.integers(1, 12),
)
def test_a_lag_is_found_whatever_is_lost(seed, true, first, loss, longest):
    """Also where frames are lost in bursts; the deviation that it tells is one."""
    rng = np.random.default_rng(seed)
    y = drive(40.0, rng, (true, 0.0) if first else (0.0, true))
    lost = np.zeros(len(y), bool)
    for at in np.flatnonzero(rng.random(len(y)) < loss / longest):
        lost[at : at + rng.integers(1, longest + 1)] = True
    s = learned(y[~lost], np.flatnonzero(~lost))
    if s["known"] == 0:
        return  # the pedal did not move enough
    assert float(np.sqrt(s["variance"][1])) <= 0.8
    behind = -float(s["behind"][1]) if first else float(s["behind"][1])
    delay = 1.0 / np.expm1(1.0 / true) if true > 0.05 else 0.0  # of that filter in steps of 1 ms
    assert behind == pytest.approx(delay, abs=0.5 + 3.0 * float(np.sqrt(s["variance"][1])))
    if true > 1.8:
        assert float(s["tau"][0 if first else 1]) == pytest.approx(true, abs=1.1)


@compiled
@pytest.mark.parametrize("kind", ["delay", "mean"])
def test_a_lag_of_another_kind_is_found_too(kind):
    rng = np.random.default_rng(5)
    y = drive(40.0, rng, (0.0, 6.0), kind)
    s = learned(y, np.arange(len(y)))
    assert float(s["behind"][1]) == pytest.approx(6.0, abs=1.0)


@compiled
@pytest.mark.parametrize("wrong", [0.0, 15.0, -9.0])
def test_a_wrong_lag_heals(wrong):
    """Known as sure, and wrong: the second measurement that says so is believed."""
    rng = np.random.default_rng(6)
    y = drive(60.0, rng, (0.0, 8.0))
    s = zeros(1, lag.State)[0]
    s["known"], s["behind"][1], s["variance"][1] = 1, wrong, 1e-4
    s = learned(y, np.arange(len(y)), s)
    assert float(s["tau"][1] - s["tau"][0]) == pytest.approx(8.0, abs=0.5)


@compiled
def test_a_lag_beyond_the_largest_is_not_learned():
    rng = np.random.default_rng(7)
    healthy, sick = drive(30.0, rng, (0.0, 4.0)), drive(30.0, rng, (50.0, 4.0))
    y = np.concatenate([healthy, sick])
    before = learned(healthy, np.arange(len(healthy)))
    s = learned(y, np.arange(len(y)))
    assert float(before["tau"][1]) == pytest.approx(4.0, abs=0.5)
    assert float(s["tau"][1]) == pytest.approx(4.0, abs=0.6)


@compiled
def test_what_is_sure_of_a_lag_is_so():
    """Of many drives the deviation that is told is about that of the estimates, and no less than the half of it."""
    found, told = [], []
    for seed in range(amount(40, 12)):
        rng = np.random.default_rng([8, seed])
        y = drive(30.0, rng, (0.0, 5.0))
        s = learned(y, np.arange(len(y)))
        if s["known"]:
            found.append(float(s["behind"][1]))
            told.append(float(np.sqrt(s["variance"][1])))
    print(np.std(found), np.mean(told))
    assert np.mean(found) == pytest.approx(4.517, abs=0.15)
    assert np.std(found) < 2.0 * np.mean(told)


@settings(max_examples=examples(50))
@given(st.floats(-50, 50), st.floats(-2, 2), st.integers(1, 9), st.integers(1, 9))
def test_a_line_is_not_bent_however_its_samples_lie(level, slope, dt, before):
    y = [level + slope * t for t in (0.0, before, before + dt)]
    assert bent(y[2], y[1], y[0], float(dt), float(before)) == pytest.approx(0.0, abs=1e-9)
    assert bent(y[2] + 1.0, y[1], y[0], 1.0, 1.0) == pytest.approx(y[2] + 1.0 - 2 * y[1] + y[0], abs=1e-9)


@settings(max_examples=examples(50))
@given(st.floats(0.1, 0.99), st.integers(1, 16), st.floats(-2, 2))
def test_a_filter_over_lost_samples_is_the_filter_on_a_line(pole, dt, slope):
    level = 0.3
    for k in range(1, dt + 1):
        level = slope * k + pole * (level - slope * k)
    assert filtered(0.3, 0.0, slope * dt, pole, float(dt)) == pytest.approx(level, abs=1e-9)

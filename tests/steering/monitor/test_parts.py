"""Parts of the steering monitor by themselves."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from gateway_fdi.jit import zeros
from gateway_plants.steering.monitor import kinematics, onset, road_wheel, trend
from gateway_plants.steering.monitor.faults import FAULTS
from gateway_plants.steering.monitor.params import Params, Ratio, Thresholds


def history(parity, motor):
    s = zeros(1, trend.State)
    for p, m in zip(parity, motor, strict=True):
        trend.keep(s[0], p, m)
    return s[0]


@pytest.mark.parametrize("seed", range(5))
def test_drift_and_scale_are_told_apart(seed):
    rng = np.random.default_rng(seed)
    print("seed", seed)
    t = np.arange(64) * 0.01
    noise = rng.uniform(-0.05, 0.05, 64)
    motor = 600.0 * np.sin(2 * np.pi * t / 0.9 + rng.uniform(0, 6))
    assert trend.growth(history(0.57 * t + noise, motor)) == trend.WITH_TIME
    assert trend.growth(history(0.02 * motor / 20 + noise, motor)) == trend.WITH_ANGLE
    assert trend.growth(history(0.3 + noise, 0 * t)) in (trend.UNKNOWN, trend.WITH_TIME)
    assert trend.growth(history(noise[:10], motor[:10])) == trend.UNKNOWN


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("direction", [0.3, 2.0, 4.4])
def test_a_current_sensor_shows_at_once_and_a_voltage_does_not(seed, direction):
    """First sample of a sensor's step of 8 A: (R T / 2 + L) 8 A / T = 1.04 V; then R 8 A = 0.48 V."""
    rng = np.random.default_rng(seed)
    print("seed", seed)
    for shape, first, later in (
        (onset.AT_ONCE, 1.04, 0.48),
        (onset.DELAYED, rng.uniform(0, 1), 1.0),
        (onset.UNSEEN, 1.35, 1.0),  # what may be either is neither (study, seeds 100020 and 100021)
    ):
        s = zeros(1, onset.State)
        begin = onset.RING + 30 + int(rng.integers(0, 150))
        for k in range(begin + 40):
            size = 0.0 if k < begin else first if k == begin else later
            a, b = rng.normal(0, 0.04, 2)
            onset.keep(s[0], size * np.cos(direction) + a, size * np.sin(direction) + b)
        assert onset.shape(s[0]) == shape


def test_noise_alone_names_neither():
    s = zeros(1, onset.State)
    for _ in range(100):
        onset.keep(s[0], 0.0, 0.0)
    assert onset.shape(s[0]) == onset.UNKNOWN  # too little was kept


def gear(**options):
    c, s = zeros(1, kinematics.Const), zeros(1, kinematics.State)
    for name, value in {
        "motor_ratio": 20.0, "wheel_ratio": 1.0, "age_ns": 20_000_000, "leak": 2.0, **options
    }.items():  # fmt: skip
        c[0][name] = value
    return s[0], c[0]


@given(st.integers(0, 40), st.floats(-90, 90), st.floats(-3, 3))
def test_angles_are_compared_at_one_time(late_ms, rate, off):
    """Motor and pinion on straight lines, frames of 2 ms; the wheel's angle is of any moment between them."""
    s, c = gear()
    wheel = 30.0
    for k in range(40):
        motor = 20.0 * rate * 0.002 * k
        kinematics.keep(s, 2_000_000 * k, motor, motor / 20.0 + wheel - off)
    at = 78_000_000 - 1_000_000 * late_ms
    assert kinematics.fit(s, c, at, wheel, 0.0)
    assert s["parity"] == pytest.approx(off, abs=1e-9)


def test_what_lies_too_far_off_is_not_compared():
    s, c = gear()
    assert not kinematics.fit(s, c, 0, 0.0, 0.0)
    for k in range(40):
        kinematics.keep(s, 2_000_000 * k, 0.0, 0.0)
    assert kinematics.fit(s, c, 90_000_000, 0.0, 0.0)
    assert not kinematics.fit(s, c, 100_000_000, 0.0, 0.0)  # nothing newer for more than 20 ms
    assert not kinematics.fit(s, c, 2_000_000, 0.0, 0.0)  # forgotten


def test_the_wheel_s_rate_is_its_witness():
    s, c = gear()
    for k in range(200):
        kinematics.follow(s, c, 10_000_000 * k, 0.5 * k, 50.0)
    assert abs(s["wheel"]) < 1e-9
    kinematics.follow(s, c, 2_000_000_000, 101.0, 50.0)
    assert s["wheel"] == pytest.approx(1.0, rel=1e-6)


@pytest.mark.parametrize(("wheel_off", "pinion_off"), [(1.2, 0.0), (0.0, 1.2), (1.2, 1.2), (1.2, -0.9)])
def test_by_the_wheel_s_rate_the_gear_says_what_is_off_beside_the_wheel(wheel_off, pinion_off):
    s, c = gear(age_ns=20_000_000)
    for k in range(60):
        at = 10_000_000 * k
        off = [one * (k >= 30) for one in (wheel_off, pinion_off)]
        kinematics.keep(s, at - 1_000_000, 0.0, 0.5 * k + off[1])
        kinematics.keep(s, at + 1_000_000, 0.0, 0.5 * k + off[1])
        kinematics.follow(s, c, at, 0.5 * k + off[0], 50.0)
        assert kinematics.fit(s, c, at, 0.5 * k + off[0], 0.0)
    assert s["sure"] == pytest.approx(wheel_off - pinion_off, abs=1e-9)
    assert s["others"] == pytest.approx(-pinion_off, abs=1e-9)


def ratio(**options):
    c, s = zeros(1, road_wheel.Const), zeros(1, road_wheel.State)
    road_wheel.prepare(c[0], Ratio(**options))
    return s[0], c[0]


@given(st.floats(-45, 45), st.floats(0, 2))
def test_the_road_wheel_is_the_inverse_of_the_gear(road, cubic):
    """(2): pinion = F_SG(road wheel)."""
    _, c = ratio(gear=14.0, cubic=cubic)
    x = np.radians(road)
    assert road_wheel.road_wheel(c, np.degrees(14.0 * x * (1 + cubic * x * x))) == pytest.approx(road, abs=1e-6)


def test_the_ratio_lies_on_straight_lines():
    _, c = ratio(speed=(0.0, 60.0, 120.0), ratio=(12.0, 15.0, 18.0))
    speeds = (0, 30, 60, 90, 150)
    assert [road_wheel.overall_ratio(c, v) for v in speeds] == [12.0, 13.5, 15.0, 16.5, 18.0]


def test_a_wheel_that_does_not_follow_its_ratio_is_off():
    s, c = ratio()
    for _ in range(100):
        tested = road_wheel.check(s, c, 14.0 * 2.0, 30.0, 60.0)  # pinion for 2 deg; 30 deg / 15
    assert tested
    assert abs(s["off"]) < 1e-9
    for _ in range(100):
        road_wheel.check(s, c, 14.0 * 4.0, 30.0, 60.0)
    assert s["off"] == pytest.approx(2.0, abs=1e-3)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"speed": (0.0, 60.0), "ratio": (12.0, 13.0, 14.0)}, "2 speeds, but 3 ratios"),
        ({"speed": (60.0, 0.0), "ratio": (12.0, 13.0)}, "the speeds must rise"),
        ({"speed": (0.0, 60.0), "ratio": (12.0, -1.0)}, "ratios are positive"),
        ({"speed": tuple(map(float, range(9))), "ratio": (1.0,) * 9}, "at most 8 speeds"),
    ],
)
def test_ratios_that_cannot_be(options, said):
    with pytest.raises(ValidationError, match=said):
        Ratio(**options)


def test_periods_of_ten_milliseconds_are_refused():
    with pytest.raises(ValidationError, match="less than or equal to 5"):
        Params(period_ms=10.0)


def test_thresholds_grow_with_the_period_unless_they_are_given():
    short, long = Thresholds().at(1.0), Thresholds().at(5.0)
    assert short[0] == 0.03
    assert long[0] == pytest.approx(0.03 * 5**0.6)
    assert long[2:] == short[2:]
    assert Thresholds(jump=0.05).at(5.0)[0] == 0.05


def test_each_fault_has_a_dtc_of_its_own():
    assert len({fault.dtc for fault in FAULTS}) == len(FAULTS)

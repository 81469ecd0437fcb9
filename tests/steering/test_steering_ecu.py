"""The steering ECU: physics of its plant, what its frames carry, its faults."""

import crccheck
import numpy as np
import pytest
from amount import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from gateway.config.load import load_config
from gateway.signals.database import load_database
from gateway_bench.vecu.contract import Run, Truth
from gateway_bench.vecu.player import Player
from gateway_bench.vecu.scenario import load_scenario
from gateway_fdi.common.resources import shipped
from gateway_fdi.errors import InputErrors
from gateway_fdi.filters.motor import Motor
from gateway_fdi.jit import COMPILED
from gateway_plants.steering.ecu.column import Column, pinion, sampled
from gateway_plants.steering.ecu.controller import CONTROL
from gateway_plants.steering.ecu.course import driving, sweep, times
from gateway_plants.steering.ecu.ecu import ECU
from gateway_plants.steering.ecu.faults import KINDS, SteeringFault, bursts, disturb, falsify
from gateway_plants.steering.ecu.params import SteeringParams
from gateway_plants.steering.ecu.plant import Plant, drive, undisturbed

compiled = pytest.mark.skipif(not COMPILED, reason="a plant at 50 kHz")
#: Without noise: what comes out is physics.
SILENT = Plant(angle_noise=0.0, angle_bits=0, current_noise=0.0, current_bits=0, voltage_noise=0.0)


def frames_of(duration=1.0, seed=1, faults=(), **options):
    params = SteeringParams(type="steering", **options)
    rng = np.random.default_rng(seed)
    return ECU.frames(params, faults, Run(duration, 0, rng))


def turning(speed, load, seconds=1.0, plant=SILENT):
    t = times(seconds)
    rng = np.random.default_rng(0)
    return drive(plant, speed * t, np.full_like(t, load), undisturbed(len(t)), rng)


@compiled
@pytest.mark.parametrize(("speed", "load"), [(60.0, 0.3), (-90.0, -0.2), (20.0, 1.0)])
def test_a_steady_turn_obeys_voltages_and_power(speed, load):
    """(12) to (14) in steady state: currents, voltages, and power in = heat + shaft."""
    x, m = turning(speed, load)[-200:], Motor()
    assert x["omega"].mean() == pytest.approx(speed, rel=0.01)
    omega = x["omega"].mean()
    torque = load + m.friction * omega + 0.02 * np.sign(omega)
    i_q, i_d = x["i_q"].mean(), x["i_d"].mean()
    assert i_q == pytest.approx(torque / m.torque, rel=0.02)
    u_q = m.resistance * i_q + m.pole_pairs * omega * (m.flux + m.ld * i_d)
    u_d = m.resistance * i_d - m.pole_pairs * omega * m.lq * i_q
    assert x["u_q"].mean() == pytest.approx(u_q, rel=0.02)
    assert x["u_d"].mean() == pytest.approx(u_d, abs=0.03)
    power = 1.5 * np.mean(x["u_d"] * x["i_d"] + x["u_q"] * x["i_q"])
    heat = 1.5 * m.resistance * (i_q**2 + i_d**2)
    assert power == pytest.approx(heat + torque * omega, rel=0.02)


@compiled
def test_a_wrong_angle_is_followed_by_the_motor():
    """The loop is closed through the sensor: it reads what is asked, and the motor is elsewhere."""
    t = times(2.0)
    wrong = undisturbed(len(t))
    fault = SteeringFault(kind="motor_angle_offset", from_s=1.0, size=0.1)
    disturb(wrong, fault, np.random.default_rng(0))
    x = drive(SILENT, np.zeros_like(t), np.zeros_like(t), wrong, np.random.default_rng(0))
    assert abs(x["theta"][900]) < 1e-3
    assert x["sensor"][-1] == pytest.approx(0.0, abs=2e-3)
    assert x["theta"][-1] == pytest.approx(-0.1, abs=2e-3)


@compiled
def test_the_same_seed_gives_the_same_frames_and_another_gives_others():
    one, again, other = frames_of(0.3), frames_of(0.3), frames_of(0.3, seed=2)
    np.testing.assert_array_equal(one[0], again[0])
    assert (one[0]["data"] != other[0]["data"]).any()


@compiled
def test_frames_carry_what_the_database_says_with_counters_and_checksums():
    frames, _ = frames_of(0.5)
    database = load_database([shipped("dbc/steering.dbc")])
    crc_of = {
        "AFS_MotCur": "cur",
        "AFS_MotVol": "vol",
        "AFS_Angle": "ang",
        "SAS_Angle": "sas",
        "ESC_Speed": "v",
    }
    periods = {"AFS_MotCur": 1, "AFS_MotVol": 1, "AFS_Angle": 2, "SAS_Angle": 10, "ESC_Speed": 20}
    assert (np.diff(frames["t_ns"]) >= 0).all()
    for name, short in crc_of.items():
        message = database.message(name)
        mine = frames[frames["can_id"] == message.frame_id]
        assert len(mine) in (500 // periods[name], 500 // periods[name] - 1)
        counters = []
        for frame in mine:
            data = bytes(frame["data"][:8])
            values = message.decode(data, decode_choices=False)
            counters.append(int(values[f"MC_{short}"]))
            suffix = bytes([message.frame_id & 0xFF, message.frame_id >> 8])
            assert data[7] == crccheck.crc.Crc8SaeJ1850.calc(data[:7] + suffix)
        assert counters == [(k + 1) % 16 for k in range(len(counters))]
        gaps = np.diff(mine["t_ns"].astype(np.int64)) / 1e6
        np.testing.assert_allclose(gaps, periods[name], atol=0.2)


@compiled
def test_currents_and_voltages_of_one_counter_belong_together():
    frames, _ = frames_of(0.5)
    currents = frames[frames["can_id"] == 0x120]["t_ns"].astype(np.int64)
    voltages = frames[frames["can_id"] == 0x121]["t_ns"].astype(np.int64)
    n = min(len(currents), len(voltages))
    after = (voltages[:n] - currents[:n]) / 1e6
    assert (after > 0.0).all()
    assert (after < 0.3).all()
    late, truth = frames_of(0.5, late_voltage=(0.2, 0.3))
    assert truth == [Truth(200_000_000, "late_voltage", 100)]
    again = late[late["can_id"] == 0x121]["t_ns"].astype(np.int64)
    moved = (again - voltages[: len(again)]) / 1e6
    assert np.isclose(moved, 1.0, atol=0.2).sum() in range(98, 102)


@compiled
@pytest.mark.parametrize("kind", KINDS)
def test_every_fault_changes_its_own_message_from_its_time_on(kind):
    size = {"motor_angle_scale": 0.5, "current_gain": 0.5, "voltage_gain": -0.5}.get(kind, 1.0)
    fault = SteeringFault(kind=kind, from_s=1.0, size=size)
    frames, truth = frames_of(1.5, faults=(fault,), speed=((0.0, 5.0),))
    clean, none = frames_of(1.5, speed=((0.0, 5.0),))
    changed = (frames["data"] != clean["data"]).any(axis=1)
    assert not changed[frames["t_ns"] < 990_000_000].any()
    where = set(frames["can_id"][changed])
    own = {"motor": 0x120, "curre": 0x120, "volta": 0x121, "wheel": 0x0C4, "pinio": 0x122}[kind[:5]]
    assert own in where
    if kind.startswith(("wheel", "pinion")):
        assert where == {own}
    assert truth[0].kind == kind
    assert truth[0].t_ns == 1_000_000_000
    assert none == []


@settings(max_examples=examples(20), deadline=None)
@given(st.floats(0.0, 2.0), st.integers(0, 2**31))
def test_lash_is_passed_through(lash, seed):
    rng = np.random.default_rng(seed)
    column = Column(lash=lash)
    theta, wheel = np.cumsum(rng.normal(0, 0.1, 300)), np.cumsum(rng.normal(0, 1, 300))
    ideal = np.degrees(theta) / column.motor_ratio + wheel / column.wheel_ratio
    assert np.abs(pinion(column, theta, wheel) - ideal).max() <= lash / 2 + 1e-9


def test_sensors_sample_with_their_delay():
    t = times(0.1)
    told = sampled(100.0 * t, 10e-3, 0.1, 5e-3)
    np.testing.assert_allclose(told, 100.0 * (0.01 * np.arange(1, 11) - 0.005), atol=0.051)
    fault = SteeringFault(kind="wheel_angle_stuck", from_s=0.05)
    assert falsify(t, fault, "wheel")[-1] == pytest.approx(0.05)
    assert falsify(t, fault, "pinion") is t


def test_bursts_are_short_and_apart():
    hit = bursts(100_000, np.random.default_rng(0))
    edges = np.flatnonzero(np.diff(hit.astype(int)))
    assert hit[0]
    assert hit.sum() * CONTROL == pytest.approx(10 * 0.1, rel=0.3)
    assert np.diff(edges).min() >= 50


def test_courses_are_smooth_and_as_told():
    t = times(24.0)
    course = sweep(t, 2.0)
    speed = np.diff(course.motor) / CONTROL
    assert 85 < np.abs(speed).max() < 135
    assert course.load.max() == pytest.approx(1.0)
    assert course.load.min() == pytest.approx(-1.2)
    drive_course = driving(
        t,
        ((0.0, 50.0),),
        ((0.0, 10.0), (100.0, 20.0)),
        14.0,
        0.0,
        20.0,
        1.0,
        np.random.default_rng(1),
    )
    road = drive_course.wheel / 15.0  # (3)
    pinion_asked = np.degrees(drive_course.motor) / 20.0 + drive_course.wheel
    np.testing.assert_allclose(pinion_asked, 14.0 * road, atol=1e-9)  # (1), (2)


def test_errors_name_what_is_wrong(tmp_path):
    text = shipped("scenarios/steering_healthy.toml").read_text()
    bad = tmp_path / "bad.toml"
    bad.write_text(text.replace('type = "steering"', 'type = "steering"\nperiod_ms = 3\nspeed = [[1, 2], [0, 3]]'))
    with pytest.raises(InputErrors) as caught:
        load_scenario(bad)
    assert "period_ms" in str(caught.value)
    bad.write_text(text + '\n[[fault]]\nkind = "impulses"\necu = "steering"\n')
    with pytest.raises(Exception, match="is of type steering: it has no impulses"):
        load_scenario(bad)
    with pytest.raises(ValidationError, match="first numbers of the points of speed must rise"):
        SteeringParams(type="steering", speed=((1.0, 2.0), (0.0, 3.0)))
    with pytest.raises(ValidationError, match="to_s must lie after"):
        SteeringFault(kind="current_offset", from_s=2.0, to_s=1.0)


@compiled
def test_a_scenario_plays_the_same_twice():
    scenario = load_scenario(shipped("scenarios/steering_healthy.toml"))
    config = load_config(scenario.config)
    buses = {bus.name: k for k, bus in enumerate(config.bus)}
    short = scenario.model_copy(update={"duration_s": 0.5})
    np.testing.assert_array_equal(Player(short, buses).frames, Player(short, buses).frames)

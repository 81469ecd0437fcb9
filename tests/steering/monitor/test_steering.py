"""The steering monitor on a simulated steering: what it names, and what it does not."""

from functools import cache

import numpy as np
import pytest
from pydantic import ValidationError

from gateway.monitors.contract import FAILED
from gateway_fdi.jit import COMPILED, zeros
from gateway_plants.steering.ecu.faults import SteeringFault
from gateway_plants.steering.ecu.plant import Plant
from gateway_plants.steering.monitor import MONITOR, monitor
from gateway_plants.steering.monitor.faults import FAULTS, PAIRING
from gateway_plants.steering.monitor.monitor import DEGRADED, INVALID, MEASURED, REPLACED
from gateway_plants.steering.monitor.params import Params, Thresholds
from gateway_plants.steering.study.cases import Spread
from gateway_plants.steering.study.follow import ROW, Run, follow, make, samples_of

compiled = pytest.mark.skipif(not COMPILED, reason="24 s of a drive at 10 kHz")
NAMES = [fault.name for fault in FAULTS]
UNSURE = {"angles", "electric", "motor_angle_implausible"}


@cache
def run(kind="", size=0.0, begin=9.0, end=None, seed=0, period=1e-3):
    rng = np.random.default_rng([2026, seed])
    plant, scale = Spread(resistance=(0.95, 1.05)).draw(rng)
    faults = (SteeringFault(kind=kind, size=size, from_s=begin, to_s=end),) if kind else ()
    return make(plant, scale, faults, rng, period=period)


def params(**options):
    return Params(resistance_error=0.15, temperature=False, **options)


def named(followed, period=1e-3):
    """Return what was reported as failed: name -> time [s]."""
    return {NAMES[k]: (followed.first[k] + 1) * period for k in np.flatnonzero(followed.first >= 0)}


@compiled
@pytest.mark.parametrize("seed", range(6))
def test_nothing_is_found_where_nothing_is_wrong(seed):
    followed = follow(run(seed=seed), params())
    assert named(followed) == {}
    limits = np.array(Thresholds().at(1.0))
    assert (followed.peaks < 0.9 * limits).all(), followed.peaks / limits


@compiled
@pytest.mark.parametrize("begin", [7.3, 9.0, 20.1])
@pytest.mark.parametrize(
    ("kind", "size", "within"),
    [
        ("motor_angle_offset", 0.1, 0.1),
        ("motor_angle_offset", 0.35, 0.1),
        ("motor_angle_stuck", 0.0, 0.1),
        ("motor_angle_noise", 0.02, 0.1),
        ("motor_angle_intermittent", 0.2, 0.1),
        ("motor_angle_drift", 0.2, 3.0),
    ],
)
def test_the_motor_angle_s_faults_are_named_and_heal(kind, size, within, begin):
    followed = follow(run(kind, size, begin, begin + 1.2), params())
    found = named(followed)
    assert set(found) - UNSURE == {kind}, found
    assert begin <= found[kind] <= begin + within
    if kind == "motor_angle_drift":
        assert found["angles"] <= begin + 0.6  # the wheel's age is still being learned
    assert (followed.found[-300:] == -1).all()


@compiled
@pytest.mark.parametrize(
    ("kind", "size", "name", "within"),
    [
        ("wheel_angle_offset", 1.0, "wheel_angle", 0.1),
        ("wheel_angle_drift", -1.0, "wheel_angle", 1.0),
        ("pinion_angle_offset", -1.0, "pinion_angle", 0.5),
        ("pinion_angle_drift", 1.0, "pinion_angle", 1.0),
        ("pinion_angle_stuck", 0.0, "pinion_angle", 0.5),
        ("current_offset", 8.0, "current", 0.1),
        ("current_frozen", 0.0, "current", 0.2),
        ("voltage_offset", 1.0, "voltage", 0.1),
    ],
)
def test_the_other_parts_are_told_apart(kind, size, name, within):
    followed = follow(run(kind, size, 9.0, 11.0), params())
    found = named(followed)
    assert set(found) - UNSURE == {name}, found
    assert found[name] <= 9.0 + within


@compiled
def test_a_scale_error_is_named_once_the_motor_turns():
    found = named(follow(run("motor_angle_scale", 0.02, 7.6), params()))
    assert set(found) - UNSURE == {"motor_angle_scale"}, found


@compiled
def test_a_drift_at_rest_belongs_to_one_of_three_angles_until_the_motor_turns():
    """12.5 s: rest, then creep: the EMF says nothing."""
    followed = follow(run("motor_angle_drift", 0.2, 12.5, 14.0), params())
    found = named(followed)
    assert found["angles"] < 12.9
    assert "pinion_angle" not in found
    assert "wheel_angle" not in found


@compiled
def test_the_angle_is_replaced_when_its_sensor_fails():
    made = run("motor_angle_offset", 0.35, 9.0, 10.0)
    sent = walk(made.inputs)
    k = np.arange(9101, 9900, 2)  # where a frame with the pinion has just come
    off = np.radians(sent["value"][k]) - made.theta[k]
    assert (sent["quality"][k] == REPLACED).all()
    assert np.abs(off).max() < 0.15  # of the gear's lash and the sensors' steps, 20 times
    assert np.abs(np.radians(made.inputs["delta_m"][k]) - made.theta[k]).min() > 0.3
    assert sent["quality"][5000] == MEASURED


def walk(inputs, p=None):
    """Step the monitor through inputs; returns what it sends and the faults it reports as failed."""
    p = p or params()
    s, c, out = (zeros(1, dtype) for dtype in (MONITOR.state, MONITOR.const, MONITOR.results))
    MONITOR.prepare(p, s[0], c[0])
    u, rows = samples_of(inputs, p)
    failed = {}
    value, quality = np.zeros(len(inputs)), np.zeros(len(inputs), int)
    for k, row in enumerate(rows):
        out[0]["n"] = 0
        out[0]["send"] = 0
        monitor.step(s[0], c[0], u[k], out[0])
        for r in out[0]["results"][: out[0]["n"]]:
            if r["result"] == FAILED:
                failed.setdefault(NAMES[r["fault"]], []).append(row)
        value[row], quality[row] = out[0]["values"][0], out[0]["values"][2]
    return {"value": value, "quality": quality, "failed": failed, "state": s[0]}


def apart(inputs):
    """Return the inputs as two events a period: first the current's frame and the angles, then the voltage's."""
    two = np.repeat(inputs, 2)
    voltage = ["u_sd_mean", "u_sq_mean", "mc_vol", "t_wdg"]
    for name in voltage:
        two[name][2::2] = two[name][1:-2:2]
    two["mc_vol"][0] = 15
    two["t_ns"][1::2] += 150_000
    return two


@compiled
def test_frames_that_come_one_after_the_other_are_paired_by_their_counters():
    made = run(seed=1)
    got = walk(apart(made.inputs[:4000]))
    assert got["failed"] == {}
    assert got["state"]["pairs"] == 4000


@compiled
def test_voltages_one_frame_late_are_told_by_the_counters_and_blamed_on_nobody_else():
    """At 88 rad/s, where a voltage of the wrong frame would look like a fault of everything."""
    inputs = apart(run(seed=1).inputs[:11000])
    late = inputs.copy()
    for name in ("u_sd_mean", "u_sq_mean", "mc_vol"):
        late[name][18001:20000:2] = inputs[name][17999:19998:2]
        late[name][18002:20001:2] = late[name][18001:20000:2]
    got = walk(late)
    assert set(got["failed"]) == {"pairing"}, {k: v[0] for k, v in got["failed"].items()}
    assert min(got["failed"]["pairing"]) in range(18000, 18004)
    assert max(got["failed"]["pairing"]) < 20004
    assert got["state"]["pairs"] > 10980  # each voltage found its current, but for 16 that came earlier than expected
    assert NAMES[PAIRING] == "pairing"


@compiled
@pytest.mark.parametrize("seed", range(3))
def test_lost_frames_are_no_fault_of_a_sensor(seed):
    """Two in a hundred pairs of motor frames, and one gap of 50 ms."""
    made = run(seed=2)
    rng = np.random.default_rng(seed)
    print("seed", seed)
    u = made.inputs.copy()
    lost = rng.random(len(u)) < 0.02
    lost[9400:9450] = True
    for k in np.flatnonzero(lost[1:]) + 1:
        for name in ("i_u", "i_v", "theta_park", "mc_cur", "u_sd_mean", "u_sq_mean", "mc_vol"):
            u[name][k] = u[name][k - 1]
    assert named(follow(Run(u, made.theta, made.omega, made.samples), params())) == {}


@compiled
def test_a_wheel_s_frame_that_is_late_on_the_bus_is_no_fault():
    """Now and then one comes a millisecond late while the wheel turns with 250 deg/s: 0.25 deg off."""
    made = run(seed=2)
    rng = np.random.default_rng(7)
    u = made.inputs.copy()
    for k in range(9, len(u) - 1, 30):
        if rng.random() < 0.5:
            for name in ("delta_s", "delta_s_dot", "mc_sas"):
                u[name][k] = u[name][k - 1]
    followed = follow(Run(u, made.theta, made.omega, made.samples), params())
    assert named(followed) == {}
    assert np.nanmax(np.abs(followed.trace[:, 2])) < 0.15  # it is dated by its message's period


@compiled
def test_without_the_other_angles_the_motor_s_is_watched_all_the_same():
    made = run("motor_angle_offset", 0.35, 9.0, 10.0)
    u = made.inputs.copy()
    for name in (
        "delta_m",
        "delta_g",
        "mc_ang",
        "valid_ang",
        "delta_s",
        "delta_s_dot",
        "mc_sas",
        "valid_sas",
    ):
        u[name] = np.nan
    found = named(follow(Run(u, made.theta, made.omega, made.samples), params()))
    assert set(found) == {"motor_angle_offset"}
    assert 9.0 < found["motor_angle_offset"] < 9.1


@compiled
def test_invalid_samples_are_not_looked_at():
    made = run("motor_angle_noise", 0.3, 9.0, 10.0)
    u = made.inputs.copy()
    for name in ("valid_cur", "valid_ang"):
        u[name][8990:10010] = 0.0
    found = named(follow(Run(u, made.theta, made.omega, made.samples), params()))
    assert found == {}


@compiled
def test_a_sensor_without_noise_that_rests_is_not_stuck_and_one_that_does_not_turn_is():
    rng = np.random.default_rng(3)
    quiet = Plant(angle_noise=0.0)
    assert named(follow(make(quiet, 1.0, (), rng), params())) == {}
    stuck = SteeringFault(kind="motor_angle_stuck", from_s=9.0, to_s=9.2)
    found = named(follow(make(quiet, 1.0, (stuck,), rng), params()))
    assert found["motor_angle_stuck"] < 9.1


@compiled
def test_the_winding_s_temperature_explains_its_resistance():
    """120 degC: 39 % more resistance."""
    hot = Plant(motor=type(Plant().motor)(resistance=0.06 * 1.39))
    made = make(hot, 1.3, (), np.random.default_rng(4), celsius=120.0)
    known = follow(made, Params(resistance_error=0.1))
    unknown = follow(made, Params(resistance_error=0.1, temperature=False))
    assert named(known) == {}
    assert named(unknown) != {}
    assert known.peaks[4] < 0.5 * unknown.peaks[4]


@compiled
@pytest.mark.parametrize("period", [2e-3, 5e-3])
def test_longer_periods_are_usable(period):
    p = params(period_ms=1e3 * period)
    assert named(follow(run(seed=3, period=period), p)) == {}
    found = named(follow(run("motor_angle_offset", 0.35, 9.0, 10.0, period=period), p), period)
    assert set(found) - UNSURE == {"motor_angle_offset"}
    assert found["motor_angle_offset"] < 9.1
    late = walk(run(seed=3, period=period).inputs[:400], p)
    assert late["quality"][-1] == (DEGRADED if period == 5e-3 else MEASURED)


def test_five_milliseconds_are_degraded_and_that_is_said():
    assert MONITOR.warnings(params(period_ms=2.0)) == ()
    assert "degraded" in MONITOR.warnings(params(period_ms=5.0))[0]


def still(n, rng):
    """Return inputs of a motor at rest, frames of 1 ms."""
    u = np.zeros(n, ROW)
    k = np.arange(n)
    u["t_ns"] = (k + 1) * 1_000_000
    u["i_u"], u["i_v"] = rng.normal(0, 0.2, (2, n))
    u["theta_park"] = rng.integers(0, 3, n) * 0.35
    u["mc_cur"] = u["mc_vol"] = k % 16
    u["mc_ang"], u["mc_sas"] = (k // 2) % 16, (k // 10) % 16
    for name in ("valid_cur", "valid_ang", "valid_sas", "valid_v"):
        u[name] = 1.0
    u["t_wdg"] = 20.0
    return u


@pytest.mark.long
def test_a_motor_at_rest_is_healthy_and_one_that_jumps_is_not():
    rng = np.random.default_rng(6)
    u = still(800, rng)
    p = params()
    assert walk(u[:450], p)["failed"] == {}
    u["theta_park"][600:] += 60.0
    u["delta_m"][600:] += 15.0
    failed = walk(u, p)["failed"]
    assert set(failed) == {"motor_angle_offset"}
    assert 600 < failed["motor_angle_offset"][0] < 660


def test_the_paper_s_estimators_say_where_they_are():
    with pytest.raises(ValidationError, match="compare = True: the paper's estimators are in the study"):
        params(compare=True)


def test_a_silent_bus_makes_the_angle_invalid():
    s, c, out = (zeros(1, dtype) for dtype in (MONITOR.state, MONITOR.const, MONITOR.results))
    MONITOR.prepare(params(), s[0], c[0])
    u, _ = samples_of(still(1, np.random.default_rng(0)), params())
    monitor.step(s[0], c[0], u[0], out[0])
    assert out[0]["wake_ns"] == 51_000_000
    u[0]["trigger"] = -1
    monitor.step(s[0], c[0], u[0], out[0])
    assert out[0]["send"] == 1
    assert out[0]["values"][2] == INVALID

"""Vans of one fleet: learned of three healthy drives of a minute and a half, judged on others with everyday faults."""

import struct

import numpy as np
import pytest
from learning import as_before, asked, quiet

from gateway.bus.frames import empty
from gateway.bus.logs import LogReader, open_writer
from gateway.config.load import load_config
from gateway_bench.wire.replay import through
from gateway_fleet.learn.learn import learn, write
from gateway_replay.channels import channels_of

SECONDS = 90.0
DBC = """VERSION ""
NS_ :
BS_:
BU_: Motor Brakes Body Tester
BO_ 257 MotorStatus: 8 Motor
 SG_ Rpm : 0|16@1+ (0.25,0) [0|8000] "rpm" Tester
 SG_ Torque : 16|16@1- (0.1,0) [-500|500] "Nm" Tester
BO_ 288 WheelSpeed: 8 Brakes
 SG_ FL : 0|16@1+ (0.01,0) [0|300] "km/h" Tester
 SG_ FR : 16|16@1+ (0.01,0) [0|300] "km/h" Tester
 SG_ RL : 32|16@1+ (0.01,0) [0|300] "km/h" Tester
 SG_ RR : 48|16@1+ (0.01,0) [0|300] "km/h" Tester
BO_ 320 VehicleSpeed: 4 Body
 SG_ Speed : 0|16@1+ (0.01,0) [0|300] "km/h" Tester
BO_ 512 Coolant: 4 Motor
 SG_ Temp : 0|8@1+ (1,-40) [-40|150] "degC" Tester
BO_ 544 Battery: 6 Body
 SG_ Volt : 0|16@1+ (0.01,0) [0|30] "V" Tester
"""


def wander(rng, seconds, step_s, over_s, low, high):
    """A course that goes to and fro between two ends."""
    knots = rng.uniform(low, high, int(seconds / over_s) + 4)
    t = np.arange(round(seconds / step_s)) * step_s
    return np.interp(t, np.arange(len(knots)) * over_s, knots)


def van(path, seed, fault="", seconds=SECONDS):
    """Write a drive of a van; half of the drive is with its fault."""
    rng = np.random.default_rng(seed)
    step, half = 0.02, 0.5 * seconds
    count = round(seconds / step)
    t = np.arange(count) * step
    speed = np.convolve(wander(rng, seconds, step, 6.0, -10.0, 95.0), np.ones(75) / 75, "same").clip(0.0)
    bend = np.convolve(wander(rng, seconds, step, 4.0, -1.0, 1.0), np.ones(75) / 75, "same")
    scale = rng.normal(1.0, 0.004, 4)  # tyres
    wheels = [speed * scale[k] * (1.0 + 0.01 * bend * (-1) ** k) + rng.normal(0, 0.06, count) for k in range(4)]
    wheels[0] += 8.0 * ((fault == "wheel") & (t > half))
    told = speed + rng.normal(0, 0.05, count)
    if fault == "speed":
        told[t > half] = told[t <= half][-1]
    gear = 1.0 + np.floor((speed + 1.0) / 20.0)
    rpm = 800.0 + 2200.0 * (speed / (20.0 * gear)) + rng.normal(0, 8, count)
    coolant = np.full(count, 138.0) if fault == "coolant" else wander(rng, seconds, step, 20.0, 84.0, 93.0)
    volt = np.full(count, 9.6) if fault == "battery" else wander(rng, seconds, step, 5.0, 13.75, 14.05)
    volt = volt + rng.normal(0, 0.02, count)
    torque = np.gradient(np.convolve(speed, np.ones(50) / 50, "same"), step) * 30.0 + rng.normal(0, 3, count)

    def at(k):
        yield 257, struct.pack("<Hhi", round(rpm[k] * 4), round(torque[k] * 10), 0), True
        lives = fault != "brakes" or t[k] < half
        yield 288, struct.pack("<4H", *(max(round(100 * wheel[k]), 0) for wheel in wheels)), lives
        yield 320, struct.pack("<HH", max(round(told[k] * 100), 0), 0), k % 2 == 0
        yield 512, bytes([round(coolant[k]) + 40, 0, 0, 0]), k % 50 == 0
        yield 544, struct.pack("<HI", round(volt[k] * 100), 0), k % 5 == 0

    sent = [(t[k], can_id, data) for k in range(count) for can_id, data, comes in at(k) if comes]
    frames = empty(len(sent))
    frames["t_ns"] = [1_000_000_000_000 + round(when * 1e9) + 200_000 * (n % 5) for n, (when, _, _) in enumerate(sent)]
    frames["can_id"] = [can_id for _, can_id, _ in sent]
    frames["length"] = [len(data) for _, _, data in sent]
    for n, (_, _, data) in enumerate(sent):
        frames["data"][n, : len(data)] = list(data)
    with open_writer(path) as writer:
        writer.write(frames[np.argsort(frames["t_ns"], kind="stable")])
    return path


@pytest.fixture(scope="module")
def fleet(tmp_path_factory):
    folder = tmp_path_factory.mktemp("vans")
    (folder / "van.dbc").write_text(DBC)
    logs = [van(folder / f"healthy{seed}.log", seed) for seed in (1, 2, 3)]
    result = learn(asked(folder / "van.toml", *logs, databases=(folder / "van.dbc",)), quiet)
    assert result.alarms == ()
    write(result.files(folder / "van.toml"))
    as_before("van.toml", (folder / "van.toml").read_text(), folder)
    return folder


def codes(fleet, seed, fault=""):
    log = van(fleet / f"van{seed}{fault}.log", seed, fault)
    config = load_config(fleet / "van.toml")
    said = through(config, list(LogReader(log, channels_of(config, ()))))
    return {name for _, name, failed in said.dtcs if failed}


@pytest.mark.parametrize(
    ("fault", "code"),
    [
        ("wheel", "WheelSpeed_FL_by"),
        ("coolant", "Temp.high"),
        ("battery", "Volt.low"),
        ("brakes", "WheelSpeed.timeout"),
        ("speed", "Speed"),
    ],
)
def test_a_fault_of_a_van_is_found(fleet, fault, code):
    found = codes(fleet, 11, fault)
    assert any(code in name for name in found), (fault, found)


@pytest.mark.parametrize("seed", [21, 22])
def test_a_healthy_van_is_silent(fleet, seed):
    assert codes(fleet, seed) == set(), f"seed {seed}"

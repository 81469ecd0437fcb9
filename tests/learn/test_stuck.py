"""Logs of ten minutes and more teach how long a signal may rest; a shorter one does not."""

import math
import random

import pytest
from learning import as_before, asked, drive, quiet

from gateway.bus.logs import LogReader
from gateway.config.load import load_config
from gateway_bench.wire.replay import through
from gateway_fleet.learn.learn import learn, write
from gateway_fleet.learn.lines import SIGNAL
from gateway_replay.channels import channels_of

DBC = (
    'VERSION ""\nNS_ :\nBS_:\nBU_: A\nBO_ 256 Pedal: 8 A\n SG_ Travel : 0|16@1+ (0.1,0) [0|6553.5] "mm" A\n'
    ' SG_ Fixed : 16|8@1+ (1,0) [0|255] "" A\n'
)
#: Longest rest [s], each some seconds; between two rests it wanders.
REST, PERIOD = 2.0, 0.1


def wandering(seconds, seed, frozen=(1e9, 1e9), at=None):
    """One message: a travel that wanders and rests, held from and to [s] (or put at), and a value that never moves."""
    rng = random.Random(seed)
    values, resting = [1000], 0
    for k in range(round(seconds / PERIOD)):
        if resting == 0 and rng.random() < 0.02:
            resting = round(rng.uniform(0.5, REST) / PERIOD)
        resting = max(resting - 1, 0)
        still = resting > 0 or frozen[0] <= k * PERIOD < frozen[1]
        step = 0 if still else rng.choice((-3, -2, -1, 1, 2, 3))
        values.append(min(max(values[-1] + step, 10), 6000))
    if at is not None:
        first, last = (round(t / PERIOD) for t in frozen)
        values[first:last] = [at] * (last - first)
    return [(256, PERIOD, lambda k: bytes([values[k] & 0xFF, values[k] >> 8, 7, 0, 0, 0, 0, 0]), 0.0)]


def learned(folder, seconds, seed):
    """Learn of one log; returns the file and the lines of its signals."""
    (folder / "car.dbc").write_text(DBC)
    log = drive(folder / "drive.log", seconds, wandering(seconds, seed))
    result = learn(asked(folder / "car.toml", log, databases=(folder / "car.dbc",)), quiet)
    assert result.alarms == ()
    write(result.files(folder / "car.toml"))
    as_before(f"stuck{seed}.toml", (folder / "car.toml").read_text(), folder)
    lines = {place[2]: line for place, line in result.learned.lines.items() if place[1] == SIGNAL}
    return folder / "car.toml", lines


def alarms(config, log):
    """Return (seconds, fault) of each fault that a log sets."""
    config = load_config(config)
    said = through(config, list(LogReader(log, channels_of(config, ()))))
    return [(t - 1000.0, fault) for t, fault, failed in said.dtcs if failed]


@pytest.mark.parametrize("seed", [11, 12])
def test_a_signal_that_rests_for_seconds_is_stuck_when_it_rests_for_much_longer(tmp_path, seed):
    print("seed", seed)
    config, lines = learned(tmp_path, 900.0, seed)
    keys = lines["Pedal.Travel"].keys
    limit = keys["stuck"]["seconds"]
    assert 10.0 * 0.5 * REST <= limit <= 12.0 * (REST + PERIOD), "ten times the longest rest that it has seen"
    assert "at rest for" in lines["Pedal.Travel"].why
    assert "Pedal.Fixed" not in lines or "stuck" not in lines["Pedal.Fixed"].keys, "it never moves"
    fresh = drive(tmp_path / "fresh.log", 120.0, wandering(120.0, seed + 100))
    assert alarms(config, fresh) == [], "another drive of the same kind"
    held = drive(tmp_path / "held.log", 120.0, wandering(120.0, seed + 100, (40.0, 40.0 + limit + 15.0)))
    (alarm,) = alarms(config, held)
    assert alarm[1].endswith("Travel.stuck")
    assert 40.0 + limit - 1.0 - REST < alarm[0] < 40.0 + limit + 2.0
    short = drive(tmp_path / "short.log", 120.0, wandering(120.0, seed + 100, (40.0, 40.0 + 0.5 * limit)))
    assert alarms(config, short) == [], "half of it is none"
    for end in (0, 65535):
        at_end = drive(tmp_path / "end.log", 120.0, wandering(120.0, seed + 100, (40.0, 100.0), end))
        assert not [fault for _, fault in alarms(config, at_end) if fault.endswith("stuck")], "saturated, or at rest"


def test_less_than_ten_minutes_teach_no_rest(tmp_path):
    _, lines = learned(tmp_path, 590.0, 13)
    assert "stuck" not in lines["Pedal.Travel"].keys


def test_a_signal_that_moves_far_less_than_its_value_has_a_place_where_it_must_move(tmp_path):
    (tmp_path / "car.dbc").write_text(
        'VERSION ""\nNS_ :\nBS_:\nBU_: A\nBO_ 256 Air: 8 A\n SG_ Pressure : 0|24@1+ (0.001,0) [0|16777] "hPa" A\n'
        ' SG_ Mode : 24|8@1+ (1,0) [0|1] "" A\n'
    )
    rng = random.Random(14)
    raw = [
        (1013_400 + rng.randrange(-60, 61)).to_bytes(3, "little") + bytes([rng.randrange(2), 0, 0, 0, 0])
        for _ in range(2001)
    ]
    log = drive(tmp_path / "drive.log", 60.0, [(256, 0.03, raw.__getitem__, 0.0)])
    result = learn(asked(tmp_path / "car.toml", log, databases=(tmp_path / "car.dbc",)), quiet)
    write(result.files(tmp_path / "car.toml"))
    load_config(tmp_path / "car.toml")
    lines = {place[2]: line.keys for place, line in result.learned.lines.items() if place[1] == SIGNAL}
    low, high = lines["Air.Pressure"]["stuck"]["inside"]
    assert (1013.3 < low < 1013.35, 1013.45 < high < 1013.5) == (True, True)
    assert "stuck" not in lines.get("Air.Mode", {}), "nothing lies between 0 and 1"


@pytest.mark.parametrize(("seconds", "moves", "asked_for"), [(40, 1.0, True), (40, 0.8, False), (80, 0.8, True)])
def test_half_a_minute_does_not_teach_how_often_a_signal_rests_where_nothing_says_when(
    tmp_path, seconds, moves, asked_for
):
    """A torque idles as the pedal rests: no signal says how fast the car is, and three tenths are held out."""
    (tmp_path / "car.dbc").write_text(
        'VERSION ""\nNS_ :\nBS_:\nBU_: A\nBO_ 256 Engine: 8 A\n SG_ Torque : 0|16@1+ (1,0) [0|65535] "Nm" A\n'
    )
    rng, raw = random.Random(15), [1500]
    for _ in range(50 * seconds + 1):
        raw.append(raw[-1] + (rng.random() < moves) * (1 if rng.random() < (3000 - raw[-1]) / 3000 else -1))
    frames = [(256, 0.02, lambda k: raw[k].to_bytes(2, "little") + bytes(6), 0.0)]
    log = drive(tmp_path / "drive.log", float(seconds), frames)
    result = learn(asked(tmp_path / "car.toml", log, databases=(tmp_path / "car.dbc",)), quiet)
    lines = {place[2]: line.keys for place, line in result.learned.lines.items() if place[1] == SIGNAL}
    assert ("share" in lines.get("Engine.Torque", {}).get("stuck", {})) == asked_for


@pytest.mark.parametrize(("signed", "asked_for"), [("-", True), ("+", False)])
def test_a_wheel_that_turns_farther_than_any_has_the_wrong_sign_and_no_limit_by_grip(tmp_path, signed, asked_for):
    """An angle around zero that the database calls unsigned is 6553 degrees: times the speed it is any curve."""
    (tmp_path / "car.dbc").write_text(
        'VERSION ""\nNS_ :\nBS_:\nBU_: A\nBO_ 256 Steer: 8 A\n'
        f' SG_ SteeringAngle : 0|16@1{signed} (0.1,0) [0|0] "deg" A\n'
        'BO_ 257 Move: 8 A\n SG_ Speed : 0|16@1+ (0.01,0) [0|655] "km/h" A\n'
    )
    angle = [round(80 * math.sin(k / 90.0)) for k in range(3001)]
    speed = [round(4000 + 1500 * math.sin(k / 210.0)) for k in range(3001)]
    frames = [
        (256, 0.02, lambda k: angle[k].to_bytes(2, "little", signed=True) + bytes(6), 0.0),
        (257, 0.02, lambda k: speed[k].to_bytes(2, "little") + bytes(6), 0.0),
    ]
    log = drive(tmp_path / "drive.log", 60.0, frames)
    result = learn(asked(tmp_path / "car.toml", log, databases=(tmp_path / "car.dbc",)), quiet)
    assert any(line.name.endswith("_by_grip") for line in result.learned.lines.values()) == asked_for


@pytest.mark.parametrize(("lasts_s", "told"), [(1.8, False), (4.0, True)])
def test_an_ecu_that_has_just_started_may_have_no_value_for_some_seconds(tmp_path, lasts_s, told):
    """The learning drive began later: it shows no code that stands for none."""
    (tmp_path / "car.dbc").write_text(
        'VERSION ""\nNS_ :\nBS_:\nBU_: A\nBO_ 256 Body: 8 A\n SG_ Crash : 0|2@1+ (1,0) [0|3] "" A\n'
        'VAL_ 256 Crash 3 "Invalid" 2 "Cut" 1 "Deploy" 0 "None" ;\n'
    )
    log = drive(tmp_path / "drive.log", 40.0, [(256, 0.02, lambda _: bytes(8), 0.0)])
    result = learn(asked(tmp_path / "car.toml", log, databases=(tmp_path / "car.dbc",)), quiet)
    write(result.files(tmp_path / "car.toml"))
    started = drive(
        tmp_path / "on.log", 20.0, [(256, 0.02, lambda k: bytes([3 * (k * 0.02 < lasts_s)] + [0] * 7), 0.0)]
    )
    assert [fault for _, fault in alarms(tmp_path / "car.toml", started)] == ["Crash.invalid"] * told

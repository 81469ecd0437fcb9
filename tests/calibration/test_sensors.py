"""What healthy logs say of a pedal's channels, put into its configuration; logs that do not tell are refused."""

import json
import re

import numpy as np
import pytest
from typer.testing import CliRunner

from gateway.bus.logs import open_writer
from gateway.cli import app
from gateway.config.load import load_config
from gateway.config.monitor_types import monitor_of
from gateway_bench.wire.channel_model import road
from gateway_fdi.errors import InputError
from gateway_fdi.jit import COMPILED
from gateway_plants.pedal.monitor.channel_estimates import found
from gateway_plants.pedal.monitor.params import PairParams
from gateway_plants.pedal.study.outside import faults as cases
from gateway_plants.pedal.study.outside import sensors
from gateway_plants.pedal.study.outside.foot import driving, points

pytestmark = [pytest.mark.long, pytest.mark.skipif(not COMPILED, reason="minutes of samples each 1 ms")]

SEED = 1_780_000
SECONDS = 75.0

CONFIG = f"""
[[bus]]
name = "can0"
uri = "loopback:127.0.0.1:29555"
database = ["{sensors.DBC}"]

[[monitor]]
name = "brake"
type = "redundant_pair"  # of the pedal
noise_mV = 2.0

[fault."brake.drift"]
dtc = "P157C-28"
"""


def log(path, plant, travel, rng, **way):
    """Write a drive as a log; ``way``: what happens to its frames."""
    with open_writer(path) as writer:
        writer.write(road(sensors.frames(plant, sensors.readings(plant, travel, rng)), rng, **way))
    return path


def calibrate(*arguments):
    return CliRunner().invoke(app, ["calibrate", *(str(argument) for argument in arguments)])


@pytest.fixture(scope="module")
def drive():
    """Sensors of 4 mV with errors of slope and offset, the second behind a filter of 6 ms; their readings."""
    rng = np.random.default_rng(SEED)
    plant = sensors.brake(0.004, (0.0, 6.0), rng=rng)
    return plant, driving(SECONDS, rng), rng


def test_the_command_measures_and_writes(tmp_path, drive):
    print("seed", SEED)
    plant, travel, rng = drive
    healthy = log(tmp_path / "drive.log", plant, travel, rng)
    config = tmp_path / "c.toml"
    config.write_text(CONFIG)
    shown = calibrate(config, healthy, "--json")
    assert shown.exit_code == 0, shown.output
    assert config.read_text() == CONFIG, "nothing is written unasked"
    said = json.loads(shown.stdout)
    fleet = calibrate(config, healthy, "--parts", tmp_path / "parts", "--workers", 0, "--json")
    assert json.loads(fleet.stdout)["sensors"] == said["sensors"], "kept readings are those of the log"
    rows = {name: (told, value, sd) for name, told, value, sd in said["sensors"][0]["rows"]}
    for k in range(2):
        told, value, sd = rows[f"channel[{k}].noise"]
        assert told == 0.002
        assert value == pytest.approx(0.004, rel=0.08)
        assert 0.0 < sd < 0.001
        assert rows[f"channel[{k}].resolution"][1] == pytest.approx(5 / 4096, rel=0.02)
    assert rows["channel[0] lag [ms]"][1] == pytest.approx(0.0, abs=0.5)
    assert rows["channel[1] lag [ms]"][1] == pytest.approx(6.0, abs=0.5)
    # Against the mean of both, what they differ by has the half of it on either side.
    one, other = plant.sensors
    slope, offset = 50.0 * (one.gain - other.gain), 12.5 * (one.offset + other.offset)
    assert rows["channel[0] slope, error [%]"][1] == pytest.approx(slope, abs=0.03)
    assert rows["channel[1] slope, error [%]"][1] == pytest.approx(-slope, abs=0.03)
    assert rows["channel[0] offset at rest [%]"][1] == pytest.approx(offset, abs=0.02)
    assert said["failed"] == []

    shown = calibrate(config, healthy, "--write")
    assert shown.exit_code == 0, shown.output
    assert "lag [ms]" in shown.output, "units are no markup"
    text = config.read_text()
    assert "# of the pedal" in text
    assert "noise_mV" not in text, "it would be said twice"
    (entry,) = load_config(config).monitor
    _, params = monitor_of(entry)
    assert [c.noise for c in params.channels] == pytest.approx([0.004, 0.004], rel=0.08)
    assert params.channels[1].at_rest == 4.5, "what it does not tell is the preset's"
    assert 6.0 < params.lag_ms <= 12.0
    assert params.calibrated.startswith("75 s of healthy logs, sha256 ")
    again = calibrate(config, healthy, "--write")
    assert again.exit_code == 0, again.output
    anew = monitor_of(load_config(config).monitor[0])[1]
    assert [c.noise for c in anew.channels] == pytest.approx([c.noise for c in params.channels], rel=0.08)


def test_frames_that_are_lost_or_late_or_swapped_change_nothing(tmp_path, drive):
    print("seed", SEED + 5)
    plant, travel, _ = drive
    config, said = tmp_path / "c.toml", []
    config.write_text(CONFIG)
    for way in ({}, {"loss": 0.05, "stamps_ms": 0.3, "reorder": 0.02}):
        drove = log(tmp_path / "drive.log", plant, travel, np.random.default_rng(SEED + 5), **way)
        shown = calibrate(config, drove, "--json")
        assert shown.exit_code == 0, shown.output
        said.append({name: value for name, _, value, _ in json.loads(shown.stdout)["sensors"][0]["rows"]})
    whole, lossy = said
    for name in ("channel[0].noise", "channel[1].noise", "tolerance", "gain_error", "lag_ms"):
        assert lossy[name] == pytest.approx(whole[name], rel=0.05), name


def test_what_it_sets_is_silent_on_a_fresh_drive_and_sees_a_fault_sooner(drive):
    plant, travel, rng = drive
    keys = found(PairParams(), [sensors.readings(plant, travel, rng)]).keys
    said = cases.healthy(lambda _: plant, 0.03, SEED + 1, **keys)
    assert said.set == []
    told, begin = cases.faulty("drift 0.1 %/s", SEED + 2, plant=lambda _: plant, seconds=40.0)
    sure, _ = cases.faulty("drift 0.1 %/s", SEED + 2, plant=lambda _: plant, seconds=40.0, **keys)
    assert sure.at("drift") is not None
    assert begin < sure.at("drift") < (told.at("drift") or np.inf)


@pytest.mark.parametrize(
    ("what", "key", "says"),
    [
        ("rests", "tolerance", "do not tell offsets and slopes"),
        ("short", "period_ms", "3 are needed, 60 s"),
        ("slow", "lag_ms", "do not tell the lag"),
        ("short circuit", "channel[0]", "not healthy"),
        ("filter", "lag_ms", "lags"),
        ("another pedal", "channel", "at_rest"),
    ],
)
def test_logs_that_do_not_tell_are_refused_with_the_key(what, key, says):
    rng = np.random.default_rng(SEED + 10)
    plant, travel, faults = sensors.brake(rng=rng), driving(65.0, rng), ()
    if what == "rests":
        travel = 0.5 + 0.02 * (travel - 0.5)
    if what == "short":
        travel = travel[:45_000]
    if what == "slow":
        travel = points(65.0, (0, 0.05), (30, 0.9), (65, 0.05))
    if what == "short circuit":
        faults = (sensors.level(0, 30.0, 0.0, end_s=31.0),)
    if what == "filter":
        plant = sensors.brake(lag=(15.0, 0.0))
    if what == "another pedal":
        plant = sensors.Plant((sensors.Sensor(2.6, 3.0), sensors.Sensor(4.5, 0.5)))
    volts = sensors.readings(plant, travel, rng, faults=faults)
    with pytest.raises(InputError) as error:
        found(PairParams(), [volts])

    assert error.value.key == key
    assert re.search(says, error.value.message), error.value.message


def test_the_command_names_file_and_key(tmp_path):
    rng = np.random.default_rng(SEED + 20)
    rests = log(tmp_path / "rest.log", sensors.brake(rng=rng), np.full(62_000, 0.3), rng)
    config = tmp_path / "c.toml"
    config.write_text(CONFIG)
    shown = calibrate(config, rests, "--write")
    assert shown.exit_code != 0
    assert isinstance(shown.exception, InputError)
    assert str(config) in str(shown.exception)
    assert 'monitor[0].tolerance: of "brake"' in str(shown.exception)
    assert config.read_text() == CONFIG

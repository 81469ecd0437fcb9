"""nu and J of CUSUM tests from healthy logs, beside cantools and a CUSUM written out in NumPy."""

import json

import cantools
import numpy as np
import pytest
from fleet_command import needs_fleet
from typer.testing import CliRunner

from gateway.bus.logs import open_writer
from gateway.cli import app
from gateway.config.load import load_config
from gateway.config.monitor_types import monitor_of
from gateway_calibration.cusum import learn
from gateway_calibration.file import write
from gateway_calibration.logs import Reading, digest
from gateway_fdi.common.resources import shipped
from gateway_fdi.errors import InputError
from gateway_fdi.jit import COMPILED
from gateway_plants.truck.ecu.drive import drive
from gateway_plants.truck.ecu.ecu import frames_of
from gateway_plants.truck.ecu.params import TruckFault, TruckParams
from gateway_plants.truck.monitor.params import QUANTITIES

compiled = pytest.mark.skipif(not COMPILED, reason="tens of thousands of frames")
SECONDS = 90.0


def log(path, truck, seed, fault=None):
    faults = () if fault is None else (TruckFault(kind=fault),)
    frames = frames_of(truck, drive(truck, faults, SECONDS), bus=0, rng=np.random.default_rng(seed))
    writer = open_writer(path)
    writer.write(frames)
    writer.close()
    return path


@pytest.fixture(scope="module")
def truck():
    return TruckParams(type="truck", start_s=175.0, noise_factor=3.0)


@pytest.fixture(scope="module")
def healthy(tmp_path_factory, truck):
    """Two healthy drives with three times the noise, and a configuration of one's own."""
    folder = tmp_path_factory.mktemp("truck")
    logs = [log(folder / f"{seed}.log", truck, seed) for seed in (1, 2)]
    config = folder / "truck.toml"
    text = shipped("configs/truck.toml").read_text()
    config.write_text(text)
    return config, logs


def by_hand(logs):
    """nu of T1 and, with it, its largest T in units of nu: cantools decodes, NumPy adds up."""
    database = cantools.database.load_file(shipped("dbc/truck.dbc"))
    drives = []
    for path in logs:
        asked, measured = [], []
        for line in path.read_text().splitlines():
            number, data = line.split()[2].split("#")
            if number == "110":
                asked.append(database.decode_message(0x110, bytes.fromhex(data))["U_em_ctrl"])
            elif number == "100":
                measured.append(database.decode_message(0x100, bytes.fromhex(data))["U_em_sens"])
        asked, measured = np.array(asked), np.array(measured)
        used = np.maximum(np.abs(asked), np.abs(measured)) >= 20.0
        drives.append(np.abs(asked - measured)[used])
    every = np.concatenate(drives)
    nu = every.mean() + every.std()
    largest = 0.0
    for r in drives:
        t = 0.0
        for x in r:
            t = max(0.0, t + x - nu)
            largest = max(largest, t / nu)
    return nu, largest


@pytest.mark.long
@compiled
def test_nu_and_the_largest_t_are_those_of_a_cusum_by_hand(healthy, tmp_path):
    """Sensors are taken as they are: nothing is followed."""
    followed, logs = healthy
    path = tmp_path / "truck.toml"
    kind = 'type = "hybrid_powertrain"'
    path.write_text(followed.read_text().replace(kind, f"{kind}\nfollow = false"))
    found = learn(load_config(path), logs, Reading(path), margin=0.4, floor=2.0)
    (t1,) = (row for row in found.rows if row.name == "T1")
    nu, largest = by_hand(logs)
    assert t1.nu == pytest.approx(nu, rel=1e-9)
    assert t1.largest == pytest.approx(largest, rel=1e-9)
    assert t1.threshold == pytest.approx(max(largest, 2.0) / 0.4)
    assert t1.floored == (largest < 2.0)
    assert t1.margin <= 0.4 + 1e-12
    assert found.seconds == pytest.approx(2 * SECONDS, abs=0.1)


@compiled
def test_the_noise_is_learned_and_what_was_too_low_is_told(healthy):
    """Three times the noise: nu is as much larger, and the configuration's thresholds alarm in these healthy logs."""
    path, logs = healthy
    config = load_config(path)
    found = learn(config, logs, Reading(path))
    assert [row.name for row in found.rows] == [*QUANTITIES, "T7"]
    for row in found.rows:
        if row.residual:
            # T5 has what is learned of resistance and torque constant from so noisy a speed in it, too.
            assert row.nu == pytest.approx(3.0 * row.nu_now, rel=0.2 if row.residual == "T5" else 0.1)
            assert row.threshold >= 50.0
        assert 0.0 <= row.margin <= 0.5
    assert "P1A1F-62" in found.failed


@needs_fleet
@pytest.mark.long
@compiled
def test_they_are_written_and_the_diagnosis_works_with_them(healthy, truck, tmp_path):
    path, logs = healthy
    config = tmp_path / "mine.toml"
    config.write_text(path.read_text())
    said = CliRunner().invoke(app, ["calibrate", str(config), *map(str, logs), "--write", "--json"])
    assert said.exit_code == 0, said.output
    told = json.loads(said.stdout)
    assert told["data"] == digest(logs)
    assert told["written"]
    assert told["margin"] == 0.5
    rows = {row["name"]: row for row in told["cusum"]}
    params = monitor_of(load_config(config).monitor[0])[1]
    nu, threshold = params.nu.T2, params.thresholds.T2
    assert nu == pytest.approx(rows["T2"]["nu"], rel=1e-3)
    assert threshold == pytest.approx(rows["T2"]["threshold"], rel=1e-3)
    assert digest(logs) in params.calibrated
    assert "margin 0.5" in params.calibrated
    kept = [line for line in path.read_text().splitlines() if line not in config.read_text()]
    assert kept == []
    third = log(tmp_path / "3.log", truck, 3)
    assert learn(load_config(config), [third], Reading(config)).failed == ()
    faulty = log(tmp_path / "4.log", truck, 4, "battery_short")
    assert "P1A10-01" in learn(load_config(config), [faulty], Reading(config)).failed


@needs_fleet
@compiled
def test_the_command_states_the_margin(healthy):
    path, logs = healthy
    said = CliRunner().invoke(app, ["calibrate", str(path), *map(str, logs)], env={"COLUMNS": "200"})
    assert said.exit_code == 0, said.output
    assert "With these thresholds no test fires in them: the largest healthy T is 0." in said.output
    assert "0.5 at most was asked for" in said.output
    assert "These logs set P1A" in said.output
    assert "The floor of 25 nu decides for" in said.output


@compiled
def test_a_log_of_something_else_is_refused(healthy, tmp_path):
    path, _ = healthy
    other = tmp_path / "other.log"
    other.write_text("(1.000000) can0 7FF#00\n(2.000000) can0 7FF#00\n")
    with pytest.raises(InputError, match="nothing that monitor"):
        learn(load_config(path), [other], Reading(path))


def test_a_configuration_without_cusum_tests_is_refused(tmp_path):
    path = shipped("configs/steering.toml")
    with pytest.raises(InputError, match="no monitor here has CUSUM tests"):
        learn(load_config(path), [tmp_path / "none.log"], Reading(path))


@needs_fleet
def test_the_command_refuses_a_configuration_without_thresholds(tmp_path):
    (tmp_path / "a.log").write_text("(1.000000) can0 123#00\n")
    said = CliRunner().invoke(app, ["calibrate", str(shipped("configs/diagnostics.toml")), str(tmp_path / "a.log")])
    assert said.exit_code != 0
    assert "no monitor here has thresholds that logs can set" in str(said.exception)


def test_only_the_monitors_found_are_written(tmp_path):
    path = tmp_path / "two.toml"
    path.write_text('# mine\n[[monitor]]\nname = "a"\n\n[[monitor]]\nname = "b"  # other\n')
    write(path, {"b": {"nu": {"T1": 1.23456}}}, "source")
    assert path.read_text() == (
        '# mine\n[[monitor]]\nname = "a"\n\n[[monitor]]\nname = "b"  # other\n'
        'nu = {T1 = 1.235}\ncalibrated = "source"\n'
    )

"""Thresholds from healthy logs."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from fleet_command import needs_fleet
from hypothesis import given
from hypothesis import strategies as st

from gateway.bus.logs import open_writer
from gateway.config.load import load_config
from gateway.config.monitor_types import monitor_of
from gateway_bench.vecu.player import Player
from gateway_bench.vecu.scenario import load_scenario
from gateway_calibration.file import write
from gateway_calibration.logs import Reading, digest
from gateway_calibration.stopping import alarms, calibrate, levels, propose, tables
from gateway_fdi.common.resources import shipped
from gateway_fdi.errors import InputError
from gateway_fdi.jit import COMPILED
from gateway_fdi.stopping import assured

compiled = pytest.mark.skipif(not COMPILED, reason="a plant at 50 kHz")


def test_alarms_are_counted_once_while_they_last():
    maxima = np.array([0, 2, 2, 0, 3, 0, 0, 2.5])
    assert alarms(maxima, 2.0) == 3
    assert alarms(maxima, 2.6) == 1
    assert alarms(maxima, 5.0) == 0
    assert alarms(np.array([4.0, 4.0]), 1.0) == 1


@given(st.integers(0, 2**31), st.floats(20, 900))
def test_the_logs_themselves_have_no_more_alarms_than_asked_for(seed, target):
    rng = np.random.default_rng(seed)
    maxima = rng.exponential(1.0, 1000)
    threshold = propose(maxima, 1000.0, target)
    assert alarms(maxima, threshold) <= 1000 / target


def test_a_target_beyond_the_data_is_continued_from_the_tail():
    """Exponential maxima: the level that is reached once in a target is known, log(target / block)."""
    rng = np.random.default_rng(1)
    maxima = rng.exponential(1.0, 2000)
    for target in (1e4, 1e6):
        assert propose(maxima, 2000.0, target) == pytest.approx(np.log(target), rel=0.15)
    assert propose(maxima, 2000.0, 1e4) >= maxima.max()


def test_a_symptom_that_never_speaks_gets_no_threshold():
    assert propose(np.zeros(100), 100.0, 1000.0) == 0.0


def test_what_the_data_assure():
    assert assured(300.0, 0) == pytest.approx(100.0, rel=2e-3)


@pytest.fixture(scope="module")
def healthy(tmp_path_factory):
    """Two healthy drives, and a configuration of one's own."""
    folder = tmp_path_factory.mktemp("healthy")
    scenario = load_scenario(shipped("scenarios/steering_healthy.toml"))
    logs = []
    for seed in (1, 2):
        player = Player(scenario.model_copy(update={"duration_s": 8.0}), {"chassis": 0}, seed=seed)
        logs.append(folder / f"{seed}.log")
        writer = open_writer(logs[-1])
        writer.write(player.frames)
        writer.close()
    config = folder / "steering.toml"
    text = Path(scenario.config).read_text()
    config.write_text(text)
    return config, logs


@pytest.mark.long
@compiled
def test_healthy_drives_set_thresholds(healthy):
    path, logs = healthy
    config = load_config(path)
    seen = levels(config, logs, Reading(path))
    assert seen.seconds == 10.0  # of each 2 s are warm-up, and the last second is not whole
    assert seen.failed == ()
    rows = {row.symptom: row for row in calibrate(config, seen, 3600.0)}
    assert list(rows) == ["jump", "restless", "angle", "parity", "balance", "surprise", "rate"]
    for row in rows.values():
        assert row.alarms == 0
        assert row.alarms_now == 0
        assert row.largest < row.threshold or row.largest == 0.0
        assert row.beyond == pytest.approx(3600 * 7 / 10)
        assert row.assured_s == pytest.approx(10 / 2.996, rel=0.01)
    assert 0.003 < rows["jump"].threshold < 0.06


@pytest.mark.long
@compiled
def test_they_are_written_and_all_else_stays(healthy):
    path, logs = healthy
    config = load_config(path)
    before = path.read_text()
    rows = calibrate(config, levels(config, logs, Reading(path)), 600.0)
    write(path, tables(rows), f"sha256 {digest(logs)}")
    after = path.read_text()
    assert "# steering wheel over road wheel, as the controller makes it" in after
    assert [line for line in before.splitlines() if line not in after.splitlines()] == []
    params = monitor_of(load_config(path).monitor[0])[1]
    assert params.calibrated == f"sha256 {digest(logs)}"
    assert params.thresholds.jump == pytest.approx(rows[0].threshold, rel=1e-3)
    path.write_text(before)


@needs_fleet
@pytest.mark.long
@compiled
def test_the_command_says_how_far_the_data_carry(healthy):
    path, logs = healthy
    command = [
        str(Path(sys.executable).parent / "gateway"),
        "calibrate",
        str(path),
        *map(str, logs),
    ]
    said = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert "The logs hold 10 s" in said
    assert "lies beyond the data" in said
    assert "extrapolated" in said
    found = json.loads(
        subprocess.run([*command, "--mtfa", "2", "--json"], capture_output=True, text=True, check=True).stdout
    )
    assert found["assured_s"] == pytest.approx(10 / 2.996, rel=0.01)
    assert found["data"] == digest(logs)
    assert not found["written"]


def test_a_configuration_without_such_thresholds_is_refused(tmp_path):
    path = shipped("configs/pedal.toml")
    with pytest.raises(InputError, match="no monitor here has stopping rules"):
        levels(load_config(path), [tmp_path / "none.log"], Reading(path))


@compiled
def test_logs_that_are_too_short_are_refused(healthy, tmp_path):
    path, _ = healthy
    log = tmp_path / "short.log"
    player = Player(
        load_scenario(shipped("scenarios/steering_healthy.toml")).model_copy(update={"duration_s": 1.0}),
        {"chassis": 0},
    )
    writer = open_writer(log)
    writer.write(player.frames)
    writer.close()
    with pytest.raises(InputError, match="less than 3 s"):
        levels(load_config(path), [log], Reading(path))

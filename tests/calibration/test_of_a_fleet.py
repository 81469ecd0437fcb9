"""``gateway calibrate --parts``: what workers find of a fleet's logs is what one process finds, and is found once."""

import json
from pathlib import Path

import dask
import distributed  # noqa: F401 - its settings are there before the test changes one
import numpy as np
import pyarrow.parquet as pq
import pytest
from linear import frames as linear
from linear.plants import SERVO, simulate
from typer.testing import CliRunner

from gateway.bus.logs import open_writer
from gateway.cli import app
from gateway_bench.vecu.player import Player
from gateway_bench.vecu.scenario import load_scenario
from gateway_calibration.part import Part, load, save
from gateway_fdi.common.resources import shipped
from gateway_fdi.errors import InputError, InputErrors
from gateway_fdi.jit import COMPILED
from gateway_plants.truck.ecu.drive import drive
from gateway_plants.truck.ecu.ecu import frames_of
from gateway_plants.truck.ecu.params import TruckParams

pytestmark = [pytest.mark.long, pytest.mark.skipif(not COMPILED, reason="tens of thousands of frames")]

SEED = 4_000_000


def written(path, frames):
    path.parent.mkdir(parents=True, exist_ok=True)
    with open_writer(path) as writer:
        writer.write(frames)
    return path


def truck_log(folder, seed):
    truck = TruckParams(type="truck", start_s=175.0, noise_factor=2.0)
    frames = frames_of(truck, drive(truck, (), 20.0), bus=0, rng=np.random.default_rng(SEED + seed))
    return written(folder / "logs" / f"car{seed % 2}" / f"{seed}.log", frames)


def shipped_config(folder, name):
    path = folder / f"{name}.toml"
    path.write_text(shipped(f"configs/{name}.toml").read_text())
    return path


def steering_log(folder, seed):
    scenario = load_scenario(shipped("scenarios/steering_healthy.toml"))
    player = Player(scenario.model_copy(update={"duration_s": 5.0}), {"chassis": 0}, seed=SEED + seed)
    return written(folder / "logs" / f"{seed}.log", player.frames)


def calibrate(*words):
    """Call the command; returns what it says, and its exit code."""
    ended = CliRunner().invoke(app, ["calibrate", *map(str, words), "--json"])
    if ended.exception is not None and not isinstance(ended.exception, SystemExit):
        raise ended.exception
    return json.loads(ended.stdout), ended.exit_code


def same(first, second):
    """Check that two calibrations say the same, to the last bit."""
    strip = ("data", "logs", "left_out", "written")
    one, other = ({k: v for k, v in said.items() if k not in strip} for said in (first, second))
    assert json.dumps(one) == json.dumps(other)


@pytest.fixture
def trucks(tmp_path):
    """Four healthy drives of two trucks, and a configuration."""
    for seed in range(4):
        truck_log(tmp_path, seed)
    return tmp_path, shipped_config(tmp_path, "truck")


def test_cusum_tests(trucks):
    """A log that is damaged, one that is empty and a copy are left out; a second run reads nothing, a new log once."""
    folder, config = trucks
    serial, _ = calibrate(config, folder / "logs")
    fleet, code = calibrate(config, folder / "logs", "--parts", folder / "parts", "--workers", "0")
    same(serial, fleet)
    assert (code, fleet["logs"], fleet["left_out"]) == (0, 4, [])
    car = folder / "logs" / "car0"
    (car / "damaged.log").write_bytes((car / "0.log").read_bytes()[:5000] + b"\nnonsense\n")
    (car / "empty.log").write_bytes(b"")
    (car / "zcopy.log").write_bytes((car / "0.log").read_bytes())
    (car / "gone.log").symlink_to(car / "nowhere.log")
    more, code = calibrate(config, str(folder / "logs" / "**"), "--parts", folder / "parts", "--workers", "0")
    same(serial, more)
    assert code == 2, "gone.log may be there another time"
    kinds = {Path(row["path"]).name: row["kind"] for row in more["left_out"]}
    assert kinds == {"damaged.log": "damaged", "empty.log": "empty", "zcopy.log": "copy", "gone.log": "unreadable"}
    told = pq.read_table(folder / "parts" / "errors" / "errors.parquet").to_pylist()
    assert {Path(row["path"]).name: row["kind"] for row in told} == kinds
    assert "damaged.log:" in next(row["text"] for row in told if row["kind"] == "damaged")
    with pytest.raises((InputError, InputErrors), match=r"damaged\.log|empty\.log|gone\.log"):
        calibrate(config, folder / "logs")


def test_what_is_known_is_not_read_again(trucks):
    folder, config = trucks
    words = ["calibrate", str(config), str(folder / "logs"), "--parts", str(folder / "parts"), "--workers", "0"]
    assert "4 logs, 4 of them read now, 0 left out" in CliRunner().invoke(app, words).output
    assert "4 logs, 0 of them read now, 0 left out" in CliRunner().invoke(app, words).output
    truck_log(folder, 4)
    steps = CliRunner().invoke(app, [*words, "--write-to", str(folder / "new.toml")])
    # nu is that of five logs now: the largest T of each is another one.
    assert "5 logs, 5 of them read now, 0 left out" in steps.output
    sums = list((folder / "parts" / "sums").glob("*.npz"))
    assert len(sums) == 5
    assert "calibrated" in (folder / "new.toml").read_text()
    assert "calibrated" not in config.read_text()
    serial, _ = calibrate(config, folder / "logs")
    fleet, _ = calibrate(*words[1:])
    same(serial, fleet)
    with pytest.raises(InputError, match=r"--write-to = .*beside the configuration"):
        calibrate(*words[1:], "--write-to", folder / "elsewhere" / "new.toml")


@pytest.mark.system
@pytest.mark.full("13 s: fleet/test_workers.py kills those of a run")
def test_by_workers_of_which_one_is_killed(trucks):
    folder, config = trucks
    (folder / "kill.py").write_text(
        "import os, signal\n"
        "from gateway_fleet.fleet import healthy\n"
        "asked = getattr(healthy, 'before', healthy._part)\n"
        "healthy.before = asked\n"
        "def poisoned(ask, *rest):\n"
        "    if ask.recording.path.name == 'poison.log':\n"
        "        os.kill(os.getpid(), signal.SIGKILL)\n"
        "    return asked(ask, *rest)\n"
        "healthy._part = poisoned\n"
    )
    serial, _ = calibrate(config, folder / "logs")
    poison = folder / "logs" / "car1" / "poison.log"
    poison.write_bytes((folder / "logs" / "car1" / "1.log").read_bytes() + b"\n")
    with dask.config.set({"distributed.worker.preload": [str(folder / "kill.py")]}):
        fleet, code = calibrate(config, folder / "logs", "--parts", folder / "parts", "--workers", "2")
    same(serial, fleet)
    assert code == 2
    assert [(Path(row["path"]).name, row["kind"]) for row in fleet["left_out"]] == [("poison.log", "killed")]


def test_stopping_rules_and_only_the_new_log_is_read(tmp_path):
    config = shipped_config(tmp_path, "steering")
    for seed in (1, 2):
        steering_log(tmp_path, seed)
    words = [config, tmp_path / "logs", "--parts", tmp_path / "parts", "--workers", "0"]
    calibrate(*words)
    steering_log(tmp_path, 3)
    ended = CliRunner().invoke(app, ["calibrate", *map(str, words)])
    assert "3 logs, 1 of them read now, 0 left out" in ended.output, ended.output
    fleet, _ = calibrate(*words)
    serial, _ = calibrate(config, tmp_path / "logs")
    same(serial, fleet)
    assert len(fleet["rows"]) == 7


def test_plants_go_from_log_to_log(tmp_path):
    rng = np.random.default_rng(SEED)
    a, b = SERVO.wrong(0.05, rng)
    config = linear.configuration(tmp_path, SERVO, a, b, extra="model_error = 0.2")
    (tmp_path / "logs").mkdir()
    for k in range(2):
        linear.written(tmp_path / "logs" / f"{k}.log", linear.encode(SERVO, *simulate(SERVO, 15.0, rng)))
    serial, _ = calibrate(config, tmp_path / "logs", "--write-to", tmp_path / "serial.toml")
    words = [config, tmp_path / "logs", "--parts", tmp_path / "parts", "--workers", "0"]
    fleet, _ = calibrate(*words, "--write-to", tmp_path / "fleet.toml")
    same(serial, fleet)
    assert len(fleet["plants"][0]["fit"]) == 2
    written = [(tmp_path / f"{name}.toml").read_text().split("sha256")[0] for name in ("serial", "fleet")]
    assert written[0] == written[1]
    linear.written(tmp_path / "logs" / "2.log", linear.encode(SERVO, *simulate(SERVO, 15.0, rng)))
    ended = CliRunner().invoke(app, ["calibrate", *map(str, words)])
    assert "3 logs, 1 of them read now, 0 left out" in ended.output, ended.output


def test_parts_are_kept_to_the_last_bit(tmp_path):
    rng = np.random.default_rng(SEED)
    part = Part(0.1 + 0.2, ("P0001-00",), {"a b": rng.normal(size=(3, 4)), "": np.zeros((0, 2))}, {"rows": [1, 2]})
    save(tmp_path / "of" / "p.npz", part)
    again = load(tmp_path / "of" / "p.npz")
    assert (again.seconds, again.failed, again.facts) == (part.seconds, part.failed, part.facts)
    assert again.arrays.keys() == part.arrays.keys()
    for name, array in part.arrays.items():
        np.testing.assert_array_equal(again.arrays[name], array)
    whole = (tmp_path / "of" / "p.npz").read_bytes()
    for cut in (0, 10, len(whole) // 2, len(whole) - 1):
        (tmp_path / "of" / "p.npz").write_bytes(whole[:cut])
        assert load(tmp_path / "of" / "p.npz") is None, "found again, not believed"
    assert load(tmp_path / "none.npz") is None


def test_mistakes(trucks):
    folder, config = trucks
    with pytest.raises(InputError, match="goes with --parts"):
        calibrate(config, folder / "logs", "--workers", "2")
    with pytest.raises(InputError, match="a scheduler has workers of its own"):
        calibrate(
            config, folder / "logs", "--parts", folder / "p", "--workers", "2", "--scheduler", "tcp://127.0.0.1:1"
        )
    (folder / "none").mkdir()
    (folder / "none" / "a.log").write_bytes(b"")
    with pytest.raises(InputError, match="of no log anything is to be learnt; empty: .*no frame in this log"):
        calibrate(config, folder / "none", "--parts", folder / "p", "--workers", "0")

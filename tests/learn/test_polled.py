"""A car that is only asked: J1979 values at their rate have limits and relations, and everyday faults are found."""

import numpy as np
import pytest
from learning import drive, quiet

from gateway.config.load import load_config
from gateway.config.resolve import answer_buses
from gateway.runtime.assemble import prepare
from gateway_bench.wire.replay import through
from gateway_calibration.logs import read_answered
from gateway_fleet.learn.car import Asking, asked_for, learned

SECONDS = 900
ECU = """
[[bus]]
name = "obd"
uri = "socketcan:can0"

[[ecu]]
name = "engine"
bus = "obd"
request = 0x7E0
response = 0x7E8
read = [
    { pid = 0x05, every_ms = 1000 }, { pid = 0x0C, every_ms = 1000 }, { pid = 0x0D, every_ms = 1000 },
    { pid = 0x42, every_ms = 1000 },
]
"""


def values(seed, fault=""):
    """Coolant [degC], engine speed [rpm], speed [km/h] and supply [V] of each second; wrong from the half on."""
    rng = np.random.default_rng(seed)
    knots = rng.uniform(15.0, 110.0, SECONDS // 12 + 3)
    speed = np.interp(np.arange(SECONDS), 12 * np.arange(len(knots)), knots)
    found = {
        0x05: 88.0 + 4.0 * np.sin(np.arange(SECONDS) / 40.0) + rng.uniform(-0.5, 0.5, SECONDS),
        0x0C: 28.0 * speed + rng.normal(0, 4, SECONDS),
        0x0D: speed,
        0x42: rng.normal(13.9, 0.05, SECONDS),
    }
    late = np.arange(SECONDS) > SECONDS // 2
    wrong = {
        "coolant": (0x05, 150.0),
        "rpm": (0x0C, 9000.0),
        "supply": (0x42, 8.0),
        "stuck": (0x0D, speed[SECONDS // 2]),
    }
    if fault:
        pid, value = wrong[fault]
        found[pid] = np.where(late, value, found[pid])
    return found


SCALES = {0x05: (1, 1.0, 40.0), 0x0C: (2, 4.0, 0.0), 0x0D: (1, 1.0, 0.0), 0x42: (2, 1000.0, 0.0)}


def log(path, seed, fault=""):
    """Write what a tester asks each second, and what it is told."""
    found, sent = values(seed, fault), []
    for n, (pid, (size, factor, less)) in enumerate(SCALES.items()):
        raws = [round((value + less) * factor) for value in found[pid]]
        ask = bytes([2, 1, pid, 0, 0, 0, 0, 0])
        told = [bytes([2 + size, 0x41, pid, *raw.to_bytes(size, "big"), 0, 0, 0, 0])[:8] for raw in raws]
        sent.append((0x7E0, 1.0, lambda k, ask=ask: ask, 0.1 * n))
        sent.append((0x7E8, 1.0, lambda k, told=told: told[k], 0.1 * n + 0.02))
    return drive(path, SECONDS, sent)


@pytest.fixture(scope="module")
def car(tmp_path_factory):
    folder = tmp_path_factory.mktemp("polled")
    (folder / "ecu.toml").write_text(ECU)
    healthy = log(folder / "healthy.log", 1)
    result = learned(asked_for([], [healthy], folder / "car.toml", Asking(ecu=folder / "ecu.toml")), quiet)
    assert result.alarms == ()
    return folder


def codes(folder, seed, fault=""):
    config = load_config(folder / "car.toml")
    path = log(folder / f"{seed}{fault}.log", seed, fault)
    answers = answer_buses(config)
    engine = prepare(config, folder / "car.toml").engine
    batches = [frames for frames, _ in read_answered(config, answers, engine.plan, path, ())]
    said = through(config, batches)
    return {name for _, name, failed in said.dtcs if failed}


@pytest.mark.parametrize("fault", ["coolant", "rpm", "supply", "stuck"])
def test_a_wrong_answer_is_found(car, fault):
    assert codes(car, 2, fault)


def test_healthy_answers_of_another_drive_are_silent(car):
    assert codes(car, 3) == set()

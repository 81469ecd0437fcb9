"""A pedal of a real car's database, monitored by configuration alone: the layout of opendbc's interceptor."""

import json

import cantools
import numpy as np
import pytest
from typer.testing import CliRunner

from gateway.bus.frames import empty, payload, put
from gateway.bus.logs import open_writer
from gateway.cli import app
from gateway_fdi.common.resources import shipped
from gateway_plants.pedal.ecu.strokes import driving

CONFIG = shipped("configs/pedal_comma.toml")
MESSAGE = cantools.database.load_file(shipped("dbc/pedal_comma.dbc")).get_message_by_name("GAS_SENSOR")
VOTED = cantools.database.load_file(shipped("dbc/pedal.dbc")).get_message_by_name("GW_AcceleratorPedal")


def log_of(path, change=lambda k, a, b: (a, b), seconds=40.0, seed=6):
    """Encode a drive by cantools, 50 frames a second; the raw values are those of two 12-bit ADCs."""
    print("seed", seed)
    rng = np.random.default_rng(seed)
    x = driving(np.arange(0, seconds, 0.02), rng) * 250
    frames = empty(len(x))
    for k, value in enumerate(x):
        a, b = change(k, value + rng.normal(0, 0.15), value + rng.normal(0, 0.08))
        data = MESSAGE.encode(
            {"INTERCEPTOR_GAS": a, "INTERCEPTOR_GAS2": b, "STATE": 0, "COUNTER_PEDAL": k % 16, "CHECKSUM_PEDAL": 0},
            strict=False,
        )  # fmt: skip
        put(frames, k, k * 20_000_000, MESSAGE.frame_id, data)
    writer = open_writer(path)
    writer.write(frames)
    writer.close()
    return frames, x


def replay(path):
    shown = CliRunner().invoke(app, ["replay", str(path), "--config", str(CONFIG), "--json"])
    assert shown.exit_code == 0, shown.output
    events = [json.loads(line) for line in shown.stdout.splitlines()]
    return [e for e in events if e["event"] == "dtc"], events[-1]


def test_a_healthy_drive_has_no_dtc(tmp_path):
    frames, x = log_of(tmp_path / "drive.log")
    dtcs, summary = replay(tmp_path / "drive.log")
    assert dtcs == []
    assert summary["decoded"] == len(frames)
    state = summary["monitors"]["gas"]
    assert state["value"] == pytest.approx(x[-1] / 2.55, abs=0.3)
    assert state["quality"] == 1


@pytest.mark.parametrize(
    ("change", "dtc"),
    [
        (lambda k, a, b: (a + 30, b) if k > 800 else (a, b), "P2120-64"),
        (lambda k, a, b: (a, 120.0) if k > 800 else (a, b), "P2125-2A"),
        (lambda k, a, b: (a, -60.0) if k > 800 else (a, b), "P2125-14"),
    ],
    ids=["offset", "stuck", "short"],
)
def test_its_faults_are_found(tmp_path, change, dtc):
    log_of(tmp_path / "drive.log", change)
    dtcs, _ = replay(tmp_path / "drive.log")
    assert [e["dtc"] for e in dtcs] == [dtc]
    assert dtcs[0]["evidence"]


def test_the_voted_message_is_found_without_naming_its_database(tmp_path):
    from gateway.config.load import load_config
    from gateway.runtime.app import Gateway

    frames, _ = log_of(tmp_path / "drive.log", seconds=1.0)
    gateway = Gateway(load_config(CONFIG))
    gateway.start(0)
    sent = gateway.feed(frames)
    gateway.close()
    voted = sent[sent["can_id"] == VOTED.frame_id]
    assert len(voted) == len(frames)
    assert VOTED.decode(payload(voted[-1]))["Quality"] == "agreed"

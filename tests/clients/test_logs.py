"""Answers in logs that no gateway is fed: gateway decode and gateway learn."""

import json

import numpy as np
import pyarrow.parquet as pq
import pytest
from asking_rig import BUS, DBC, Car, Ecu, write
from command import command

from gateway.bus.frames import OWN
from gateway.bus.logs import open_writer
from gateway.config.load import load_config

SEED = 3
#: An answer that does not come: DID 0x1092.
NEVER = 'BO_ 2149716114 Never: 2 A\n SG_ Never : 7|16@0+ (1,0) [0|9] "" A\n'
#: As gateway import writes it; nothing is asked by whoever only reads logs.
ECU = """
[[ecu]]
name = "battery"
bus = "obd"
request = 0x7E4
response = 0x7EC
signals = ["cells.dbc"]
read = [
    { did = 0x2101, every_ms = 100 },
    { did = 0x1091, every_ms = 100 },    # speed
]
"""


@pytest.fixture
def recorded(tmp_path):
    """A file of an ECU, a log of its answers as another tester asked for them, and what it said."""
    file, rng, said = (
        write(tmp_path, BUS + "[bus.ask]\nrequests_per_s = 100\n" + ECU, DBC.replace("[0|65]", "[0|5]") + NEVER),
        np.random.default_rng(SEED),
        [],
    )
    print("seed", SEED)

    def answer(request):
        if request == b"\x22\x21\x01":
            data = bytearray(150)
            cell = round(3600 + 400 * np.sin(len(said) / 40) + rng.uniform(-9, 9))  # as a cell is: slow
            data[0:2] = cell.to_bytes(2, "big")
            data[55:63] = int(rng.integers(1 << 50)).to_bytes(8, "little")
            data[148:150] = (cell + int(rng.integers(-2, 3))).to_bytes(2, "big")
        else:
            data = int(rng.integers(0, 30_000)).to_bytes(2, "big")
        said.append((request[1:], bytes(data)))
        return [(3, b"\x62" + request[1:] + data)]

    made = Car(file, [Ecu(0x7E4, 0x7EC, answer)])
    made.run(20_000)
    made.close()
    frames = made.recording()
    frames["flags"] &= ~np.uint8(OWN)
    with open_writer(tmp_path / "drive.log") as log:
        log.write(frames)
    return file, tmp_path / "drive.log", said


def column(folder, message, name):
    return [
        value
        for file in sorted(folder.rglob(f"{message}/**/*.parquet"))
        for value in pq.read_table(file)[name].to_pylist()
    ]


@pytest.mark.long
@pytest.mark.parametrize("way", ["--config", "--ecu"])
def test_answers_in_a_log_are_decoded(recorded, way, tmp_path, capsys, monkeypatch):
    file, log, said = recorded
    (tmp_path / "other.dbc").write_text('VERSION ""\nBU_: A\nBO_ 291 Other: 2 A\n')
    more = ["--database", tmp_path / "other.dbc"] if way == "--ecu" else []
    ended = command(capsys, monkeypatch, "decode", log, "--out", tmp_path / "lake", way, file, *more, "--json")
    assert ended.code == 0, ended.err
    told = json.loads(ended.out)
    lake = tmp_path / "lake"
    cells = [data for did, data in said if did == b"\x21\x01"]
    assert len(cells) > 100
    decoded = column(lake, "Cells", "First")
    assert decoded == pytest.approx([int.from_bytes(data[:2], "big") * 0.001 for data in cells[: len(decoded)]])
    assert len(cells) - len(decoded) in (0, 1)  # one may be under way at the end
    edges = [int.from_bytes(data[55:63], "little") for data in cells]
    assert column(lake, "Cells_2", "Edge") == edges[: len(decoded)]
    assert len(column(lake, "Cells_3", "Last")) == len(decoded)
    speeds = column(lake, "Speed", "Speed")
    assert told["answers"] == 3 * len(decoded) + len(speeds)
    assert any(
        note.startswith(f"ECU battery: {len(decoded) + len(speeds)} answers decoded, 0 ") for note in told["notes"]
    )


@pytest.mark.long
def test_answers_in_a_log_are_learned_from(recorded, tmp_path, capsys, monkeypatch):
    file, log, _ = recorded
    out = tmp_path / "car.toml"
    ended = command(capsys, monkeypatch, "learn", log, "--ecu", file, "-o", out, "--json")
    assert ended.code == 0, ended.err
    config = load_config(out)
    (battery,) = config.ecu
    assert battery.place == load_config(file).ecu[0].place
    assert battery.read == load_config(file).ecu[0].read
    assert config.bus[0].ask.requests_per_s == 100
    assert {check.message for check in battery.check} == {"Cells", "Cells_2", "Cells_3", "Speed"}
    assert not [check for check in battery.check if check.timeout_ms is not None]
    (signals,) = [entry for entry in config.monitor if entry.type == "signal"]
    asked = {entry["signal"]: set(entry) for entry in signals.model_extra["signal"]}
    assert "plausible" in asked["Cells.First"]
    assert not [keys for keys in asked.values() if keys & {"gradient", "stuck"}]
    assert not [entry for entry in config.monitor if entry.type == "rule"]
    again = tmp_path / "again.toml"
    told = (
        file.read_text() + 'check = [{ message = "Cells", timeout_ms = 900.0 }, { message = "Never", value = false }]\n'
    )
    (tmp_path / "told.toml").write_text(told)
    ended = command(capsys, monkeypatch, "learn", log, "--ecu", tmp_path / "told.toml", "-o", again, "--json")
    assert ended.code == 0, ended.err
    for update in (False, True):
        if update:
            text = again.read_text()
            ended = command(capsys, monkeypatch, "learn", log, "--update", "-o", again, "--json")
            assert ended.code == 0, ended.err
            assert again.read_text().count("message =") == text.count("message =")
            assert again.read_text().count("signal =") == text.count("signal =")
        timeouts = {check.message: check.timeout_ms for check in load_config(again).ecu[0].check}
        assert timeouts == {"Cells": 900.0, "Cells_2": None, "Cells_3": None, "Never": None, "Speed": None}
    ended = command(capsys, monkeypatch, "replay", log, "-c", out, "--json", "--memory", tmp_path / "m.sqlite")
    assert ended.code == 0, ended.err
    assert not [line for line in ended.out.splitlines() if json.loads(line)["event"] == "dtc"]


@pytest.mark.long
def test_faults_are_put_into_answers(recorded, tmp_path, capsys, monkeypatch):
    file, log, _ = recorded
    out = tmp_path / "judged.toml"
    monitor = '[[monitor]]\nname = "cells"\ntype = "signal"\nbus = "answers:obd"\n'
    monitor += 'signal = [{ signal = "Cells.First", plausible = [2.9, 4.3] }]\n'
    checked = 'check = [{ message = "Speed", timeout_ms = 1000.0, length = false }]\n'
    out.write_text(file.read_text() + checked + monitor)

    def faults(*inject):
        arguments = [part for text in inject for part in ("--inject", text)]
        ended = command(capsys, monkeypatch, "replay", log, "-c", out, "--json", *arguments)
        assert ended.code == 0, ended.err
        events = [json.loads(line) for line in ended.out.splitlines()]
        begun = next(event["t_ns"] for event in events if "t_ns" in event)
        notes = next(event["notes"] for event in events if event["event"] == "log")
        set_ = {e["fault"]: (e["t_ns"] - begun) / 1e9 for e in events if e["event"] == "dtc" and e["status"] & 1}
        return set_, notes

    assert faults()[0] == {}
    set_, notes = faults("offset answers:obd.Cells.First=2 @5")
    assert list(set_) == ["cells.First.high"]
    assert set_["cells.First.high"] > 5
    assert any("--inject" in note and not note.endswith(" 0 frames") for note in notes)
    assert list(faults("drop Speed @8..12")[0]) == ["answers:obd.Speed.timeout"]


@pytest.mark.parametrize(
    ("arguments", "file", "why"),
    [
        (
            ("--ecu", "more.toml"),
            BUS + ECU + '[memory]\npath = "m"\n',
            "more.toml: memory: only [[bus]]",
        ),
        (("--ecu", "more.toml"), BUS, "more.toml: ecu: there is no [[ecu]]"),
        (("--ecu", "more.toml", "--bus", "can"), BUS + ECU, "--bus = 'can': the buses of more.toml are obd"),
    ],
)
def test_what_cannot_be_learned_with_is_told(arguments, file, why, tmp_path, capsys, monkeypatch):
    write(tmp_path, BUS)
    (tmp_path / "more.toml").write_text(file)
    (tmp_path / "drive.log").write_text("(1.0) can0 7EC#00\n")
    monkeypatch.chdir(tmp_path)
    ended = command(capsys, monkeypatch, "learn", "drive.log", *arguments)
    assert (ended.code, why in ended.err) == (2, True), ended.err

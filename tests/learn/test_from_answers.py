"""gateway learn from a log of answers that no gateway is fed."""

import json
import re

import pytest
from asked_log import ECU, recorded
from asking_rig import BUS, write
from command import command

from gateway.config.load import load_config


@pytest.mark.long
def test_answers_in_a_log_are_learned_from(tmp_path, capsys, monkeypatch):
    file, log, _ = recorded(tmp_path)
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
    rules = [rule["name"] for entry in config.monitor if entry.type == "rule" for rule in entry.model_extra["rule"]]
    # One cell is as the other; which of the pairs that are as good is taken, is rounding of the processor.
    assert len(rules) == 1
    assert re.fullmatch(r"Cells(_[23])?_(First_by_Last|Last_by_First)", rules[0])
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

"""What ``gateway check`` says of a configuration that is not wrong."""

import importlib
import json

import pytest
from typer.testing import CliRunner

from gateway.cli import app
from gateway_commands.check import check
from gateway_commands.dependencies import why
from gateway_fdi.common.resources import shipped
from gateway_fdi.errors import InputError

check_module = importlib.import_module("gateway_commands.check")


def steering(folder, extra=""):
    path = folder / "steering.toml"
    text = shipped("configs/steering.toml").read_text()
    path.write_text(text.replace("resistance_error = 0.15", f"resistance_error = 0.15\n{extra}"))
    return path


def test_long_periods_are_warned_of(tmp_path, capsys):
    assert check(steering(tmp_path), schema_wanted=False, json=True) == 0
    assert json.loads(capsys.readouterr().out)["warnings"] == []
    slow = steering(tmp_path, "period_ms = 5.0")
    assert check(slow, schema_wanted=False, json=True) == 0
    (said,) = json.loads(capsys.readouterr().out)["warnings"]
    assert said.startswith("steering: period_ms = 5.0: the currents' time constant is 1.67 ms")
    assert check(slow, schema_wanted=False, json=False) == 0
    assert "warning: steering: period_ms" in capsys.readouterr().out


def test_what_this_machine_lacks_is_warned_of(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(check_module, "no_socketcan", lambda: "no SocketCAN in this kernel")
    config = tmp_path / "c.toml"
    config.write_text('[[bus]]\nname = "b"\nuri = "socketcan:can0"\n[memory]\npath = "none/f.sqlite"\n')
    assert check(config, schema_wanted=False, json=True) == 0
    said = json.loads(capsys.readouterr().out)["warnings"]
    assert said == [
        "bus[0].uri = 'socketcan:can0': gateway run ends here: no SocketCAN in this kernel",
        f"memory.path: the folder {tmp_path}/none is not there; gateway run makes it",
    ]


def test_errors_in_json_have_file_key_and_value(tmp_path, capsys):
    config = tmp_path / "c.toml"
    config.write_text('[[bus]]\nname = "b"\nuri = "vcan0"\n')
    assert check(config, schema_wanted=False, json=True) == 2
    (error,) = json.loads(capsys.readouterr().out)["errors"]
    assert (error["file"], error["key"], error["value"]) == (str(config), "bus[0].uri", "vcan0")


def test_a_structural_monitor_tells_what_will_run(tmp_path, capsys):
    path = shipped("configs/motor.toml")
    assert check(path, schema_wanted=False, json=False) == 0
    said = capsys.readouterr().out
    assert "motor:\n  test e1 (S) sees f_R, f_i, f_w; it checks e1 (winding): u = R * (1 + f_R) * I + k * omega" in said
    assert "  fault f_b  isolated; fires e1_2 e5 e5_2; size by e3\n" in said
    assert "P1B11-64  motor.f_b: the bearing's friction" in said
    assert check(path, schema_wanted=False, json=True) == 0
    assert len(json.loads(capsys.readouterr().out)["told"]["motor"]) == 8


def test_why_says_what_a_fault_depends_on_in_80_columns(capsys):
    path = shipped("configs/steering.toml")
    assert why(path, "steering.angles", json=False) == 0
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 80
    assert lines[0] == "steering.angles  C1A04-62"
    assert any(line.split()[:2] == ["signal", "chassis.SAS_Angle.Delta_S"] for line in lines)
    assert any(line.split()[:2] == ["ecu", "chassis.SAS"] for line in lines)
    assert why(path, "steering.angles", json=True) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["fault"], told["dtc"]) == ("steering.angles", "C1A04-62")
    assert {"component", "kind", "power", "why"} == set(told["depends"][0])


def test_why_of_a_fault_that_is_not_there_names_near_ones(capsys):
    path = shipped("configs/steering.toml")
    with pytest.raises(InputError, match=r"no monitor reports this fault.*did you mean steering.angles") as error:
        why(path, "steering.angle", json=False)
    assert (error.value.key, error.value.value) == ("--why", "steering.angle")
    assert why(path, "steering.angle", json=True) == 2
    (told,) = json.loads(capsys.readouterr().out)["errors"]
    assert told["key"] == "--why"


def test_many_faults_are_counted_by_kind_and_listed_on_demand(tmp_path):
    count = 40
    messages = "".join(
        f'BO_ {k} Message{k}: 8 ECU\n SG_ Value : 0|8@1+ (1,0) [0|0] "" X\n\n' for k in range(1, count + 1)
    )
    (tmp_path / "car.dbc").write_text(f'VERSION ""\n\nBU_: ECU X\n\n{messages}')
    path = tmp_path / "car.toml"
    checks = "".join(f'[[bus.check]]\nmessage = "Message{k}"\ntimeout_ms = 100.0\n' for k in range(1, count + 1))
    path.write_text(
        f'name = "car"\n[[bus]]\nname = "can0"\nuri = "virtual:a"\ndatabase = ["car.dbc"]\ncodes = "own"\n{checks}'
    )
    said = CliRunner().invoke(app, ["check", str(path)])
    assert said.exit_code == 0, said.output
    lines = said.output.splitlines()
    assert lines[0].startswith(f"{path}: good. 1 bus(es), 0 monitor(s), ")
    assert len(lines) < 12
    (bus,) = [line for line in lines if line.split()[1:2] == ["can0:"]]
    assert f"timeout {count}" in bus
    assert f"{count} codes given out: gateway check {path} --all" in lines[-1]
    every = CliRunner().invoke(app, ["check", str(path), "--all"]).output
    assert sum(".timeout: " in line for line in every.splitlines()) == count
    assert int(lines[0].split()[-2]) == sum(line.startswith("  ") and ": " in line for line in every.splitlines())

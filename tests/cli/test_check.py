"""What ``gateway check`` says of a configuration that is not wrong."""

import json

from gateway.cli.check import check
from gateway.resources import shipped


def steering(folder, extra=""):
    path = folder / "steering.toml"
    text = shipped("configs/steering.toml").read_text().replace("../dbc/", f"{shipped('dbc')}/")
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

"""Help texts: at 80 columns, whole, with their units."""

import pytest
from typer.main import get_command
from typer.testing import CliRunner

from gateway.cli import app


def commands(command=None, path=()):
    command = get_command(app) if command is None else command
    yield path, command
    for name, inner in getattr(command, "commands", {}).items():
        yield from commands(inner, (*path, name))


ALL = list(commands())


@pytest.mark.parametrize(("path", "command"), ALL, ids=[" ".join(p) or "gateway" for p, _ in ALL])
def test_help_is_whole(path, command):
    made = CliRunner().invoke(app, [*path, "--help"], env={"COLUMNS": "80"})
    assert made.exit_code == 0
    text = " ".join(made.output.split())
    assert max(map(len, made.output.splitlines())) <= 80
    for parameter in command.params:
        told = getattr(parameter, "help", None)
        if told:
            assert " ".join(told.split()) in text, parameter.name
    for name, inner in getattr(command, "commands", {}).items():
        assert f"{name} {inner.help.splitlines()[0]}" in text


def test_units_are_there():
    made = CliRunner().invoke(app, ["calibrate", "--help"], env={"COLUMNS": "200"})
    assert "Mean time between false alarms of a monitor [s]." in made.output

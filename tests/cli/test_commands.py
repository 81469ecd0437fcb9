"""Commands that name the function they call: its parameters are the command's options."""

from importlib import import_module
from inspect import signature

import pytest
import typer

from gateway.cli import app, commands


def every():
    """Our commands, those of groups, and those of other packages that are here."""
    others = [commands.OTHERS[name] for name in commands.OTHERS]
    apps = [app, *(group.typer_instance for group in app.registered_groups)]
    apps += [each for each in others if isinstance(each, typer.Typer)]
    found = [each.callback for one in apps for each in one.registered_commands] + others
    return [each for each in found if hasattr(each, "__wrapped__")]


def test_each_command_has_the_parameters_of_its_function(monkeypatch):
    called = []

    class Module:
        def __init__(self, name):
            self.module = import_module(name)

        def __getattr__(self, name):
            work = getattr(self.module, name)

            def bound(**given):
                signature(work).bind(**given)
                called.append(name)
                return 3

            return bound

    monkeypatch.setattr(commands, "import_module", Module)
    for command in every():
        with pytest.raises(typer.Exit) as ended:
            command(**dict.fromkeys(signature(command).parameters))
        assert ended.value.exit_code == 3
    assert len(called) == len(every()) >= 20


def test_lists_that_are_not_given_are_empty_and_options_get_the_names_of_the_function(monkeypatch):
    given = {}
    monkeypatch.setattr("gateway_replay.cli.signal_plot.plot_file", lambda **options: given.update(options) or 0)
    plot = commands.OTHERS["plot"]
    with pytest.raises(typer.Exit):
        plot(series="a", output="b", only=None)
    assert given == {"series": "a", "output": "b", "only": ()}

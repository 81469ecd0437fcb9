"""Help texts: at 80 columns, whole, with their units, in plain words."""

import re

import pytest
import typer
from typer.main import get_command

from gateway.cli import app
from gateway.cli.commands import OTHERS


def commands(command, parent=None, name="gateway"):
    """Yield context, command and help of a command and of all below it, those of other packages too."""
    with command.make_context(name, [], parent=parent, resilient_parsing=True) as context:
        yield context, command, context.get_help()
        for inner in command.list_commands(context) if hasattr(command, "list_commands") else ():
            yield from commands(command.get_command(context, inner), context, inner)


@pytest.fixture(scope="module")
def helps():
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("COLUMNS", "80")
        return list(commands(get_command(app)))


def test_every_command_is_here(helps):
    paths = {context.command_path for context, _, _ in helps}
    assert {"gateway", "gateway faults show"} | {f"gateway {name}" for name in OTHERS} <= paths
    assert len(paths) > 25


def test_help_is_whole(helps):
    for context, command, shown in helps:
        path, text = context.command_path, " ".join(shown.split())
        assert max(map(len, shown.splitlines())) <= 80, path
        for parameter in command.params:
            told = getattr(parameter, "help", None)
            if told and not getattr(parameter, "hidden", False):
                assert " ".join(told.split()) in text, (path, parameter.name)
        for name in command.list_commands(context) if hasattr(command, "list_commands") else ():
            first = command.get_command(context, name).help.splitlines()[0]
            assert f"{name} {first}" in text, "a summary is cut: make it shorter"


def texts(helps):
    for context, command, _ in helps:
        for line in (command.help or "").splitlines():
            if line.strip():
                yield context.command_path, line.strip()
        for parameter in command.params:
            told = getattr(parameter, "help", None)
            if told:
                yield f"{context.command_path} {parameter.name}", told


def test_help_is_in_plain_words(helps):
    """No clause as a subject, none of the words that have a plainer one."""
    unclear = re.compile(
        r"^(What|Who|Whose|That which)\b(?!.*\?)|\banew\b|\bso long\b|\bbehind\b|\bmeanwhile\b|\bsay\b"
    )
    wrong = [(path, text) for path, text in texts(helps) if unclear.search(text)]
    assert not wrong


def test_units_are_there(helps):
    told = dict(texts(helps))
    assert told["gateway run duration"] == "Stop after this time [s]."
    assert "gateway mqtt rate" in {path for path, text in told.items() if text.endswith("[Hz].")}


def test_a_hit_of_the_word_list_is_found():
    bad = typer.Typer()

    @bad.command()
    def one(_: int = 0) -> None:
        """Who asks waits anew."""

    with pytest.raises(AssertionError):
        test_help_is_in_plain_words([*commands(get_command(bad))])

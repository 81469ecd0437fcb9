"""``gateway --help``: commands by what they are for, and their names by the shell's completion."""

import os
import subprocess
import sys

from typer.main import get_command
from typer.testing import CliRunner
from uses import lacking

from gateway.cli import app
from gateway.cli.commands import SECTIONS
from gateway_fdi.common.resources import shipped


def test_each_command_is_in_one_section_and_lines_fit_80_columns():
    said = CliRunner().invoke(app, ["--help"], env={"COLUMNS": "80"}).output
    group = get_command(app)
    names = [line.split()[0] for line in said.split("Run (")[1].splitlines()[1:] if line.startswith("  ")]
    assert sorted(names) == sorted(group.list_commands(None))
    assert max(map(len, said.splitlines())) <= 80
    assert "..." not in said.split("Run (")[1], "no text is cut"


def test_examples_of_sections_are_commands_of_theirs():
    for title, names in SECTIONS.items():
        if names:
            words = title.partition("(")[2].rstrip(")").split()
            assert words[0] == "gateway"
            assert words[1] in names
            for word in words:
                assert not word.startswith("scenarios/") or lacking("crank") or shipped(word).exists()


def test_a_shell_completes_commands_and_options():
    for words, at, found in (("gateway re", 1, "replay"), ("gateway replay --fai", 2, "--fail-on-dtc")):
        asked = {"COMP_WORDS": words, "COMP_CWORD": str(at), "_GATEWAY_COMPLETE": "complete_bash"}
        code = "import sys; sys.argv = ['gateway']; from gateway.cli import main; main()"
        said = subprocess.run(
            [sys.executable, "-c", code], env={**os.environ, **asked}, capture_output=True, text=True, check=False
        )
        assert found in said.stdout.split(), said.stderr

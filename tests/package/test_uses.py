"""The table of what tests use by name only has no stale line, and all tests can be collected without the plants."""

import re
import subprocess
import sys
from functools import cache
from importlib import import_module
from importlib.util import find_spec

import pytest
from uses import BELOW, GUESTS, PLANTS, ROOT, TESTS, USES, helpers, imported, lacking, uses

LINES = sorted((place, owner) for place, owners in USES.items() for owner in owners)


#: Tests that run without plants: help, doctor, a log that is learned.
SOME = "test_help or test_doctor or test_each_channel_of_a_log"

#: What is taken away: all plants, or a plant, or a package that the core does without.
WITHOUT = [PLANTS, *([name] for name in (*PLANTS, *GUESTS))]

#: A file that takes every shipped file, page, key or type of ECU uses all plants.
EVERY = ("all_shipped", "glob", "rglob", "keys_of", "VIRTUAL_ECUS")


@cache
def names_of(owner):
    """Return the names by which tests call what a plant or a package brings: files, types, commands."""
    package = owner if owner.startswith("gateway_") else f"gateway_plants.{owner}"
    folders = [f"packages/{package.replace('.', '/')}", f"dbc/{owner}", f"scenarios/{owner}"]
    files = [file for folder in folders for file in (ROOT / folder).rglob("*.*") if file.suffix in (".toml", ".dbc")]
    brought = vars(import_module(f"{package}.plugin").PLUGIN).values() if find_spec(f"{package}.plugin") else ()
    words = {name.split()[-1].strip(".") for door in brought if isinstance(door, dict) for name in door}
    for file in (ROOT / "gateway.toml", *ROOT.glob("packages/**/configs/*.toml"), *ROOT.glob("scenarios/*/*.toml")):
        if words & words_of(file):  # a configuration of ours that has it; and a scenario of this configuration
            words.add("gateway.toml" if file.name == "gateway.toml" else file.stem)
    return {owner, *words, *EVERY, *(file.stem for file in files)}


def words_of(file):
    """Return the words of a file, those of its helpers too."""
    texts = [each.read_text() for each in (file, *(helpers(file) if file.suffix == ".py" else ()))]
    return {word for text in texts for word in re.findall(r"gateway\.toml|\w+", text)}


def of_others(file):
    """Return the packages and plants that tests beside a file use whose files it names (it runs them)."""
    beside = [file.parent / f"{word}.py" for word in words_of(file) if word.startswith("test_")]
    return {owner for other in beside if other.exists() and other != file for owner in uses(other)}


@pytest.mark.skipif(any(map(lacking, (*PLANTS, *BELOW))), reason="not the whole checkout")
def test_no_line_of_the_table_is_stale():
    stale = []
    for place, owner in LINES:
        files = [TESTS / place] if place.endswith(".py") else sorted((TESTS / place).glob("test_*.py"))
        if not any(file.exists() for file in files):
            stale.append(f"{place}: there is no such test")
        elif all(owner in imported(file) for file in files):
            stale.append(f"{place}: {owner} is imported, which is seen without the line")
        elif not any(words_of(file) & names_of(owner) or owner in of_others(file) for file in files):
            stale.append(f"{place}: names nothing of {owner}")
    assert stale == []


@pytest.mark.long
@pytest.mark.full("17 s each")
@pytest.mark.skipif(any(map(lacking, (*PLANTS, *BELOW))), reason="not the whole checkout")
@pytest.mark.parametrize("gone", WITHOUT, ids=" ".join)
def test_without_plants_or_a_package_all_tests_are_collected_and_some_run(gone):
    """In a copy without the folders; a test that takes something of them at its import is an error there."""
    command = [sys.executable, "scripts/without", *gone, "--", "-n", "0", "-k", SOME]
    ended = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stdout[-3000:] + ended.stderr
    assert "100%]" in ended.stdout, "pytest's code is 0 only where tests ran and passed"

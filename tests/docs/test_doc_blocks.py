"""Commands and TOML of the documentation: each command line is taken by its command, each table by what reads it.

Tutorials (tests/docs/test_tutorials.py) and the uses of docs/api.md (tests/api/test_docs.py) run; nothing here does.
"""

import re
import shlex
import tomllib
from pathlib import Path

import pytest
import typer
from jsonschema_rs import Draft202012Validator

from gateway.cli import app
from gateway.common.trust import importable
from gateway_bench.vecu.scenario import Scenario
from gateway_commands.configuration_schema import schema
from gateway_fdi.common.resources import all_shipped, shipped
from gateway_fdi.structure.file import load_model

ROOT = Path(__file__).parents[2]
PAGES = [*sorted((ROOT / "docs").rglob("*.md")), ROOT / "README.md", ROOT / "CONTRIBUTING.md"]
BLOCK = re.compile(r"^ *```([\w-]*)[^\n]*\n(.*?)^ *```", re.MULTILINE | re.DOTALL)
#: What ends a command of a shell's line.
ENDS = {"&&", "||", "|", "&", ";", ">", "<", "2>&1"}
#: Of the packages that are told to be added: '.[extra]' in the checkout; the name is not on PyPI.
EXTRAS = re.compile(r"'\.\[([\w,]+)\]")
#: Files that come with the gateway, or with an example of its own folder, as text names them.
SHIPPED = re.compile(r"(?<![\w/.-])((?:configs|scenarios|models|dbc)/[\w-]+\.(?:toml|dbc))")
#: A command within a sentence; NAME stands for any.
SPAN = re.compile(r"`gateway ((?!evaluate NAME)[a-z][^`]*)`")
#: Of typer, which brings its own copy of click.
UsageError = typer.BadParameter.__bases__[0]
#: Programs and tests of the checkout, as text names them.
FILES = re.compile(r"(?<![\w/.-])(?!tests/test_a\b)((?:bench|scripts|tests|deploy)/[\w./-]*\w)")


def blocks(*languages):
    """Yield page and text of all blocks of these languages."""
    for page in PAGES:
        for language, text in BLOCK.findall(page.read_text(encoding="utf-8")):
            if language in languages:
                yield page, text


def commands(page, language, text):
    """Yield the words of each call of the gateway in a block."""
    for line in text.replace("\\\n", " ").splitlines():
        shown = line.strip()
        if language == "console":
            if not shown.startswith("$ "):
                continue
            shown = shown.removeprefix("$ ")
        if "gateway " not in shown:
            continue
        call = []
        for word in [*shlex.split(shown, comments=True), ";"]:
            if word not in ENDS:
                call.append(word)
                continue
            while call and "=" in call[0]:  # the environment
                call.pop(0)
            if call and Path(call[0]).name == "gateway":
                yield call[1:]
            call = []


def command_of(words):
    """Return the command that words name, the words behind it, and the context above it."""
    command, words, context = typer.main.get_command(app), list(words), None
    while hasattr(command, "resolve_command") and words and not words[0].startswith("-"):
        context = typer.Context(command, parent=context, info_name=command.name)
        _, command, words = command.resolve_command(context, words)
    return command, words, context


def refusal(words):
    """Return what a command says against its arguments; files need not be there."""
    try:
        command, words, context = command_of(words)
        command.make_context(command.name, words, parent=context)
    except typer.Exit:  # --help, --version
        return ""
    except UsageError as error:
        text = error.format_message()
        return "" if "does not exist" in text else text
    return ""


def test_commands_are_taken():
    seen, wrong = 0, []
    for language in ("sh", "sh-fails", "console"):
        for page, text in blocks(language):
            for words in commands(page, language, text):
                seen += 1
                if said := refusal(words):
                    wrong.append(f"{page.name}: gateway {shlex.join(words)}: {said}")
    assert wrong == []
    assert seen > 130
    assert refusal(["replay", "a.log", "--colour"])
    assert refusal(["faults", "lists"])


def test_commands_within_sentences_are_there():
    seen = 0
    for page in PAGES:
        for span in SPAN.findall(BLOCK.sub("", page.read_text(encoding="utf-8"))):
            command, words, _ = command_of(span.split())
            known = {"--help", *(name for each in command.params for name in (*each.opts, *each.secondary_opts))}
            assert {word.partition("=")[0] for word in words if word.startswith("--")} <= known, f"{page.name}: {span}"
            seen += 1
    assert seen > 150


def test_extras_and_files_are_there():
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        for names in EXTRAS.findall(text):
            assert set(names.split(",")) <= set(extras), page.name
        assert not re.search(r"pip install \S*ecu-gateway", text), page.name
        gone = [file for file in FILES.findall(text) if not (ROOT / file).exists()]
        assert gone == [], page.name


def test_scenarios_and_shipped_files_are_there():
    scenarios = {path.stem for path in all_shipped("scenarios", ".toml")} | {"SCENARIO"}
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        for name in re.findall(r"gateway (?:demo|simulate) (\w+)(?![\w./-])", text):
            assert name in scenarios, f"{page.name}: {name}"
        for file in SHIPPED.findall(text):
            assert (ROOT / "examples/bench" / file).exists() or shipped(file).exists(), f"{page.name}: {file}"


@pytest.fixture(scope="module")
def judge():
    """Return a validator of parts of a configuration, and the tables of monitors: no key is needed, none is unknown."""
    document = schema()
    base = document["$defs"]["MonitorConfig"]["properties"]

    def loose(node):
        if isinstance(node, dict):
            if isinstance(node.get("required"), list):  # no property of this name
                del node["required"]
            for each in node.values():
                loose(each)
        elif isinstance(node, list):
            for each in node:
                loose(each)

    for one in document["$defs"]["MonitorConfig"]["anyOf"]:
        one["additionalProperties"] = "const" not in one["properties"]["type"]
        one["properties"] = {**base, **one["properties"]}
    loose(document)
    return Draft202012Validator(document), document["$defs"]["MonitorConfig"]["anyOf"]


def of_a_configuration(judge, block):
    """Return whether a table is a configuration's, or of a bus or a monitor of it."""
    validator, monitors = judge
    if isinstance(block.get("bus"), dict):  # tables of a bus that is told before
        block = {**block, "bus": [block["bus"]]}
    parts = [block, {"bus": [block]}]
    for one in monitors:
        if name := one["properties"]["type"].get("const"):
            parts.append({"monitor": [{"type": name, **block}]})
    return any(validator.is_valid(part) for part in parts)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a folder with the plant that scenarios of the pages name; their virtual ECU is that of the example."""
    path = tmp_path_factory.mktemp("pages")
    (plant,) = (text for _, text in blocks("python") if text.startswith("class Motor:"))
    (path / "my_plant.py").write_text(plant)
    importable(shipped("examples/battery_voltage/battery_ecu.py").parent)  # where other tests have it from
    importable(path)
    return path


def of_a_scenario(block):
    """Read a scenario, or a part of one."""
    plant = {"type": "my_plant:Motor", "inputs": {"duty": "A.B"}, "outputs": {"A.C": "i"}}
    ecus = {"pending": {"type": "responder"}, "actuator_gain": plant}
    if "ecu" not in block:
        fault = block["fault"][0]
        named = {"name": fault["ecu"]} if "ecu" in fault else {}
        block = {"ecu": [{**ecus.get(fault["kind"], {"type": "restbus"}), **named}], **block}
    Scenario.model_validate({"name": "part", "duration_s": 100.0, **block})


def test_tables_are_taken(judge, folder):
    seen = 0
    for page, text in blocks("toml"):
        block = tomllib.loads(text)
        if "equation" in block:
            (folder / "model.toml").write_text(text)
            load_model(folder / "model.toml")
        elif isinstance(block.get("fault"), list) or "duration_s" in block or "type" in str(block.get("ecu", "")):
            of_a_scenario(block)
        elif "project" not in block:
            assert of_a_configuration(judge, block), f"{page.name}:\n{text}"
        seen += 1
    assert seen > 50
    assert not of_a_configuration(judge, {"memory": {"entires": 3}})
    assert not of_a_configuration(judge, {"monitor": [{"type": "signal", "signals": 3}]})

"""Schemas for editors, and shipped files that name real paths."""

import json
import tomllib
from pathlib import Path

import pytest
from command import command
from jsonschema_rs import Draft202012Validator

from gateway_commands.schema import schemas
from gateway_fdi.common.resources import all_shipped, shipped

ROOT = shipped("gateway.toml").parent


@pytest.fixture(scope="module")
def found():
    return {kind: Draft202012Validator(one) for kind, one in schemas().items()}


def told(validator, text):
    return [error.message for error in validator.iter_errors(tomllib.loads(text))]


@pytest.mark.parametrize(("kind", "folder"), [("gateway", "configs"), ("scenario", "scenarios"), ("model", "models")])
def test_shipped_files_are_right_by_their_schema(found, kind, folder):
    files = [path for path in all_shipped(folder, ".toml") if not path.stem.endswith("_faults") or folder != "configs"]
    assert len(files) > 5
    assert {path.name: told(found[kind], path.read_text()) for path in files} == {path.name: [] for path in files}


@pytest.mark.parametrize(
    ("kind", "text"),
    [
        ("gateway", '[[bus]]\nname = "b"\nuri = "virtual:b"\nbitrat = 5\n'),
        ("scenario", 'name = "a"\nduration_s = 1.0\n[[ecu]]\ntype = "restbus"\ncycle = 5\n'),
        (
            "scenario",
            'name = "a"\nduration_s = 1.0\n[[ecu]]\ntype = "restbus"\n[[fault]]\nkind = "missed_pulses"\nrat = 1\n',
        ),
        ("model", 'unknown = { x = { uni = "V" } }\nequation = {}\n'),
    ],
)
def test_slips_are_found(found, kind, text):
    assert told(found[kind], text)


def test_all_schemas_are_written_with_the_names_that_files_begin_with(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert command(capsys, monkeypatch, "schema", "--out", ".").code == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "gateway.schema.json", "model.schema.json", "scenario.schema.json",
    ]  # fmt: skip
    assert json.loads(command(capsys, monkeypatch, "schema", "model").out)["properties"]["equation"]
    assert command(capsys, monkeypatch, "new-monitor", "own").code == 0
    for name, kind in (("gateway", "gateway"), ("drained", "scenario")):
        first = (tmp_path / "own" / f"{name}.toml").read_text().splitlines()[0]
        assert first == f"#:schema {kind}.schema.json"


def test_shipped_configurations_name_files_by_their_whole_paths():
    """From the folder of dbc/, or beside the file itself: nobody needs to know where else is looked."""
    for path in [shipped("gateway.toml"), *all_shipped("configs", ".toml"), *all_shipped("examples/*", ".toml")]:
        for bus in tomllib.loads(path.read_text()).get("bus", []):
            for name in bus.get("database", []):
                assert (ROOT / name).is_file() or (Path(path).parent / name).is_file(), f"{path}: {name}"

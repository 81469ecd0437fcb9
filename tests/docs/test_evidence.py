"""Rows of docs/evidence.toml and marks in tests belong together; what a row is called by what its tests did."""

import importlib.machinery
import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from nested_pytest import PYTEST
from uses import PACKAGES, PLANTS, lacking

ROOT = Path(__file__).parents[2]
CATALOGUE = """
[[part]]
name = "A"
title = "first"
source = "somewhere"
[part.rows]
"1" = "says one"
"2" = "says two"
[part.left_out]
"3" = ["says three", "nobody wants it"]
"""
SUITE = """
import pytest

@pytest.mark.evidence("A: 1")
def test_good():
    pass

@pytest.mark.parametrize("k", [pytest.param(0, marks=pytest.mark.evidence("A: 2")), 1])
def test_of_cases(k):
    assert k == 0

@pytest.mark.evidence("A: 4")
class TestAll:
    @pytest.mark.skip
    def test_never(self):
        pass

    @pytest.mark.xfail
    def test_known_wrong(self):
        assert False

@pytest.fixture
def broken():
    yield
    assert False

@pytest.mark.evidence("A: 5")
def test_whose_end_fails(broken):
    pass
"""


@pytest.fixture(scope="module")
def evidence():
    loader = importlib.machinery.SourceFileLoader("evidence_script", str(ROOT / "scripts" / "evidence"))
    made = importlib.util.module_from_spec(importlib.util.spec_from_loader("evidence_script", loader))
    sys.modules["evidence_script"] = made  # its dataclasses look there
    loader.exec_module(made)
    return made


@pytest.mark.skipif(any(map(lacking, (*PLANTS, *PACKAGES))), reason="its tests are not there")
def test_no_row_and_no_mark_is_dead_and_there_are_300(evidence):
    marked = evidence.marked(evidence.tests_of(ROOT / "tests"))
    parts, dead = evidence.catalogue((ROOT / "docs" / "evidence.toml").read_text(), marked)
    parts.append(evidence.promises((ROOT / "docs" / "security.md").read_text()))
    assert dead + evidence.missing(parts) == []
    rows = [row for part in parts for row in part.rows]
    assert sum(not row.why for row in rows) >= 300
    assert len({(part.name, row.key) for part in parts for row in part.rows}) == len(rows)


def test_dead_rows_and_marks_are_named(evidence):
    parts, dead = evidence.catalogue(CATALOGUE, {"A: 2": ["tests/test_x.py::test_y"], "A: 9": ["tests/test_x.py"]})
    assert dead == ["A: 1: no test", "A: 9: no row of evidence.toml (tests/test_x.py)"]
    assert evidence.missing(parts) == ["A: 2: there is no tests/test_x.py::test_y"]
    own = "tests/docs/test_evidence.py"
    page = f"# Page\n## Who\n| cannot | held by |\n|---|---|\n| fly | `{own}::test_that_is_not`, `{own}` |\n"
    row = evidence.promises(page).rows[0]
    assert (row.key, row.says) == ("Who 1", "fly")
    assert evidence.missing([evidence.promises(page)]) == [f"Security: Who 1: there is no {own}::test_that_is_not"]


def test_marks_of_functions_classes_modules_and_cases_are_found(evidence, tmp_path, monkeypatch):
    monkeypatch.setattr(evidence, "ROOT", tmp_path)
    file = tmp_path / "test_suite.py"
    file.write_text(SUITE)
    name = "test_suite.py::"
    assert evidence.marked([file]) == {
        "A: 1": [f"{name}test_good"],
        "A: 2": [f"{name}test_of_cases"],
        "A: 4": [f"{name}TestAll::test_never", f"{name}TestAll::test_known_wrong"],
        "A: 5": [f"{name}test_whose_end_fails"],
    }
    file.write_text(SUITE + '\npytestmark = [pytest.mark.long, pytest.mark.evidence("A: 6")]\n')
    assert len(evidence.marked([file])["A: 6"]) == 5


@pytest.mark.long
@pytest.mark.parametrize("workers", [pytest.param("0", marks=pytest.mark.full("1 s")), "2"])
def test_outcomes_are_those_of_the_run_also_of_several_processes(evidence, tmp_path, workers):
    (tmp_path / "test_suite.py").write_text(SUITE)
    (tmp_path / "pytest.ini").write_text("[pytest]\nmarkers = evidence\n")
    (tmp_path / "conftest.py").write_text(
        "import os\nfrom outcomes import Outcomes, note_ids\n"
        "def pytest_configure(config):\n"
        "    file = os.environ.pop('GATEWAY_OUTCOMES', None)\n"
        "    if file: config.pluginmanager.register(Outcomes(file))\n"
        "def pytest_collection_modifyitems(items): note_ids(items)\n"
    )
    file = tmp_path / "out" / "told.json"
    support = os.pathsep.join([str(ROOT / "tests" / "support"), os.environ.get("PYTHONPATH", "")])
    environment = {**os.environ, "GATEWAY_OUTCOMES": str(file), "PYTHONPATH": support}
    command = [*PYTEST, "-q", "-n", workers]
    run = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert run.returncode == 1, run.stdout
    told = evidence.joined([file])
    name = "test_suite.py::"
    assert told["tests"] == {
        f"{name}test_good": [1, 0, 0], f"{name}test_of_cases": [1, 1, 0], f"{name}TestAll::test_never": [0, 0, 1],
        f"{name}TestAll::test_known_wrong": [0, 0, 1], f"{name}test_whose_end_fails": [0, 1, 0],
    }  # fmt: skip
    assert told["ids"]["A: 2"] == {f"{name}test_of_cases": [1, 0, 0]}, "the case that is marked, not the other one"
    assert [evidence.joined([file, file])["tests"][f"{name}test_good"]] == [[2, 0, 0]]


@pytest.mark.parametrize(
    ("counts", "result", "code"),
    [
        ([[1, 0, 0]], "verified", 0), ([[3, 0, 1]], "verified", 0), ([[3, 1, 0]], "FAILED", 1),
        ([[0, 0, 2]], "skipped", 0), ([], "not run", 1),
    ],
)  # fmt: skip
def test_a_row_is_verified_only_by_tests_that_passed(evidence, tmp_path, monkeypatch, capsys, counts, result, code):
    test = "tests/docs/test_evidence.py::test_dead_rows_and_marks_are_named"
    (tmp_path / "evidence.toml").write_text(CATALOGUE.replace('"2" = "says two"\n', ""))
    (tmp_path / "security.md").write_text("# Security\n")
    monkeypatch.setattr(evidence, "CATALOGUE", tmp_path / "evidence.toml")
    monkeypatch.setattr(evidence, "SECURITY", tmp_path / "security.md")
    monkeypatch.setattr(evidence, "marked", lambda files: {"A: 1": [test]})
    of_test = dict(zip([test], counts, strict=False))
    told = {"tests": of_test, "ids": {"A: 1": of_test}}
    (tmp_path / "told.json").write_text(json.dumps(told))
    page = tmp_path / "build" / "evidence.md"
    assert evidence.main(["--results", str(tmp_path / "told.json"), "--to", str(page)]) == code
    assert f"| 1 | says one | {result} |" in page.read_text()
    assert "| 3 | says three | left out | left out: nobody wants it |" in page.read_text()
    assert (f"A: 1: {result}: {test}" in capsys.readouterr().out) == (result != "verified")


def test_a_page_that_is_old_is_told(evidence, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(evidence, "PAGE", tmp_path / "evidence.md")
    assert evidence.main(["--check"]) == 1
    assert "evidence.md is old: run scripts/evidence" in capsys.readouterr().out
    assert evidence.main([]) == 0
    assert evidence.main(["--check"]) == 0

"""examples/bench: a project of others, run from a copy of its folder, as it stands."""

import shutil
from pathlib import Path

import pytest
from foreign_project import ROOT, gateway, properties, run
from junitparser import JUnitXml

EXAMPLE = ROOT / "examples" / "bench"


@pytest.fixture
def project(tmp_path):
    """Return a copy of the example."""
    folder = tmp_path / "bench"
    shutil.copytree(EXAMPLE, folder, ignore=shutil.ignore_patterns("__pycache__", "left", ".pytest_cache"))
    return folder


def cases(file):
    return {case.name: case for suite in JUnitXml.fromfile(str(file)) for case in suite}


@pytest.mark.long
def test_it_passes(project):
    assert len([file for file in project.rglob("*") if file.is_file()]) == 10
    code, said = run(project, "--strict-markers", "--junitxml=out.xml")
    assert (code, "4 passed" in said) == (0, True), said
    found = cases(project / "out.xml")
    assert found.keys() == {
        "healthy",
        "blocked",
        "test_a_sensor_without_a_value_is_named",
        "test_more_load_is_more_air",
    }
    told = properties(found["blocked"])
    assert [value for name, value in told if name == "requirement"] == ["FAN-2", "FAN-3"]
    assert any(name == "injected" and value.startswith("actuator gain at 2.0") for name, value in told)
    assert not (project / "left").exists()


@pytest.mark.full("4 s")
def test_its_broken_scenario_fails_and_says_what_was_seen(project):
    code, said = run(project, "broken", "-o", "gateway_scenarios=broken", "--junitxml=out.xml")
    assert (code, "1 failed" in said) == (1, True), said
    failure = cases(project / "out.xml")["too_early"]
    assert "P0480-64 not set by 2.2 s, but at 2." in failure.result[0].text
    assert ("requirement", "FAN-4") in properties(failure)
    left = dict(properties(failure))
    log, report = Path(left["recording"]), Path(left["report"])
    assert log == project / "left" / "too_early" / "can.log"
    assert len(log.read_text().splitlines()) > 1000
    assert "P0480-64" in report.read_text()
    assert f"recording: {log}" in said
    assert failure.system_out.splitlines() == [f"[[ATTACHMENT|{log}]]", f"[[ATTACHMENT|{report}]]"]
    # What is left can be replayed, and shows the same.
    _, replayed = gateway(project, "replay", str(log), "-c", "gateway.toml", "--map", "can0=can")
    assert "P0480-64" in replayed

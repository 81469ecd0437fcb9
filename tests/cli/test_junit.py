"""The JUnit files of simulate and replay, as junitparser reads them."""

from pathlib import Path
from xml.etree import ElementTree

import pytest
from junitparser import Error, Failure, JUnitXml, Skipped

from gateway_bench.cli.simulate import simulate
from gateway_fdi.errors import InputError
from gateway_replay.cli.junit import Case, write_junit
from gateway_replay.cli.replay import replay

ROOT = Path(__file__).parents[2]
BATTERY = (ROOT / "examples" / "battery_voltage" / "drained.toml").read_text()
FOLDER = ROOT / "examples" / "battery_voltage"


@pytest.fixture
def scenario(tmp_path):
    """Return a function that writes the drained battery's scenario with other expectations."""
    for name in ("battery.dbc", "battery_voltage.py", "battery_ecu.py", "gateway.toml"):
        (tmp_path / name).write_text((FOLDER / name).read_text())

    def write(text=BATTERY):
        file = tmp_path / "drained.toml"
        file.write_text(text)
        return file

    return write


def simulated(file, junit, **more):
    asked = {"bus": "inside", "check": False, "wait": 1, "record": None, "seed": None, "json": False, **more}
    return simulate(file, **asked, junit=junit)


def read(path):
    [suite] = JUnitXml.fromfile(str(path))
    return suite, {case.name: case for case in suite}


def test_a_good_scenario(scenario, tmp_path):
    file = scenario(BATTERY.replace("duration_s = 20.0", 'duration_s = 20.0\nrequirement = ["SWR-1", "SWR-2"]'))
    assert simulated(file, tmp_path / "reports" / "out.xml") == 0
    suite, cases = read(tmp_path / "reports" / "out.xml")
    assert (suite.name, suite.tests, suite.failures, suite.errors) == ("drained", 3, 0, 0)
    assert list(cases) == ["P0562-16 set after 5 s by 6 s", "P0562-16 healed by 12 s", "no other DTC"]
    assert not any(case.result for case in cases.values())
    properties = [(p.name, p.value) for p in suite.properties()]
    assert properties[:3] == [("seed", "1"), ("requirement", "SWR-1"), ("requirement", "SWR-2")]


def test_what_is_wrong_names_dtc_time_expected_and_time_seen(scenario, tmp_path):
    text = BATTERY.replace("by_s = 6.0\nhealed_by_s = 12.0", "by_s = 5.2\nhealed_by_s = 5.4")
    more = '\n[[expect]]\ndtc = "P0562-16"\nabsent = true\n[[expect]]\ndtc = "P0562-16"\nhealed_by_s = 10.1\n'
    assert simulated(scenario(text + more), tmp_path / "out.xml") == 1
    suite, cases = read(tmp_path / "out.xml")
    assert suite.failures == sum(any(isinstance(r, Failure) for r in case.result) for case in cases.values()) == 3
    told = {name: case.result[0] for name, case in cases.items() if case.result}
    seen = {"P0562-16 set after 5 s by 5.2 s": "P0562-16 not set by 5.2 s, but at 5."}
    seen["P0562-16 never set"] = "P0562-16 set at 5."
    seen["P0562-16 healed by 10.1 s"] = "P0562-16 not healed by 10.1 s, but at 10."
    assert told.keys() == seen.keys()
    for name, result in told.items():  # in the text, too: GitLab shows nothing else
        assert result.text.startswith(seen[name])
        assert result.message == result.text


def test_a_dtc_that_nobody_expects_is_one_case(scenario, tmp_path):
    text = BATTERY.replace('"P0562-16"', '"P0563-17"')
    assert simulated(scenario(text), tmp_path / "out.xml") == 1
    suite, cases = read(tmp_path / "out.xml")
    assert list(cases) == ["P0563-17 set after 5 s by 6 s", "no other DTC"]
    assert cases["P0563-17 set after 5 s by 6 s"].result[0].text == "P0563-17 not set by 6.0 s"
    assert "P0562-16 set at 5." in cases["no other DTC"].result[0].text
    assert suite.failures == 2


def test_a_gateway_without_dtc_frames_is_judged_by_its_events(scenario, tmp_path):
    file = scenario()
    config = tmp_path / "gateway.toml"
    config.write_text(config.read_text().replace("[output.dtc_frame]\ncycle_ms = 1000.0", ""))
    assert "dtc_frame" not in config.read_text()
    assert simulated(file, None, check=True) == 0
    assert simulated(scenario(BATTERY.replace("by_s = 6.0", "by_s = 5.2")), None, check=True) == 1
    assert simulated(scenario(BATTERY.partition("[[expect]]")[0]), None, check=True) == 1, "nobody expects its DTC"


def replayed(log, config, junit, **more):
    return replay(log, config, memory=None, json=False, fail_on_dtc=False, junit=junit, **more)


def test_a_replay_has_a_case_a_fault(scenario, tmp_path):
    simulated(scenario(), None, record=tmp_path / "drive.log")
    config = tmp_path / "gateway.toml"
    assert replayed(tmp_path / "drive.log", config, tmp_path / "out.xml", injections=["drop BATT @15..18"]) == 0
    suite, cases = read(tmp_path / "out.xml")
    [low] = [case for name, case in cases.items() if name.endswith("P0562-16")]
    assert low.result[0].text.startswith("P0562-16 set at 5.")
    [lost] = [case for name, case in cases.items() if name.endswith("-87")]
    assert "U0100-87 set at 15." in lost.result[0].text
    assert not cases["log is whole"].result
    assert suite.failures == 2
    assert ("injected", "drop BATT @15..18") in [(p.name, p.value) for p in suite.properties()]


def test_what_was_never_tested_is_skipped(scenario, tmp_path):
    simulated(scenario(), None, record=tmp_path / "drive.log")
    log = tmp_path / "drive.log"
    log.write_text(log.read_text().splitlines()[0] + "\n")
    assert replayed(log, tmp_path / "gateway.toml", tmp_path / "out.xml") == 0
    suite, cases = read(tmp_path / "out.xml")
    assert suite.skipped
    assert any(isinstance(case.result[0], Skipped) for case in cases.values() if case.result)


def test_a_damaged_log_is_an_error(scenario, tmp_path):
    simulated(scenario(), None, record=tmp_path / "drive.log")
    log = tmp_path / "drive.log"
    log.write_text(log.read_text()[:2000] + "\nthis is no frame\n")
    with pytest.raises(Exception, match="drive.log"):
        replayed(log, tmp_path / "gateway.toml", tmp_path / "out.xml")
    suite, cases = read(tmp_path / "out.xml")
    assert isinstance(cases["log is whole"].result[0], Error)
    assert suite.errors == 1


def test_files_of_what_failed_are_attached(scenario, tmp_path, monkeypatch):
    monkeypatch.delenv("CI_PROJECT_DIR", raising=False)
    log, report = tmp_path / "drive.log", tmp_path / "report.html"
    wrong = scenario(BATTERY.replace("by_s = 6.0", "by_s = 5.2"))
    assert simulated(wrong, tmp_path / "out.xml", record=log, html=report) == 1
    _, cases = read(tmp_path / "out.xml")
    told = {name: case.system_out for name, case in cases.items() if case.result}
    assert told == {"P0562-16 set after 5 s by 5.2 s": f"[[ATTACHMENT|{log}]]\n[[ATTACHMENT|{report}]]"}
    assert "ATTACHMENT" not in str([case.system_out for case in cases.values() if not case.result])
    # GitLab wants paths in its project.
    monkeypatch.setenv("CI_PROJECT_DIR", str(tmp_path))
    assert replayed(log, tmp_path / "gateway.toml", tmp_path / "out.xml") == 0
    _, cases = read(tmp_path / "out.xml")
    assert [case.system_out for case in cases.values() if case.system_out] == ["[[ATTACHMENT|drive.log]]"]


#: What Jenkins' plugin xunit allows (its junit-10.xsd, version of 2024): attributes, and what stands in it.
ALLOWED = {
    "testsuites": ({"name", "time", "tests", "failures", "errors"}, {"testsuite"}),
    "testsuite": (
        {"name", "tests", "failures", "errors", "time", "skipped", "timestamp", "hostname", "id", "package", "file"},
        {"properties", "testcase", "system-out", "system-err"},
    ),
    "properties": (set(), {"property"}),
    "property": ({"name", "value"}, set()),
    "testcase": ({"name", "time", "classname"}, {"skipped", "error", "failure", "system-out", "system-err"}),
    **{name: ({"type", "message"}, set()) for name in ("skipped", "error", "failure")},
    "system-out": (set(), set()),
}


def test_it_has_what_jenkins_allows_and_no_more(tmp_path):
    cases = [Case("a", "seen"), *(Case(outcome, "why", outcome) for outcome in ("failure", "error", "skipped"))]
    write_junit(tmp_path / "out.xml", "x", cases, 1.5, [("p", 1)], [tmp_path / "drive.log"])
    entries = list(ElementTree.parse(tmp_path / "out.xml").iter())
    assert {entry.tag for entry in entries} == ALLOWED.keys()
    for entry in entries:
        attributes, inside = ALLOWED[entry.tag]
        assert set(entry.keys()) <= attributes, entry.tag
        assert {child.tag for child in entry} <= inside, entry.tag


def test_any_text_is_xml(tmp_path):
    cases = [Case("a", "\x00\x1b[1m<&>\ud800 \u00e4", "failure"), Case("a", "b"), Case("a")]
    write_junit(tmp_path / "out.xml", 'x"<', cases, 1.5, [("p", "\x01")])
    suite, named = read(tmp_path / "out.xml")
    assert list(named) == ["a", "a (2)", "a (3)"]
    assert named["a"].result[0].text == "??[1m<&>? \u00e4"
    assert (suite.name, suite.tests) == ('x"<', 3)
    again = (tmp_path / "out.xml").read_bytes()
    write_junit(tmp_path / "out.xml", 'x"<', cases, 1.5, [("p", "\x01")])
    assert (tmp_path / "out.xml").read_bytes() == again


def test_a_file_that_cannot_be_written_is_told(tmp_path):
    (tmp_path / "out.xml").mkdir()
    with pytest.raises(InputError, match="--junit"):
        write_junit(tmp_path / "out.xml", "x", [Case("a")], 1.0)

"""The plugin in a project of others: pytest runs it in a process of its own, in its own folder."""

import tomllib
from fnmatch import fnmatchcase
from pathlib import Path
from types import SimpleNamespace

import pytest
from foreign_project import ROOT, properties, run
from junitparser import JUnitXml

from gateway.bus.frames import empty, put
from gateway.servers.uds.params import UdsParams
from gateway_bench.pytest_plugin.fixtures import left_in
from gateway_bench.pytest_plugin.scenario_run import ScenarioRun, leave
from gateway_bench.pytest_plugin.uds import _Transport

EXAMPLE = ROOT / "examples" / "battery_voltage"
DRAINED = (EXAMPLE / "drained.toml").read_text().replace('"gateway.toml"', '"../gateway.toml"')
for _old, _new in (
    ("duration_s = 20.0", "duration_s = 7.0"),
    ("from_s = 5.0\nto_s = 10.0", "from_s = 1.0\nto_s = 3.0"),
    ("after_s = 5.0\nby_s = 6.0\nhealed_by_s = 12.0", "after_s = 1.0\nby_s = 2.0\nhealed_by_s = 6.0"),
):
    assert _old in DRAINED
    DRAINED = DRAINED.replace(_old, _new)
BROKEN = DRAINED.replace("by_s = 2.0", "by_s = 1.1")
INI = "[pytest]\ngateway_scenarios = scenarios\ngateway_config = gateway.toml\n"
TESTS = """
import pytest

pytestmark = pytest.mark.requirement("SWR-1", "SWR-2")


def battery(virtual_ecu, **more):
    virtual_ecu("battery_ecu:ECU", volts=12.6, duration_s=20, **more)


def test_drained(gateway_bench, virtual_ecu, dtcs, can_log):
    battery(virtual_ecu, faults=[{"kind": "drained", "from_s": 5.0, "to_s": 10.0, "volts": 10.5}])
    set_at = dtcs.expect("P0562-16", by=6.0, after=5.0, healed_by=12.0)
    assert 5.0 < set_at < 6.0
    assert dtcs.failed == []
    dtcs.none(but=("P0562-16",))
    times = [t for t, values in can_log.of("BATT") if values["Voltage"] < 11]
    assert 5.0 <= min(times) and max(times) <= 10.1
    assert gateway_bench.now_s < 12.0
    assert [fact.kind for fact in gateway_bench.truth] == ["drained"]


def test_its_clock_and_single_frames(gateway_bench, dtcs):
    for _ in range(20):
        gateway_bench.send("BATT", Voltage=12.5)
        gateway_bench.run(0.1)
    dtcs.none()
    gateway_bench.run(0.3)
    assert abs(gateway_bench.now_s - 2.3) < 1e-9
    gateway_bench.run(0.5)
    assert dtcs.failed == ["U0100-87"]


def test_an_ecu_is_switched_off(gateway_bench, virtual_ecu, dtcs):
    battery(virtual_ecu)
    dtcs.none(until=2.0)
    gateway_bench.switch_off("battery")
    assert 2.3 < dtcs.expect("U0100-87", by=3.0) < 2.7


def test_by_uds(gateway_bench, virtual_ecu, dtcs, uds):
    battery(virtual_ecu, faults=[{"kind": "drained", "from_s": 1.0, "to_s": 9.0, "volts": 10.5}])
    dtcs.expect("P0562-16", by=3.0)
    answer = uds.get_dtc_by_status_mask(0x01)
    assert [dtc.id for dtc in answer.service_data.dtcs] == [0x056216]
    assert len(uds.get_supported_dtc().service_data.dtcs) > 1          # more than one frame
    assert 3.0 < gateway_bench.now_s + 2.0 < 6.0
"""
FAILING = """
def test_too_early(virtual_ecu, dtcs, can_log):
    virtual_ecu("battery_ecu:ECU", volts=12.6, duration_s=20,
                faults=[{"kind": "drained", "from_s": 5.0, "to_s": 10.0, "volts": 10.5}])
    dtcs.expect("P0562-16", by=5.1)


def test_heals(virtual_ecu, dtcs):
    virtual_ecu("battery_ecu:ECU", volts=12.6, duration_s=20,
                faults=[{"kind": "drained", "from_s": 5.0, "to_s": 10.0, "volts": 10.5}])
    dtcs.expect("P0562-16", by=6.0, healed_by=9.0)


def test_misspelt(dtcs):
    dtcs.expect("P0562-17", by=1.0)


def test_without_end(gateway_bench, virtual_ecu):
    virtual_ecu("battery_ecu:ECU", duration_s=1)
    gateway_bench.run(2.0)


def test_misspelt_ecu(virtual_ecu):
    virtual_ecu("restbuss")
"""


@pytest.fixture
def project(tmp_path):
    """Return the folder of a project with the example's battery."""
    for name in ("battery.dbc", "battery_voltage.py", "battery_ecu.py", "gateway.toml"):
        (tmp_path / name).write_text((EXAMPLE / name).read_text())
    (tmp_path / "gateway.toml").write_text((tmp_path / "gateway.toml").read_text() + "[output.uds]\n")
    (tmp_path / "scenarios").mkdir()
    (tmp_path / "tests").mkdir()
    (tmp_path / "pytest.ini").write_text(INI)
    for name in ("battery_voltage.py", "battery_ecu.py"):  # those that a scenario's folder has beside it
        (tmp_path / "scenarios" / name).write_text((EXAMPLE / name).read_text())
    return tmp_path


@pytest.mark.long
def test_scenarios_and_fixtures(project):
    (project / "scenarios" / "drained.toml").write_text(
        DRAINED.replace("[[ecu]]", 'requirement = ["SWR-7"]\n[[ecu]]', 1)
    )
    (project / "tests" / "test_battery.py").write_text(TESTS)
    code, said = run(project, "--junitxml=out.xml", "--strict-markers")
    assert (code, "5 passed" in said) == (0, True), said
    cases = {case.name: case for suite in JUnitXml.fromfile(str(project / "out.xml")) for case in suite}
    assert len(cases) == 5
    told = properties(cases["drained"])
    assert ("requirement", "SWR-7") in told
    assert ("seed", "1") in told
    assert any(name == "verdict" and value.startswith("P0562-16 set at 1.") for name, value in told)
    assert [p for p in properties(cases["test_drained"]) if p[0] == "requirement"] == [
        ("requirement", "SWR-1"),
        ("requirement", "SWR-2"),
    ]


@pytest.mark.long
@pytest.mark.parametrize("workers", [pytest.param("0", marks=pytest.mark.full("6 s")), "2"])
def test_a_broken_scenario_fails(project, workers):
    (project / "scenarios" / "broken.toml").write_text(BROKEN)
    (project / "scenarios" / "misspelt.toml").write_text(DRAINED.replace("battery_ecu:ECU", "battery_ec:ECU"))
    (project / "scenarios" / "settings.toml").write_text('name = "no scenario"\n')
    code, said = run(project, "-n", workers, "--junitxml=out.xml")
    assert (code, "2 failed" in said) == (1, True), said
    assert "NOT as expected: P0562-16 not set by 1.1 s, but at 1." in said
    assert "as expected: P0562-16 healed" not in said.split("seed 1")[0].split("NOT as expected")[0]
    cases = {case.name: case for suite in JUnitXml.fromfile(str(project / "out.xml")) for case in suite}
    assert cases.keys() == {"broken", "misspelt"}
    assert "P0562-16 not set by 1.1 s, but at 1." in cases["broken"].result[0].text
    assert "misspelt.toml: ecu[0].type" in cases["misspelt"].result[0].text
    assert "Traceback" not in said


@pytest.mark.parametrize(
    ("nodeid", "folder"),
    [
        ("tests/test_a.py::test_b", "tests/test_a/test_b"),
        ("test_a.py::TestC::test_b[4-x=1]", "test_a/TestC/test_b[4-x=1]"),
        ("../test_a.py::test_b", "..-????????/test_a/test_b"),
        ("test_a.py::test_b[P0562/16 | 2]", "test_a/test_b[P0562_16___2]-????????"),
        (f"test_a.py::test_b[{'x' * 300}]", f"test_a/test_b[{'x' * 93}-????????"),
    ],
)
def test_each_test_leaves_its_files_in_a_folder_of_its_own(nodeid, folder):
    left = left_in(Path("left"), nodeid)
    assert fnmatchcase(str(left), f"left/{folder.replace('[', '[[]')}")
    assert left_in(Path("left"), nodeid) == left
    assert left_in(Path("left"), nodeid.replace("/", "_")) != left or "/" not in nodeid


@pytest.mark.long
@pytest.mark.parametrize("artifacts", [pytest.param(False, marks=pytest.mark.full("3 s")), True])
def test_what_fails_says_what_was_seen(project, artifacts):
    (project / "tests" / "test_battery.py").write_text(FAILING)
    folder = ("-o", "gateway_artifacts=left") if artifacts else ()
    code, said = run(project, "--junitxml=out.xml", "-o", "junit_logging=system-out", *folder)
    assert (code, "5 failed" in said) == (1, True), said
    for text in (
        "P0562-16 not set by 5.1 s (set so far: none; now 5.100 s)",
        "P0562-16 not healed by 9.0 s, set at 5.",
        "did you mean P0563-17 or P0562-16?",
        "virtual ECU 'battery' sends until 1 s only: give it a duration_s",
        "did you mean restbus?",
        "can.log",
    ):
        assert text in said, text
    assert "packages/gateway_bench/pytest_plugin/" not in said  # the way through our own code helps nobody
    [log] = [line for line in said.splitlines() if line.strip().endswith("can.log")]
    assert Path(log.strip()).stat().st_size > 1000
    wanted = project / "left" / "tests" / "test_battery" / "test_too_early" / "can.log"
    assert (Path(log.strip()) == wanted) == artifacts
    cases = {case.name: case for suite in JUnitXml.fromfile(str(project / "out.xml")) for case in suite}
    assert f"[[ATTACHMENT|{log.strip()}]]" in cases["test_too_early"].system_out.splitlines()
    assert not any("ATTACHMENT" in (case.system_out or "") for name, case in cases.items() if name != "test_too_early")


@pytest.mark.long
def test_a_checked_monitor_says_its_seed(project):
    (project / "tests" / "test_monitor.py").write_text(
        "import sys\n\nsys.path.append('.')\nfrom battery_voltage import MONITOR\n\n"
        "def test_it(check_monitor):\n    check_monitor(MONITOR, low=10.5)\n"
    )
    code, said = run(project, "tests", "--junitxml=out.xml", "--gateway-seed", "7")
    assert (code, "1 passed" in said) == (0, True), said
    (case,) = (case for suite in JUnitXml.fromfile(str(project / "out.xml")) for case in suite)
    assert ("seed", "7") in properties(case)


def test_who_does_not_ask_gets_nothing(project):
    (project / "pytest.ini").write_text("[pytest]\n")
    (project / "scenarios" / "broken.toml").write_text(BROKEN)
    # Options of the conformance suite are free for others, where it is not what runs.
    (project / "conftest.py").write_text("def pytest_addoption(parser):\n    parser.addoption('--target')\n")
    (project / "tests" / "test_plain.py").write_text(
        "import sys\n\ndef test_nothing(request):\n"
        "    assert not [name for name in sys.modules if name.split('.')[0] in ('gateway', 'cantools', 'numpy')]\n"
        "    assert request.config.pluginmanager.get_plugin('gateway_bench.pytest_plugin.plugin') is None\n"
        "    with __import__('pytest').raises(Exception, match='gateway_bench'):\n"
        "        request.getfixturevalue('gateway_bench')\n"
    )
    code, said = run(project, "--target", "gateway_conformance_of_others")
    assert (code, "1 passed" in said) == (0, True), said


@pytest.mark.long
def test_a_folder_that_is_not_there_is_told(project):
    (project / "pytest.ini").write_text("[pytest]\ngateway_scenarios = scenaros\n")
    code, said = run(project)
    assert (code, "gateway_scenarios: no such folder" in said) == (4, True), said


def test_the_door_is_an_entry_point():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    assert project["project"]["entry-points"]["pytest11"] == {"gateway": "gateway_pytest"}
    assert "packages/gateway_pytest" in project["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"]


def test_frames_of_requests_are_as_long_as_can_has_them_and_filled_with_cc():
    """ISO 15765-2 recommends 0xCC for bytes that carry nothing."""
    sent = []
    bench = SimpleNamespace(
        config=SimpleNamespace(bus=()),
        on_frames=lambda take: None,
        send_frame=lambda *frame, **how: sent.append((frame, how)),
    )
    _Transport(bench, UdsParams()).send(b"\x3e\x00")
    assert sent == [((0x7E0, b"\x02\x3e\x00" + 5 * b"\xcc"), {"bus": 0, "fd": False})]


def test_the_recording_of_a_scenario_on_buses_is_left_in_its_folder(tmp_path):
    frames = empty(2)
    put(frames, 0, t_ns=10**9, can_id=0x123, payload=b"\x01\x02")
    put(frames, 1, t_ns=2 * 10**9, can_id=0x124, payload=b"")
    folder = tmp_path / "left" / "drained"
    left = list(leave(folder, None, None, None, ScenarioRun((), (), (frames[:1], frames[1:]))))
    assert left == [("recording", folder / "can.log")]
    assert (folder / "can.log").read_text().splitlines() == ["(1.000000000) can0 123#0102", "(2.000000000) can0 124#"]

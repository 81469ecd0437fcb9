"""--gateway-bus: the example's tests on a bus between processes, where python-can listens."""

import shutil
import threading
from collections import Counter

import can
import cantools
import pytest
from foreign_project import ROOT, run
from processes import bus

EXAMPLE = ROOT / "examples" / "bench"
#: No test is to fail because the machine is busy: what it looks at is watched with more patience here.
PATIENT = [("timeout_ms = 200.0", "timeout_ms = 2000.0")]


@pytest.fixture
def project(tmp_path):
    """Return a copy of the example whose gateway is patient."""
    folder = tmp_path / "bench"
    shutil.copytree(EXAMPLE, folder, ignore=shutil.ignore_patterns("__pycache__", "left", ".pytest_cache"))
    config = (folder / "gateway.toml").read_text()
    for old, new in PATIENT:
        assert old in config
        config = config.replace(old, new)
    (folder / "gateway.toml").write_text(config)
    return folder


@pytest.mark.system
def test_the_same_tests_on_a_bus(project, tmp_path):
    with bus(tmp_path) as uri:
        host, _, port = uri.removeprefix("loopback:").rpartition(":")
        seen, errors = Counter(), []
        with can.Bus(interface="socketcand", host=host, port=int(port.partition("/")[0]), channel="can0") as peer:
            database = cantools.database.load_file(project / "fan.dbc")
            over = threading.Event()

            def listen():
                while not over.is_set():
                    message = peer.recv(0.2)
                    if message is not None:
                        seen[message.arbitration_id] += 1
                        try:
                            if message.arbitration_id in (256, 272, 288):
                                database.decode_message(message.arbitration_id, message.data)
                        except Exception as error:  # told below
                            errors.append(error)

            thread = threading.Thread(target=listen)
            thread.start()
            try:
                code, said = run(
                    project, "--gateway-bus", uri, "--junitxml=out.xml",
                    "scenarios/blocked.toml", "test_fan.py::test_a_sensor_without_a_value_is_named",
                )  # fmt: skip
            finally:
                over.set()
                thread.join(60)
    assert (code, "2 passed" in said) == (0, True), said
    assert not errors
    assert min(seen[256], seen[272], seen[288]) > 300, "50 a second, for seconds"
    assert seen[0x7E0] > 0, "a tester's request"
    assert seen[0x7E8] > 0, "its answer"


@pytest.mark.long
def test_workers_do_not_share_a_bus(project):
    code, said = run(project, "--gateway-bus", "virtual:x", "-n", "2", "scenarios/healthy.toml")
    assert code == 4
    assert "cannot share a bus" in said, said


@pytest.mark.long
def test_what_is_no_bus_is_told(project):
    code, said = run(project, "--gateway-bus", "nowhere:x", "scenarios/healthy.toml")
    assert code == 1
    assert "no such kind of bus" in said, said
    code, said = run(project, "--gateway-bus", "kan=virtual:x", "scenarios/healthy.toml")
    assert code == 1
    assert "did you mean can?" in said, said


@pytest.mark.system
@pytest.mark.full("8 s")
def test_workers_have_buses_of_their_own(project):
    code, said = run(
        project, "--gateway-bus", "virtual:{worker}", "-n", "2", "scenarios/healthy.toml", "scenarios/blocked.toml"
    )
    assert (code, "2 passed" in said) == (0, True), said

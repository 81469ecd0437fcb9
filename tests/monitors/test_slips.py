"""What an author of a monitor can do wrong: each slip is named in one line, and a healthy monitor goes on beside it."""

import json
import sys

import pytest
from slips import REFUSED, RUNNING, running_source
from structlog.testing import capture_logs

from gateway.bus.frames import empty, put
from gateway.cli.step_lines import text_of
from gateway.config.load import load_config
from gateway.faults import service
from gateway.runtime.app import Gateway
from gateway_commands.check import check
from gateway_fdi.common.resources import shipped
from gateway_fdi.errors import GatewayError
from gateway_replay.trace import Trace, only

CONFIG = """
[[bus]]
name = "can"
uri = "virtual:can0"
database = ["{database}"]

[[monitor]]
name = "slips"
type = "{module}:MONITOR"
{more}

[[monitor]]
name = "healthy"
type = "made_well:MONITOR"

[fault."healthy.low"]
dtc = "P1000-16"
[fault."healthy.high"]
dtc = "P1000-17"
[memory]
path = "{folder}/faults.sqlite"
"""
EXAMPLE = shipped("examples/battery_voltage")
PERIOD_NS = 100_000_000
VOLTS = [12.6] * 3 + [10.5] * 8 + [25.0] * 3 + [12.6] * 12 + [10.5] * 12 + [12.6] * 12


@pytest.fixture(autouse=True)
def _path_as_before(monkeypatch):
    """Load_config puts the configuration's folder there."""
    monkeypatch.setattr(sys, "path", [*sys.path])


@pytest.fixture(scope="module", autouse=True)
def _imported():
    """Take modules of these tests away that others may have by the same name."""
    yield
    sys.modules.pop("made_well", None)


def write(folder, module, source, more=""):
    """Write a configuration with a monitor that slips, and a healthy one."""
    (folder / f"{module}.py").write_text(source)
    (folder / "made_well.py").write_text((EXAMPLE / "battery_voltage.py").read_text())
    text = CONFIG.format(folder=folder, database=EXAMPLE / "battery.dbc", module=module, more=more)
    (folder / "gateway.toml").write_text(text)
    return folder / "gateway.toml"


def refusal(work):
    with pytest.raises(GatewayError) as refused:
        work()
    return str(refused.value)


def start(path):
    gateway = Gateway(load_config(path), None, file=path)
    try:
        gateway.start(0)
    finally:
        gateway.close()


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_run_is_refused_in_one_line_that_names_file_and_slip(tmp_path, case):
    slip = REFUSED[case]
    module = "refused_" + "".join(filter(str.isalnum, case)).lower()
    path = write(tmp_path, module, slip.source(module))
    text = refusal(lambda: check(path, schema_wanted=False, json=False))
    assert slip.told in text
    assert "\n" not in text
    assert (slip.of or module) in text
    if slip.at:
        (line,) = [
            k for k, line in enumerate((tmp_path / f"{module}.py").read_text().splitlines(), 1) if slip.at in line
        ]
        assert text.startswith(f"{tmp_path / module}.py:{line}: ")
    if not slip.told.startswith(("Notes", "Warnings")):  # nobody asks for these but check
        assert refusal(lambda: start(path)) == text


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Where the module lies that is imported once."""
    return tmp_path_factory.mktemp("running")


@pytest.fixture
def played(tmp_path, folder):
    """Plays the voltages to a monitor with a slip and to a healthy one; returns events, lines, and the gateway."""

    def play(number):
        path = write(folder, MODULE, running_source(MODULE), f"slip = {number}")
        gateway = Gateway(load_config(path), tmp_path / "faults.sqlite", file=path)
        told = []
        gateway.listen(told.append)
        with capture_logs() as lines:
            gateway.start(0)
            message = gateway.databases[0].message("BATT")
            for k, volts in enumerate(VOLTS):
                frame = empty(1)
                put(frame, 0, (k + 1) * PERIOD_NS, message.frame_id, message.encode({"Voltage": volts}))
                gateway.feed(frame)
            gateway.close()
        return told, lines, gateway, path

    return play


def test_a_slip_does_not_hide_the_configuration_s_own_mistakes(tmp_path, capsys):
    path = write(tmp_path, "refused_hides", REFUSED["faults fails"].source("refused_hides"))
    path.write_text(path.read_text().replace('"P1000-17"', '"P1000-16"'))
    assert check(path, schema_wanted=False, json=True) == 2
    told = json.loads(capsys.readouterr().out)["errors"]
    assert [error["key"] for error in told] == ['monitor type "refused_hides".faults', 'fault."healthy.high".dtc']


def test_a_capability_that_fails_is_an_error_of_check_in_json_too(tmp_path, capsys):
    path = write(tmp_path, "refused_notes", REFUSED["notes fail"].source("refused_notes"))
    assert check(path, schema_wanted=False, json=True) == 2
    (error,) = json.loads(capsys.readouterr().out)["errors"]
    assert error["key"] == 'monitor type "refused_notes".Notes.of'


MODULE = "slips_while_it_runs"


def verdicts(told, fault):
    return [(e["t_ns"], e["status"] & 1) for e in told if e["event"] == "dtc" and e["fault"] == fault]


HEALTHY = [(k * PERIOD_NS, status) for k, status in ((8, 1), (21, 0), (31, 1), (48, 0))]


def test_without_a_slip_both_say_the_same(played):
    told, lines, _, path = played(-1)
    assert verdicts(told, "healthy.low") == verdicts(told, "slips.low") == HEALTHY
    assert lines == []
    assert check(path, schema_wanted=False, json=True) == 0


@pytest.mark.parametrize(
    ("case", "told"),
    [
        ("a value that is no number", "low not tested: nan against 11"),
        ("a number above its faults", "number 7: there is none failed: 25 against 11"),
        ("a cause of its own", f"number {1 << 40}"),
        ("an exception", None),
    ],
)
def test_a_trace_shows_what_a_step_did(folder, case, told):
    path = write(folder, MODULE, running_source(MODULE), f"slip = {list(RUNNING).index(case)}")
    gateway = Gateway(only(load_config(path), "slips"), None, file=path)
    trace = Trace(gateway.engine)
    gateway.start(0)
    frame = empty(1)
    put(frame, 0, PERIOD_NS, 0x510, (25_000).to_bytes(2, "little") + bytes(6))
    gateway.feed(frame)
    lines = [line for step in trace.steps() for line in text_of(step, 0, 200)]
    gateway.close()
    assert (told is None and lines == []) or told in "\n".join(lines)


@pytest.mark.parametrize("case", RUNNING)
def test_what_slips_while_it_runs_is_named_in_one_line_and_harms_nobody(tmp_path, folder, played, case):
    slip, number = RUNNING[case], list(RUNNING).index(case)
    told, lines, gateway, path = played(number)
    assert verdicts(told, "healthy.low") == HEALTHY
    assert verdicts(told, "healthy.high") == []
    steps = {name: shown["steps"] for name, shown in gateway.engine.readout().items()}
    assert steps["healthy"] == len(VOLTS)
    assert (steps["slips"] == VOLTS.index(25.0)) == bool(slip.off)
    off = [event for event in told if event["event"] == "monitor_off"]
    assert [slip.off in event["reason"] for event in off] == [True] * bool(slip.off)
    assert bool(verdicts(told, "gateway.monitor_off")) == bool(slip.off)
    file = str(folder / f"{MODULE}.py")
    assert len(lines) == bool(slip.off or slip.said), lines
    assert all(line["file"] == file and (slip.off or slip.said) in line["reason"] for line in lines)
    assert min(gateway.engine.counters().values()) >= 0
    kept = {entry["fault"] for entry in service.list_entries(tmp_path / "faults.sqlite")}
    assert {e["fault"] for e in told if e["event"] == "dtc"} == kept
    assert service.verify(tmp_path / "faults.sqlite")["whole"]
    if slip.check:
        text = refusal(lambda: check(path, schema_wanted=False, json=False))
        assert slip.check in text
        assert text.startswith(f"{file}: ")
        assert "\n" not in text
    else:
        assert check(path, schema_wanted=False, json=True) == 0

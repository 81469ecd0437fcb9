"""What a person and a program see first is the cause, of the diagnosis; its symptoms are folded below it."""

import json
import re

import pytest
from rich.console import Console
from shared_signal import config, frames
from typer.testing import CliRunner

from gateway.cli import app
from gateway.faults import service
from gateway.faults.fault_groups import cases_of
from gateway.runtime.app import Gateway
from gateway_serve.broker import Broker
from gateway_serve.cli.run_report import RunReport
from gateway_serve.cli.watch import as_json, drawn
from gateway_serve.hello import described
from gateway_serve.hub import Hub
from gateway_serve.memory import MemoryFile
from gateway_serve.metrics import Metrics
from gateway_serve.mqtt import Published, Publisher
from gateway_serve.report.page import Words, write_report

SPEED = "signal can0.Speed.V"
HOLD = 'symptoms = "hold"'


@pytest.fixture
def shown(tmp_path):
    """A hub that has heard of a gateway whose Speed is wrong, and the gateway's memory."""
    path = tmp_path / "m.sqlite"
    gateway = Gateway(config(tmp_path, memory=HOLD), path)
    gateway.start(0)
    gateway.feed(frames(0.0, 5.0))
    gateway.feed(frames(5.0, 8.0, Speed=40))
    hub = Hub(tmp_path / "nobody")
    hub._on_link(True, "")
    hub._on_hello(json.loads(json.dumps(described(gateway))), b"")
    hub.memory = MemoryFile(path).read(hub.hello["faults"])
    yield hub, path
    gateway.close()


def test_a_case_is_a_cause_with_what_it_explains(shown):
    hub, path = shown
    (case,) = hub.memory["cases"]
    assert (case["components"], case["proven"], case["failing"]) == ([SPEED], True, 3)
    assert case["faults"] == ["rules.A", "rules.B", "rules.C"], "the one that stands for it first"
    entries = service.list_entries(path)
    other = {**entries[0], "fault": "other", "dtc": "U0001-00", "cause": None, "last_ns": 10**15}
    healed = {**entries[0], "fault": "old", "status": 0x2E, "cause": None, "last_ns": 10**16}
    assert [c.entries[0]["fault"] for c in cases_of([healed, other, *entries])] == ["rules.A", "other", "old"]


def test_the_terminal_leads_with_the_cause_in_eighty_columns(shown):
    hub, path = shown
    console = Console(width=80)
    with console.capture() as captured:
        console.print(drawn(hub))
    lines = captured.get().splitlines()
    assert f"1 now: {SPEED}" in lines[0]
    assert "U" not in lines[0], "no code: they are symptoms"
    at = next(k for k, line in enumerate(lines) if line.startswith(f"{SPEED} ("))
    codes = {entry["fault"]: entry["dtc"] for entry in service.list_entries(path)}
    for line, (fault, indent) in zip(lines[at + 1 :], [("rules.A", 2), ("rules.B", 4), ("rules.C", 4)], strict=False):
        assert line.startswith(f"{'':{indent}}{codes[fault]}")
        assert ("held" in line) == (indent == 4)
    assert max(map(len, lines)) <= 80
    assert as_json(hub)["causes"][0]["components"] == [SPEED]


def test_metrics_and_mqtt_say_it(shown, tmp_path):
    hub, _ = shown
    text = Metrics(hub).text().decode()
    assert re.search(rf'gateway_cause_faults{{cause="{SPEED}",proven="true"}} 3.0', text)
    assert re.search(rf'gateway_cause_probability{{cause="{SPEED}",proven="true"}} (0\.9|1\.0)', text)
    assert "gateway_symptoms_held 2.0" in text
    states = Publisher(hub, Broker(host="127.0.0.1"), Published(), "car").states()
    (case,) = json.loads(states["gateway/car/causes"])
    assert (case["components"], case["faults"][0]) == ([SPEED], "rules.A")
    held = json.loads(states["gateway/car/dtc/rules.B"])
    assert (held["cause"]["role"], held["cause"]["lead"], held["hold"]) == ("symptom", "rules.A", "held")


def test_the_commands_say_it(shown):
    _, path = shown
    listed = CliRunner().invoke(app, ["faults", "list", "--memory", str(path)]).output.splitlines()
    assert listed[0] == f"Cause: {SPEED}"
    assert listed[2].startswith(SPEED)
    assert "0x2F confirmed" in listed[3]
    assert "0x27 held" in listed[5]
    codes = {entry["fault"]: entry["dtc"] for entry in service.list_entries(path)}
    one = CliRunner().invoke(app, ["faults", "show", codes["rules.B"], "--memory", str(path)]).output
    assert re.search(rf"^cause +{SPEED} \((9[0-9]|100)", one, re.MULTILINE)
    assert f"a symptom; {codes['rules.A']} stands for the cause; held" in one
    assert f"with      {codes['rules.C']}  rules.C" in one
    lead = CliRunner().invoke(app, ["faults", "show", codes["rules.A"], "--memory", str(path)]).output
    assert "a symptom, stands for the cause" in lead


def test_a_report_leads_with_the_cause(tmp_path):
    gateway = Gateway(config(tmp_path, memory=HOLD))
    report = RunReport(tmp_path / "r.html", gateway, tmp_path / "car.toml")
    report.collector.start(0)
    report.collector.feed(frames(0.0, 5.0))
    report.collector.feed(frames(5.0, 8.0, Speed=40))
    report.collector.stop(8 * 10**9)
    assert len(report.collector.windows) == 3, "a confirmation that has waited is no other failure"
    write_report(tmp_path / "r.html", gateway, report.collector, Words("car", (), tmp_path / "car.toml"))
    text = (tmp_path / "r.html").read_text()
    verdict = text[text.index('<section class="verdict') :]
    assert verdict.index(f"Cause: {SPEED}") < verdict.index('class="case proven"')
    cases = text[text.index('class="case proven"') :]
    assert cases.index("rules.A") < cases.index("2 more that it explains") < cases.index("rules.B")
    gateway.close()

"""Metrics: what a scraper reads, named by the catalogue, and what the shipped rules and dashboard ask for is there."""

import json
import re
import subprocess
from pathlib import Path

import numpy as np
import pytest
from debian import program
from prometheus_client.parser import text_string_to_metric_families

from gateway.config.load import load_config
from gateway.engine.buckets import TickRow
from gateway.faults.explanation import HELD
from gateway.runtime.app import Gateway
from gateway_fdi.common.resources import shipped
from gateway_serve.broker import Broker
from gateway_serve.hello import described
from gateway_serve.hub import Hub
from gateway_serve.memory import BITS
from gateway_serve.metrics import Metrics
from gateway_serve.mqtt import Published, Publisher

DEPLOY = Path(__file__).parents[2] / "deploy"


@pytest.fixture
def hub(tmp_path):
    gateway = Gateway(load_config(shipped("gateway.toml")))
    made = Hub(tmp_path / "nobody")
    made._on_link(True, "")
    made._on_hello(json.loads(json.dumps(described(gateway))), b"")
    gateway.close()
    made.memory = {**made.memory, "status": {"crank.missed_pulse": 0x2F}}
    rows = np.zeros(1, TickRow.dtype)
    rows["count"] = rows["numbers"] = 1
    rows["ratio"] = 0.75
    made._on_tick({"t_ns": 10**9}, rows.tobytes())
    traffic = {"frames": 7, "errors": 0, "nominal_bits": 900, "data_bits": 0, "others": 0}
    state = {"bus": "powertrain", "state": "open", "received": 7, "overflow": 2, "losses": 1, "errors": {"bus_off": 1}}
    for t_ns in (10**9, 2 * 10**9):
        bus = {**state, "traffic": {**traffic, "nominal_bits": 50_000 * t_ns // 10**9}}
        counters = dict.fromkeys(("frames", "decoded", "timeouts", "crc_failed", "events_lost"), 5)
        made._on_buses({"t_ns": t_ns, "buses": [bus], "counters": counters}, b"")
    return made


def samples(text):
    families = list(text_string_to_metric_families(text.decode()))
    return {(s.name, *sorted(s.labels.items())): s.value for family in families for s in family.samples}


#: All metrics but those of the engine's counters, by name, with the values of their labels.
WANTED = """
up 1
monitoring_on 0
dtc_status testFailed P0336-39 crank.missed_pulse 1
dtc_status testFailedThisOperationCycle P0336-39 crank.missed_pulse 1
dtc_status pendingDTC P0336-39 crank.missed_pulse 1
dtc_status confirmedDTC P0336-39 crank.missed_pulse 1
dtc_status testNotCompletedSinceLastClear P0336-39 crank.missed_pulse 0
dtc_status testFailedSinceLastClear P0336-39 crank.missed_pulse 1
dtc_status testNotCompletedThisOperationCycle P0336-39 crank.missed_pulse 0
dtc_status warningIndicatorRequested P0336-39 crank.missed_pulse 0
test_ratio crank.missed_pulse 0.75
dtc_occurrences P0336-39 crank.missed_pulse 3
cause_probability wire and sensor true 0.9
cause_faults wire and sensor true 2
symptoms_held 1
memory_stored 1
restarts_total 4
bus_open powertrain 1
bus_open body 0
bus_load_ratio powertrain 0.1
bus_frames_total powertrain 7
bus_frames_lost_total powertrain 2
bus_losses_total powertrain 1
bus_errors_total powertrain bus_off 1
reports_total passed battery 8
reports_total passed  5
reporter_losses_total battery 2
reporter_lost battery 1
ecu_requests_total engine 11
ecu_outcomes_total engine answered 9
ecu_dtc P0A80 engine 1
ecu_dtc P0A81 engine 0
exceptions_total status gateway first 6
exceptions_total  gateway second 0
exceptions_total  page first 0
exceptions_total  page second 0
engine_frames_total 5
engine_decoded_total 5
engine_timeouts_total 5
engine_crc_failed_total 5
engine_events_lost_total 5
page_missed_ticks_total 12
page_refused_total 13
"""


def test_metrics_say_what_is(hub):
    hub.monitoring = {**hub.monitoring, "on": False}
    entry = {"fault": "crank.missed_pulse", "occurrence": 3, "hold": HELD}
    case = {"components": ["wire", "sensor"], "proven": True, "probability": 0.9, "failing": 2}
    hub.memory |= {"entries": [entry, {"fault": "gone", "hold": ""}], "cases": [case, {"failing": 0}]}
    dtcs = [{"ecu": "engine", "dtc": dtc, "there": there} for dtc, there in (("P0A80", True), ("P0A81", False))]
    hub.memory |= {"restarts": {"count": 4}, "ecu_dtcs": dtcs}
    hub.buses.append({"bus": "body", "state": "lost", "load": None, "errors": {}})
    hub.reporters = [
        {"reporter": "battery", "lost": True, "counts": {"passed": 8, "lost": 2}},
        {"reporter": "", "lost": False, "counts": {"passed": 5}},
    ]
    hub.ecus = [{"ecu": "engine", "requests": 11, "answered": 9, "protocol": "obd"}]
    hub.exceptions = {"first": {"status": 6}, "second": {}}
    hub.missed, hub.refused = 12, 13
    metrics = Metrics(hub)
    found = samples(metrics.text())
    lines = [" ".join([name, *(value for _, value in labels), f"{found[name, *labels]:g}"]) for name, *labels in found]
    assert lines == [f"gateway_{line}" for line in WANTED.split("\n")[1:-1]]
    assert "gateway_test_ratio" not in {name for name, *_ in samples(metrics.text())}, "the worst since the last scrape"


def test_security_events_are_metrics_states_of_a_broker_and_listed(hub):
    told = {"event": "security", "t_ns": 10**9, "sensor": "powertrain.3A1", "kind": "unknown"}
    for count, total in ((1, 1), (99, 100)):
        hub._on_event({"event": {**told, "count": count, "total": total, "context": {"frames": total}}}, b"")
    assert (
        samples(Metrics(hub).text())["gateway_security_events_total", ("kind", "unknown"), ("sensor", "powertrain.3A1")]
        == 100.0
    )
    states = Publisher(hub, Broker(host="nowhere"), Published(), "car").states()
    assert json.loads(states["gateway/car/security/powertrain.3A1/unknown"])["total"] == 100
    assert [event["total"] for event in hub.events] == [1, 100]


def test_labels_are_those_of_the_catalogue(hub):
    """Whatever the wire says: no label is of a frame, a reason or a file."""
    known = {fault["id"] for fault in hub.hello["faults"]} | {fault["dtc"] for fault in hub.hello["faults"]}
    known |= {"powertrain", "bus_off", *BITS, "gateway", "page", "first", "second", ""}
    for key in samples(Metrics(hub).text()):
        assert {value for _, value in key[1:]} <= known


def test_what_the_rules_and_the_dashboard_ask_for_is_there(hub):
    told = {key[0] for key in samples(Metrics(hub).text())} | {"gateway_dtc_occurrences", "gateway_cause_faults"}
    asked = set()
    for file in ("prometheus/gateway.rules.yml", "grafana/gateway.json"):
        text = (DEPLOY / file).read_text()
        names = re.findall(r"gateway_[a-z_]+", text)
        assert names, file
        asked |= set(names)
    assert asked <= told, asked - told


def test_promtool_accepts_metrics_and_rules(hub):
    promtool = program("promtool", "prometheus")
    said = subprocess.run([promtool, "check", "metrics"], input=Metrics(hub).text(), capture_output=True, check=False)
    assert said.returncode == 0, said.stdout + said.stderr
    folder = DEPLOY / "prometheus"
    for command in (("check", "rules", "gateway.rules.yml"), ("test", "rules", "gateway.rules.test.yml")):
        ended = subprocess.run([promtool, *command], cwd=folder, capture_output=True, text=True, check=False)
        assert ended.returncode == 0, ended.stdout + ended.stderr
    ended = subprocess.run(
        [promtool, "check", "config", "prometheus.yml"], cwd=folder, capture_output=True, text=True, check=False
    )
    assert ended.returncode == 0, ended.stdout + ended.stderr

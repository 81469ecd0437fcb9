"""Debian's Prometheus scrapes a gateway: what the dashboard and the alert rules ask for is answered."""

import json
import socket
import subprocess
import urllib.parse
import urllib.request
from contextlib import contextmanager
from pathlib import Path

import pytest
import warm
from debian import program
from kernel_can import wait_for
from processes import GATEWAY, bus, process

pytestmark = pytest.mark.system

ROOT = Path(__file__).parents[2]
DEPLOY = ROOT / "deploy"
DASHBOARD = json.loads((DEPLOY / "grafana" / "gateway.json").read_text())
#: Panels that have nothing to show where all is well.
QUIET = {"Errors of the buses"}


def expressions():
    return [(panel["title"], target["expr"]) for panel in DASHBOARD["panels"] for target in panel["targets"]]


def test_the_dashboard_is_whole():
    """As Grafana reads it: a data source to choose, panels in 24 columns that do not overlap, each with its targets."""
    (variable,) = DASHBOARD["templating"]["list"]
    assert (variable["type"], variable["query"]) == ("datasource", "prometheus")
    assert DASHBOARD["schemaVersion"] >= 36
    assert DASHBOARD.get("id") is None, "a number of one Grafana's database"
    panels = DASHBOARD["panels"]
    assert len({panel["id"] for panel in panels}) == len({panel["title"] for panel in panels}) == len(panels)
    taken = set()
    for panel in panels:
        assert panel["type"] in {"stat", "timeseries", "state-timeline"}, panel["title"]
        assert panel["datasource"] == {"type": "prometheus", "uid": f"${{{variable['name']}}}"}, panel["title"]
        refs = [target["refId"] for target in panel["targets"]]
        assert refs, panel["title"]
        assert len(set(refs)) == len(refs), panel["title"]
        place = panel["gridPos"]
        cells = {(x, y) for x in range(place["x"], place["x"] + place["w"])
                 for y in range(place["y"], place["y"] + place["h"])}  # fmt: skip
        assert max(x for x, _ in cells) < 24
        assert not cells & taken, f"{panel['title']} lies on another one"
        taken |= cells


@contextmanager
def failing_gateway(folder):
    """A gateway with its page, and a virtual ECU that fails; yields the page's address."""
    with bus(folder) as uri:
        text = (ROOT / "gateway.toml").read_text().replace("loopback:127.0.0.1:29536", uri)
        (folder / "gateway.toml").write_text(text)
        options = {"cwd": folder}
        with (
            process("run", "gateway.toml", "--status", "status", ready="monitoring", **options),
            process("serve", "--status", "status", "--port", "0", ready="page:", **options) as page,
        ):
            ecu = warm.Popen(
                [*GATEWAY, "simulate", "crank_missed_tooth", "--bus", uri],
                cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            )  # fmt: skip
            try:
                yield page.said.split()[1].partition("#")[0]
            finally:
                ecu.terminate()
                ecu.wait(60)


@contextmanager
def prometheus(folder, page):
    """Prometheus with the shipped configuration, but for the address of the page and the pace; yields its API."""
    server = program("prometheus")
    rules = DEPLOY / "prometheus" / "gateway.rules.yml"
    text = (DEPLOY / "prometheus" / "prometheus.yml").read_text()
    for shipped, here in (
        ("scrape_interval: 5s", "scrape_interval: 500ms\n  evaluation_interval: 500ms"),
        ("- gateway.rules.yml", f"- {rules}"),
        ("127.0.0.1:8808", urllib.parse.urlsplit(page).netloc),
    ):
        assert text.count(shipped) == 1
        text = text.replace(shipped, here)
    (folder / "prometheus.yml").write_text(text)
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{probe.getsockname()[1]}"
    started = subprocess.Popen(
        [server, f"--config.file={folder / 'prometheus.yml'}", f"--storage.tsdb.path={folder / 'tsdb'}",
         f"--web.listen-address={address}", "--log.level=error"],
        stderr=(folder / "prometheus.log").open("w"),
    )  # fmt: skip

    def api(path, **query):
        assert started.poll() is None, (folder / "prometheus.log").read_text()
        with urllib.request.urlopen(f"http://{address}/api/v1/{path}?{urllib.parse.urlencode(query)}") as answer:
            told = json.load(answer)
        assert told["status"] == "success"
        return told["data"]

    def ready():
        try:
            return api("status/buildinfo")
        except OSError:
            return None

    try:
        wait_for(ready)
        yield api
    finally:
        started.terminate()
        started.wait(60)


def test_prometheus_answers_what_the_dashboard_and_the_rules_ask(tmp_path):
    with failing_gateway(tmp_path) as page, prometheus(tmp_path, page) as api:
        wait_for(lambda: [each["health"] for each in api("targets")["activeTargets"]] == ["up"])
        waiting = {expr: title for title, expr in expressions() if title not in QUIET}

        def all_answered():
            for expr in list(waiting):
                if api("query", query=expr)["result"]:
                    del waiting[expr]
            return not waiting

        try:
            wait_for(all_answered)
        finally:
            print("no answer yet:", waiting)
        for _, expr in expressions():
            api("query", query=expr)  # is one, at least

        def confirmed():
            named = [a for a in api("alerts")["alerts"] if a["labels"]["alertname"] == "GatewayFaultConfirmed"]
            return {alert["annotations"]["summary"] for alert in named}

        wait_for(lambda: "P0336-39 (crank.missed_pulse) is confirmed" in confirmed())
        rules = [rule for group in api("rules")["groups"] for rule in group["rules"]]
        assert {rule["health"] for rule in rules} == {"ok"}
        assert len(rules) >= 8

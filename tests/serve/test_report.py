"""A report says what --json says, is the same each time, and needs nobody."""

import json
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import pytest

from gateway.cli.replay import replay
from gateway.cli.simulate import INSIDE, simulate
from gateway.common.resources import shipped
from gateway.errors import InputError
from gateway.serve.report.page import OF_THE_MOMENT

CONFIG = shipped("gateway.toml")
MOST_BYTES = 5_000_000


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """A drive with a missed pulse."""
    path = tmp_path_factory.mktemp("log") / "drive.log"
    ended = subprocess.run(
        [sys.executable, "-c", "from gateway.cli import main; main()", "simulate", "crank_missed_tooth", "--bus",
         "inside", "--record", str(path)],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert ended.returncode == 0, ended.stderr
    return path


def report_of(log, path, **more):
    replay(log, CONFIG, memory=None, html=path, json=True, fail_on_dtc=False, **more)
    return path.read_text()


def part(text, name):
    return json.loads(re.search(rf'<script type="application/json" id="{name}">(.*?)</script>', text, re.S)[1])


def lasting(lines):
    events = [json.loads(line) for line in lines.splitlines()]
    made = [{key: value for key, value in event.items() if key not in OF_THE_MOMENT} for event in events]
    for event in made:
        if event["event"] == "log":
            event["file"] = event["file"].rpartition("/")[2]
    return made


def test_its_numbers_are_those_of_json_and_its_bytes_are_the_same_each_time(log, tmp_path, capsys):
    text = report_of(log, tmp_path / "one.html")
    told = lasting(capsys.readouterr().out)
    assert part(text, "events") == told
    replay(log, CONFIG, memory=None, json=True, fail_on_dtc=False)
    assert lasting(capsys.readouterr().out) == told, "without a report it is the same"
    again = tmp_path / "elsewhere"
    again.mkdir()
    assert report_of(log, again / "two.html") == text
    assert len(text.encode()) < MOST_BYTES
    (dtc,) = {event["dtc"] for event in told if event["event"] == "dtc"}
    evidence = next(event["evidence"] for event in told if event["event"] == "dtc")
    assert f'data-dtc="{dtc}"' in text
    assert f"The test found {evidence['value']:.6g}; its limit is {evidence['threshold']:.6g}" in text
    figures = json.dumps(part(text, "figures"))
    assert f"{evidence['value']:.7g}"[:8] in figures, "the peak is in a column"
    assert "around its failure" in figures


class Links(HTMLParser):
    def __init__(self):
        super().__init__()
        self.found = []

    def handle_starttag(self, tag, attrs):
        self.found += [(tag, name, value) for name, value in attrs if name in ("src", "href", "action")]


def test_a_scenario_tells_its_verdict_and_the_truth(tmp_path, capsys):
    path = tmp_path / "run.html"
    more = {"bus": INSIDE, "check": True, "wait": 1.0, "record": None, "seed": None, "json": True}
    assert simulate(Path("crank_missed_tooth"), html=path, **more) == 0
    told = lasting(capsys.readouterr().out)
    text = path.read_text()
    assert part(text, "events") == [event for event in told if event["event"] != "expectation"]
    assert "As expected" in text
    assert "injected: missed pulses, 1" in json.dumps(part(text, "figures"))
    with pytest.raises(InputError, match="inside"):
        simulate(Path("crank_missed_tooth"), html=path, **{**more, "bus": "virtual:x"})


def test_what_a_log_says_cannot_become_markup(log, tmp_path, capsys):
    name = tmp_path / "<img src=x onerror=alert(1)>.log"
    name.write_bytes(log.read_bytes())
    text = report_of(name, tmp_path / "one.html")
    assert "<img" not in text
    parser = Links()
    parser.feed(text)
    assert parser.found == [], "it asks nobody for anything"
    assert "default-src 'none'" in text

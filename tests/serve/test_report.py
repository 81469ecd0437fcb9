"""A report says what --json says, is the same each time, and needs nobody."""

import json
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import pytest

from gateway_bench.cli.simulate import INSIDE, simulate
from gateway_fdi.common.resources import shipped
from gateway_fdi.errors import InputError
from gateway_replay.cli.replay import replay
from gateway_serve.report.page import OF_THE_MOMENT
from gateway_serve.report.timeline import MOST_TICKS, Span, timeline

CONFIG = shipped("gateway.toml")
MOST_BYTES = 5_000_000


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """A drive with a missed pulse: its log, and what is printed."""
    path = tmp_path_factory.mktemp("log") / "drive.log"
    ended = subprocess.run(
        [sys.executable, "-c", "from gateway.cli import main; main()", "simulate", "crank_missed_tooth", "--bus",
         "inside", "--record", str(path)],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert ended.returncode == 0, ended.stderr
    return path, ended.stdout


@pytest.fixture
def log(drive):
    return drive[0]


def test_the_readme_shows_what_is_printed(drive):
    """Its line of a cause is that of the diagnosis."""
    text = (Path(__file__).parents[2] / "README.md").read_text()
    shown = re.search(r"^```\n(DTC .*?)^```", text, re.MULTILINE | re.DOTALL)[1]
    printed = {re.sub(r"^\d+\.\d+ s +", "", line.strip()) for line in drive[1].splitlines()}
    assert {line.strip() for line in shown.splitlines()} <= printed


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


@pytest.mark.long
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
    assert f"Pulse away from its place: {evidence['value']:.6g} pitch, limit {evidence['threshold']:.6g} pitch" in text
    figures = json.dumps(part(text, "figures"))
    assert f"{evidence['value']:.7g}"[:8] in figures, "the peak is in a column"
    assert "around its failure" in text


def test_its_times_begin_with_the_log_whatever_its_clock_says(log, tmp_path):
    """A recorder's clock may have begun with the recorder, hours before the log."""
    later = tmp_path / "drive.log"
    stamps = re.compile(r"^\((\d+)\.", re.M)
    later.write_text(stamps.sub(lambda found: f"({int(found[1]) + 46400}.", log.read_text()))
    text, other = report_of(log, tmp_path / "one.html"), report_of(later, tmp_path / "two.html")
    assert "<td>46" not in other
    for pattern in ("length</th><td>.*? s<", '<div class="timeline">.*?</div></div>', r"first \S* s, last \S* s"):
        (found,) = re.findall(pattern, text)
        assert re.findall(pattern, other) == [found]
    assert part(other, "figures") == part(text, "figures")


def test_its_words_stand_in_the_page_where_they_take_the_lines_that_they_need(log, tmp_path):
    text = report_of(log, tmp_path / "one.html")
    assert "<p>P0336-39 crank.missed_pulse</p>" in text
    assert ">crank.missed_pulse around its failure at 4.0" in text
    assert "crank.missed_pulse" not in json.dumps(part(text, "figures")), "a canvas does not break lines"


@pytest.mark.parametrize("length", [0.0, 3e-4, 0.9, 8.0, 59.993, 60.0, 3600.0, 86400 * 30.0])
def test_a_timeline_has_few_round_numbers_within_the_run(length):
    found = re.findall(r'<span style="left:([\d.]+)%">([\d.e+-]+) s<', timeline([Span("a", 0.0)], length))
    assert 1 < len(found) <= MOST_TICKS
    assert [float(share) for share, _ in found] == sorted({float(share) for share, _ in found})
    for share, text in found:
        assert float(text) == pytest.approx(float(share) / 100 * max(length, 1e-3), rel=1e-3)
        assert float(share) <= 96


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
    assert "<p>injected: missed pulses, 1</p>" in text
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

"""``gateway report``, ``gateway.report`` for Python and the header for C, against a gateway that runs."""

import json
import select
import signal
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest
from command import command
from debian import program
from reporting import served, write_config

from gateway.cli.events import EventPrinter
from gateway.report import UNANSWERED, UNDELIVERED, Reporter, header
from gateway.report.words import REFUSALS, RESULTS
from gateway_serve.report_socket import ReportSocket

ROOT = Path(__file__).parents[2]
HOT, SLOW, BLIND = "battery.hot", "battery.slow", "camera.blind"


def failing(gateway, fault):
    return bool(gateway.memory.status(fault) & 1)


@pytest.fixture
def run(capsys, monkeypatch):
    def ended(*arguments):
        found = command(capsys, monkeypatch, "report", *arguments)
        return found.code, found.out.strip(), found.err.strip()

    return ended


# The command


def test_the_command_reports_and_says_goodbye(tmp_path, run):
    with served(tmp_path) as gateway:
        config = tmp_path / "reported.toml"
        assert run(HOT, "failed", "--data", "temperature=81.5", "--data", "cell=3", "-c", config) == (0, "", "")
        assert run(BLIND, "failed", "--socket", tmp_path / "report.sock")[0] == 0
        assert run(BLIND, "passed", "--socket", tmp_path / "report.sock")[0] == 0
    assert failing(gateway, HOT)
    assert not failing(gateway, BLIND)
    assert gateway.memory.entry(HOT).record.evidence["temperature [degC]"] == 81.5
    assert gateway.reports.counters()["reporters_lost"] == 0


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["battery.hat", "failed"], 2, "refused (unknown_fault): no reporter of the configuration has this fault; did"),
        ([HOT, "failed", "--data", "volts=5"], 2, "refused (data): volts: its data are temperature, cell"),
        ([HOT, "failed", "--data", "volts"], 2, "--data = 'volts': NAME=NUMBER"),
        ([HOT, "fail"], 2, "'fail': a result is one of passed, failed, prepassed, prefailed, not_tested; did you mean"),
        ([HOT], 2, "gateway report FAULT RESULT"),
        ([SLOW, "failed"], 1, "battery.slow: refused (not_enabled): "),
    ],
)
def test_each_refusal_is_one_line_and_an_exit_code(tmp_path, run, arguments, code, words):
    extra = f'[fault."{SLOW}"]\nenable = [{{ signal = "One.Level", min = 5 }}]\n'
    with served(tmp_path, extra=extra):
        ended, out, err = run(*arguments, "-c", tmp_path / "reported.toml")
    assert (ended, out) == (code, "")
    assert words in err
    assert "\n" not in err


def test_the_answer_as_json(tmp_path, run):
    with served(tmp_path):
        good = run(HOT, "prefailed", "--json", "-c", tmp_path / "reported.toml")
        wrong = run("battery.x", "failed", "--json", "-c", tmp_path / "reported.toml")
    assert good[0] == 0
    assert json.loads(good[1]) == {"fault": HOT, "result": "prefailed", "accepted": True, "refused": "", "why": ""}
    assert wrong[0] == 2
    assert json.loads(wrong[1])["refused"] == "unknown_fault"


def test_where_nobody_listens_it_says_so(tmp_path, run):
    code, _, err = run(HOT, "failed", "--socket", tmp_path / "nothing")
    assert code == 2
    assert "undelivered: no gateway listens at" in err
    (tmp_path / "bare.toml").write_text('[[bus]]\nname = "a"\nuri = "virtual:a"\n')
    code, _, err = run(HOT, "failed", "-c", tmp_path / "bare.toml")
    assert code == 2
    assert "no table [report]" in err


def test_who_is_gone_is_said_to_people(capsys):
    event = {
        "event": "reporter",
        "t_ns": 10**9,
        "reporter": "battery",
        "state": "lost",
        "reason": "why",
        "faults": [HOT],
    }
    EventPrinter(as_json=False)(event)
    assert capsys.readouterr().out.split() == ["1.0000", "s", "reporter", "battery", "lost", "why;", HOT]


def test_check_names_users_that_are_not_there(tmp_path, capsys, monkeypatch):
    path = write_config(tmp_path, battery='users = ["nobody-of-this-machine"]')
    ended = command(capsys, monkeypatch, "check", path)
    assert ended.code == 0
    assert 'report.reporter[0]: this machine has no user "nobody-of-this-machine"' in ended.out


# Python


def test_a_reporter_loads_nothing_but_the_standard_library():
    code = "import sys, gateway.report; print([m for m in sys.modules if m.split('.')[0] in ('numpy', 'pydantic')])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout.strip() == "[]"


def test_a_reporter_counts_what_it_got_and_goes_on_after_a_restart(tmp_path):
    path = tmp_path / "report.sock"
    with Reporter(path, patience_s=5.0, retry_s=0.0) as reporter:
        answer = reporter.failed(HOT)
        assert (bool(answer), answer.refused) == (False, UNDELIVERED)
        with served(tmp_path) as first:
            assert reporter.failed(HOT, temperature=90)
            assert reporter.prefailed(SLOW)
            assert reporter.passed(HOT, volts=1).refused == "data"
        assert reporter.failed(HOT).refused == UNDELIVERED
        with served(tmp_path) as second:
            assert reporter.passed(HOT)
            assert reporter.prepassed(HOT)
            assert reporter.not_tested(HOT)
            assert reporter.goodbye()
    assert (failing(first, HOT), failing(second, HOT)) == (True, False)
    assert (reporter.accepted, reporter.refused, reporter.undelivered) == (5, {"data": 1}, 2)
    assert [g.reports.counters()["reports_accepted"] for g in (first, second)] == [2, 3]


def test_it_waits_no_longer_than_its_patience_and_late_answers_are_counted(tmp_path):
    with served(tmp_path) as gateway:
        config = gateway.config.report.model_copy(update={"socket": str(tmp_path / "idle.sock")})
        door = ReportSocket(config, gateway)  # nobody turns it
        reporter = Reporter(tmp_path / "idle.sock", patience_s=0.02)
        assert reporter.failed(HOT).refused == UNANSWERED
        assert reporter.failed(HOT).refused == UNANSWERED
        assert (reporter.accepted, reporter.unanswered) == (0, 2)
        for seconds in (1.0, 2.0):
            door.turn(seconds)
        for _ in range(2):
            assert reporter.passed(HOT).refused == UNANSWERED
        assert (reporter.accepted, reporter.unanswered) == (2, 2)
        for number in list(gateway.reports._senders):
            gateway.reports.let_go(number)
        door._connections.clear()
        door.close()


class Late(Reporter):
    """One that sends when the gateway has ended the connection already."""

    def _connect(self, until_s):
        made = super()._connect(until_s)
        ended = select.poll()
        ended.register(made, 0)  # POLLHUP is always told
        ended.poll(60_000)
        return made


@pytest.mark.parametrize("kind", [Reporter, Late])
def test_one_that_is_turned_away_is_told_why(tmp_path, monkeypatch, kind):
    monkeypatch.setattr("gateway_serve.report_socket.credentials_of", lambda connection: (1, 54321, 54321))
    monkeypatch.setattr("gateway_serve.report_socket.groups_of", lambda connection: set())
    with served(tmp_path):
        reporter = kind(tmp_path / "report.sock", patience_s=5.0)
        answer = reporter.failed(HOT)
    assert answer.refused == "not_allowed"
    assert answer.why == REFUSALS["not_allowed"]


def test_who_fails_says_no_goodbye(tmp_path):
    with served(tmp_path) as gateway:
        with pytest.raises(ZeroDivisionError), Reporter(tmp_path / "report.sock", patience_s=5.0) as reporter:
            reporter.passed(HOT)
            raise ZeroDivisionError
        with Reporter(tmp_path / "report.sock", patience_s=5.0) as after:  # the gateway has seen the end before this
            after.passed(BLIND)
    assert gateway.reports.counters()["reporters_lost"] == 1


# C

C = """
#define _POSIX_C_SOURCE 200809L
#include "gateway_report.h"

int main(int count, char **arguments)
{
    gateway_reporter r;
    if (count != 2 || gateway_report_open(&r, arguments[1], 5000) != 0)
        return 2;
    printf("%d\\n", gateway_report(&r, "battery.hot", GATEWAY_FAILED, "\\"temperature\\": 81.5, \\"cell\\": 3"));
    printf("%d\\n", gateway_report(&r, "battery.slow", GATEWAY_PREFAILED, NULL));
    printf("%d %s\\n", gateway_report(&r, "battery.hat", GATEWAY_PASSED, NULL), r.refused);
    printf("%d %s\\n", gateway_report(&r, "camera.blind", GATEWAY_NOT_TESTED, "\\"x\\": 1"), r.refused);
    printf("%d %s\\n", gateway_report(&r, "camera.blind", GATEWAY_PREPASSED, NULL), r.refused);
    gateway_report_close(&r);
    printf("%d\\n", gateway_report(&r, "camera.blind", GATEWAY_PASSED, NULL));
    fflush(stdout);
    getchar();
    printf("%d\\n", gateway_report(&r, "battery.hot", GATEWAY_PASSED, NULL));
    printf("%lu %lu %lu %lu\\n", r.accepted, r.denied, r.undelivered, r.unanswered);
    return 0;
}
"""


@pytest.fixture(scope="module")
def compiled(tmp_path_factory):
    folder = tmp_path_factory.mktemp("c")
    (folder / "reporter.c").write_text(C)
    flags = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", f"-I{header().parent}"]
    subprocess.run(
        [program("gcc", "gcc", "libc6-dev"), *flags, "reporter.c", "-o", "reporter"], cwd=folder, check=True, timeout=60
    )
    return folder / "reporter"


def test_a_c_program_reports_and_is_lost_when_it_is_killed(tmp_path, compiled):
    with (
        served(tmp_path) as gateway,
        subprocess.Popen(
            [compiled, tmp_path / "report.sock"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        ) as started,
    ):
        said = [started.stdout.readline().strip() for _ in range(6)]
        started.send_signal(signal.SIGKILL)
    assert said == ["0", "0", "1 unknown_fault", "1 data", "0", "0"]
    assert failing(gateway, HOT)
    assert gateway.memory.entry(HOT).record.evidence["cell"] == 3.0
    states = {state["reporter"]: state["lost"] for state in gateway.reports.states()}
    assert states == {"battery": [], "camera": [BLIND], "": []}, "it said goodbye before, and reported this again"


def test_a_c_program_goes_on_after_a_restart_of_the_gateway(tmp_path, compiled):
    with subprocess.Popen(
        [compiled, tmp_path / "report.sock"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as started:
        said = [started.stdout.readline().strip() for _ in range(6)]
        with served(tmp_path) as gateway:
            last, _ = started.communicate("\n", timeout=60)
    assert said == ["2", "2", "2", "2", "2", "2"], "nobody listens"
    assert last.split() == ["0", "1", "0", "6", "0"]
    assert gateway.reports.counters()["reports_accepted"] == 1


def test_the_header_is_found_and_knows_the_words(run):
    code, out, _ = run("--header")
    assert code == 0
    text = Path(out).read_text()
    assert all(f'"{word}"' in text for word in RESULTS)
    assert "#define GATEWAY_REPORT_MOST 4096" in text


def test_the_protocol_is_what_the_page_says(tmp_path, capsys, monkeypatch):
    page = (ROOT / "docs/report.md").read_text()
    assert all(f"`{word}`" in page for word in (*RESULTS, *REFUSALS))
    begin = page.index("```toml") + len("```toml\n")
    table = textwrap.dedent(page[begin : page.index("```", begin)])
    bus = '[[bus]]\nname = "a"\nuri = "virtual:a"\n'
    (tmp_path / "page.toml").write_text(bus + table)
    ended = command(capsys, monkeypatch, "check", tmp_path / "page.toml")
    assert ended.code == 0, ended.err

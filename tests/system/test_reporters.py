"""A gateway and four reporter processes, one of them killed: each report is accounted for, each verdict right.

``GATEWAY_TESTS=full`` sends 10,000 reports, in ``GATEWAY_REPORT_SECONDS`` (default: as fast as they are answered).
"""

import json
import os
import random
import socket
import subprocess
import sys
import time
from collections import Counter

import pytest
from amount import amount
from processes import process

REPORTERS, FAULTS = "abcd", ("x", "y", "z")
KILLED, BOUND, BOUNDED = "b", 40, "d"
TABLE = """
[[bus]]
name = "bus"
uri = "virtual:reporters"
[status]
socket = "status.sock"
[report]
socket = "report.sock"
"""
REPORTER = """
import random, sys, time
from gateway.report import Reporter
name, seed, count, pause_s = sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), float(sys.argv[4])
draw = random.Random(f"{seed}{name}")
sys.stdin.readline()
with Reporter("report.sock", patience_s=60.0) as reporter:
    for k in range(count):
        fault, result = draw.choice("xyz"), draw.choice(["passed", "passed", "failed", "prefailed", "prepassed"])
        print("sent", fault, result, flush=True)
        answer = reporter.report(f"{name}.{fault}", result, number=k)
        print("got", answer.refused or "accepted", flush=True)
        time.sleep(pause_s)
assert reporter.accepted + sum(reporter.refused.values()) == count, vars(reporter)
"""


def write_config(folder):
    text = TABLE
    for k, name in enumerate(REPORTERS):
        bound = BOUND if name == BOUNDED else 10_000
        text += f'[[report.reporter]]\nname = "{name}"\nevents_per_s = {bound}\n'
        for j, fault in enumerate(FAULTS):
            text += f'[[report.reporter.fault]]\nname = "{fault}"\ndtc = "B1{k}0{j}-00"\ndescription = "{fault}"\n'
            text += 'data = ["number"]\ndebounce = { failed_after = 3, passed_after = 2, jump_down = true }\n'
    (folder / "reporters.toml").write_text(text)


class Expected:
    """What AUTOSAR's debounce makes of the results that were accepted; written from its definition."""

    def __init__(self):
        self.counter, self.failed = 0, False

    def take(self, result):
        if result in ("failed", "passed"):
            self.counter = 3 if result == "failed" else -2
        elif result == "prefailed":
            self.counter = min(max(self.counter, 0) + 1, 3)
        else:
            self.counter = max(min(self.counter, 0) - 1, -2)
        self.failed = self.counter == 3 or (self.failed and self.counter > -2)


def counted(folder):
    """What the status socket tells of the reporters now."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as reader, reader.makefile("rb") as file:
        reader.connect(str(folder / "status.sock"))
        while True:
            message = json.loads(file.readline())
            file.read(message.get("size", 0))
            if message["kind"] == "buses":
                return {each["reporter"]: each for each in message["reporters"]}


def started(folder, name, seed, count, pause_s):
    return subprocess.Popen(
        [sys.executable, "-c", REPORTER, name, str(seed), str(count), str(pause_s)],
        cwd=folder, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip


@pytest.mark.evidence("Nothing is silent: reports")
@pytest.mark.system
def test_every_report_of_four_processes_is_accounted_for_though_one_is_killed(tmp_path):
    count = amount(10_000, 800) // len(REPORTERS)
    pause_s = float(os.environ.get("GATEWAY_REPORT_SECONDS", "0")) / count
    seed = int(os.environ.get("GATEWAY_SEED", random.randrange(10**6)))
    print("seed", seed)
    write_config(tmp_path)
    run = ("run", "reporters.toml", "--json", "--memory", "faults.sqlite")
    with process(*run, cwd=tmp_path, ready="monitoring") as gateway:
        reporters = {name: started(tmp_path, name, seed, count, pause_s) for name in REPORTERS}
        for each in reporters.values():
            each.stdin.write("\n")
            each.stdin.flush()
        said = {KILLED: [reporters[KILLED].stdout.readline() for _ in range(count)]}  # half of its way
        reporters[KILLED].kill()
        for name, each in reporters.items():
            # Not communicate(), which would lose what readline() has read ahead.
            said.setdefault(name, []).extend(each.stdout.readlines())
            each.wait(timeout=600)
            assert name == KILLED or each.returncode == 0
        until = time.monotonic() + 60
        while not (told := counted(tmp_path))[KILLED]["lost"] and time.monotonic() < until:
            pass
    assert gateway.code == 0
    events = [json.loads(line) for line in (tmp_path / "run.out").read_text().splitlines()]
    totals = Counter()
    for name in REPORTERS:
        lines = [line.split() for line in said[name] if line.endswith("\n")]
        sent = [line[1:] for line in lines if line[0] == "sent"]
        got = [line[1] for line in lines if line[0] == "got"]
        counts = Counter({key: n for key, n in told[name]["counts"].items() if key != "lost"})
        totals += counts
        if name == KILLED:  # it may have been killed between print and send, or before it read its answer
            assert len(got) <= counts.total() <= len(sent) <= len(got) + 1
            assert set(counts) <= {"accepted"}
            got += ["accepted"] * (counts.total() - len(got))
        else:
            assert Counter(got) == counts, "what it was told is what was counted"
            assert len(sent) == len(got) == count, "accepted and refused are all that it sent"
            assert told[name]["lost"] == []
        assert_verdicts(name, list(zip(sent, got, strict=False)), events)
    assert totals["rate"] == told[BOUNDED]["counts"].get("rate", 0)
    (lost,) = [event for event in events if event["event"] == "reporter" and event["state"] == "lost"]
    assert lost["reporter"] == KILLED
    assert set(lost["faults"]) <= {f"{KILLED}.{fault}" for fault in FAULTS}
    statuses = [event["status"] & 1 for event in events if event.get("dtc") == "U3000-93"]
    assert statuses == [1]
    counters = events[-1]["counters"]
    assert (counters["reports_accepted"], counters["reporters_lost"]) == (totals["accepted"], 1)
    assert counters["reports_refused"] == totals["rate"]
    print(dict(totals))


def assert_verdicts(name, results, events):
    """Each change of testFailed was told, in order; the last is what the last results make of it."""
    for fault in FAULTS:
        expected, changes = Expected(), []
        for (of, result), outcome in results:
            if of == fault and outcome == "accepted":
                before = expected.failed
                expected.take(result)
                if expected.failed != before:
                    changes.append(int(expected.failed))
        told, now = [], 0
        for event in events:
            if event["event"] == "dtc" and event["fault"] == f"{name}.{fault}" and event["status"] & 1 != now:
                now = event["status"] & 1
                told.append(now)
        assert told == changes, f"{name}.{fault}"

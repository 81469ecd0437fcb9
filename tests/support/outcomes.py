"""Outcomes of tests for scripts/evidence: of each function, and of each id that a test is marked with.

A process of pytest-xdist gives the ids of its tests to the controller with their reports; the controller alone writes.
"""

import json
from collections import defaultdict
from pathlib import Path

#: Name of the ids among the properties that go with a report.
PROPERTY = "evidence"


def note_ids(items):
    """Have each test's reports tell the ids that it is marked with."""
    for item in items:
        ids = [name for mark in item.iter_markers("evidence") for name in mark.args]
        if ids:
            item.user_properties.append((PROPERTY, ids))


class Outcomes:
    """A plugin of pytest that writes a file of outcomes at the end.

    The file has ``tests``: function -> [passed, failed, skipped], and ``ids``: id -> function -> the same, where only
    cases that are marked with the id count.
    """

    def __init__(self, file):
        self._file = Path(file)
        self._worst = {}  # test -> passed, failed or skipped, of its set-up, call and tear-down
        self._ids = {}

    def pytest_runtest_logreport(self, report):
        # What was expected to fail and does (xfail) is told as skipped: it proves nothing.
        before = self._worst.get(report.nodeid, "passed")
        self._worst[report.nodeid] = "failed" if "failed" in (before, report.outcome) else (
            "skipped" if "skipped" in (before, report.outcome) else "passed"
        )  # fmt: skip
        self._ids[report.nodeid] = dict(report.user_properties).get(PROPERTY, [])

    def pytest_sessionfinish(self):
        tests = defaultdict(lambda: [0, 0, 0])
        ids = defaultdict(lambda: defaultdict(lambda: [0, 0, 0]))
        for nodeid, outcome in self._worst.items():
            function, place = nodeid.partition("[")[0], ("passed", "failed", "skipped").index(outcome)
            tests[function][place] += 1
            for name in self._ids[nodeid]:
                ids[name][function][place] += 1
        self._file.parent.mkdir(parents=True, exist_ok=True)
        self._file.write_text(json.dumps({"tests": tests, "ids": ids}))

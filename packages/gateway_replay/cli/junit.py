"""JUnit's XML file of a run: Jenkins, GitLab and others show its tests.

There is no schema that all of them keep. Here: one ``testsuite`` with ``properties``, a ``testcase`` for each thing
judged with ``failure``, ``error`` or ``skipped``. The text of a failure stands in its body, too: GitLab shows no
attribute of it. Names are the same in each run, so that a test's history is that of one test.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal
from xml.etree import ElementTree as Xml

from gateway_fdi.errors import InputError
from gateway_replay.attachments import attachments

#: Characters that XML 1.0 cannot have, written in any way.
_FORBIDDEN = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


@dataclass(frozen=True)
class Case:
    """One thing that was judged.

    Attributes:
        name: the same in each run.
        text: observation; of a good one it may be "".
        outcome: good, or what is told of it.
    """

    name: str
    text: str = ""
    outcome: Literal["passed", "failure", "error", "skipped"] = "passed"


def write_junit(
    path: Path,
    suite: str,
    cases: Iterable[Case],
    seconds: float,
    properties: Iterable[tuple[str, object]] = (),
    files: Iterable[Path] = (),
) -> None:
    """Write the file; a folder that is not there is made.

    Args:
        path: of the file.
        suite: name of its one test suite.
        cases: judged tests; of those with one name the later ones get a number.
        seconds: how long it took [s].
        properties: name, value; names may come several times.
        files: recording, report, ... that belong to each case that failed.

    Raises:
        InputError: it cannot be written.
    """
    cases = list(cases)
    counts = {kind: str(sum(case.outcome == kind for case in cases)) for kind in ("failure", "error", "skipped")}
    numbers = {
        "tests": str(len(cases)),
        "failures": counts["failure"],
        "errors": counts["error"],
        "skipped": counts["skipped"],
        "time": f"{seconds:.3f}",
    }
    # Jenkins' schema of what holds all suites knows no "skipped".
    root = Xml.Element("testsuites", {name: value for name, value in numbers.items() if name != "skipped"})
    top = Xml.SubElement(root, "testsuite", {"name": _plain(suite), **numbers})
    entries = Xml.SubElement(top, "properties")
    for name, value in properties:
        Xml.SubElement(entries, "property", {"name": name, "value": _plain(str(value))})
    left = attachments(files)
    seen: dict[str, int] = {}
    for case in cases:
        seen[case.name] = number = seen.get(case.name, 0) + 1
        name = case.name if number == 1 else f"{case.name} ({number})"
        keys = {"classname": _plain(suite), "name": _plain(name), "time": f"{seconds / len(cases):.3f}"}
        entry = Xml.SubElement(top, "testcase", keys)
        _write(entry, case)
        if left and case.outcome in ("failure", "error"):
            Xml.SubElement(entry, "system-out").text = _plain(left)
    Xml.indent(root)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        Xml.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)
    except OSError as error:
        raise InputError(error.strerror or str(error), file=path, key="--junit") from error


def _write(entry: Xml.Element, case: Case) -> None:
    text = _plain(case.text)
    if case.outcome == "passed":
        if text:
            Xml.SubElement(entry, "system-out").text = text
        return
    first = text.splitlines()[0] if text else case.outcome
    keys = {"message": first} if case.outcome == "skipped" else {"message": first, "type": case.outcome}
    Xml.SubElement(entry, case.outcome, keys).text = text


def _plain(text: str) -> str:
    return _FORBIDDEN.sub("?", text)


def of_faults(faults: Iterable[tuple[str, str]], failed: Mapping[str, str], not_tested: Iterable[str]) -> list[Case]:
    """Return a log's verdict, a case a fault.

    Args:
        faults: id and DTC of all that a configuration can find.
        failed: id -> its text.
        not_tested: ids of those whose tests never came to an end.
    """
    left_out = set(not_tested)
    cases = []
    for fault, dtc in faults:
        name = f"{fault} {dtc}"
        if fault in failed:
            cases.append(Case(name, failed[fault], "failure"))
        elif fault in left_out:
            cases.append(Case(name, "not tested", "skipped"))
        else:
            cases.append(Case(name))
    return cases

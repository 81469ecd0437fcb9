"""Test cases of a scenario's verdict, for its JUnit file; a replay, which knows no scenario, does not load them."""

from __future__ import annotations

from collections.abc import Sequence

from gateway_bench.vecu.expectations import OTHERS, Finding
from gateway_bench.vecu.scenario import Scenario
from gateway_replay.cli.junit import Case


def of_findings(scenario: Scenario, findings: Sequence[Finding]) -> list[Case]:
    """Return a scenario's verdict, a case an expectation; the DTCs that none names are one more."""
    named = [finding for finding in findings if finding.expected != OTHERS]
    cases = [Case(one.expected, one.text, "passed" if one.good else "failure") for one in named]
    if scenario.unexpected == "fail":
        others = "\n".join(finding.text for finding in findings if finding.expected == OTHERS)
        cases.append(Case(OTHERS, others, "failure" if others else "passed"))
    return cases


def stopped(scenario: Scenario, why: str) -> list[Case]:
    """Return the case of a scenario that was not judged."""
    return [Case(scenario.name, why, "error")]

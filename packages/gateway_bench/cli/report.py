"""``--html`` of a scenario: a run as one file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gateway_bench.vecu.expectations import Judge
from gateway_bench.vecu.player import Player
from gateway_bench.vecu.scenario import Scenario
from gateway_serve.cli.run_report import RunReport


def write_scenario(
    report: RunReport, scenario: Scenario, player: Player, judge: Judge, summary: Mapping[str, Any]
) -> None:
    """Write the report of a scenario."""
    source = [("scenario", f"{scenario.name}: {scenario.description}"), ("seed", str(player.seed))]
    findings = [(finding.good, finding.text) for finding in judge.findings()]
    truth = [(f"{fact.kind.replace('_', ' ')}, {fact.count}", fact.t_ns) for fact in player.truth]
    report.write(scenario.name, source, events=[summary], findings=findings, truth=truth)

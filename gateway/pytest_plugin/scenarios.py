"""Scenario files as tests: their expectations are the asserts."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from gateway.config.load import load_config
from gateway.errors import GatewayError
from gateway.runtime.app import Gateway
from gateway.runtime.drive import drive, judgeable
from gateway.vecu.expectations import Finding, Judge
from gateway.vecu.player import Player
from gateway.vecu.scenario import load_scenario

#: Keys of which a scenario has one; a configuration beside it has none.
_KEYS = frozenset({"ecu", "expect", "duration_s"})


class ScenarioError(Exception):
    """A scenario whose expectations do not hold.

    Args:
        findings: the whole verdict.
        seed: that was used.
    """

    def __init__(self, findings: list[Finding], seed: int) -> None:
        self.findings, self.seed = findings, seed
        super().__init__(self.text)

    @property
    def text(self) -> str:
        """Each line of the verdict, what is wrong first."""
        lines = sorted(self.findings, key=lambda finding: finding.good)
        shown = [("as expected: " if line.good else "NOT as expected: ") + line.text for line in lines]
        return "\n".join([*shown, f"seed {self.seed}"])


def is_scenario(path: Path) -> bool:
    """Tell a scenario from other TOML files; one that cannot be read counts as one, so that it is told."""
    try:
        data = tomllib.loads(path.read_text("utf-8"))
    except (OSError, ValueError):
        return True
    return bool(_KEYS & data.keys())


class ScenarioFile(pytest.File):
    """A file with one scenario."""

    def collect(self) -> Iterator[ScenarioItem]:
        """Yield its test."""
        yield ScenarioItem.from_parent(self, name=self.path.stem)


class ScenarioItem(pytest.Item):
    """A scenario, played to a gateway in this process as fast as it goes."""

    def runtest(self) -> None:
        """Play it and judge it.

        Raises:
            ScenarioError: an expectation does not hold.
            GatewayError: a scenario or configuration that is wrong.
        """
        scenario = load_scenario(self.path)
        config = load_config(scenario.config)
        judgeable(scenario, config, file=self.path)
        buses = {bus.name: index for index, bus in enumerate(config.bus)}
        databases = {index: bus.database for index, bus in enumerate(config.bus)}
        try:
            player = Player(scenario, buses, seed=self.config.getoption("--gateway-seed"), databases=databases)
        except GatewayError as error:
            raise GatewayError(f"{self.path}: {error}") from error
        self.user_properties.append(("seed", player.seed))
        self.user_properties += [("requirement", name) for name in scenario.requirement]
        judge = Judge(scenario)
        gateway = Gateway(config, file=scenario.config)
        try:
            drive(gateway, player, judge=judge)
        finally:
            gateway.close()
        findings = judge.findings()
        self.user_properties += [
            ("injected", f"{fact.kind.replace('_', ' ')} at {fact.t_ns / 1e9:.3f} s, {fact.count}")
            for fact in player.truth
        ]
        self.user_properties += [("verdict", finding.text) for finding in findings]
        if not all(finding.good for finding in findings):
            raise ScenarioError(findings, player.seed)

    def repr_failure(self, excinfo: pytest.ExceptionInfo[BaseException], style: Any = None) -> Any:
        """Return what is told of a failure: the verdict, or the one line of a mistake."""
        if isinstance(excinfo.value, ScenarioError):
            return excinfo.value.text
        if isinstance(excinfo.value, GatewayError):
            return str(excinfo.value)
        return super().repr_failure(excinfo, style)

    def reportinfo(self) -> tuple[Path, None, str]:
        """Return where it stands, and what it is called."""
        return self.path, None, f"scenario {self.name}"

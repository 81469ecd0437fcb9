"""Scenario files as tests: their expectations are the asserts."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest

from gateway.config.load import load_config
from gateway.config.model import Config
from gateway_bench.drive import judgeable
from gateway_bench.pytest_plugin.fixtures import buses_of
from gateway_bench.pytest_plugin.scenario_run import ScenarioRun, inside, leave, on_buses
from gateway_bench.vecu.expectations import Finding
from gateway_bench.vecu.scenario import Scenario, load_scenario
from gateway_fdi.common.tomlfile import read_toml
from gateway_fdi.errors import GatewayError, InputError

#: Keys of which a scenario has one; a configuration beside it has none.
_KEYS = frozenset({"ecu", "expect", "duration_s"})


class ScenarioError(Exception):
    """A scenario whose expectations do not hold."""

    def __init__(self, findings: list[Finding], seed: int, left: Sequence[str] = ()) -> None:
        self.findings, self.seed, self._left = findings, seed, left
        super().__init__(self.text)

    @property
    def text(self) -> str:
        """Each line of the verdict, wrong ones first."""
        lines = sorted(self.findings, key=lambda finding: finding.good)
        shown = [("as expected: " if line.good else "NOT as expected: ") + line.text for line in lines]
        return "\n".join([*shown, f"seed {self.seed}", *self._left])


def is_scenario(path: Path) -> bool:
    """Tell a scenario from other TOML files; one that cannot be read counts as one, so that it is told."""
    try:
        data = read_toml(path)
    except InputError:
        return True
    return bool(_KEYS & data.keys())


class ScenarioFile(pytest.File):
    """A file with one scenario."""

    def collect(self) -> Iterator[ScenarioItem]:
        """Yield its test."""
        yield ScenarioItem.from_parent(self, name=self.path.stem)


class ScenarioItem(pytest.Item):
    """A scenario, played to a gateway in this process: as fast as it goes, or on real buses in real time."""

    def runtest(self) -> None:
        """Play it and judge it.

        Raises:
            ScenarioError: an expectation does not hold.
            GatewayError: a scenario or configuration that is wrong.
        """
        scenario = load_scenario(self.path)
        config = load_config(scenario.config)
        seed, buses = self.config.getoption("--gateway-seed"), buses_of(self.config)
        if buses:
            judgeable(scenario, config, file=self.path)
        self.user_properties.append(("seed", scenario.seed if seed is None else seed))
        self.user_properties += [("requirement", name) for name in scenario.requirement]
        try:
            run = on_buses(scenario, config, seed, buses) if buses else inside(scenario, config, seed)
        except InputError as error:
            raise error.within(self.path) from error
        self.user_properties += [
            ("injected", f"{fact.kind.replace('_', ' ')} at {fact.t_ns / 1e9:.3f} s, {fact.count}")
            for fact in run.truth
        ]
        self.user_properties += [("verdict", finding.text) for finding in run.findings]
        if not all(finding.good for finding in run.findings):
            left = self._left(scenario, config, seed, run)
            raise ScenarioError(run.findings, scenario.seed if seed is None else seed, left)

    def _left(self, scenario: Scenario, config: Config, seed: int | None, run: ScenarioRun) -> list[str]:
        """Leave the run as files; returns lines about them."""
        folders: list[Path] = self.config.getini("gateway_artifacts")
        folder = folders[0] / self.name if folders else Path(tempfile.mkdtemp(prefix=f"gateway-{self.name}-"))
        told = []
        try:
            for what, path in leave(folder, scenario, config, seed, run):
                self.user_properties.append((what, str(path)))
                told.append(f"{what}: {path}")
        except (GatewayError, OSError) as error:
            told.append(f"the run could not be left in {folder}: {error}")
        return told

    def repr_failure(self, excinfo: pytest.ExceptionInfo[BaseException], style: Any = None) -> Any:
        """Return the text of a failure: the verdict, or the one line of a mistake."""
        if isinstance(excinfo.value, ScenarioError):
            return excinfo.value.text
        if isinstance(excinfo.value, GatewayError):
            return str(excinfo.value)
        return super().repr_failure(excinfo, style)

    def reportinfo(self) -> tuple[Path, None, str]:
        """Return its place and its name."""
        return self.path, None, f"scenario {self.name}"

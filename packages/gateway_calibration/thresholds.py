"""Thresholds of one configuration as :mod:`gateway_api` gives them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from gateway_api.thresholds import Targets
from gateway_calibration.configuration import Found, as_dict, calibrate, keep


class Thresholds:
    """Thresholds that healthy logs ask for: as :class:`gateway_api.thresholds.Findings`."""

    def __init__(self, file: Path, targets: Targets, found: Found) -> None:
        self._file, self._targets, self._found = file, targets, found
        self.seconds, self.failed = found.seconds, found.failed
        self.facts: dict[str, Any] = as_dict(targets, found)

    @property
    def rows(self) -> list[tuple[str, str, float | None, float, float]]:
        """Monitor, test, threshold now, largest healthy value, proposed threshold; of stopping rules and CUSUM."""
        rules = [(p.monitor, p.symptom, p.now, p.largest, p.threshold) for p in self._found.proposals]
        tests = () if self._found.tests is None else self._found.tests.rows
        return [*rules, *((t.monitor, t.name, t.now, t.largest, t.threshold) for t in tests)]

    def write(self, into: Path) -> None:
        """Write them into the configuration, or a copy of it beside it; errors as of ``keep``."""
        keep(self._file, self._targets, self._found, into)


def thresholds(file: Path, logs: Sequence[Path], targets: Targets, maps: Sequence[str]) -> Thresholds:
    """Return the thresholds that healthy logs ask for; arguments and errors as of ``calibrate``."""
    return Thresholds(file, targets, calibrate(file, logs, targets, maps))

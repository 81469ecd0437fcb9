"""Thresholds that healthy logs ask for."""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike, fspath
from pathlib import Path
from typing import Any

from gateway.api.table import Table
from gateway.api.words import spoken
from gateway.calibration.configuration import Found, Targets, as_dict, keep


class Calibrated:
    """Thresholds that healthy logs ask for; nothing is changed before :meth:`write`.

    Args:
        file: of the configuration.
        targets: of it.
        found: in the logs.

    Attributes:
        seconds: length of the logs [s].
        failed: DTCs that the logs set: they are not healthy, or the thresholds are wrong.
        facts: everything, as ``gateway calibrate --json`` has it.
    """

    def __init__(self, file: Path, targets: Targets, found: Found) -> None:
        self._file, self._targets, self._found = file, targets, found
        self.seconds, self.failed = found.seconds, found.failed
        self.facts: Mapping[str, Any] = as_dict(targets, found)

    @property
    def thresholds(self) -> Table:
        """Proposals beside the present values: of stopping rules their levels, of CUSUM tests J in units of nu."""
        types = {"monitor": str, "test": str, "now": float, "largest": float, "proposed": float}
        rules = [(p.monitor, p.symptom, p.now, p.largest, p.threshold) for p in self._found.proposals]
        tests = () if self._found.tests is None else self._found.tests.rows
        return Table.of(types, [*rules, *((t.monitor, t.name, t.now, t.largest, t.threshold) for t in tests)])

    def write(self, into: str | PathLike[str] | None = None) -> Path:
        """Write the thresholds with their source into the configuration's file, or into a copy of it beside it.

        Args:
            into: the copy; None: the file itself.

        Raises:
            InputError: the copy would not find what lies beside the configuration.
        """
        path = self._file if into is None else Path(fspath(into))
        with spoken():
            keep(self._file, self._targets, self._found, path)
        return path

    def __repr__(self) -> str:
        failed = f"; set {', '.join(self.failed)}" if self.failed else ""
        return f"Calibrated({self.seconds:.0f} s{failed})\n{self.thresholds}"

    def _repr_html_(self) -> str:
        return self.thresholds._repr_html_()

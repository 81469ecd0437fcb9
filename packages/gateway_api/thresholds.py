"""Thresholds that healthy logs ask for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from os import PathLike, fspath
from pathlib import Path
from typing import Any, Protocol

from gateway_api.table import Table
from gateway_api.words import spoken


@dataclass(frozen=True)
class Targets:
    """Targets of thresholds.

    Attributes:
        mtfa_s: mean time between false alarms [s], for stopping rules.
        margin: largest healthy T over its threshold, for CUSUM tests.
        floor: least threshold of these [nu].
    """

    mtfa_s: float = 3600.0
    margin: float = 0.5
    floor: float = 25.0


class Findings(Protocol):
    """Findings of a package above the core in healthy logs; attributes as of :class:`Calibrated`."""

    seconds: float
    failed: tuple[str, ...]
    facts: dict[str, Any]

    @property
    def rows(self) -> Sequence[tuple[str, str, float | None, float, float]]:
        """Rows of :attr:`Calibrated.thresholds`."""

    def write(self, into: Path) -> None:
        """Write them into a configuration, or a copy of it beside it; InputError: it cannot be written."""


class Calibrated:
    """Thresholds that healthy logs ask for; nothing is changed before :meth:`write`.

    Args:
        file: of the configuration.
        learned: in the logs.

    Attributes:
        seconds: length of the logs [s].
        failed: DTCs that the logs set: they are not healthy, or the thresholds are wrong.
        facts: everything, as ``gateway calibrate --json`` has it.
    """

    def __init__(self, file: Path, learned: Findings) -> None:
        self._file, self._learned = file, learned
        self.seconds, self.failed = learned.seconds, learned.failed
        self.facts: Mapping[str, Any] = learned.facts

    @property
    def thresholds(self) -> Table:
        """Proposals beside the present values: of stopping rules their levels, of CUSUM tests J in units of nu."""
        types = {"monitor": str, "test": str, "now": float, "largest": float, "proposed": float}
        return Table.of(types, self._learned.rows)

    def write(self, into: str | PathLike[str] | None = None) -> Path:
        """Write the thresholds with their source into the configuration's file, or into a copy of it beside it.

        Args:
            into: the copy; None: the file itself.

        Raises:
            InputError: the copy would not find what lies beside the configuration.
        """
        path = self._file if into is None else Path(fspath(into))
        with spoken():
            self._learned.write(path)
        return path

    def __repr__(self) -> str:
        failed = f"; set {', '.join(self.failed)}" if self.failed else ""
        return f"Calibrated({self.seconds:.0f} s{failed})\n{self.thresholds}"

    def _repr_html_(self) -> str:
        return self.thresholds._repr_html_()

"""Rows of series: their columns, and how many are handed on at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

#: Rows that are handed on, and written, at once: a row group of Parquet.
GROUP = 1 << 16

#: Kinds of series.
FAULT, QUANTITY, SIGNAL, DTC = "fault", "quantity", "signal", "dtc"
#: Results by their numbers: of a fault's test, or of a DTC.
RESULTS = ("", "not tested", "passed", "failed", "set", "healed")


@dataclass(frozen=True)
class Series:
    """Common fields of rows.

    Attributes:
        monitor: its name; of a message check that of the check; empty: a signal.
        kind: ``fault``, ``quantity``, ``signal`` or ``dtc``.
        name: of the fault, the quantity or the signal; of a DTC its code.
        unit: of the values, empty where that is not known.
    """

    monitor: str
    kind: str
    name: str
    unit: str = ""


@dataclass(frozen=True)
class Rows:
    """Some rows, in order of time; arrays of shape (rows,).

    Attributes:
        t_ns: wall time [ns].
        series: place in the list of series.
        value: computed, in the series' unit.
        limit: compared with it, NaN: none.
        result: place in :data:`RESULTS`.
    """

    t_ns: NDArray[np.int64]
    series: NDArray[np.int32]
    value: NDArray[np.float64]
    limit: NDArray[np.float64]
    result: NDArray[np.int8]

    def __len__(self) -> int:
        return len(self.t_ns)


class Sink(Protocol):
    """Takes rows."""

    def write(self, rows: Rows, series: Sequence[Series]) -> None:
        """Take rows; the list of series only grows."""

    def close(self) -> None:
        """Take no more."""

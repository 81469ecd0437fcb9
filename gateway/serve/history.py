"""The last ten minutes of all residuals: columns of 50 ms for a minute, of 500 ms before."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway.engine.buckets import Bucket, Buckets, TickRow, merge

#: Columns that are kept, fine and coarse; ticks of a coarse one.
FINE, COARSE, TICKS = 1200, 1200, 10


class History:
    """What the ticks said.

    Args:
        faults: how many there are.
    """

    def __init__(self, faults: int) -> None:
        self._fine: deque[tuple[float, NDArray[np.void]]] = deque(maxlen=FINE)
        self._coarse: deque[tuple[float, NDArray[np.void]]] = deque(maxlen=COARSE)
        self._open: Buckets = np.zeros(faults, Bucket.dtype)
        self._ticks = 0

    def add(self, t_ms: float, rows: NDArray[np.void]) -> None:
        """Add one tick: its time and rows of TickRow."""
        rows = rows[rows["fault"] < len(self._open)]
        self._fine.append((t_ms, rows))
        later = np.zeros(len(self._open), Bucket.dtype)
        for name in Bucket.dtype.names or ():
            later[name][rows["fault"]] = rows[name]
        merge(self._open, later)
        self._ticks += 1
        if self._ticks >= TICKS:
            self._coarse.append((t_ms, _owned(self._open)))
            self._open = np.zeros(len(self._open), Bucket.dtype)
            self._ticks = 0

    def of(self, fault: int) -> dict[str, dict[str, list[Any]]]:
        """Return the columns of one fault: times of their ends [ms], least, greatest, limit of the worst, nearest."""
        return {"fine": _columns(self._fine, fault), "coarse": _columns(self._coarse, fault)}


def _owned(buckets: Buckets) -> NDArray[np.void]:
    told = np.flatnonzero(buckets["count"])
    rows = np.zeros(len(told), TickRow.dtype)
    for name in buckets.dtype.names or ():
        rows[name] = buckets[name][told]
    rows["fault"] = told
    return rows


def _columns(kept: deque[tuple[float, NDArray[np.void]]], fault: int) -> dict[str, list[Any]]:
    made: dict[str, list[Any]] = {"t": [], "low": [], "high": [], "threshold": [], "ratio": []}
    for t_ms, rows in kept:
        for row in rows[(rows["fault"] == fault) & (rows["numbers"] > 0)]:
            made["t"].append(t_ms)
            for name, field in (("low", "low"), ("high", "high"), ("threshold", "limit"), ("ratio", "ratio")):
                made[name].append(float(row[field]))
    return made

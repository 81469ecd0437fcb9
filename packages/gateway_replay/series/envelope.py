"""As much of a series as a picture can show: least and greatest value of buckets that grow with the log."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gateway_replay.series.rows import DTC, RESULTS, Rows, Series

#: Buckets of a series at most; with twice as many, two and two become one.
BUCKETS = 2000
#: DTC marks that are kept.
MOST_MARKS = 500

_FAILED = RESULTS.index("failed")


@dataclass
class Trace:
    """A series in buckets; arrays of shape (buckets,).

    Attributes:
        series: which.
        t_ns: of the first row in each bucket.
        low: least value.
        high: greatest value.
        limit: the last one.
        failed: whether a test failed in it.
    """

    series: Series
    t_ns: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))
    low: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    high: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    limit: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0))
    failed: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, np.bool_))

    def add(self, rows: Rows, at: NDArray[np.int64]) -> None:
        """Take rows."""
        value, failed = rows.value[at], rows.result[at] == _FAILED
        self.t_ns = np.append(self.t_ns, rows.t_ns[at])
        self.low, self.high = np.append(self.low, value), np.append(self.high, value)
        self.limit, self.failed = np.append(self.limit, rows.limit[at]), np.append(self.failed, failed)
        while len(self.t_ns) > 2 * BUCKETS:
            self._halve()

    def _halve(self) -> None:
        """Make one bucket of two neighbours, of equal spans of time."""
        edges = np.linspace(self.t_ns[0], self.t_ns[-1] + 1, BUCKETS + 1)
        first = np.flatnonzero(np.diff(np.searchsorted(edges, self.t_ns, side="right"), prepend=-1))
        with np.errstate(all="ignore"):
            self.low, self.high = np.fmin.reduceat(self.low, first), np.fmax.reduceat(self.high, first)
        self.failed = np.logical_or.reduceat(self.failed, first)
        last = np.append(first[1:], len(self.t_ns)) - 1
        self.limit, self.t_ns = self.limit[last], self.t_ns[first]


@dataclass(frozen=True)
class Mark:
    """A DTC that was set, or healed."""

    t_ns: int
    name: str
    monitor: str
    is_set: bool


class Envelope:
    """Takes rows, and keeps a picture's worth of them.

    Args:
        wanted: tells which series are kept; DTCs always are.
    """

    def __init__(self, wanted: Callable[[Series], bool] = lambda _: True) -> None:
        self._wanted = wanted
        self.traces: dict[Series, Trace] = {}
        self.marks: list[Mark] = []
        self.lost_marks = 0
        self.begin_ns, self.end_ns = math.inf, -math.inf

    def write(self, rows: Rows, series: Sequence[Series]) -> None:
        """Take rows."""
        if not len(rows):
            return
        self.begin_ns, self.end_ns = min(self.begin_ns, int(rows.t_ns[0])), max(self.end_ns, int(rows.t_ns[-1]))
        for k in np.unique(rows.series):
            one, at = series[int(k)], np.flatnonzero(rows.series == k)
            if one.kind == DTC:
                self._mark(rows, one, at)
            elif self._wanted(one):
                self.traces.setdefault(one, Trace(one)).add(rows, at)

    def _mark(self, rows: Rows, one: Series, at: NDArray[np.int64]) -> None:
        for j in at:
            if len(self.marks) >= MOST_MARKS:
                self.lost_marks += 1
                continue
            is_set = RESULTS[int(rows.result[j])] == "set"
            self.marks.append(Mark(int(rows.t_ns[j]), one.name, one.monitor, is_set))

    def close(self) -> None:
        """Take no more."""

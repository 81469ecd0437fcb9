"""The values of all signals at the same times: the data for relations between them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

#: Times that are kept at most; then every second one goes, and the room between them doubles.
MOST = 6000
#: Room between them at first [ns].
STEP_NS = 50_000_000
#: A value that is older does not count any more [ns]; of a signal that comes seldom: than this number of its usual
#: times from value to value, at most this time.
STALE_NS, TIMES, MOST_NS = 400_000_000, 2.5, 6_000_000_000


class Snapshots:
    """Values of signals over time, in rows of equal distance; bounded.

    Args:
        signals: how many columns there are.
    """

    def __init__(self, signals: int) -> None:
        self._held = np.full(signals, np.nan)
        self._since_ns = np.full(signals, np.iinfo(np.int64).min // 2)
        self._usual_ns = np.zeros(signals)
        self._rows: list[NDArray[np.float64]] = []
        self._stamps: list[NDArray[np.int64]] = []
        self._step_ns = STEP_NS
        self._next_ns: int | None = None

    @property
    def width(self) -> int:
        """How many signals there are."""
        return len(self._held)

    def begin(self) -> None:
        """Begin with another log."""
        self._since_ns[:] = np.iinfo(np.int64).min // 2
        self._next_ns = None

    def _stale_ns(self, columns: slice) -> float:
        """Return the age from which on values of a message do not count any more."""
        return max(STALE_NS, min(TIMES * float(self._usual_ns[columns.start]), MOST_NS))

    def every_s(self) -> NDArray[np.float64]:
        """Return the usual time from value to value of each signal [s]; 0: not known."""
        return self._usual_ns * 1e-9

    def grid(self, first_ns: int, last_ns: int) -> NDArray[np.int64]:
        """Return the times of a batch that rows are wanted of."""
        if self._next_ns is None:
            self._next_ns = first_ns + self._step_ns
        times: NDArray[np.int64] = np.arange(self._next_ns, last_ns + 1, self._step_ns, dtype=np.int64)
        if len(times):
            self._next_ns = int(times[-1]) + self._step_ns
        self._block = np.full((len(times), len(self._held)), np.nan)
        self._times = times
        return times

    def put(self, columns: slice, t_ns: NDArray[np.int64], values: NDArray[np.float64]) -> None:
        """Put the signals of one message into the batch's rows.

        Args:
            columns: of these signals.
            t_ns: stamps of its frames in the batch, in order.
            values: shape (frames, signals).
        """
        self._follow(columns, t_ns)
        stale_ns = self._stale_ns(columns)
        at = np.searchsorted(t_ns, self._times, side="right") - 1
        known = at >= 0
        fresh = known & (self._times - t_ns[at] <= stale_ns)
        self._block[fresh, columns] = values[at[fresh]]
        early = ~known & (self._times - self._since_ns[columns.start] <= stale_ns)
        self._block[early, columns] = self._held[columns]
        self._held[columns] = values[-1]
        self._since_ns[columns] = t_ns[-1]

    def _follow(self, columns: slice, t_ns: NDArray[np.int64]) -> None:
        """Learn how often a message comes: by half the difference, as a batch may have one frame of it only."""
        before = self._since_ns[columns.start]
        stamps = np.concatenate([[before], t_ns]) if before > 0 else t_ns
        if len(stamps) > 1 and columns.start < len(self._usual_ns):
            found, usual = float(np.median(np.diff(stamps))), float(self._usual_ns[columns.start])
            self._usual_ns[columns] = 0.5 * (usual + found) if usual else found

    def rest(self, columns: slice) -> None:
        """Put what a message that did not come in the batch had last."""
        early = self._times - self._since_ns[columns.start] <= self._stale_ns(columns)
        self._block[early, columns] = self._held[columns]

    def end(self) -> None:
        """Keep the batch's rows."""
        self._rows.append(self._block)
        self._stamps.append(self._times)
        if sum(len(block) for block in self._rows) > MOST:
            self._rows = [np.concatenate(self._rows)[::2]]
            self._stamps = [np.concatenate(self._stamps)[::2]]
            self._step_ns *= 2

    @property
    def step_s(self) -> float:
        """Time between rows [s]."""
        return self._step_ns * 1e-9

    def stamps(self) -> NDArray[np.int64]:
        """Return the times of the rows [ns]."""
        return np.concatenate(self._stamps) if self._stamps else np.zeros(0, np.int64)

    def matrix(self) -> NDArray[np.float64]:
        """Return the rows, shape (times, signals), NaN where a signal has no value."""
        return np.concatenate(self._rows) if self._rows else np.zeros((0, len(self._held)))

"""Silences that are common to all messages of a bus: it slept, or the recorder paused. No message is late for them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gateway_fleet.learn.gaps import Gaps, cycle_ns

#: A silence of the whole bus is a pause from this multiple on of the gap that 99.5 % of its gaps do not exceed, and
#: from this time on [ns]; of a bus with this number of identifiers: one or two may fall silent themselves.
UNUSUAL, SHARE, LEAST_NS, LEAST_IDS = 20.0, 0.995, 100_000_000, 3
#: Gaps of a bus that it takes to know what is usual.
LEAST_GAPS = 100
#: After a pause the bus woke up if a message came later than this number of its cycles, and this time [ns]: after a
#: pause of the recorder each comes within its cycle.
LATE, LATE_NS = 8.0, 200_000_000


class Pauses:
    """The pauses of one bus, of any number of logs.

    Attributes:
        count: pauses.
        longest_s: the longest [s].
    """

    def __init__(self) -> None:
        self.count, self.longest_s = 0, 0.0
        self._gaps = Gaps()
        self._ids: set[int] = set()
        self._numbers = 0
        self.begin()

    def begin(self) -> None:
        """Begin with another log: its begin has a number, too."""
        self._gaps.begin()
        self._begin_ns: int | None = None
        self._last_ns = 0
        self._starts: list[int] = []
        self._ends: list[int] = []
        self._number = self._numbers
        self._numbers += 1

    def add(self, t_ns: NDArray[np.int64], ids: NDArray[np.integer]) -> None:
        """Add the frames of the bus: stamps in order, identifiers."""
        self._ids.update(int(each) for each in np.unique(ids))
        stamps = t_ns if self._begin_ns is None else np.concatenate([[self._last_ns], t_ns])
        if self._begin_ns is None:
            self._begin_ns = int(t_ns[0])
        self._last_ns = int(t_ns[-1])
        self._gaps.add(t_ns)
        if self._gaps.count < LEAST_GAPS or len(self._ids) < LEAST_IDS:
            return
        least = max(LEAST_NS, UNUSUAL * self._gaps.quantile_ns(SHARE))
        for k in np.flatnonzero(np.diff(stamps) > least):
            self._starts.append(int(stamps[k]))
            self._ends.append(int(stamps[k + 1]))
            self._numbers += 1
            self.count += 1
            self.longest_s = max(self.longest_s, float(stamps[k + 1] - stamps[k]) * 1e-9)

    def woke_ns(self, since_ns: int) -> int:
        """Return when the last pause ended that began at a time or later, 0: there was none."""
        return self._ends[-1] if self._ends and self._starts[-1] >= since_ns else 0

    def give(self, gaps: Gaps, t_ns: NDArray[np.int64]) -> None:
        """Give a message the stamps of frames of its own, in order, of frames that the bus was given.

        A gap that the whole bus was silent in is none of the message; how soon it came again is kept.
        """
        first = gaps.last_ns is None
        stamps = gaps.stamps(t_ns)
        ends = np.array([self._begin_ns or 0, *self._ends], np.int64)
        pauses = np.searchsorted(np.array(self._starts, np.int64), stamps, side="left")
        none = pauses[1:] > pauses[:-1]
        for k in [0] * first + [int(at) + 1 for at in np.flatnonzero(none)]:
            gaps.returns_ns[self._number + int(pauses[k])] = int(stamps[k] - ends[pauses[k]])
        gaps.add(t_ns, none)


def set_wakes(gaps: Sequence[Gaps]) -> None:
    """Tell each message of a bus after how many pauses the bus woke up, and how late the message came."""
    woke = {
        number
        for each in gaps
        for number, delay in each.returns_ns.items()
        if (cycle := cycle_ns(each)) > 0.0 and delay > LATE * cycle + LATE_NS
    }
    for each in gaps:
        late = [delay for number, delay in each.returns_ns.items() if number in woke]
        each.wakes = len(late), max(late, default=0)

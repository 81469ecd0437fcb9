"""How a message is sent, by the order statistics of the gaps between its frames."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: Gaps are counted in bins, each this much wider than the one before; the first is of 1 us.
RATIO = 1.02
FIRST_NS = 1_000
BINS = 1200  # to 5.7 h
#: The longest gaps that are kept as they are.
LONGEST = 8


@dataclass
class Gaps:
    """The gaps between a message's frames, of any number of logs.

    Attributes:
        count: gaps.
        bins: how many gaps are in each, shape (BINS,).
        longest_ns: the longest, in falling order.
        last_ns: stamp of the latest frame in this log; None: none yet.
    """

    count: int = 0
    bins: NDArray[np.int64] = field(default_factory=lambda: np.zeros(BINS, np.int64))
    longest_ns: list[int] = field(default_factory=list)
    last_ns: int | None = None

    def begin(self) -> None:
        """Begin with another log: what lies between is no gap."""
        self.last_ns = None

    def add(self, t_ns: NDArray[np.int64]) -> None:
        """Add the stamps of frames, in order."""
        stamps = t_ns if self.last_ns is None else np.concatenate([[self.last_ns], t_ns])
        self.last_ns = int(t_ns[-1])
        gaps = np.diff(stamps)
        if not len(gaps):
            return
        self.count += len(gaps)
        places = np.log(np.maximum(gaps, FIRST_NS) / FIRST_NS) / np.log(RATIO)
        self.bins += np.bincount(np.minimum(places.astype(np.int64), BINS - 1), minlength=BINS)
        top = np.sort(gaps)[-LONGEST:]
        self.longest_ns = sorted([*self.longest_ns, *(int(gap) for gap in top)], reverse=True)[:LONGEST]

    def join(self, other: Gaps) -> None:
        """Add the gaps of other logs."""
        self.count += other.count
        self.bins += other.bins
        self.longest_ns = sorted([*self.longest_ns, *other.longest_ns], reverse=True)[:LONGEST]

    def quantile_ns(self, share: float) -> float:
        """Return a gap that a share of all gaps does not exceed, to 1 % [ns]."""
        assert self.count
        place = int(np.searchsorted(np.cumsum(self.bins), share * self.count))
        return float(FIRST_NS * RATIO ** (min(place, BINS - 1) + 0.5))

    @property
    def largest_ns(self) -> int:
        """The longest gap [ns]."""
        return self.longest_ns[0]

    def data(self) -> dict[str, Any]:
        """Return it for a file."""
        used = np.flatnonzero(self.bins)
        return {
            "count": self.count,
            "bins": {str(k): int(self.bins[k]) for k in used},
            "longest_ns": self.longest_ns,
        }

    @classmethod
    def of(cls, data: dict[str, Any]) -> Gaps:
        """Read it from a file."""
        made = cls(int(data["count"]), longest_ns=[int(gap) for gap in data["longest_ns"]])
        for k, count in data["bins"].items():
            made.bins[int(k)] = count
        return made


#: How a message is sent.
CYCLIC, MIXED, ON_CHANGE, TOO_FEW = "cyclic", "cyclic and on change", "on change", "too few"
#: Gaps that it takes to say anything.
LEAST_GAPS = 10


def sending(gaps: Gaps) -> str:
    """Tell how a message is sent.

    Cyclic: the longest gap is near the middle one. Cyclic and on change: many gaps are as long as the longest, which is
    its cycle, others shorter. Else on change: nothing says how long it may stay away.
    """
    if gaps.count < LEAST_GAPS:
        return TOO_FEW
    middle = gaps.quantile_ns(0.5)
    long = gaps.quantile_ns(0.9)
    if gaps.largest_ns <= 5 * middle and long <= 2.5 * middle:
        return CYCLIC
    if gaps.largest_ns <= 2 * long and gaps.quantile_ns(0.75) >= 0.8 * long:
        return MIXED
    return ON_CHANGE


def timeout_ms(gaps: Gaps) -> float | None:
    """Return a time after which a message is missing [ms], None where gaps do not say one.

    Of n gaps that follow one law the next exceeds the longest with probability 1/(n + 1): the fewer there are the more
    is added to it.
    """
    if sending(gaps) in (ON_CHANGE, TOO_FEW):
        return None
    cycle = gaps.quantile_ns(0.5 if sending(gaps) == CYCLIC else 0.9)
    return _rounded(max(5.0 * cycle, gaps.largest_ns * (2.0 + 20.0 / gaps.count)) * 1e-6)


def _rounded(value: float) -> float:
    """Round up to two digits, as people write."""
    unit = 10.0 ** (np.floor(np.log10(value)) - 1)
    return float(f"{np.ceil(value / unit - 1e-9) * unit:.6g}")

"""How a message is sent, by the order statistics of the gaps between its frames."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import bdtrc

from gateway_fleet.learn.counters import LEAST_EVIDENCE

#: Gaps are counted in bins, each this much wider than the one before; the first is of 1 us.
RATIO = 1.02
FIRST_NS = 1_000
BINS = 1200  # to 5.7 h
#: The longest gaps that are kept as they are.
LONGEST = 8
#: Numbers of gaps in a row whose shortest sum is kept.
ROWS = tuple(2**k for k in range(1, 11))


@dataclass
class Gaps:
    """The gaps between a message's frames, of any number of logs.

    Attributes:
        count: gaps.
        bins: how many gaps are in each, shape (BINS,).
        longest_ns: the longest, in falling order.
        last_ns: stamp of the latest frame in this log; None: none yet.
        returns_ns: number of a pause of the bus -> when it came again after it [ns].
        wakes: after how many times the bus woke up, and the latest that it came then [ns].
        counted: gaps whose rows were looked at.
        spans_ns: number of gaps in a row -> the shortest time that they took [ns]; 0: none was seen.
    """

    count: int = 0
    bins: NDArray[np.int64] = field(default_factory=lambda: np.zeros(BINS, np.int64))
    longest_ns: list[int] = field(default_factory=list)
    last_ns: int | None = None
    returns_ns: dict[int, int] = field(default_factory=dict)
    wakes: tuple[int, int] = (0, 0)
    counted: int = 0
    spans_ns: dict[int, int] = field(default_factory=lambda: dict.fromkeys(ROWS, 0))
    _recent: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))

    def begin(self) -> None:
        """Begin with another log: the time between is no gap."""
        self.last_ns = None
        self._recent = np.zeros(0, np.int64)

    def stamps(self, t_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the stamps of frames, with the one before them."""
        return t_ns if self.last_ns is None else np.concatenate([[self.last_ns], t_ns])

    def add(self, t_ns: NDArray[np.int64], none: NDArray[np.bool_] | None = None) -> None:
        """Add the stamps of frames, in order; ``none``: which gaps of :meth:`stamps` are none of this message."""
        self._count(t_ns)
        gaps = np.diff(self.stamps(t_ns))
        self.last_ns = int(t_ns[-1])
        if none is not None:
            gaps = gaps[~none]
        if not len(gaps):
            return
        self.count += len(gaps)
        places = np.log(np.maximum(gaps, FIRST_NS) / FIRST_NS) / np.log(RATIO)
        self.bins += np.bincount(np.minimum(places.astype(np.int64), BINS - 1), minlength=BINS)
        top = np.sort(gaps)[-LONGEST:]
        self.longest_ns = sorted([*self.longest_ns, *(int(gap) for gap in top)], reverse=True)[:LONGEST]

    def _count(self, t_ns: NDArray[np.int64]) -> None:
        """Look for the shortest rows of gaps that end with these frames; an old stamp counts where it came."""
        stamps = np.maximum.accumulate(np.concatenate([self._recent, t_ns]))
        self.counted += len(t_ns)
        for row in ROWS:
            if len(stamps) > row:
                self._shorter(row, int((stamps[row:] - stamps[:-row]).min()))
        self._recent = stamps[-ROWS[-1] :]

    def _shorter(self, row: int, span_ns: int) -> None:
        before = self.spans_ns[row]
        self.spans_ns[row] = span_ns if before == 0 else min(before, span_ns)

    def join(self, other: Gaps) -> None:
        """Add the gaps of other logs."""
        self.counted += other.counted
        for row, span_ns in other.spans_ns.items():
            if span_ns:
                self._shorter(row, span_ns)
        self.count += other.count
        self.bins += other.bins
        self.longest_ns = sorted([*self.longest_ns, *other.longest_ns], reverse=True)[:LONGEST]
        self.wakes = self.wakes[0] + other.wakes[0], max(self.wakes[1], other.wakes[1])

    def beyond(self, ns: float) -> float:
        """Return the share of gaps that are longer, to 2 % of the length."""
        place = int(np.log(max(ns, FIRST_NS) / FIRST_NS) / np.log(RATIO)) + 1
        return float(self.bins[place:].sum() / max(self.count, 1))

    def near(self, ns: float, within: float) -> float:
        """Return the share of gaps within a share of a length."""
        return self.beyond((1.0 - within) * ns) - self.beyond((1.0 + within) * ns)

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
            "wakes": list(self.wakes),
            "counted": self.counted,
            "spans_ns": [[row, span_ns] for row, span_ns in self.spans_ns.items()],
        }

    @classmethod
    def of(cls, data: dict[str, Any]) -> Gaps:
        """Read it from a file."""
        made = cls(int(data["count"]), longest_ns=[int(gap) for gap in data["longest_ns"]])
        for k, count in data["bins"].items():
            made.bins[int(k)] = count
        times, latest_ns = data.get("wakes", (0, 0))
        made.wakes = int(times), int(latest_ns)
        made.counted = int(data.get("counted", 0))  # earlier versions did not look
        made.spans_ns |= {int(row): int(span_ns) for row, span_ns in data.get("spans_ns", ())}
        return made


#: How a message is sent.
CYCLIC, MIXED, ON_CHANGE, TOO_FEW = "cyclic", "cyclic and on change", "on change", "too few"
#: Gaps that it takes to say anything.
LEAST_GAPS = 10
#: A cyclic message's gaps, of its cycle: nine of ten, 99 of 100, and the share that may be longer than ``FAR`` cycles
#: (frames were lost one after the other, its ECU restarted).
MOST_OF_TEN, MOST_OF_HUNDRED, FAR, SHARE_FAR = 2.5, 4.0, 6.0, 0.005
#: Share of the gaps that are near the cycle, and how near: of gaps by chance (exponential) fewer are.
NEAR_CYCLIC, WITHIN_CYCLIC, NEAR_MIXED, WITHIN_MIXED = 0.5, 0.4, 0.25, 0.25
#: How near gaps are looked for, to say that chance does not explain them.
WITHIN_EVIDENT = (0.4, 0.1)
#: One and a half standard deviations of a share of a half, of one gap.
FEW = 0.75
#: A message that once stayed away for this number of cycles, and for this time [ns], does so at times: no timeout fits
#: it.
AWAY, AWAY_NS = 100.0, 10_000_000_000
#: Cycles of a timeout, at least; more where that number of frames lost one after the other is not rare enough. A bus
#: with fewer cyclic frames than SHOWS [1/s], the engine's 100 in 15 s, does not show that it loses this share.
CYCLES, RARE, SHOWS, UNSEEN = 5.0, 1e-10, 100.0 / 15.0, 0.1
#: Longest time that a check of a message may have [ms].
LONGEST_MS = 3.6e6


def sending(gaps: Gaps) -> str:
    """Tell how a message is sent.

    Cyclic: nearly all gaps are a cycle; frames that were lost make a few of two, three, ... of them. Cyclic and on
    change: many gaps are as long as nearly the longest, which is its cycle, others shorter. Else on change: nothing
    says how long it may stay away.
    """
    if gaps.count < LEAST_GAPS:
        return TOO_FEW
    room = FEW / np.sqrt(gaps.count)  # few gaps show a share only roughly
    middle, long, longer = (gaps.quantile_ns(share) for share in (0.5, 0.9, 0.99))
    cycle = 0.0
    if (
        long <= MOST_OF_TEN * middle
        and longer <= MOST_OF_HUNDRED * middle
        and gaps.near(middle, WITHIN_CYCLIC) >= NEAR_CYCLIC + room
    ):
        kind, cycle = CYCLIC, middle
    elif (
        longer <= MOST_OF_TEN * long
        and gaps.quantile_ns(0.75) >= 0.8 * long
        and gaps.near(long, WITHIN_MIXED) >= NEAR_MIXED + room
    ):
        kind, cycle = MIXED, long
    if cycle == 0.0 or gaps.beyond(FAR * cycle) > max(SHARE_FAR, 1.5 / gaps.count):
        return ON_CHANGE
    if gaps.largest_ns > max(AWAY * cycle, AWAY_NS):
        return ON_CHANGE
    return kind if _evident(gaps, cycle) else TOO_FEW


def _evident(gaps: Gaps, cycle: float) -> bool:
    """Return whether chance does not explain how many gaps are near a cycle [ns].

    Of gaps by chance (exponential) the share q within (1 - w) and (1 + w) cycles is largest where their mean is
    2 w / ln((1 + w) / (1 - w)) cycles; that many of n are there by the binomial law.
    """
    for within in WITHIN_EVIDENT:
        rate = np.log((1.0 + within) / (1.0 - within)) / (2.0 * within)
        share = np.exp(-rate * (1.0 - within)) - np.exp(-rate * (1.0 + within))
        near = round(gaps.near(cycle, within) * gaps.count)
        if near and bdtrc(near - 1, gaps.count, share) * len(WITHIN_EVIDENT) < 2.0**-LEAST_EVIDENCE:
            return True
    return False


def cycle_ns(gaps: Gaps) -> float:
    """Return the cycle of a message [ns], 0 where it has none."""
    kind = sending(gaps)
    return 0.0 if kind in (ON_CHANGE, TOO_FEW) else gaps.quantile_ns(0.5 if kind == CYCLIC else 0.9)


def lost_share(gaps: Gaps) -> float:
    """Return the share of a cyclic message's frames that the log does not have, estimated.

    Of frames lost by chance, each with probability p, gaps of k cycles come p^(k - 1) (1 - p) of the time: gaps of two
    cycles are more than those of one and a half. Where they are not, the gaps are late frames.
    """
    if sending(gaps) != CYCLIC:
        return 0.0
    cycle = gaps.quantile_ns(0.5)
    half, two, rest = (gaps.beyond(times * cycle) for times in (1.3, 1.75, 2.25))
    return gaps.beyond(1.5 * cycle) if two - rest > 2.0 * (half - two) else 0.0


def shows_loss(some: Iterable[Gaps]) -> bool:
    """Return whether messages of a bus come often enough together to show that their frames get lost."""
    return sum(1e9 / cycle_ns(each) for each in some if sending(each) == CYCLIC) >= SHOWS


def timeout_ms(gaps: Gaps, *, shown: bool = True) -> float | None:
    """Return a time after which a message is missing [ms], None where gaps do not say one.

    Of n gaps that follow one law the next exceeds the longest with probability 1/(n + 1): the fewer there are the more
    is added to it. Where frames get lost, it is longer than any row of losses that is not rare.

    Args:
        gaps: of the message.
        shown: whether its bus shows that frames get lost (:func:`shows_loss`).
    """
    cycle = cycle_ns(gaps)
    if cycle == 0.0:
        return None
    lost = min(max(lost_share(gaps), 0.0 if shown else UNSEEN), 0.5)
    cycles = max(CYCLES, np.log(RARE) / np.log(lost)) if lost > 0.0 else CYCLES
    found = _rounded(max(cycles * cycle, gaps.largest_ns * _longer(gaps.count)) * 1e-6)
    return found if found <= LONGEST_MS else None


def _longer(count: int) -> float:
    """Return what a longest time of this number of times is multiplied by for what the next may take."""
    return 2.0 + 20.0 / count


def _rounded(value: float) -> float:
    """Round up to two digits, as people write."""
    unit = 10.0 ** (np.floor(np.log10(value)) - 1)
    return float(f"{np.ceil(value / unit - 1e-9) * unit:.6g}")


#: Shortest time of the row of gaps that is limited [ns]; share of it that such a row must take at least, and number of
#: rows that it takes to say so.
WINDOW_NS, LEAST_SHARE, LEAST_ROWS = 1_000_000_000, 0.75, 2
#: A message with a longer cycle is slow [ns]: it may be sent at a change, too, and its row has this number of gaps at
#: least. Two frames more, as senders send when they wake or are asked, break no limit: these cycles are left out.
SLOW_NS, LEAST_ROW, MORE = 90_000_000, 8, 2.25
#: Where fewer frames than this share repeat the one before, repeats say nothing; then a row has more gaps at least, and
#: takes this share of its time.
REPEATED, LONG_ROW, SHORT_SHARE = 1.0 / 3.0, 16, 0.6


def most(gaps: Gaps, repeated: float) -> dict[str, float | bool] | None:
    """Return how often a cyclic message may come, as ``most`` of its check; None where nothing says it.

    A second sender halves the time of a row of gaps, queues shorten it by their length, so that a limit of three
    quarters of a second stands a host that is a quarter of a second late. Of n rows that follow one law the next
    is shorter than the shortest with probability 1/(n + 1): the fewer there are, the more is added to what was missing.
    Of a slow message only frames that repeat the content before are counted, as nobody knows whether it is sent at a
    change, too; of one whose content always changes all are, with room for half as many again.

    Args:
        gaps: of the message.
        repeated: share of its frames that repeat the content before.
    """
    if sending(gaps) != CYCLIC:
        return None
    cycle = gaps.quantile_ns(0.5)
    slow, rolls = cycle > SLOW_NS, repeated < REPEATED
    least, share = (LONG_ROW, SHORT_SHARE) if slow and rolls else (LEAST_ROW, LEAST_SHARE)
    for row, span_ns in gaps.spans_ns.items():
        whole, count = row * cycle, gaps.counted // row
        if not WINDOW_NS <= whole <= LONGEST_MS * 1e6 or row < least or span_ns == 0 or count < LEAST_ROWS:
            continue
        share = min(share, 1.0 - MORE / row)
        if whole - _longer(count) * max(whole - span_ns, 0.0) >= share * whole:
            ms, cycle_ms = (float(f"{ns * 1e-6:.3g}") for ns in (share * whole, cycle))
            again = {"repeats": True} if slow and not rolls else {}
            return {"frames": row, "ms": ms, "cycle_ms": cycle_ms, **again}
    return None


#: After a few wake-ups a message may come later than ever by this factor; the bus's own time to wake is this [ms].
LATER, WAKE_MS = 2.0, 15_000.0
#: Wake-ups that it takes to wait less than the bus's own time.
LEAST_WAKES = 3


def wake_ms(gaps: Gaps, timeout: float) -> float | None:
    """Return the time that a message has to come after a wake-up and a start [ms], None: no wake-up was seen.

    Args:
        gaps: of the message.
        timeout: of it [ms].
    """
    times, latest_ns = gaps.wakes
    latest = max(latest_ns, 1_000_000) * 1e-6
    most = min(max(_rounded(LATER * latest), timeout, WAKE_MS), LONGEST_MS)
    if times >= LEAST_WAKES:
        return min(max(_rounded(_longer(times) * latest), timeout), most)
    return most if times else None

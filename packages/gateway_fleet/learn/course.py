"""Courses of signals: extremes, steepness, rest; all signals of a message at once."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway_fleet.learn.tails import wandering

#: First time of a log, in which signals do not count: senders start [ns].
START_NS = 1_000_000_000
#: Different values that are kept, to say whether a signal is a quantity or a state.
MOST_VALUES = 24
#: Values whose span is a smaller share of their size are those of one level: a cell's voltage at one charge.
NARROW = 0.02


@dataclass
class Course:
    """Course of one signal.

    Attributes:
        count: values, without those that stand for none.
        none: values that stand for none.
        none_s: the longest time of these, one after the other [s].
        lowest, highest: of the values; the start of a log is left out.
        steepest: largest change per second.
        changes: how often it changed.
        rest_s: the longest time without change, while it came [s].
        values: the first different ones, at most MOST_VALUES + 1.
        swings: how often it went from one end of its span to the other, in the latest logs.
        ways: of these, without noise.
        walk: how far its level wanders in a time as long as they are; 0: it is not shown to move.
    """

    count: int = 0
    none: int = 0
    none_s: float = 0.0
    lowest: float = np.inf
    highest: float = -np.inf
    steepest: float = 0.0
    changes: int = 0
    rest_s: float = 0.0
    values: set[float] = field(default_factory=set)
    swings: int = 0
    ways: int = 0
    walk: float = 0.0

    @property
    def span(self) -> float:
        """From the lowest to the highest value."""
        return self.highest - self.lowest if self.count else 0.0

    @property
    def narrow(self) -> bool:
        """Whether it stayed near one level: nothing shows where that is on another day, nor a law through zero."""
        return self.span < NARROW * max(abs(self.lowest), abs(self.highest))

    @property
    def states(self) -> bool:
        """Whether it has few values only."""
        return len(self.values) <= MOST_VALUES

    def join(self, other: Course) -> None:
        """Add what it did in other logs."""
        self.count += other.count
        self.none += other.none
        self.none_s = max(self.none_s, other.none_s)
        self.lowest, self.highest = min(self.lowest, other.lowest), max(self.highest, other.highest)
        self.steepest = max(self.steepest, other.steepest)
        self.changes += other.changes
        self.rest_s = max(self.rest_s, other.rest_s)
        self.values = set(sorted(self.values | other.values)[: MOST_VALUES + 1])

    def measure(self, values: NDArray[np.float64], rows: int = 1) -> None:
        """Count how often values, in order, go from a quarter at one end of their span to the other; and their walk.

        ``rows``: that one value of the signal takes. Two values are there in a real way; noise about one value comes
        there alone, and says nothing of where a quantity goes.
        """
        self.walk = wandering(values[~np.isnan(values)])
        with np.errstate(invalid="ignore"):
            side = np.sign((values > self.highest - 0.25 * self.span) * 1 - (values < self.lowest + 0.25 * self.span))
        twice = (side[rows:] == side[:-rows]) & (side[rows:] != 0)
        self.swings = int(np.count_nonzero(np.diff(side[side != 0])))
        self.ways = int(np.count_nonzero(np.diff(side[rows:][twice])))

    def data(self) -> list[Any]:
        """Return it for a file."""
        return [
            self.count, self.none, self.none_s, self.lowest, self.highest, self.steepest, self.changes, self.rest_s,
            sorted(self.values),
        ]  # fmt: skip

    @classmethod
    def of(cls, data: list[Any]) -> Course:
        """Read it from a file."""
        made = cls(*data[:-1])
        made.values = set(data[-1])
        return made


class Courses:
    """Courses of the signals of a message.

    Args:
        codes: of each signal, the values that stand for none.
    """

    def __init__(self, codes: list[tuple[float, ...]]) -> None:
        self.each = [Course() for _ in codes]
        self._codes = codes
        self._columns = sorted({k for k, some in enumerate(codes) if some})
        self.begin(0)

    def begin(self, t_ns: int) -> None:
        """Begin with another log, whose first frame is of this time."""
        count = len(self.each)
        self._start_ns = t_ns
        self._last = np.full(count, np.nan)
        self._last_ns = 0
        self._moved_ns = np.full(count, -1, np.int64)
        self._none_ns = np.full(count, -1, np.int64)

    def add(self, t_ns: NDArray[np.int64], values: NDArray[np.float64], usual_s: float = 0.0) -> None:
        """Add frames.

        Args:
            t_ns: their stamps, in order.
            values: shape (frames, signals), NaN where there is none.
            usual_s: time from frame to frame: a change is taken over this time at least, as the monitor takes it;
                frames that an adapter hands over together change no faster [s].
        """
        none = self._without_codes(t_ns, values)
        started = t_ns >= self._start_ns + START_NS
        present = ~np.isnan(values)
        counts = present.sum(axis=0)
        settled = np.where(started[:, None] & present, values, np.nan)
        with np.errstate(invalid="ignore"):
            lowest = np.fmin.reduce(settled, axis=0, initial=np.inf)
            highest = np.fmax.reduce(settled, axis=0, initial=-np.inf)
        for k, course in enumerate(self.each):
            course.count += int(counts[k])
            course.none += int(none[k])
            course.lowest, course.highest = min(course.lowest, lowest[k]), max(course.highest, highest[k])
            if len(course.values) <= MOST_VALUES:
                more = np.unique(settled[:, k][~np.isnan(settled[:, k])])[: MOST_VALUES + 1]
                course.values.update(float(each) for each in more)
        self._movement(t_ns, values, started, usual_s)

    def _without_codes(self, t_ns: NDArray[np.int64], values: NDArray[np.float64]) -> NDArray[np.int64]:
        """Take out what stands for no value; returns how often each signal had it."""
        none = np.zeros(len(self.each), np.int64)
        for k in self._columns:
            hit = np.isin(values[:, k], self._codes[k])
            none[k] = hit.sum()
            if none[k] or self._none_ns[k] >= 0:
                self._longest_none(k, t_ns, hit)
            values[hit, k] = np.nan
        return none

    def _longest_none(self, k: int, t_ns: NDArray[np.int64], hit: NDArray[np.bool_]) -> None:
        edges = np.flatnonzero(np.diff(np.concatenate([[self._none_ns[k] >= 0], hit]).astype(np.int8)))
        began = self._none_ns[k]
        for edge in edges:
            if hit[edge]:
                began = t_ns[edge]
            else:
                self.each[k].none_s = max(self.each[k].none_s, float(t_ns[edge] - began) * 1e-9)
                began = -1
        if began >= 0:
            self.each[k].none_s = max(self.each[k].none_s, float(t_ns[-1] - began) * 1e-9)
        self._none_ns[k] = began

    def _movement(
        self, t_ns: NDArray[np.int64], values: NDArray[np.float64], started: NDArray[np.bool_], usual_s: float
    ) -> None:
        """Take in changes: how steep, how many, how long there was none."""
        first_ns = self._last_ns if self._last_ns else int(t_ns[0])
        seconds = np.diff(np.concatenate([[first_ns], t_ns])) * 1e-9
        before = np.concatenate([self._last[None], values[:-1]])
        with np.errstate(invalid="ignore", divide="ignore"):
            change = np.abs(values - before)
            over = np.maximum(seconds, usual_s)
            rate = np.where((over > 0)[:, None] & started[:, None], change / over[:, None], np.nan)
        steepest = np.fmax.reduce(rate, axis=0, initial=0.0)
        moved = change > 0
        for k, course in enumerate(self.each):
            course.steepest = max(course.steepest, float(steepest[k]))
            at = np.flatnonzero(moved[:, k])
            if self._moved_ns[k] < 0:
                self._moved_ns[k] = t_ns[0]
            stamps = np.concatenate([[self._moved_ns[k]], t_ns[at], t_ns[-1:]])
            course.changes += len(at)
            course.rest_s = max(course.rest_s, float(np.diff(stamps).max()) * 1e-9)
            if len(at):
                self._moved_ns[k] = t_ns[at[-1]]
        self._last = np.where(np.isnan(values[-1]), self._last, values[-1])
        self._last_ns = int(t_ns[-1])

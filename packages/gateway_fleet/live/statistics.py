"""Statistics of each test in a drive, which those of other drives and cars can be added to: block maxima.

Of each minute the farthest that a test's value went towards its limit is kept, from the ticks of the status socket, in
which no test result is missed. At the end of a drive, and each half hour of a long one, a test's minutes become the
largest of them as they are (a tenth, as :mod:`gateway_fdi.tails` takes for the tail) and a t-digest of the others
(Dunning; the package fastdigest): values, and how many minutes each stands for. They are columns of small whole
numbers, of which little is left when they are compressed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
from fastdigest import TDigest

from gateway.engine.buckets import TickRow
from gateway.faults.fleet import FleetCondition
from gateway.runtime.contract import STATISTICS
from gateway_fdi.tails import SHARE

#: Length of a block [s]; blocks of a part of a long drive.
BLOCK_S, BLOCKS = 60.0, 30
#: Largest block maxima that are told at most; centroids of a digest; significant digits of what is alike or a limit.
MOST_TOP, CENTROIDS, DIGITS = 20, 5, 4
#: Steps that an interquartile range of block maxima is told in, at least.
STEPS = 10.0
#: Tests of one event.
TESTS = 100


@dataclass
class _Test:
    """A test: this block, and the blocks before."""

    sign: int = 0
    limit: float = math.nan
    farthest: float = -math.inf
    failed: int = 0
    blocks: dict[str, list[float]] = field(default_factory=dict)


class Drive:
    """Takes ticks, and makes statistics of them.

    Args:
        conditions: by which blocks are kept apart.
    """

    def __init__(self, conditions: Sequence[FleetCondition] = ()) -> None:
        self._conditions = conditions
        self._names: list[str] = []
        self._tests: dict[str, _Test] = {}
        self._begin_ns = self._block_ns = 0
        self._count = 0
        self._done: list[dict[str, Any]] = []
        self.condition = ""

    @property
    def signals(self) -> list[str]:
        """Signals that conditions name."""
        return sorted({condition.signal for condition in self._conditions})

    def note(self, values: Mapping[str, float | None]) -> None:
        """Note latest values of signals: the first condition that they meet is that of the block."""
        met = (one.name for one in self._conditions if _is_met(one, values.get(one.signal)))
        self.condition = next(met, "")

    def on_message(self, message: Mapping[str, Any], block: bytes) -> None:
        """Take a message of the status socket."""
        kind = message["kind"]
        if kind == "hello":
            self.end(self._block_ns)  # a daemon that begins: another drive
            self._names = [fault["id"] for fault in message["faults"]]
        elif kind == "tick":
            self._on_tick(int(message["t_ns"]), np.frombuffer(block, TickRow.dtype))
        elif kind == "event" and message["event"]["event"] == "cycle" and message["event"]["state"] == "ended":
            self.end(int(message["event"]["t_ns"]))

    def _on_tick(self, t_ns: int, rows: np.ndarray[Any, Any]) -> None:
        if not self._begin_ns or t_ns < self._block_ns:  # or the clock was set back
            self._begin_ns = self._block_ns = t_ns
        if t_ns >= self._block_ns + BLOCK_S * 1e9:
            self._close_block(t_ns)
        for row in rows[(rows["numbers"] > 0) & (rows["fault"] < len(self._names))]:
            test = self._tests.setdefault(self._names[int(row["fault"])], _Test())
            if row["worst"] != row["limit"]:
                test.sign = 1 if (row["worst"] > row["limit"]) == (row["ratio"] > 1.0) else -1
            test.limit = float(row["threshold"])
            test.failed += int(row["failed"])
            towards = float(row["high"]) if test.sign >= 0 else -float(row["low"])
            test.farthest = max(test.farthest, towards)

    def _close_block(self, t_ns: int) -> None:
        for test in self._tests.values():
            if math.isfinite(test.farthest):
                test.blocks.setdefault(self.condition, []).append(test.farthest)
            test.farthest = -math.inf
        self._block_ns = t_ns
        self._count += 1
        if self._count >= BLOCKS:
            self.end(t_ns)

    def end(self, t_ns: int) -> None:
        """End a drive, or a part of it; a block that is not over does not count."""
        conditions = sorted({name for test in self._tests.values() for name in test.blocks})
        for condition in conditions:
            here = [(name, test) for name, test in sorted(self._tests.items()) if test.blocks.get(condition)]
            seconds = BLOCK_S * max(len(test.blocks[condition]) for _, test in here)
            for part, at in enumerate(range(0, len(here), TESTS)):
                tests = columns({name: (test, test.blocks[condition]) for name, test in here[at : at + TESTS]})
                self._done.append({
                    "event": "statistics", "t_ns": t_ns, "begin_ns": self._begin_ns, "part": part,
                    "condition": condition, "block_s": BLOCK_S, "seconds": seconds, "tests": tests,
                })  # fmt: skip
        self._tests, self._count, self._begin_ns = {}, 0, 0

    def take(self) -> list[dict[str, Any]]:
        """Return events of drives that have ended, once."""
        done, self._done = self._done, []
        return done

    def give_back(self, events: Sequence[dict[str, Any]]) -> None:
        """Keep events that nobody took; of very many the first go."""
        self._done = [*events, *self._done][-1000:]


def _is_met(condition: FleetCondition, value: float | None) -> bool:
    if value is None or math.isnan(value):
        return False
    return (condition.min is None or value >= condition.min) and (condition.max is None or value <= condition.max)


def columns(tests: Mapping[str, tuple[_Test, Sequence[float]]]) -> dict[str, list[Any]]:
    """Return tests and their blocks as columns: see :data:`STATISTICS`."""
    columns: dict[str, list[Any]] = {name: [] for name in STATISTICS}
    for name, (test, blocks) in tests.items():
        unit, values, weights = _summary(sorted(blocks))
        limit = float(f"{test.limit:.{DIGITS}g}") if math.isfinite(test.limit) else None
        row = (name, test.sign, limit, test.failed, unit, values, weights)
        for column, value in zip(columns.values(), row, strict=True):
            column.append(value)
    return columns


def _summary(ordered: Sequence[float]) -> tuple[int, list[int], list[int]]:
    """Return the unit of blocks, their values in it, and how many blocks each stands for."""
    count = min(math.ceil(SHARE * len(ordered)) + 1, MOST_TOP, len(ordered))
    digest = TDigest(CENTROIDS)
    if len(ordered) > count:
        digest.batch_update(ordered[:-count])
    spread = ordered[3 * len(ordered) // 4] - ordered[len(ordered) // 4] or ordered[-1] - ordered[0]
    step = spread / STEPS or abs(ordered[-1]) * 10.0 ** (1 - DIGITS) or 1.0
    unit = math.floor(math.log2(step))
    of: dict[int, int] = {}
    for value, weight in [*digest.centroids, *((value, 1) for value in ordered[-count:])]:
        whole = round(value / 2.0**unit)
        of[whole] = of.get(whole, 0) + round(weight)
    return unit, [now - before for before, now in pairwise([0, *of])], [*of.values()]

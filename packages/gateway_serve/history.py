"""The last ten minutes of all residuals: columns of 50 ms for a minute, of 500 ms before; of bounded bytes.

Columns are kept in rings of rows that are there from the beginning: nothing is allocated for as long as the process
runs, and nothing small that lives for minutes lies between buffers that come and go.
"""

from __future__ import annotations

import base64
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from gateway.common.jsonlines import line
from gateway.engine.buckets import Bucket, Buckets, merge

#: Columns of one fault that are kept, fine and coarse; ticks of a coarse one, and how long each is kept [ms].
FINE, COARSE, TICKS = 1200, 1200, 10
FINE_MS, COARSE_MS = 60_000.0, 600_000.0
#: Most that each kind keeps [byte]: a minute and ten minutes of 280 faults with results in each tick, less of more.
MOST_BYTES = 16 << 20
#: Most that a new page gets, all in all and at once [byte]; it asks for the rest where a user looks at it.
PAST_BYTES, PIECE_BYTES = 4 << 20, 64 << 10

#: One column of one fault: when it ended [ms], least, greatest, limit of the worst result, nearest to a failure.
FIELDS = ("t", "low", "high", "threshold", "ratio")
_COLUMN = np.dtype([*((name, "<f8") for name in FIELDS), ("fault", "<i4")])
_BUCKET = list(Bucket.dtype.names or ())


class _Ring:
    """The last rows of those that were added."""

    def __init__(self, rows: int) -> None:
        self._rows = np.zeros(rows, _COLUMN)
        self._added = 0

    def add(self, rows: NDArray[np.void]) -> None:
        rows = rows[max(len(rows) - len(self._rows), 0) :]
        if not len(rows):
            return
        at = self._added % len(self._rows)
        first = min(len(rows), len(self._rows) - at)
        self._rows[at : at + first] = rows[:first]
        self._rows[: len(rows) - first] = rows[first:]
        self._added += len(rows)

    def parts(self) -> tuple[NDArray[np.void], ...]:
        """Return what is kept, the older part first."""
        if self._added < len(self._rows) or not len(self._rows):
            return (self._rows[: self._added],)
        at = self._added % len(self._rows)
        return (self._rows[at:], self._rows[:at])


class History:
    """Columns of the ticks.

    Args:
        faults: how many there are.
        most_bytes: that each of the two kinds of columns may take.

    Attributes:
        now_ms: time of the latest tick.
    """

    def __init__(self, faults: int, most_bytes: int = MOST_BYTES) -> None:
        most = most_bytes // _COLUMN.itemsize
        self._fine, self._coarse = _Ring(min(FINE * faults, most)), _Ring(min(COARSE * faults, most))
        self._open: Buckets = np.zeros(faults, Bucket.dtype)
        self._ticks = 0
        self.now_ms = 0.0

    def add(self, t_ms: float, rows: NDArray[np.void]) -> None:
        """Add one tick: its time and rows of TickRow, of each fault one at most."""
        rows = rows[(rows["fault"] < len(self._open)) & (rows["count"] > 0)]
        self.now_ms = t_ms
        faults = rows["fault"]
        self._fine.add(_columns(t_ms, faults, rows))
        merged = self._open[faults]
        merge(merged, rows[_BUCKET].astype(Bucket.dtype))
        self._open[faults] = merged
        self._ticks += 1
        if self._ticks >= TICKS:
            told = np.flatnonzero(self._open["count"])
            self._coarse.add(_columns(t_ms, told, self._open[told]))
            self._open["count"] = 0
            self._ticks = 0

    def of(self, fault: int, until_ms: float | None = None) -> dict[str, str]:
        """Return the columns of one fault as ``fine`` and ``coarse``.

        Each is base64 of little-endian float64: all times, then all least values, and so on as in :data:`FIELDS`.

        Args:
            fault: which one.
            until_ms: time of the last column; None: now.
        """
        until_ms = self.now_ms if until_ms is None else until_ms
        return {
            "fine": _as_json(self._fine, fault, until_ms - FINE_MS, until_ms),
            "coarse": _as_json(self._coarse, fault, until_ms - COARSE_MS, until_ms),
        }

    def past(self) -> Iterator[str]:
        """Yield the data for a new page, in pieces of JSON, the faults that are nearest to a failure first.

        A piece is ``{"faults": {NUMBER: as of() has it}, "end": whether it is the last}``. Each is made when it is
        asked for, of the columns until now.
        """
        return self._pieces(self.now_ms)

    def _pieces(self, until_ms: float) -> Iterator[str]:
        piece, size, all_of = {}, 0, 0
        for fault in self._nearest_first():
            found = self.of(int(fault), until_ms)
            piece[str(fault)] = found
            size += len(found["fine"]) + len(found["coarse"])
            if size >= PIECE_BYTES:
                yield line({"faults": piece, "end": False})
                all_of += size
                piece, size = {}, 0
                if all_of >= PAST_BYTES:
                    break
        yield line({"faults": piece, "end": True})

    def _nearest_first(self) -> NDArray[np.int64]:
        nearest = np.full(len(self._open), -1.0)
        for ring in (self._fine, self._coarse):
            for part in ring.parts():
                np.maximum.at(nearest, part["fault"], part["ratio"])
        order = np.argsort(-nearest, kind="stable")
        return order[nearest[order] >= 0]


def _columns(t_ms: float, faults: NDArray[np.integer], buckets: NDArray[np.void]) -> NDArray[np.void]:
    """Return the columns of buckets with numbers in them."""
    told = buckets["numbers"] > 0
    rows = np.zeros(int(told.sum()), _COLUMN)
    rows["t"], rows["fault"] = t_ms, faults[told]
    for name, field in (("low", "low"), ("high", "high"), ("threshold", "limit"), ("ratio", "ratio")):
        rows[name] = buckets[field][told]
    return rows


def _as_json(ring: _Ring, fault: int, since_ms: float, until_ms: float) -> str:
    parts = [part[part["fault"] == fault] for part in ring.parts()]
    rows = np.concatenate(parts)
    rows = rows[(rows["t"] > since_ms) & (rows["t"] <= until_ms)]
    return base64.b64encode(np.stack([rows[name] for name in FIELDS]).tobytes()).decode("ascii")

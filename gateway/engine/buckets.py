"""Buckets: the test results of each fault since the last look.

A residual of 1 kHz is looked at 20 times a second, and yet no sample is missed: least, greatest, latest and worst value
of all results in between are kept in the loop, where each result passes. They are reset when they are read, so an
engine has one reader, which shares them. Results that do not count (gate closed, results
held) are in none.

How near a result came to a failure is one number for limits from above and from below: 1 + (value - limit) / abs(limit)
for a value that must not exceed its limit, 1 - (value - limit) / abs(limit) for one that must not fall below it. For
limits of the usual kinds that is value / limit; 1 is the limit itself. A result says by its verdict which kind its
limit is. There is no scale where the limit is 0, nor where a value that equals it passes (tests for equality: CRC,
length): 0 passed, 2 failed.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway_fdi.jit import Record, f8, i1, i4, i8, kernel, means


class Bucket(Record):
    """Test results of one fault since the last look; times are of the wall clock."""

    count: i8 = means("test results; 0: the rest means nothing")
    failed: i8 = means("of them, those that failed")
    odd: i8 = means("of them, those whose value or limit is no number; they are in no other field but last_ns")
    numbers: i8 = means("of them, those that are in the fields below")
    low: f8 = means("least value")
    high: f8 = means("greatest value")
    last: f8 = means("latest value")
    threshold: f8 = means("its limit")
    ratio: f8 = means("nearest to a failure, 1: at the limit, above: failed")
    worst: f8 = means("value of that result")
    limit: f8 = means("its limit")
    worst_ns: i8 = means("its time", "ns")
    last_ns: i8 = means("time of the latest result", "ns")


class BucketOwner(Record):
    """Whose it is, where not all are together."""

    fault: i4 = means("index in the engine's list of faults")
    fdc: i1 = means("fault detection counter when the bucket was read")


class TickRow(Bucket, BucketOwner):
    """One row of a tick of the status socket (see live.status)."""


#: Shape (faults,) of :class:`Bucket`.
Buckets = NDArray[np.void]


@kernel
def nearness(failed: bool, value: float, limit: float) -> float:
    """Return how near a finite test result is to a failure, 0 or more; 1 at the limit."""
    scale = abs(limit)
    if scale == 0.0 or (value == limit and not failed):
        return 2.0 if failed else 0.0
    away = (value - limit) / scale
    if (value > limit) != failed:  # a limit from below
        away = -away
    return max(1.0 + away, 0.0)


@kernel
def note(T: Any, t_ns: int, fault: int, failed: bool, value: float, limit: float) -> None:
    """Keep one test result."""
    wall_ns = t_ns + T.clock[0].offset_ns
    note_alike(T.buckets, wall_ns, wall_ns, fault, 1, failed, value, limit)


@kernel
def note_alike(
    buckets: Any, first_ns: int, last_ns: int, fault: int, count: int, failed: bool, value: float, limit: float
) -> None:
    """Keep a number of test results that are all the same, from the first to the last by the wall clock."""
    if fault >= buckets.shape[0]:
        return
    b = buckets[fault]
    if b.count == 0:
        b.failed = 0
        b.odd = 0
        b.numbers = 0
    b.count += count
    b.last_ns = last_ns
    if failed:
        b.failed += count
    if not (np.isfinite(value) and np.isfinite(limit)):
        b.odd += count
        return
    if not failed and b.numbers > 0 and value == b.last and limit == b.threshold:
        b.numbers += count  # no nearer to a failure than the same result before
        b.last = value  # of the same sign, where it is zero
        b.threshold = limit
        return
    near = nearness(failed, value, limit)
    if b.numbers == 0:
        b.low = value
        b.high = value
        b.ratio = -1.0
    elif value < b.low:
        b.low = value
    elif value > b.high:
        b.high = value
    b.numbers += count
    b.last = value
    b.threshold = limit
    if near > b.ratio:
        b.ratio = near
        b.worst = value
        b.limit = limit
        b.worst_ns = first_ns


def take(buckets: Any) -> Buckets:
    """Return a copy of the buckets, and reset them."""
    taken = np.array(buckets, Bucket.dtype)
    buckets["count"] = 0
    return taken


def merge(into: Buckets, later: Buckets) -> None:
    """Add the results of a later time to buckets, as if they had been kept together; shape (n,) both."""
    if not len(into):
        return
    new = into["count"] == 0
    into[new] = later[new]
    both = ~new & (later["count"] > 0)
    fresh = both & (into["numbers"] == 0) & (later["numbers"] > 0)
    numbers = both & (into["numbers"] > 0) & (later["numbers"] > 0)
    for name in ("low", "high", "last", "threshold", "ratio", "worst", "limit", "worst_ns"):
        into[name][fresh] = later[name][fresh]
    into["low"][numbers] = np.minimum(into["low"], later["low"])[numbers]
    into["high"][numbers] = np.maximum(into["high"], later["high"])[numbers]
    worse = numbers & (later["ratio"] > into["ratio"])
    for name in ("last", "threshold"):
        into[name][numbers] = later[name][numbers]
    for name in ("ratio", "worst", "limit", "worst_ns"):
        into[name][worse] = later[name][worse]
    for name in ("count", "failed", "odd", "numbers"):
        into[name][both] += later[name][both]
    into["last_ns"][both] = later["last_ns"][both]

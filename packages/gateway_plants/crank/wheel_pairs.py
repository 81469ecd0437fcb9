"""A wheel none of whose intervals is like the next: two pitches that alternate, as of Mazda's 4-2.

Interval k alternates when it is about as long as the one two before it, and differs from the one before it by more
than ripple does. How often in a row it did is counted, with the mean ratio of the two. What that says depends on who
asks: on a wheel with a gap it cannot go on for two turns, because the gap comes in between.
"""

from __future__ import annotations

from math import exp, log

from gateway_fdi.jit import Record, f8, f8s, i8, kernel, means

#: An interval is like the one two before it within this share, and unlike the one before it from this ratio on
#: (logarithm).
LIKE, UNLIKE = 0.22, 0.28
#: Intervals in a row that have to alternate before two pitches are claimed.
LEAST = 96


class Pairs(Record):
    """What alternates."""

    one: f8 = means("last interval; 0: not known", "us")
    two: f8 = means("interval before that; 0: not known", "us")
    total: f8 = means("sum of the logarithms of the ratios")
    ratio: f8 = means("mean ratio of the longer to the shorter pitch, at the highest count")
    count: i8 = means("intervals in a row that alternated")
    most: i8 = means("highest count so far")


@kernel
def skip(pa: Pairs) -> None:
    """Pulses were lost, or the engine stood."""
    pa.one = 0.0
    pa.two = 0.0
    pa.count = 0


@kernel
def note(pa: Pairs, y: float) -> None:
    """Take an interval [us]; zero or less where pulses were lost."""
    if y <= 0.0:
        skip(pa)
        return
    alternates = pa.two > 0.0 and abs(y - pa.two) < LIKE * pa.two
    change = log(y / pa.one) if alternates else 0.0
    if abs(change) > UNLIKE:
        pa.total = abs(change) + (pa.total if pa.count > 0 else 0.0)
        pa.count += 1
        if pa.count > pa.most:
            pa.most = pa.count
            pa.ratio = exp(pa.total / pa.count)
    else:
        pa.count = 0
    pa.two = pa.one
    pa.one = y


@kernel
def longer(pa: Pairs) -> float:
    """Return the longer of the two pitches that alternated longest, when both together are two pitches."""
    return float(2.0 * pa.ratio / (1.0 + pa.ratio))


@kernel
def watch(pa: Pairs, intervals_us: f8s) -> None:
    """Take intervals one after the other, shape (n,) [us]."""
    for y in intervals_us:
        note(pa, y)

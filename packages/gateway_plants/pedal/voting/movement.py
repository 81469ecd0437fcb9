"""Readings at uneven times: what lies between two of them, and whether a third goes on along their line."""

from __future__ import annotations

import math

from gateway_fdi.jit import kernel

#: Over more lost samples than this nobody knows how it went.
MOST_LOST = 16.0


@kernel
def bent(y: float, last: float, older: float, dt: float, before: float) -> float:
    """Return the second difference of three readings, as if they were one period apart each.

    The line through ``older`` and ``last``, q = dt / before times as far on, is missed by y - last - q (last - older);
    of white noise that has the variance 1 + (1 + q)^2 + q^2, which is 6 for q = 1. It is scaled to that.

    Args:
        y: a reading.
        last: the one before, ``dt`` periods ago.
        older: the one before that, ``before`` periods earlier.
        dt: periods.
        before: periods.
    """
    if dt == before:
        return float(y - 2.0 * last + older)
    q = dt / before
    return float((y - last - q * (last - older)) * math.sqrt(6.0 / (1.0 + (1.0 + q) * (1.0 + q) + q * q)))


@kernel
def filtered(level: float, last: float, y: float, pole: float, dt: float) -> float:
    """Return what a filter of first order makes of a reading ``dt`` periods after the last, the way between a line.

    Args:
        level: of the filter at the last reading.
        last: the last reading.
        y: the reading.
        pole: of the filter, for one period.
        dt: periods, whole ones.
    """
    if dt > MOST_LOST:
        return y
    for k in range(1, int(dt)):
        between = last + (y - last) * k / dt
        level = between + pole * (level - between)
    return y + pole * (level - y)

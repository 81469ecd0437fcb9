"""Readings of one time, of sensors that are late by different times: what is early waits for what is late.

Samples come once a period. Of each signal the value is taken as many periods ago as it is early against the latest one,
between two samples on a line. So a sensor's lag takes no noise along, as a slope of its reading would.
"""

from __future__ import annotations

from typing import Annotated

from gateway_fdi.jit import Record, f8, f8s, i8, kernel, means

#: Samples that are kept, a power of 2; largest lag of either sign [periods].
KEPT = 16
MOST = KEPT // 2 - 1


class Const(Record):
    """Constants."""

    back: f8 = means("by how many periods what is neither late nor early is taken later")
    per_ms: f8 = means("periods in a millisecond")


class State(Record, lengths={"signals": 128}):
    """The newest samples."""

    value: Annotated[f8s, KEPT, "signals"] = means("values of the samples, in the signals' units")
    at: i8 = means("place of the last sample")


@kernel
def put(s: State, value: f8s, periods: int) -> None:
    """Take a sample.

    Args:
        value: of each signal.
        periods: since the sample before; those between are on a line. Not above 0: all begins again.
    """
    before = s.at
    for k in range(len(value)):
        last = s.value[before, k] if periods > 0 else value[k]
        count = min(periods, KEPT) if periods > 0 else KEPT
        for n in range(1, count + 1):
            s.value[(before + n) & (KEPT - 1), k] = last + n / count * (value[k] - last) if n < count else value[k]
    s.at = (before + (min(periods, KEPT) if periods > 0 else KEPT)) & (KEPT - 1)


@kernel
def read(s: State, k: int, back: float) -> float:
    """Return a signal's value ``back`` periods ago, at least 0 and at most 2 MOST."""
    ago = min(max(back, 0.0), 2.0 * MOST)
    whole = int(ago)
    value = s.value[(s.at - whole) & (KEPT - 1), k]
    if ago > whole:
        value += (ago - whole) * (s.value[(s.at - whole - 1) & (KEPT - 1), k] - value)
    return float(value)

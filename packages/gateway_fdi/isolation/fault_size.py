"""A fault whose size is estimated: confirmed, doubted, gone.

A suspect is not a finding. It is **confirmed** once its size has been what counts; it is let go where that takes too
long (**doubted**), and is **gone** when its size has been small for the hold time.
"""

from __future__ import annotations

from gateway_fdi.jit import Record, i8, kernel, means

#: Outcomes: it goes on; it never was; it has healed.
STANDS, DOUBTED, GONE = range(3)


class State(Record):
    """State."""

    confirmed: i8 = means("1: its size has been what counts")
    doubted: i8 = means("samples until now in which it has not been")
    well: i8 = means("samples in a row in which it was small")


@kernel
def begin(s: State) -> None:
    """Begin with a new suspect, or with none."""
    s.confirmed = s.doubted = s.well = 0


@kernel
def follow(s: State, counts: bool, small: bool, patience: int, hold: int) -> int:
    """Take the size of one sample; returns STANDS, DOUBTED or GONE.

    Args:
        counts: the size is what counts.
        small: it is so small that the fault may be gone.
        patience: samples in which a suspect has to be confirmed.
        hold: samples after which a fault is gone.
    """
    if counts:
        s.confirmed = 1
    s.doubted = 0 if s.confirmed == 1 else s.doubted + 1
    s.well = s.well + 1 if small else 0
    if s.well >= hold:
        return GONE
    return DOUBTED if s.doubted > patience else STANDS

"""Residuals that use the gear wait: a gear change, past or to come, takes away those of 200 ms before and behind it."""

from __future__ import annotations

from typing import Annotated

from gateway_fdi.jit import Record, f8s, i8, i8s, kernel, means

#: Residuals that wait beside each other, and sets that they can wait for.
LANES, MOST = 2, 64


class State(Record):
    """State."""

    at: i8 = means("sets so far; modulo MOST, the place of the next one")
    gear: i8 = means("gear of the last set")
    quiet: i8 = means("sets until residuals count again")
    held: Annotated[f8s, MOST, LANES] = means("residuals that wait")
    due: Annotated[i8s, MOST] = means("1: they count")


@kernel
def forget(s: State, wait: int) -> None:
    """Drop what waits, and count nothing for a while."""
    s.quiet = wait
    s.due[:] = 0


@kernel
def put(s: State, wait: int, gear: int, counts: bool, first: float, second: float) -> int:
    """Take a set's residuals; returns the place of those that have waited and count, or -1.

    Args:
        wait: sets before and behind a gear change.
        gear: of this set.
        counts: whether they may count: the clutch holds, and a gear is in.
        first: residual of lane 0.
        second: of lane 1.
    """
    if gear != s.gear:
        s.gear = gear
        forget(s, wait)
    now = s.at % MOST
    s.held[now, 0], s.held[now, 1] = first, second
    s.due[now] = 1 if counts and s.quiet == 0 else 0
    s.quiet = max(s.quiet - 1, 0)
    ready = (s.at - wait) % MOST
    behind = s.at >= wait and s.due[ready] == 1
    s.at += 1
    if behind:
        s.due[ready] = 0
        return int(ready)
    return -1

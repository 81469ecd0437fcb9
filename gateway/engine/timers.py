"""Timers of the loop: which one falls due next.

A heap of all timers by the time noted for each, of equal times the first in the table: checks of messages, monitors,
debounces by time, health of the buses. The times lie in the heap, so that nothing else is read to keep its order. The
owners keep their real deadlines; the time noted is a lower bound of it. So
a deadline that only moves on, as that of a message does with every frame, costs one comparison with the one before; the
heap is put right when the time noted comes. A deadline earlier than the one before must be told by :func:`arm`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from gateway.common.times import NEVER
from gateway.engine.tables import table
from gateway_fdi.jit import Record, i4, i8, kernel, means, u1

#: Whose a timer is.
CHECK, HANDLER, DEBOUNCE, HEALTH = range(4)


#: Places below one of the heap: they lie together, and the heap is half as high as with two.
_BELOW = 4


class Timer(Record):
    """One timer."""

    place: i4 = means("in the heap")
    index: i4 = means("its owner's row")
    kind: u1 = means("CHECK, HANDLER, DEBOUNCE, HEALTH")


class Noted(Record):
    """One place of the heap."""

    noted_ns: i8 = means("lower bound of the deadline of the timer's owner", "ns")
    timer: i4 = means("number of the timer")


@kernel
def _put(T: Any, place: int, noted_ns: int, timer: int) -> None:
    """Put a timer in a place."""
    n = T.heap[place]
    n.noted_ns = noted_ns
    n.timer = timer
    T.timers[timer].place = place


@kernel
def _first(T: Any, one: int, other: int) -> int:
    """Return which of two places holds the timer that comes first; without a branch, which would be unpredictable."""
    a, b = T.heap[one], T.heap[other]
    first = (a.noted_ns < b.noted_ns) | ((a.noted_ns == b.noted_ns) & (a.timer < b.timer))
    return one if first else other


@kernel
def _rise(T: Any, place: int, noted_ns: int, timer: int) -> None:
    """Put a timer where it belongs, from a place upwards that is free."""
    while place > 0:
        above = (place - 1) // _BELOW
        n = T.heap[above]
        if noted_ns > n.noted_ns or (noted_ns == n.noted_ns and timer > n.timer):
            break
        _put(T, place, n.noted_ns, n.timer)
        place = above
    _put(T, place, noted_ns, timer)


@kernel
def _sink(T: Any, place: int, noted_ns: int, timer: int) -> None:
    """Put a timer where it belongs, from a place downwards that is free."""
    count = T.timers.shape[0]
    while True:
        below = _BELOW * place + 1
        if below >= count:
            break
        least = _first(T, _first(T, below, below + 1), _first(T, below + 2, below + 3))
        n = T.heap[least]
        if noted_ns < n.noted_ns or (noted_ns == n.noted_ns and timer < n.timer):
            break
        _put(T, place, n.noted_ns, n.timer)
        place = least
    _put(T, place, noted_ns, timer)


@kernel
def arm(T: Any, timer: int, deadline_ns: int) -> None:
    """Take a deadline of a timer's owner that may be earlier than the one noted."""
    place = T.timers[timer].place
    if deadline_ns >= T.heap[place].noted_ns:
        return
    _rise(T, place, deadline_ns, timer)
    T.clock[0].deadline_ns = T.heap[0].noted_ns


@kernel
def _deadline(T: Any, timer: int) -> int:
    """Return the deadline that a timer's owner has now [ns]."""
    t = T.timers[timer]
    if t.kind == CHECK:
        return int(T.checks[t.index].deadline_ns)
    if t.kind == HANDLER:
        return int(T.handlers[t.index].wake_ns)
    if t.kind == DEBOUNCE:
        return int(T.debounces[t.index].deadline_ns)
    return int(T.health[t.index].deadline_ns)


@kernel
def put_right(T: Any, timer: int) -> None:
    """Note the deadline that a timer's owner has now."""
    place, deadline_ns = T.timers[timer].place, _deadline(T, timer)
    if deadline_ns < T.heap[place].noted_ns:
        _rise(T, place, deadline_ns, timer)
    else:
        _sink(T, place, deadline_ns, timer)
    T.clock[0].deadline_ns = T.heap[0].noted_ns


@kernel
def next_due(T: Any, t_ns: int) -> int:
    """Return the next timer that falls due at or before a time, -1: none does; its owner must be seen to."""
    while T.heap[0].noted_ns <= t_ns:
        timer, deadline_ns = T.heap[0].timer, _deadline(T, T.heap[0].timer)
        if T.heap[0].noted_ns == deadline_ns:
            return int(timer)
        _sink(T, 0, deadline_ns, timer)  # the noted time is never later than the deadline
    T.clock[0].deadline_ns = T.heap[0].noted_ns
    return -1


def timers_of(owners: Sequence[tuple[int, Any]]) -> tuple[Any, Any]:
    """Return the table of timers, and the heap; each owner gets the place of its own.

    Args:
        owners: kind and rows, in the order in which timers of equal deadlines fall due; debounces that count results
            have none.
    """
    kept = [
        (kind, index) for kind, rows in owners for index in range(len(rows)) if kind != DEBOUNCE or rows[index]["timed"]
    ]
    timers = table(len(kept), Timer)
    by_kind = dict(owners)
    for rows in by_kind.values():
        rows["timer"] = -1
    for k, (kind, index) in enumerate(kept):
        timers[k]["place"], timers[k]["kind"], timers[k]["index"] = k, kind, index
        by_kind[kind][index]["timer"] = k
    heap = table(len(kept) + _BELOW - 1, Noted)  # the last timer that has one below it is asked for all of them
    heap["noted_ns"], heap["timer"] = NEVER, range(len(heap))
    return timers, heap


def note_all(T: Any) -> None:
    """Note the deadlines of all owners again: they were written without :func:`arm`."""
    owned = {
        CHECK: T.checks["deadline_ns"],
        HANDLER: T.handlers["wake_ns"],
        DEBOUNCE: T.debounces["deadline_ns"],
        HEALTH: T.health["deadline_ns"],
    }
    noted_ns = np.full(len(T.timers), NEVER)
    for kind, deadlines in owned.items():
        mine = T.timers["kind"] == kind
        noted_ns[mine] = deadlines[T.timers["index"][mine]]
    order = np.argsort(noted_ns, kind="stable")
    T.heap["noted_ns"][: len(order)], T.heap["timer"][: len(order)] = noted_ns[order], order
    T.timers["place"][order] = np.arange(len(order))
    T.clock["deadline_ns"] = T.heap["noted_ns"][0]

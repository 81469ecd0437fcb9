"""Timers of the loop: which one falls due next.

A heap of all timers by the time noted for each, of equal times the first in the table: checks of messages, monitors,
debounces by time, health of the buses. The owners keep their real deadlines; the time noted is a lower bound of it. So
a deadline that only moves on, as that of a message does with every frame, costs one comparison; the heap is put right
when the time noted comes. An earlier deadline must be told by :func:`arm`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway.common.times import NEVER
from gateway.engine.tables import table
from gateway.jit import Record, i4, i8, kernel, means, u1

#: Whose a timer is.
CHECK, HANDLER, DEBOUNCE, HEALTH = range(4)


class Timer(Record):
    """One timer."""

    noted_ns: i8 = means("lower bound of its owner's deadline", "ns")
    place: i4 = means("in the heap")
    index: i4 = means("its owner's row")
    kind: u1 = means("CHECK, HANDLER, DEBOUNCE, HEALTH")


@kernel
def _before(T: Any, one: int, other: int) -> bool:
    """Tell whether a timer comes before another one."""
    first, second = T.timers[one].noted_ns, T.timers[other].noted_ns
    return first < second or (first == second and one < other)


@kernel
def _rise(T: Any, place: int) -> None:
    """Let the timer at a place rise to where it belongs."""
    mine = T.heap[place]
    while place > 0:
        above = (place - 1) >> 1
        if not _before(T, mine, T.heap[above]):
            break
        T.heap[place] = T.heap[above]
        T.timers[T.heap[place]].place = place
        place = above
    T.heap[place] = mine
    T.timers[mine].place = place


@kernel
def _sink(T: Any, place: int) -> None:
    """Let the timer at a place sink to where it belongs."""
    mine, count = T.heap[place], T.heap.shape[0]
    while True:
        below = 2 * place + 1
        if below >= count:
            break
        if below + 1 < count and _before(T, T.heap[below + 1], T.heap[below]):
            below += 1
        if not _before(T, T.heap[below], mine):
            break
        T.heap[place] = T.heap[below]
        T.timers[T.heap[place]].place = place
        place = below
    T.heap[place] = mine
    T.timers[mine].place = place


@kernel
def arm(T: Any, timer: int, deadline_ns: int) -> None:
    """Take a deadline of a timer's owner that may be earlier than the one noted."""
    t = T.timers[timer]
    if deadline_ns >= t.noted_ns:
        return
    t.noted_ns = deadline_ns
    _rise(T, t.place)
    T.clock[0].deadline_ns = T.timers[T.heap[0]].noted_ns


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
    t = T.timers[timer]
    t.noted_ns = _deadline(T, timer)
    _rise(T, t.place)
    _sink(T, t.place)
    T.clock[0].deadline_ns = T.timers[T.heap[0]].noted_ns


@kernel
def next_due(T: Any, t_ns: int) -> int:
    """Return the next timer that falls due at or before a time, -1: none does; its owner must be seen to."""
    while T.timers[T.heap[0]].noted_ns <= t_ns:
        timer = int(T.heap[0])
        if T.timers[timer].noted_ns == _deadline(T, timer):
            return timer
        put_right(T, timer)
    return -1


def timers_of(owners: Sequence[tuple[int, Any]]) -> tuple[Any, NDArray[np.int32]]:
    """Return the table of timers, and the heap; each owner is told which is its own.

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
        timers[k]["noted_ns"], timers[k]["place"] = NEVER, k
        timers[k]["kind"], timers[k]["index"] = kind, index
        by_kind[kind][index]["timer"] = k
    return timers, np.arange(len(kept), dtype=np.int32)


def note_all(T: Any) -> None:
    """Note the deadlines of all owners anew: they were written without :func:`arm`."""
    owned = {
        CHECK: T.checks["deadline_ns"],
        HANDLER: T.handlers["wake_ns"],
        DEBOUNCE: T.debounces["deadline_ns"],
        HEALTH: T.health["deadline_ns"],
    }
    for kind, deadlines in owned.items():
        mine = T.timers["kind"] == kind
        T.timers["noted_ns"][mine] = deadlines[T.timers["index"][mine]]
    T.heap[:] = np.argsort(T.timers["noted_ns"], kind="stable")
    T.timers["place"][T.heap] = np.arange(len(T.heap))
    T.clock["deadline_ns"] = T.timers["noted_ns"][T.heap[0]]

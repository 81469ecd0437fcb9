"""Timers of the loop: which one falls due next.

A heap by the time noted, of equal times the first in the table: checks of messages, monitors, debounces by time, health
of the buses. The times lie in the heap, so that nothing else is read to keep its order. The owners keep their real
deadlines; the time noted is a lower bound of it. So a deadline that only moves on, as that of a message does with every
frame, costs one comparison with the one before; the heap is put right when the time noted comes. A deadline earlier
than the one before must be told by :func:`arm`.

Checks of messages with about the same timeout are looked at together: a group has one place in the heap, by the
earliest of its timers. Their deadlines move on alike, and a look at all of them costs little more than at one.
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


#: Checks of a group at most, and the longest of their timeouts over the shortest.
_MOST, _SPREAD = 16, 2


class Timer(Record):
    """One timer."""

    group: i4 = means("its group")
    index: i4 = means("its owner's row")
    kind: u1 = means("CHECK, HANDLER, DEBOUNCE, HEALTH")


class Group(Record):
    """Timers that are looked at together: checks, or one of another kind."""

    place: i4 = means("in the heap")
    first: i4 = means("of its timers, among the members")
    count: i4 = means("its timers")


class Noted(Record):
    """One place of the heap."""

    noted_ns: i8 = means("lower bound of the deadlines of the group's owners", "ns")
    timer: i4 = means("number of the timer that had it")
    group: i4 = means("number of the group")


@kernel
def _put(T: Any, place: int, noted_ns: int, timer: int, group: int) -> None:
    """Put a group in a place."""
    n = T.heap[place]
    n.noted_ns = noted_ns
    n.timer = timer
    n.group = group
    T.groups[group].place = place


@kernel
def _first(T: Any, one: int, other: int) -> int:
    """Return which of two places holds the timer that comes first; without a branch, which would be unpredictable."""
    a, b = T.heap[one], T.heap[other]
    first = (a.noted_ns < b.noted_ns) | ((a.noted_ns == b.noted_ns) & (a.timer < b.timer))
    return one if first else other


@kernel
def _comes_before(noted_ns: int, timer: int, n: Any) -> bool:
    """Return whether a deadline of a timer comes before what is noted."""
    return bool(noted_ns < n.noted_ns or (noted_ns == n.noted_ns and timer < n.timer))


@kernel
def _rise(T: Any, place: int, noted_ns: int, timer: int, group: int) -> None:
    """Put a group where it belongs, from a place upwards that is free."""
    while place > 0:
        above = (place - 1) // _BELOW
        n = T.heap[above]
        if not _comes_before(noted_ns, timer, n):
            break
        _put(T, place, n.noted_ns, n.timer, n.group)
        place = above
    _put(T, place, noted_ns, timer, group)


@kernel
def _sink(T: Any, place: int, noted_ns: int, timer: int, group: int) -> None:
    """Put a group where it belongs, from a place downwards that is free."""
    count = T.groups.shape[0]
    while True:
        below = _BELOW * place + 1
        if below >= count:
            break
        least = _first(T, _first(T, below, below + 1), _first(T, below + 2, below + 3))
        n = T.heap[least]
        if _comes_before(noted_ns, timer, n):
            break
        _put(T, place, n.noted_ns, n.timer, n.group)
        place = least
    _put(T, place, noted_ns, timer, group)


@kernel
def arm(T: Any, timer: int, deadline_ns: int) -> None:
    """Take a deadline of a timer's owner that may be earlier than the one noted."""
    group = T.timers[timer].group
    place = T.groups[group].place
    if not _comes_before(deadline_ns, timer, T.heap[place]):
        return
    _rise(T, place, deadline_ns, timer, group)
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
def _earliest(T: Any, group: int) -> tuple[int, int]:
    """Return the earliest deadline of a group [ns], and the first timer that has it."""
    g = T.groups[group]
    timer = T.members[g.first]
    if T.timers[timer].kind != CHECK:
        return _deadline(T, timer), int(timer)
    earliest_ns = T.checks[timer].deadline_ns  # checks come first: the timer has the number of its row
    for k in range(g.first + 1, g.first + g.count):
        other = T.members[k]
        deadline_ns = T.checks[other].deadline_ns
        if deadline_ns < earliest_ns:
            earliest_ns, timer = deadline_ns, other
    return int(earliest_ns), int(timer)


@kernel
def put_right(T: Any, timer: int) -> None:
    """Note the deadline that a timer's owner has now."""
    group = T.timers[timer].group
    place = T.groups[group].place
    deadline_ns, first = _earliest(T, group)
    if _comes_before(deadline_ns, first, T.heap[place]):
        _rise(T, place, deadline_ns, first, group)
    else:
        _sink(T, place, deadline_ns, first, group)
    T.clock[0].deadline_ns = T.heap[0].noted_ns


@kernel
def next_due(T: Any, t_ns: int) -> int:
    """Return the next timer that falls due at or before a time, -1: none does; its owner must be seen to."""
    while T.heap[0].noted_ns <= t_ns:
        n = T.heap[0]
        deadline_ns, timer = _earliest(T, n.group)
        if n.noted_ns == deadline_ns and n.timer == timer:
            return int(timer)
        _sink(T, 0, deadline_ns, timer, n.group)  # what is noted never comes after the deadline
    T.clock[0].deadline_ns = T.heap[0].noted_ns
    return -1


def _grouped(kept: Sequence[tuple[int, int]], timeouts_ns: Any) -> list[list[int]]:
    """Return the timers of each group: checks by their timeouts, all others alone."""
    checks = [k for k, (kind, _) in enumerate(kept) if kind == CHECK]
    groups: list[list[int]] = []
    least_ns = 0
    for k in sorted(checks, key=lambda k: timeouts_ns[k]):
        if not groups or len(groups[-1]) == _MOST or timeouts_ns[k] > _SPREAD * least_ns:
            groups.append([])
            least_ns = timeouts_ns[k]
        groups[-1].append(k)
    return [*map(sorted, groups), *([k] for k in range(len(checks), len(kept)))]


def timers_of(owners: Sequence[tuple[int, Any]]) -> tuple[Any, Any, Any, Any]:
    """Return the tables of timers and groups, the members of these, and the heap; each owner gets its timer's number.

    Args:
        owners: kind and rows, in the order in which timers of equal deadlines fall due, checks first; debounces that
            count results have none.
    """
    kept = [
        (kind, index) for kind, rows in owners for index in range(len(rows)) if kind != DEBOUNCE or rows[index]["timed"]
    ]
    timers = table(len(kept), Timer)
    by_kind = dict(owners)
    for rows in by_kind.values():
        rows["timer"] = -1
    for k, (kind, index) in enumerate(kept):
        timers[k]["kind"], timers[k]["index"] = kind, index
        by_kind[kind][index]["timer"] = k
    made = _grouped(kept, by_kind[CHECK]["timeout_ns"].tolist())
    groups, members = table(len(made), Group), np.asarray([k for each in made for k in each], np.int32)
    groups["count"] = [len(each) for each in made]
    groups["first"], groups["place"] = np.cumsum(groups["count"]) - groups["count"], range(len(made))
    timers["group"][members] = np.repeat(range(len(made)), groups["count"])
    heap = table(len(made) + _BELOW - 1, Noted)  # the last group that has one below it is asked for all of them
    heap["noted_ns"], heap["timer"] = NEVER, len(kept)
    heap["timer"][: len(made)], heap["group"][: len(made)] = [each[0] for each in made], range(len(made))
    return timers, groups, members, heap


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
    order = np.lexsort((noted_ns, T.timers["group"]))  # it is stable
    earliest = order[T.groups["first"]]  # of each group
    groups = np.lexsort((earliest, noted_ns[earliest]))
    heap = T.heap[: len(groups)]
    heap["noted_ns"], heap["timer"], heap["group"] = noted_ns[earliest[groups]], earliest[groups], groups
    T.groups["place"][groups] = np.arange(len(groups))
    T.clock["deadline_ns"] = T.heap["noted_ns"][0]

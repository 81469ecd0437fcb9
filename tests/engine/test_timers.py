"""The heap of timers falls due in the order in which a search through all of them would find them."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway.common.times import NEVER
from gateway.engine.checks.bus_health import Health
from gateway.engine.checks.communication import Check
from gateway.engine.debounce import DebounceRow
from gateway.engine.tables import Clock, Handler, table
from gateway.engine.timers import CHECK, DEBOUNCE, HANDLER, HEALTH, arm, next_due, note_all, put_right, timers_of


class Tables(NamedTuple):
    """What timers read of the engine's tables."""

    checks: Any
    handlers: Any
    debounces: Any
    health: Any
    clock: Any
    timers: Any
    groups: Any
    members: Any
    heap: Any


FIELD = {CHECK: "deadline_ns", HANDLER: "wake_ns", DEBOUNCE: "deadline_ns", HEALTH: "deadline_ns"}


def tables(checks: int, handlers: int, debounces: int, health: int) -> Tables:
    rows = (table(checks, Check), table(handlers, Handler), table(debounces, DebounceRow), table(health, Health))
    rows[DEBOUNCE]["timed"] = 1
    rows[CHECK]["timeout_ns"] = np.resize([10, 100, 12], checks)
    for kind, field in FIELD.items():
        rows[kind][field] = NEVER
    clock = table(1, Clock)
    clock["deadline_ns"] = NEVER
    return Tables(*rows, clock, *timers_of([(kind, rows[kind]) for kind in FIELD]))


def owner_of(t: Tables, timer: int) -> tuple[Any, str]:
    kind = int(t.timers["kind"][timer])
    return t[kind][int(t.timers["index"][timer])], FIELD[kind]


def first_by_search(t: Tables, t_ns: int) -> int:
    """What the loop did before there was a heap."""
    found, due = -1, NEVER
    for timer in range(len(t.timers)):
        row, field = owner_of(t, timer)
        if row[field] < due:
            found, due = timer, int(row[field])
    return found if due <= t_ns else -1


deadline = st.one_of(st.integers(0, 9), st.just(NEVER))
change = st.tuples(st.integers(0, 99), deadline, st.sampled_from(["arm", "note", "write"]))


@settings(max_examples=200)
@given(
    sizes=st.tuples(st.integers(0, 30), st.integers(0, 4), st.integers(0, 4), st.integers(1, 3)),
    turns=st.lists(st.tuples(st.lists(change, max_size=6), st.integers(0, 12)), max_size=12),
)
def test_timers_fall_due_as_a_search_finds_them(sizes: Any, turns: Any) -> None:
    t, now = tables(*sizes), 0
    for changes, passed in turns:
        for which, later, how in changes:
            timer = which % len(t.timers)
            row, field = owner_of(t, timer)
            new = NEVER if later == NEVER else now + later
            if how == "write":  # only a later deadline may go untold
                new = max(new, int(row[field]))
            row[field] = new
            if how == "arm":
                arm(t, timer, new)
            elif how == "note":
                note_all(t)
        now += passed
        for _ in range(200):
            expected, found = first_by_search(t, now), int(next_due(t, now))
            assert found == expected
            if found < 0:
                break
            row, field = owner_of(t, found)
            assert t.heap["timer"][0] == found
            assert t.heap["noted_ns"][0] == row[field]
            row[field] = NEVER if (found + now) % 3 else int(row[field]) + 5
            put_right(t, found)
        else:
            raise AssertionError("a timer falls due again and again")
        assert t.clock["deadline_ns"][0] == t.heap["noted_ns"].min() == t.heap["noted_ns"][0]
        assert sorted(t.heap["group"][: len(t.groups)]) == list(range(len(t.groups)))
        assert (t.heap["noted_ns"][len(t.groups) :] == NEVER).all()
        noted = t.heap["noted_ns"][t.groups["place"][t.timers["group"]]]
        real = [int(row[field]) for row, field in (owner_of(t, k) for k in range(len(t.timers)))]
        assert (noted <= np.array(real)).all()


def test_debounces_that_count_have_no_timer() -> None:
    debounces = table(3, DebounceRow)
    debounces["timed"] = (0, 1, 0)
    timers, _, _, heap = timers_of([(CHECK, table(0, Check)), (DEBOUNCE, debounces), (HEALTH, table(1, Health))])
    assert list(debounces["timer"]) == [-1, 0, -1]
    assert list(timers["kind"]) == [DEBOUNCE, HEALTH]
    assert list(heap["timer"][:2]) == [0, 1]

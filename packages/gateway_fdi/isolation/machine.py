"""State machine of the isolation: when a fault is named from the tests that have fired, and for how long it stands.

    nothing       no test has fired
    pending       tests have fired, and nothing is told: one that is yet to fire may name the fault
    named         one fault, or one group that the tests cannot tell apart
    not isolated  told once no name can be expected any more

docs/isolation.md has the picture. A test that fires **joins** at once. It **leaves** when it has been down for the hold
time: alone, or only together with all others. A name needs the confirmation time since a test has joined last, a test
that is up, and no other one on its way. It stands until its last test has left, or one joins that contradicts it. A
fault that cannot be named stays pending for a time, so that one fault is told once, not as "not isolated" and then by
its name.

All times are of *use*, in which tests can fire, as the plant says; only the latest time counts always.
"""

from __future__ import annotations

from typing import Annotated, Any

from gateway_fdi.isolation import table
from gateway_fdi.isolation.table import NOTHING, OPEN
from gateway_fdi.jit import f8, f8s, i8, i8s, kernel, means
from gateway_fdi.masks import clear, copy, empty, exclude, has, include, within

#: A time that does not pass [ns].
NEVER = 1 << 62


class Const(table.Const, lengths=table.LENGTHS):
    """Constants: the table and the times."""

    confirm_ns: i8 = means("without another test that joins, before a name is told", "ns")
    hold_ns: i8 = means("for which a test is down before it leaves", "ns")
    heal_ns: i8 = means("likewise while a name stands", "ns")
    together: i8 = means("1: tests leave when all of them have been down for so long; 0: each alone")
    pending_ns: i8 = means("since a test joined, for which a name is awaited", "ns")
    latest_ns: i8 = means("likewise, in all, where a test is on its way that would give a name", "ns")
    hopeless_ns: i8 = means("likewise, where no fault of the table explains what has fired", "ns")
    withdraw_ns: i8 = means("for which a name stands that a test contradicts", "ns")
    near: f8 = means("T over J of a test that is on its way")


class State(table.State, lengths=table.LENGTHS):
    """State."""

    up: Annotated[i8s, "words"] = means("tests above their threshold in this sample, a mask")
    down_ns: Annotated[i8s, "tests"] = means("since each test that has fired was up", "ns")
    joined_ns: i8 = means("of use since a test joined", "ns")
    waited_ns: i8 = means("since a test joined", "ns")
    found: i8 = means("what is told: a group; after the groups: not isolated; -1: nothing")
    basis: Annotated[i8s, "words"] = means("tests that had fired for it")


def prepare(s: Any, c: Any, *, confirm_ns: int, hold_ns: int, pending_ns: int = NEVER) -> None:
    """Fill the times and the first state: each test leaves alone, and a name stands as long as a name is awaited.

    Args:
        s: record of State, or of a class derived from it.
        c: record of Const, or of a class derived from it.
        confirm_ns: before a name is told [ns].
        hold_ns: before a test leaves [ns].
        pending_ns: for which a name is awaited [ns].
    """
    c.confirm_ns, c.hold_ns, c.heal_ns, c.together = confirm_ns, hold_ns, hold_ns, 0
    c.pending_ns = c.latest_ns = c.hopeless_ns = c.withdraw_ns = pending_ns
    c.near = float("inf")
    s.found, s.joined_ns, s.waited_ns = NOTHING, NEVER // 2, NEVER // 2


@kernel
def stand(s: State, c: Const, past_ns: int, use_ns: int) -> bool:
    """Let the tests of ``s.up`` join, and those leave that have been down for long enough; returns whether one joined.

    Args:
        s: state; its ``up`` is of this sample.
        past_ns: since the sample before [ns].
        use_ns: of that, in which tests could have fired [ns].
    """
    joins = False
    rest_ns = NEVER
    s.joined_ns = min(s.joined_ns + use_ns, NEVER // 2)
    s.waited_ns = min(s.waited_ns + past_ns, NEVER // 2)
    if empty(s.up) and empty(s.fired):
        return False  # nearly always
    hold_ns = c.heal_ns if 0 <= s.found < c.groups else c.hold_ns
    for k in range(c.tests):
        if has(s.up, k):
            s.down_ns[k] = 0
            rest_ns = 0
            if not has(s.fired, k):
                include(s.fired, k)
                s.joined_ns = s.waited_ns = 0
                joins = True
        elif has(s.fired, k):
            s.down_ns[k] += use_ns
            rest_ns = min(rest_ns, s.down_ns[k])
            if c.together == 0 and s.down_ns[k] >= hold_ns:
                exclude(s.fired, k)
    if c.together == 1 and rest_ns >= hold_ns:
        clear(s.fired)
    return joins


@kernel
def _on_its_way(s: State, c: Const, level: f8s, explaining: bool) -> bool:
    """Return whether a test that has not fired is near; ``explaining``: one of a fault that explains the others."""
    for k in range(c.tests):
        if has(s.fired, k) or not level[k] > c.near:
            continue
        if not explaining:
            return True
        for fault in range(c.faults):
            if has(s.explained, fault) and has(c.may[fault], k):
                return True
    return False


@kernel
def _awaits(s: State, c: Const, level: f8s, said: int) -> bool:
    """Return whether a name may still come of what has fired."""
    if empty(s.explained):
        return bool(s.joined_ns < c.hopeless_ns)
    if s.waited_ns >= c.latest_ns:
        return False
    if s.joined_ns < c.pending_ns or (said >= 0 and s.joined_ns < c.confirm_ns):
        return True
    return _on_its_way(s, c, level, True)


@kernel
def contradicted(s: State) -> bool:
    """Return whether a test has fired that had not when the name was given."""
    return not within(s.fired, s.basis)


@kernel
def decide(s: State, c: Const, level: f8s, said: int, contradicts: bool) -> None:
    """Set ``s.found``.

    Args:
        s: state, after :func:`stand`.
        level: T over J of each test, shape (tests,).
        said: answer of the table: a group, or OPEN (:func:`gateway_fdi.isolation.table.answer`).
        contradicts: a name that stands is contradicted (:func:`contradicted`).
    """
    if empty(s.fired):
        s.found = NOTHING
        return
    named = 0 <= s.found < c.groups
    if named and not contradicts:
        return
    if said >= 0 and said == s.found:
        copy(s.basis, s.fired)
        return
    if named and s.joined_ns >= c.withdraw_ns:
        s.found = NOTHING
    if empty(s.up):
        return  # all of them are down, at least for now
    ready = s.joined_ns >= c.confirm_ns and not _on_its_way(s, c, level, False)
    awaits = _awaits(s, c, level, said)
    if said == OPEN and not awaits:
        said = table.at_last(s, c)
    if said != OPEN and ready:
        s.found = said
        copy(s.basis, s.fired)
    elif not awaits:
        s.found = c.groups

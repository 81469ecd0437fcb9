"""Signature table: which faults explain the tests that have fired.

The table is a fault signature matrix with a third value, "does not matter": of each fault the tests that **must** have
fired, and those that **may** have. A fault **explains** what has fired if all of it is in ``may``: one fault at a time,
and a test that has not fired says nothing, for it may be slow, or its fault not excited. It is **complete** if all of
``must`` has fired.

Faults that explain and are complete are told together, as the ambiguity group that they are; if they are no group of
the table, nothing can be told yet.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Annotated, Any

from gateway_fdi.jit import Record, f8s, i8, i8s, kernel, means
from gateway_fdi.masks import Masks, clear, copy, empty, exclude, has, include, pack, within

#: Lengths of the records; a plant's own classes say others.
LENGTHS = {"tests": 1, "faults": 1, "groups": 1, "words": 1}
#: No answer: nothing has fired; something has that nothing of the table explains yet.
NOTHING, OPEN = -1, -2


class Const(Record, lengths=LENGTHS):
    """Constants: the table."""

    tests: i8 = means("number of tests")
    faults: i8 = means("number of faults")
    groups: i8 = means("number of ambiguity groups")
    may: Annotated[i8s, "faults", "words"] = means("tests that each fault may make fire, a mask")
    must: Annotated[i8s, "faults", "words"] = means("tests that it is not told without, a mask")
    sure: Annotated[i8s, "faults", "words"] = means("those of them that see it however the plant is used, a mask")
    group: Annotated[i8s, "groups", "words"] = means("faults that are told as one, a mask")


class State(Record, lengths=LENGTHS):
    """State: results of the tests."""

    fired: Annotated[i8s, "words"] = means("tests that have fired, a mask")
    explained: Annotated[i8s, "words"] = means("faults that explain them, a mask")
    chosen: Annotated[i8s, "words"] = means("scratch: faults, a mask")


def prepare(
    c: Any,
    may: Sequence[Iterable[int]],
    groups: Sequence[Iterable[int]],
    *,
    tests: int,
    size: int,
    must: Sequence[Iterable[int]] | None = None,
    sure: Sequence[Iterable[int]] | None = None,
) -> None:
    """Fill the table.

    Args:
        c: record of Const, or of a class derived from it.
        may: of each fault the tests that it may make fire, by their numbers.
        groups: faults that are told as one, by their numbers; a fault alone is a group of one.
        tests: number of tests.
        size: of the masks: the larger of the numbers of tests and faults, or more.
        must: of each fault the tests that it is not told without; None: no test.
        sure: those of them that see it however the plant is used (:func:`at_last`); None: all.
    """
    c.tests, c.faults, c.groups = tests, len(may), len(groups)
    c.may[: len(may)] = pack(may, size)
    must = [()] * len(may) if must is None else must
    c.must[: len(may)], c.sure[: len(may)] = pack(must, size), pack(must if sure is None else sure, size)
    c.group[: len(groups)] = pack(groups, size)


@kernel
def fits(c: Const, fault: int, fired: Masks) -> bool:
    """Return whether a fault explains a set of tests, and is complete with it."""
    return within(fired, c.may[fault]) and within(c.must[fault], fired)


@kernel
def explain(s: State, c: Const) -> None:
    """Find the faults that explain what has fired; none if nothing has."""
    clear(s.explained)
    if empty(s.fired):
        return
    for k in range(c.faults):
        if within(s.fired, c.may[k]):
            include(s.explained, k)


@kernel
def _group(s: State, c: Const, needed: Masks) -> int:
    """Return the group of the faults that explain what has fired, with all tests that they need, or OPEN."""
    clear(s.chosen)
    for k in range(c.faults):
        if has(s.explained, k) and within(needed[k], s.fired):
            include(s.chosen, k)
    if not empty(s.chosen):
        for k in range(c.groups):
            if within(s.chosen, c.group[k]) and within(c.group[k], s.chosen):
                return k
    return OPEN


@kernel
def answer(s: State, c: Const) -> int:
    """Return the group of the faults that explain what has fired and are complete; NOTHING or OPEN without one."""
    explain(s, c)
    return NOTHING if empty(s.fired) else _group(s, c, c.must)


@kernel
def at_last(s: State, c: Const) -> int:
    """Return what is told when no further test is expected, a group or OPEN; after :func:`answer`.

    A test that may not see a fault, as the plant has been used, is no evidence against it; one that sees it all the
    time is, and has stayed silent for all of the wait.
    """
    return _group(s, c, c.sure)


@kernel
def support(c: Const, fault: int, level: f8s) -> float:
    """Return how near a fault's tests are to firing, 1 when all have: mean of T over J, each at most 1.

    Args:
        fault: its number.
        level: T over J of each test, shape (tests,).
    """
    total, count = 0.0, 0
    for k in range(c.tests):
        if has(c.may[fault], k):
            total += min(level[k], 1.0)
            count += 1
    return total / count if count > 0 else 0.0


@kernel
def ranked(s: State, c: Const, level: f8s, base: float, most: int) -> float:
    """Return the faults that explain, likeliest first, as digits: base 10 has 25 for the second, then the fifth.

    Args:
        s: state, after :func:`explain` or :func:`answer`.
        level: T over J of each test, shape (tests,).
        base: 10, 100 or 1000: room for a fault's number, from 1.
        most: faults that are ranked.
    """
    copy(s.chosen, s.explained)
    digits = 0.0
    for _ in range(most):
        best, largest = -1, -1.0
        for k in range(c.faults):
            if has(s.chosen, k):
                value = support(c, k, level)
                if value > largest:
                    best, largest = k, value
        if best < 0:
            break
        exclude(s.chosen, best)
        digits = digits * base + best + 1
    return digits

"""Matchings of equations to the variables that they are solved for, and the reach of alternating paths.

``rows`` is int64 (equations, words), the variables of each equation as masks of :mod:`gateway_fdi.structure.incidence`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from gateway_fdi.jit import i8s, kernel, lowest_bit
from gateway_fdi.masks import BITS, Masks, words
from gateway_fdi.structure.incidence import Flags

#: ``mate`` of an equation that is not matched, and of one that takes no part.
FREE, ABSENT = -1, -2


class Matching(NamedTuple):
    """A matching, and the arrays of a search along alternating paths, which the next search overwrites.

    Attributes:
        mate: variable that each equation is matched to, FREE or ABSENT, int64 (equations,).
        owner: equation that each variable is matched to, -1 if none, int64 (variables,).
        came: equation by which a search reached each variable first, int64 (variables,).
        queue: equations in the order in which a search reached them, int64 (equations,).
        reached: whether it reached an equation, bool (equations,).
        seen: mask of the variables that it reached, int64 (words,).
    """

    mate: i8s
    owner: i8s
    came: i8s
    queue: i8s
    reached: Flags
    seen: Masks


def new_matching(equations: int, variables: int) -> Matching:
    """Return a matching in which no equation has a variable."""
    return Matching(
        np.full(equations, FREE, np.int64), np.full(variables, -1, np.int64), np.zeros(variables, np.int64),
        np.zeros(equations, np.int64), np.zeros(equations, np.bool_), np.zeros(words(variables), np.int64),
    )  # fmt: skip


@kernel
def _visit(rows: Masks, matching: Matching, tail: int, until_free: bool) -> tuple[int, int]:
    """Follow alternating paths from the equations in the queue, up to a variable without an equation if that is asked.

    A path goes from an equation to any of its variables, and from that to the equation that it is matched to.

    Returns:
        how many equations are in the queue at the end, and that variable, -1: there is none.
    """
    queue, reached, seen = matching.queue, matching.reached, matching.seen
    head = 0
    while head < tail:
        i = queue[head]
        head += 1
        for w in range(rows.shape[1]):
            new = rows[i, w] & ~seen[w]
            seen[w] |= new
            while new != 0:
                v = w * BITS + lowest_bit(new)
                new &= new - 1
                matching.came[v] = i
                j = matching.owner[v]
                if until_free and j < 0:
                    return tail, v
                if j >= 0 and not reached[j]:
                    reached[j] = True
                    queue[tail] = j
                    tail += 1
    return tail, -1


@kernel
def reach_from_free(rows: Masks, size: int, matching: Matching, skip: int) -> int:
    """Mark what alternating paths reach from the free equations, all but ``skip``: the part with redundancy.

    Fills ``reached``, ``seen`` and ``came`` of the matching.

    Args:
        rows: variables of each equation.
        size: how many equations there are.
        matching: of them.
        skip: a free equation from which nothing starts, -1: none.

    Returns:
        how many equations are reached.
    """
    reached = matching.reached
    tail = 0
    for i in range(size):
        reached[i] = matching.mate[i] == FREE and i != skip
        if reached[i]:
            matching.queue[tail] = i
            tail += 1
    matching.seen[:] = 0
    return _visit(rows, matching, tail, False)[0]


@kernel
def _flip_path(matching: Matching, v: int) -> None:
    """Give ``v`` to the equation it was reached by, that one's variable to the one before, up to a free one."""
    while v >= 0:
        e = matching.came[v]
        before = matching.mate[e]
        matching.mate[e] = v
        matching.owner[v] = e
        v = before


@kernel
def make_free(rows: Masks, size: int, matching: Matching, i: int) -> bool:
    """Change a matching of ``size`` equations so that ``i`` is free; False, nothing changed, if it cannot be."""
    v = matching.mate[i]
    if v < 0:
        return True
    reach_from_free(rows, size, matching, -1)
    if not matching.reached[i]:
        return False
    matching.mate[i] = FREE
    _flip_path(matching, v)
    return True


@kernel
def augment(rows: Masks, matching: Matching, i: int, allowed: Masks) -> bool:
    """Match a free equation ``i``, moving others if need be, within the mask ``allowed``; False: impossible."""
    matching.reached[:] = False
    matching.reached[i] = True
    matching.queue[0] = i
    for w in range(rows.shape[1]):
        matching.seen[w] = ~allowed[w]
    _, v = _visit(rows, matching, 1, True)
    _flip_path(matching, v)
    return v >= 0


@kernel
def match_set(rows: Masks, members: i8s, count: int, matching: Matching, allowed: Masks) -> int:
    """Match a set of equations from nothing; all others are absent.

    Args:
        rows: variables of each equation.
        members: the equations.
        count: how many of them.
        matching: written.
        allowed: mask of the variables that may be used.

    Returns:
        how many equations stay free.
    """
    matching.mate[:] = ABSENT
    matching.owner[:] = -1
    free = 0
    for k in range(count):
        matching.mate[members[k]] = FREE
    for k in range(count):
        if not augment(rows, matching, members[k], allowed):
            free += 1
    return free


@kernel
def copy_pairs(target: Matching, source: Matching) -> None:
    """Copy which equation is matched to which variable."""
    for i in range(len(source.mate)):
        target.mate[i] = source.mate[i]
    for v in range(len(source.owner)):
        target.owner[v] = source.owner[v]

"""Matchings of equations to the variables that they are solved for, and what alternating paths reach.

Arrays of these kernels: ``rows`` int64 (equations, words), the variables of each equation; ``mate`` (equations), the
variable that an equation is matched to, -1 if it is free, -2 if it takes no part; ``owner`` (variables), the equation
that a variable is matched to, -1 if none; ``came`` and ``queue`` are scratch.
"""

from __future__ import annotations

from gateway.fdi.structure.incidence import BITS, Flags, Masks
from gateway.jit import i8s, kernel, lowest_bit

FREE, ABSENT = -1, -2


@kernel
def _visit(
    rows: Masks, owner: i8s, came: i8s, queue: i8s, reached: Flags, seen: Masks, tail: int
) -> int:
    """Follow alternating paths from the equations in the queue; returns how many are in it at the end.

    A path goes from an equation to any of its variables, and from that to the equation that it is matched to.
    """
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
                came[v] = i
                j = owner[v]
                if j >= 0 and not reached[j]:
                    reached[j] = True
                    queue[tail] = j
                    tail += 1
    return tail


@kernel
def reach_from_free(
    rows: Masks,
    size: int,
    mate: i8s,
    owner: i8s,
    skip: int,
    came: i8s,
    queue: i8s,
    reached: Flags,
    seen: Masks,
) -> int:
    """Mark what alternating paths reach from the free equations, all but ``skip``: the part with redundancy.

    Fills ``reached`` (equations), ``seen`` (words, variables of the reached) and ``came`` (variables, the equation by
    which each was reached first). Returns how many equations are reached.
    """
    tail = 0
    for i in range(size):
        reached[i] = mate[i] == FREE and i != skip
        if reached[i]:
            queue[tail] = i
            tail += 1
    for w in range(rows.shape[1]):
        seen[w] = 0
    return _visit(rows, owner, came, queue, reached, seen, tail)


@kernel
def take_from(mate: i8s, owner: i8s, came: i8s, v: int) -> None:
    """Give variable ``v`` to the equation it was reached by, that one's variable to the one before, up to a free one."""
    while v >= 0:
        e = came[v]
        before = mate[e]
        mate[e] = v
        owner[v] = e
        v = before


@kernel
def make_free(
    rows: Masks,
    size: int,
    mate: i8s,
    owner: i8s,
    i: int,
    came: i8s,
    queue: i8s,
    reached: Flags,
    seen: Masks,
) -> bool:
    """Change a matching so that equation ``i`` is free; False, and nothing changed, if it cannot be."""
    v = mate[i]
    if v < 0:
        return True
    reach_from_free(rows, size, mate, owner, -1, came, queue, reached, seen)
    if not reached[i]:
        return False
    mate[i] = FREE
    take_from(mate, owner, came, v)
    return True


@kernel
def augment(
    rows: Masks,
    mate: i8s,
    owner: i8s,
    i: int,
    allowed: Masks,
    came: i8s,
    queue: i8s,
    reached: Flags,
    seen: Masks,
) -> bool:
    """Match a free equation ``i``, moving others if need be, with variables of the mask ``allowed``; False: impossible."""
    for k in range(len(reached)):
        reached[k] = False
    reached[i] = True
    queue[0] = i
    for w in range(rows.shape[1]):
        seen[w] = ~allowed[w]
    head, tail = 0, 1
    while head < tail:
        e = queue[head]
        head += 1
        for w in range(rows.shape[1]):
            new = rows[e, w] & ~seen[w]
            seen[w] |= new
            while new != 0:
                v = w * BITS + lowest_bit(new)
                new &= new - 1
                came[v] = e
                j = owner[v]
                if j < 0:
                    take_from(mate, owner, came, v)
                    return True
                if not reached[j]:
                    reached[j] = True
                    queue[tail] = j
                    tail += 1
    return False

"""Strongly connected blocks of a matched set of equations, in the order in which they are computed (Tarjan 1972).

An equation depends on those that compute its other variables. A block of more than one is a loop.
"""

from __future__ import annotations

from gateway.fdi.structure.incidence import BITS, Masks
from gateway.jit import i8s, kernel, lowest_bit

#: Number of an equation that is in no block (yet).
NO_BLOCK = -1


@kernel
def find_blocks(
    rows: Masks,
    members: i8s,
    count: int,
    owner: i8s,
    within: Masks,
    first: int,
    block: i8s,
    scratch: i8s,
    rest: Masks,
) -> int:
    """Number the blocks of some equations in order of computation.

    Args:
        rows: variables of each equation, int64 (equations, words).
        members: the equations; each is matched.
        count: how many of them.
        owner: equation that each variable is matched to, -1 if none.
        within: mask of the variables that count; others are known.
        first: number of the first block.
        block: the numbers, by equation; those of the members are written.
        scratch: int64 (4, equations).
        rest: int64 (equations, words).

    Returns:
        the number behind the last block.
    """
    index, low, stack, path = scratch[0], scratch[1], scratch[2], scratch[3]
    for k in range(count):
        index[members[k]] = -1
        block[members[k]] = NO_BLOCK
    counter, depth, on_stack, number = 0, 0, 0, first
    for k in range(count):
        if index[members[k]] >= 0:
            continue
        path[0] = members[k]
        depth = 1
        while depth > 0:
            e = path[depth - 1]
            if index[e] < 0:
                index[e] = counter
                low[e] = counter
                counter += 1
                stack[on_stack] = e
                on_stack += 1
                for w in range(rows.shape[1]):
                    rest[e, w] = rows[e, w] & within[w]
            deeper = False
            for w in range(rows.shape[1]):
                while rest[e, w] != 0 and not deeper:
                    v = w * BITS + lowest_bit(rest[e, w])
                    rest[e, w] &= rest[e, w] - 1
                    j = owner[v]
                    if j < 0 or j == e:
                        continue
                    if index[j] < 0:
                        path[depth] = j
                        depth += 1
                        deeper = True
                    elif block[j] == NO_BLOCK:
                        low[e] = min(low[e], index[j])
            if deeper:
                continue
            depth -= 1
            if depth > 0:
                low[path[depth - 1]] = min(low[path[depth - 1]], low[e])
            if low[e] == index[e]:
                while True:
                    on_stack -= 1
                    j = stack[on_stack]
                    block[j] = number
                    if j == e:
                        break
                number += 1
    return number

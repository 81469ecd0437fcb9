"""Strongly connected blocks of a matched set of equations, in the order in which they are computed (Tarjan 1972).

An equation depends on those that compute its other variables. A block of more than one is a loop.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from gateway_fdi.jit import i8s, kernel, lowest_bit
from gateway_fdi.masks import BITS, Masks

#: Number of an equation that is in no block (yet).
NO_BLOCK = -1
#: ``discovery`` of an equation that the search has not found (yet).
_NOT_FOUND = -1


class BlockSearch(NamedTuple):
    """Arrays of a depth-first search.

    Attributes:
        discovery: number of each equation in the order in which they are found, int64 (equations,).
        low: least of these numbers on the stack that each is known to lead to, int64 (equations,).
        stack: equations found whose block is not complete, int64 (equations,).
        path: equations from the root to the one that is looked at, int64 (equations,).
        rest: mask of the variables of each that were not followed yet, int64 (equations, words).
    """

    discovery: i8s
    low: i8s
    stack: i8s
    path: i8s
    rest: Masks


def block_search(equations: int, words: int) -> BlockSearch:
    """Return the arrays for a number of equations, and masks of a number of words."""
    discovery, low, stack, path = np.zeros((4, equations), np.int64)
    return BlockSearch(discovery, low, stack, path, np.zeros((equations, words), np.int64))


@kernel
def _discover(rows: Masks, within: Masks, search: BlockSearch, e: int, found: int) -> None:
    """Number equation ``e`` as found, and all its variables within the mask as not followed."""
    search.discovery[e] = found
    search.low[e] = found
    for w in range(rows.shape[1]):
        search.rest[e, w] = rows[e, w] & within[w]


@kernel
def _follow(owner: i8s, block: i8s, search: BlockSearch, e: int) -> int:
    """Follow the variables of equation ``e`` up to one that leads to an equation not found yet.

    Returns:
        that equation, -1: no variable is left.
    """
    rest = search.rest
    for w in range(rest.shape[1]):
        while rest[e, w] != 0:
            v = w * BITS + lowest_bit(rest[e, w])
            rest[e, w] &= rest[e, w] - 1
            j = owner[v]
            if j < 0 or j == e:
                continue
            if search.discovery[j] == _NOT_FOUND:
                return int(j)
            if block[j] == NO_BLOCK:
                search.low[e] = min(search.low[e], search.discovery[j])
    return -1


@kernel
def _close(block: i8s, search: BlockSearch, e: int, on_stack: int, number: int) -> int:
    """Make equation ``e``, and all above it on the stack, a block; returns how many are on the stack then."""
    while True:
        on_stack -= 1
        j = search.stack[on_stack]
        block[j] = number
        if j == e:
            return on_stack


@kernel
def find_blocks(
    rows: Masks, members: i8s, count: int, owner: i8s, within: Masks, first: int, block: i8s, search: BlockSearch,
) -> int:  # fmt: skip
    """Number the blocks of some equations in order of computation.

    Args:
        rows: variables of each equation, int64 (equations, words).
        members: the equations; each is matched.
        count: how many of them.
        owner: equation that each variable is matched to, -1 if none.
        within: mask of the variables that count; others are known.
        first: number of the first block.
        block: the numbers, by equation; those of the members are written.
        search: scratch.

    Returns:
        the number after the last block.
    """
    discovery, low, path = search.discovery, search.low, search.path
    for k in range(count):
        discovery[members[k]] = _NOT_FOUND
        block[members[k]] = NO_BLOCK
    found, on_stack, number = 0, 0, first
    for k in range(count):
        if discovery[members[k]] != _NOT_FOUND:
            continue
        path[0] = members[k]
        depth = 1
        while depth > 0:
            e = path[depth - 1]
            if discovery[e] == _NOT_FOUND:
                _discover(rows, within, search, e, found)
                found += 1
                search.stack[on_stack] = e
                on_stack += 1
            deeper = _follow(owner, block, search, e)
            if deeper >= 0:
                path[depth] = deeper
                depth += 1
                continue
            depth -= 1
            if depth > 0:
                low[path[depth - 1]] = min(low[path[depth - 1]], low[e])
            if low[e] == discovery[e]:
                on_stack = _close(block, search, e, on_stack, number)
                number += 1
    return number

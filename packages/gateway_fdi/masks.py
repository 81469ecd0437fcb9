"""Sets of numbers as bit masks, int64 (words,): kernels compute sets of equations, tests and faults with them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from gateway_fdi.jit import kernel

#: Bits of a word that are used: two less than it has, so that no word is ever negative.
BITS = 62

Masks = NDArray[np.int64]
#: Members as flags, shape (sets, size).
Sets = NDArray[np.bool_]


def words(size: int) -> int:
    """Return how many words a mask of a size takes."""
    return max(1, -(-size // BITS))


def pack(sets: Sequence[Iterable[int]], size: int) -> Masks:
    """Return sets of numbers below ``size`` as masks, shape (len(sets), words)."""
    masks = np.zeros((len(sets), words(size)), np.int64)
    for row, members in zip(masks, sets, strict=True):
        for k in members:
            row[k // BITS] |= 1 << (k % BITS)
    return masks


def unpack(masks: Masks, size: int) -> Sets:
    """Return masks, shape (sets, words), as booleans, shape (sets, size)."""
    places = np.arange(size)
    return (masks[:, places // BITS] >> (places % BITS) & 1).astype(bool)


@kernel
def include(mask: Masks, k: int) -> None:
    """Add number ``k`` to the set that a mask is, int64 (words,)."""
    mask[k // BITS] |= 1 << (k % BITS)


@kernel
def exclude(mask: Masks, k: int) -> None:
    """Take number ``k`` out of the set that a mask is, int64 (words,)."""
    mask[k // BITS] &= ~(1 << (k % BITS))


@kernel
def clear(mask: Masks) -> None:
    """Make the set that a mask is empty, int64 (words,)."""
    for w in range(len(mask)):
        mask[w] = 0


@kernel
def copy(mask: Masks, source: Masks) -> None:
    """Make the set that a mask is equal to another one of as many words."""
    for w in range(len(mask)):
        mask[w] = source[w]


@kernel
def unite(mask: Masks, other: Masks) -> None:
    """Add all members of another set of as many words to the set that a mask is."""
    for w in range(len(mask)):
        mask[w] |= other[w]


@kernel
def has(mask: Masks, k: int) -> bool:
    """Return whether number ``k`` is in the set that a mask is."""
    return bool(mask[k // BITS] >> (k % BITS) & 1 == 1)


@kernel
def empty(mask: Masks) -> bool:
    """Return whether the set that a mask is has no member."""
    for w in range(len(mask)):
        if mask[w] != 0:
            return False
    return True


@kernel
def within(mask: Masks, other: Masks) -> bool:
    """Return whether all members of a set are in another one."""
    for w in range(len(mask)):
        if mask[w] & ~other[w] != 0:
            return False
    return True


@kernel
def disjoint(mask: Masks, other: Masks) -> bool:
    """Return whether two sets have no member in common."""
    for w in range(len(mask)):
        if mask[w] & other[w] != 0:
            return False
    return True

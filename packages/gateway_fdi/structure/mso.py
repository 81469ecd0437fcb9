"""All minimally structurally overdetermined sets of equations (Krysander, Aslund, Nyberg 2008).

An MSO set has one equation more than unknowns, and no proper subset has redundancy. From the overdetermined part of the
model, equations are left out one equivalence class at a time until the redundancy is 1; equations left out on one
branch are not tried again on the next, so that each set is found once. A class is lumped to one equation without its
own variables, so that the structure shrinks on the way down.

Equations that are not tried again stay in every set that the branch can still find. Once these equations have
redundancy of their own, the branch holds one set at most, they themselves, and ends. Without that a pack of 64 alike
cells, where nearly all branches keep two equations too many, does not come to its first thousand sets.

The number of sets grows exponentially with the redundancy. So there is a limit, and the search can be watched; where
there are more, `sufficient` finds enough of them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from gateway_fdi.jit import i8s, kernel
from gateway_fdi.masks import Masks, Sets, clear, copy, pack, unite, unpack, words
from gateway_fdi.structure.decomposition import Matched
from gateway_fdi.structure.incidence import Flags, Incidence
from gateway_fdi.structure.matching import ABSENT, FREE, Matching, augment, make_free, reach_from_free

#: Sets found between two reports of progress.
PORTION = 20_000
#: Default of the greatest number of sets.
MOST_SETS = 20_000


class TooManySetsError(ValueError):
    """More sets than the limit.

    Args:
        limit: the limit.
        redundancy: of the model.
        share: how much of the search was done, 0 to 1.
    """

    def __init__(self, limit: int, redundancy: int, share: float) -> None:
        self.limit, self.redundancy, self.share = limit, redundancy, share
        super().__init__(
            f"more than {limit} MSO sets (redundancy {redundancy}, {100 * share:.1f} % of the search done):"
            " raise the limit, or analyse a part of the model or fewer sensors"
        )


@kernel
def _lump(
    rows: Masks,
    ids: Masks,
    state: i8s,
    size: int,
    matching: Matching,
    done: Flags,
) -> int:
    """Lump the equivalence classes that may be left out; returns how many equations are left.

    ``state`` of each equation: 1 it may be left out, 0 it may not.
    """
    mate, owner = matching.mate, matching.owner
    done[:] = False
    for i in range(size):
        if mate[i] == ABSENT or state[i] == 0 or done[i]:
            continue
        make_free(rows, size, matching, i)
        reach_from_free(rows, size, matching, i)
        done[i] = True
        for j in range(size):
            if j == i or matching.reached[j] or mate[j] == ABSENT:
                continue
            # Equation i is free, so the others of its class are matched to variables that only the class contains.
            unite(rows[i], rows[j])
            unite(ids[i], ids[j])
            state[i] &= state[j]
            owner[mate[j]] = -1
            mate[j] = ABSENT
        for w in range(rows.shape[1]):
            rows[i, w] &= matching.seen[w]
    left = 0
    for i in range(size):
        if mate[i] == ABSENT:
            continue
        if left != i:
            copy(rows[left], rows[i])
            copy(ids[left], ids[i])
            state[left] = state[i]
            mate[left] = mate[i]
            if mate[i] >= 0:
                owner[mate[i]] = left
        left += 1
    return left


@kernel
def _begin_kept(rows: Masks, state: i8s, size: int, kept: Matching, everything: Masks) -> bool:
    """Match the equations that stay, from nothing; returns whether they have redundancy."""
    kept.mate[:] = ABSENT
    kept.owner[:] = -1
    redundant = False
    for i in range(size):
        if state[i] == 0 and not redundant:
            kept.mate[i] = FREE
            redundant = not augment(rows, kept, i, everything)
    return redundant


@kernel
def _only_kept(rows: Masks, ids: Masks, state: i8s, size: int, tried: int, kept: Matching, found: Masks) -> bool:
    """Write the equations that stay, if they are a set: all of them are reached from the one that is free.

    These are those that may not be left out, and those before ``tried``.
    """
    for i in range(size):
        if (state[i] == 0 or i < tried) and kept.mate[i] == ABSENT:
            return False  # there are more of them after the one that made them redundant
    reach_from_free(rows, size, kept, -1)
    clear(found)
    for i in range(size):
        if kept.mate[i] != ABSENT:
            if not kept.reached[i]:
                return False
            unite(found, ids[i])
    return True


@kernel
def _write_all(ids: Masks, size: int, found: Masks) -> None:
    """Write all equations of a level."""
    clear(found)
    for i in range(size):
        unite(found, ids[i])


@kernel
def _search(
    rows: Masks, ids: Masks, state: i8s, mate: i8s, owner: i8s, kept_mate: i8s, kept_owner: i8s, size: i8s, at: i8s,
    came: i8s, queue: i8s, reached: Flags, seen: Masks, done: Flags, everything: Masks, found: Masks,
) -> int:  # fmt: skip
    """Go on with the search until ``found`` is full or nothing is left; returns how many sets were found.

    First index of those before ``size``: the level, from which equations were left out. ``at``: the level, and then the
    next equation to be left out on each level. ``kept_...``: a matching of the equations that stay.
    """
    levels = rows.shape[0]
    level, count = at[0], 0
    while level >= 0 and count < found.shape[0]:
        if level == levels - 1:
            _write_all(ids[level], size[level], found[count])
            count += 1
            level -= 1
            continue
        matching = Matching(mate[level], owner[level], came, queue, reached, seen)
        kept = Matching(kept_mate[level], kept_owner[level], came, queue, reached, seen)
        i = at[1 + level]
        if i == 0:
            size[level] = _lump(rows[level], ids[level], state[level], size[level], matching, done)
            redundant = _begin_kept(rows[level], state[level], size[level], kept, everything)
        else:  # the one left out stays from here on
            kept.mate[i - 1] = FREE
            redundant = not augment(rows[level], kept, i - 1, everything)
        if redundant:
            if _only_kept(rows[level], ids[level], state[level], size[level], i, kept, found[count]):
                count += 1
            level -= 1
            continue
        while i < size[level] and state[level, i] == 0:
            i += 1
        if i == size[level]:
            level -= 1
            continue
        at[1 + level] = i + 1
        make_free(rows[level], size[level], matching, i)
        below = level + 1
        left = 0
        for j in range(size[level]):
            if j == i:
                continue
            copy(rows[below, left], rows[level, j])
            copy(ids[below, left], ids[level, j])
            state[below, left] = state[level, j] if j > i else 0
            mate[below, left] = mate[level, j]
            left += 1
        for v in range(owner.shape[1]):
            j = owner[level, v]
            owner[below, v] = j - 1 if j > i else j
        size[below] = left
        at[1 + below] = 0
        level = below
    at[0] = level
    return count


def _share(at: i8s, size: i8s) -> float:
    """Return how much of the first level's branches is done."""
    return float((at[1] - 1) / size[0]) if at[0] >= 0 and len(size) > 1 else 1.0


def find_msos(
    structure: Incidence,
    *,
    limit: int = MOST_SETS,
    progress: Callable[[int, float], None] | None = None,
) -> Sets:
    """Return all MSO sets, shape (sets, equations), in order of size and then of their equations.

    Args:
        structure: the model's structure.
        limit: greatest number of sets.
        progress: called now and then with the number found and the share of the search that is done, 0 to 1.

    Raises:
        TooManySetsError: there are more than the limit.
    """
    m, n = len(structure.equations), len(structure.variables)
    start = Matched(structure)
    over = np.flatnonzero(start.over())
    phi = int((start.mate[over] == FREE).sum())
    if phi == 0:
        return np.zeros((0, m), np.bool_)
    k, w = len(over), words(n)
    rows = np.zeros((phi, k, w), np.int64)
    rows[0] = structure.rows[over]
    ids = np.zeros((phi, k, words(m)), np.int64)
    ids[0] = pack([[int(e)] for e in over], m)
    state = np.zeros((phi, k), np.int64)
    state[0] = 1
    mate = np.full((phi, k), FREE, np.int64)
    mate[0] = start.mate[over]
    owner = np.full((phi, n), -1, np.int64)
    for i, v in enumerate(mate[0]):
        if v >= 0:
            owner[0, v] = i
    size = np.zeros(phi, np.int64)
    size[0] = k
    at = np.zeros(1 + phi, np.int64)
    kept_mate, kept_owner = np.full((phi, k), ABSENT, np.int64), np.full((phi, n), -1, np.int64)
    everything = pack([range(n)], n)[0]
    came, seen = np.zeros(n, np.int64), np.zeros(w, np.int64)
    queue, reached, done = np.zeros(k, np.int64), np.zeros(k, np.bool_), np.zeros(k, np.bool_)
    portions: list[Any] = []
    total = 0
    while at[0] >= 0:
        found = np.zeros((min(PORTION, limit + 1 - total), words(m)), np.int64)
        count = _search(
            rows, ids, state, mate, owner, kept_mate, kept_owner, size, at,
            came, queue, reached, seen, done, everything, found,
        )  # fmt: skip
        portions.append(found[:count])
        total += count
        if progress is not None:
            progress(total, _share(at, size))
        if total > limit:
            raise TooManySetsError(limit, phi, _share(at, size))
    return in_order(unpack(np.concatenate(portions), m))


def in_order(sets: Sets) -> Sets:
    """Return sets in order of size, and of their equations where the size is equal."""
    if not len(sets):
        return sets
    keys = [~sets[:, i] for i in range(sets.shape[1] - 1, -1, -1)]
    return sets[np.lexsort([*keys, sets.sum(1)])]

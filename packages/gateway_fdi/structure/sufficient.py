"""Enough MSO sets, where there are too many to find them all.

The isolability of a model is known without its sets (`isolability`). For each fault that can be detected, and each pair
that can be told apart, one set that does it is enough: of the equations without the second fault's, those with
redundancy, equations are left out one after the other as long as the first fault's stays in the part with redundancy.
Each is tried once, since what has to stay, has to stay in every subset too; so a set takes as many steps as there are
equations.

The order in which they are tried says which set comes out. The first orders are tried for all: the equations of other
faults first, which gives sets with few faults; then all backwards and forwards, which gives sets that do for many pairs
at once. Some sets cannot be computed, so that more orders, drawn with fixed seeds, are tried for what has no set yet
that is usable. The work is bounded by the number of faults, squared, times that of the orders.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from gateway_fdi.jit import i8s, kernel
from gateway_fdi.masks import Masks, Sets, pack
from gateway_fdi.structure.decomposition import overdetermined
from gateway_fdi.structure.incidence import Flags, Incidence, counted
from gateway_fdi.structure.isolability import incidence_of_faults, isolability_of_model, signatures
from gateway_fdi.structure.matching import ABSENT, Matching, make_free, match_set, new_matching, reach_from_free
from gateway_fdi.structure.model import Model
from gateway_fdi.structure.mso import in_order

#: Orders that are tried for every fault and pair, and at most.
ALWAYS, MOST_ORDERS = 3, 24

Ints = NDArray[np.int64]


@kernel
def _shrink(
    rows: Masks, members: i8s, count: int, stays: i8s, order: i8s, matching: Matching, everything: Masks
) -> bool:
    """Leave out equations, in an order, as long as one that is to stay has redundancy; the rest is in the matching.

    Returns False if it has none from the beginning.
    """
    size = len(matching.mate)
    match_set(rows, members, count, matching, everything)
    reach_from_free(rows, size, matching, -1)
    there = False
    for k in range(len(stays)):
        there = there or matching.reached[stays[k]]
    if not there:
        return False
    _drop_unreached(matching)
    for e in order:
        if matching.mate[e] == ABSENT:
            continue
        make_free(rows, size, matching, e)
        reach_from_free(rows, size, matching, e)
        there = False
        for k in range(len(stays)):
            there = there or (stays[k] != e and matching.reached[stays[k]])
        if there:
            _drop_unreached(matching)
    return True


@kernel
def _drop_unreached(matching: Matching) -> None:
    """Take out what the last search did not reach."""
    for i in range(len(matching.mate)):
        if not matching.reached[i] and matching.mate[i] != ABSENT:
            if matching.mate[i] >= 0:
                matching.owner[matching.mate[i]] = -1
            matching.mate[i] = ABSENT


class _Search:
    """Finds a set for a fault, or a pair, in a given order."""

    def __init__(self, model: Model, structure: Incidence) -> None:
        m, n = len(structure.equations), len(structure.variables)
        self.rows, self.where = structure.rows, incidence_of_faults(model)
        self.faulty: Flags = np.any(self.where, axis=1)
        self.everything = pack([range(n)], n)[0]
        self.over = overdetermined(structure)
        self.matching = new_matching(m, n)

    def order(self, number: int, fault: int) -> Ints:
        """Return an order of all equations."""
        m = len(self.rows)
        if number == 0:
            others = self.faulty & ~self.where[:, fault]
            return np.concatenate([np.flatnonzero(others), np.flatnonzero(~others)])
        if number <= ALWAYS - 1:
            return np.arange(m)[:: -1 if number == 1 else 1].copy()
        return np.random.default_rng([number, fault]).permutation(m)

    def find(self, fault: int, other: int | None, number: int) -> Flags | None:
        """Return a set that has a fault, and not the other; None: there is none."""
        there = self.over if other is None else self.over & ~self.where[:, other]
        members = np.flatnonzero(there)
        stays = np.flatnonzero(self.where[:, fault] & there)
        order = self.order(number, fault)
        if not _shrink(self.rows, members, len(members), stays, order, self.matching, self.everything):
            return None
        left: Flags = self.matching.mate != ABSENT
        return left


def sufficient_msos(
    model: Model,
    usable: Callable[[Sets], Flags],
    *,
    structure: Incidence | None = None,
    progress: Callable[[int, float], None] | None = None,
) -> Sets:
    """Return MSO sets that tell as much as all of them would, shape (sets, equations), in order of size.

    Args:
        usable: sets -> which of them can be computed; for what has none, more are searched.
        structure: of the model, as it is counted.
        progress: called with the number of sets, and the share of the orders that are done, 0 to 1.
    """
    structure = structure or counted(model)
    search = _Search(model, structure)
    wanted = list(_wanted(model))
    found: dict[bytes, Flags] = {}
    well: list[Sets] = []
    for number in range(MOST_ORDERS):
        missing = wanted if number < ALWAYS else _without(wanted, well)
        new: dict[bytes, Flags] = {}
        signs = np.zeros((0, len(model.faults)), np.bool_)
        for fault, other in missing:
            if _done(signs, fault, other):
                continue
            one = search.find(fault, other, number)
            if one is not None:
                new[one.tobytes()] = one
                signs = np.vstack([signs, np.any(search.where[one], axis=0)])
        fresh = [row for key, row in new.items() if key not in found]
        if fresh:
            rows = np.array(fresh)
            well.append(signatures(model, rows[usable(rows)]))
        found |= new
        if progress is not None:
            progress(len(found), (number + 1) / MOST_ORDERS)
    if not found:
        return np.zeros((0, len(structure.equations)), np.bool_)
    return in_order(np.array(list(found.values())))


def _wanted(model: Model) -> Iterator[tuple[int, int | None]]:
    """Yield what the model can tell: each fault, and each fault before another one, by their numbers."""
    best = isolability_of_model(model)
    for i in np.flatnonzero(best.detectable):
        yield int(i), None
        for j in np.flatnonzero(~best.confused[i]):
            yield int(i), int(j)


def _done(signs: Sets, fault: int, other: int | None) -> bool:
    """Return whether sets with these faults, shape (sets, faults), do it."""
    there = signs[:, fault]
    return bool(there.any() if other is None else (there & ~signs[:, other]).any())


def _without(wanted: list[tuple[int, int | None]], well: list[Sets]) -> list[tuple[int, int | None]]:
    """Return what no usable set does."""
    signs = np.concatenate(well) if well else None
    return wanted if signs is None else [one for one in wanted if not _done(signs, *one)]

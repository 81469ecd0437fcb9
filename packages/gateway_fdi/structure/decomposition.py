"""Dulmage-Mendelsohn decomposition: the parts of a model that are over, just, and underdetermined.

M+ is what alternating paths reach from the equations that no maximum matching can use all of; M- what they reach from
the variables without an equation; M0 what is left, in blocks (Dulmage, Mendelsohn 1958; Blanke et al. 2006).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gateway_fdi.masks import BITS, words
from gateway_fdi.structure.blocks import block_search, find_blocks
from gateway_fdi.structure.incidence import Incidence
from gateway_fdi.structure.matching import (
    ABSENT,
    FREE,
    augment,
    make_free,
    new_matching,
    reach_from_free,
)

Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class Block:
    """Equations and the variables that they determine."""

    equations: tuple[str, ...]
    variables: tuple[str, ...]


@dataclass(frozen=True)
class Decomposition:
    """A structure in its parts.

    Attributes:
        under: M-, fewer equations than variables.
        just: M0 in blocks, in order of computation: each needs only what stands before it, and M+.
        over: M+, more equations than variables.
        classes: M+ in equivalence classes: equations that can only be left out together (Krysander et al. 2008), with
            the variables that only they contain.
    """

    under: Block
    just: tuple[Block, ...]
    over: Block
    classes: tuple[Block, ...]

    @property
    def redundancy(self) -> int:
        """Equations beyond the number of unknowns in M+."""
        return len(self.over.equations) - len(self.over.variables)


class Matched:
    """A maximum matching of a subset of a structure's equations.

    Args:
        subset: the equations that take part, shape (equations,); None: all.
    """

    def __init__(self, structure: Incidence, subset: Bools | None = None) -> None:
        m, n = len(structure.equations), len(structure.variables)
        self.rows = structure.rows
        self._matching = new_matching(m, n)
        self.mate: Ints = self._matching.mate
        self.owner: Ints = self._matching.owner
        if subset is not None:
            self.mate[~subset] = ABSENT
        everything = np.full(words(n), (1 << BITS) - 1, np.int64)
        for i in np.flatnonzero(self.mate == FREE):
            augment(self.rows, self._matching, int(i), everything)

    def over(self, skip: int = -1) -> Bools:
        """Return the equations of M+, shape (equations,), without those only the free equation ``skip`` reaches."""
        reach_from_free(self.rows, len(self.mate), self._matching, skip)
        return self._matching.reached.copy()

    def without(self, i: int) -> Bools:
        """Return (M minus equation ``i``)+ of a set M, shape (equations,)."""
        if self.mate[i] == ABSENT:
            return self.over()
        free = make_free(self.rows, len(self.mate), self._matching, i)
        return self.over(i) if free else self.over()


def overdetermined(structure: Incidence, subset: Bools | None = None) -> Bools:
    """Return M+ of a set of equations, shape (equations,)."""
    return Matched(structure, subset).over()


def equivalence_classes(structure: Incidence, subset: Bools) -> list[Ints]:
    """Return the equivalence classes of a set M = M+: [e] = M minus (M minus e)+, paper of Krysander et al. 2008."""
    matched = Matched(structure, subset)
    left = subset.copy()
    found = []
    for i in np.flatnonzero(subset):
        if left[i]:
            together = np.flatnonzero(subset & ~matched.without(int(i)))
            left[together] = False
            found.append(together)
    return found


def _block(structure: Incidence, rows: Iterable[int], columns: Iterable[int]) -> Block:
    return Block(tuple(structure.equations[i] for i in rows), tuple(structure.variables[v] for v in columns))


def _under(matched: Matched, dense: Bools) -> tuple[Bools, Bools]:
    """Return the equations and the variables of M-."""
    equations = np.zeros(len(matched.mate), np.bool_)
    variables = matched.owner < 0
    waiting = list(np.flatnonzero(variables))
    while waiting:
        for i in np.flatnonzero(dense[:, waiting.pop()] & ~equations & (matched.mate >= 0)):
            equations[i] = True
            v = matched.mate[i]
            if not variables[v]:
                variables[v] = True
                waiting.append(v)
    return equations, variables


def decompose(structure: Incidence) -> Decomposition:
    """Return the parts of a structure; variables that no equation contains are in M-."""
    matched = Matched(structure)
    dense = structure.dense
    over = matched.over()
    over_variables = dense[over].any(0) if over.any() else np.zeros(dense.shape[1], np.bool_)
    under, under_variables = _under(matched, dense)
    members = np.flatnonzero(~over & ~under)
    m, n = dense.shape
    within = np.zeros(words(n), np.int64)
    for v in np.flatnonzero(~over_variables):
        within[v // BITS] |= 1 << (int(v) % BITS)
    number = np.full(m, -1, np.int64)
    count = find_blocks(
        matched.rows, members, len(members), matched.owner, within, 0, number,
        block_search(m, words(n)),
    )  # fmt: skip
    just = []
    for k in range(count):
        rows = members[number[members] == k]
        just.append(_block(structure, rows, sorted(matched.mate[rows])))
    classes = []
    for rows in equivalence_classes(structure, over):
        rest = over.copy()
        rest[rows] = False
        own = dense[rows].any(0) & ~dense[rest].any(0)
        classes.append(_block(structure, rows, np.flatnonzero(own)))
    return Decomposition(
        _block(structure, np.flatnonzero(under), np.flatnonzero(under_variables)),
        tuple(just),
        _block(structure, np.flatnonzero(over), np.flatnonzero(over_variables)),
        tuple(classes),
    )

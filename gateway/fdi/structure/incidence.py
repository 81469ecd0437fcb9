"""Which variable stands in which equation, as bit masks: the structure that kernels work on."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gateway.fdi.structure.model import Equation, Model
from gateway.jit import kernel

#: Bits of a word that are used: two less than it has, so that no word is ever negative.
BITS = 62

Masks = NDArray[np.int64]
#: A flag for each equation.
Flags = NDArray[np.bool_]
#: Sets of equations, shape (sets, equations).
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


@dataclass(frozen=True)
class Incidence:
    """A structure.

    Attributes:
        equations: names of the rows.
        variables: names of the columns.
        rows: which variables each equation contains, shape (equations, words).
    """

    equations: tuple[str, ...]
    variables: tuple[str, ...]
    rows: Masks

    @property
    def dense(self) -> Sets:
        """The incidence matrix, shape (equations, variables)."""
        return unpack(self.rows, len(self.variables))

    def subset(self, names: Iterable[str]) -> NDArray[np.bool_]:
        """Return a set of equations as booleans, shape (equations,)."""
        wanted = set(names)
        return np.array([name in wanted for name in self.equations])

    def names(self, subset: NDArray[np.bool_]) -> tuple[str, ...]:
        """Return the names of a set of equations."""
        return tuple(name for name, there in zip(self.equations, subset, strict=True) if there)


def _of(equations: tuple[Equation, ...], variables: tuple[str, ...], lumped: set[str]) -> Incidence:
    place = {name: k for k, name in enumerate(variables)}
    for state in lumped:
        place[f"der({state})"] = place[state]
    rows = [[place[v] for v in e.variables] for e in equations]
    return Incidence(tuple(e.name for e in equations), variables, pack(rows, len(variables)))


def counted(model: Model) -> Incidence:
    """Return a model's structure as it is counted: a lumped state is one variable with its derivative."""
    return _of(model.equations, model.variables, set(model.lumped_states))


def full(model: Model) -> Incidence:
    """Return a model's structure with all derivatives and their relations, tacit ones last."""
    return _of(model.full_equations, model.full_variables, set())

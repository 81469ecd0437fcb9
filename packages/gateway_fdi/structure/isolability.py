"""Which faults a model, or a set of tests, can detect and tell apart.

A fault is detectable if its equation is in the overdetermined part of the model, and isolable from another if it is in
that of the model without the other's equations (Krysander, Frisk 2008). A test on a set of equations is sensitive to
the faults in it; a set of tests isolates f_i from f_j if one of them is sensitive to f_i and not to f_j.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gateway_fdi.masks import Sets
from gateway_fdi.structure.decomposition import overdetermined
from gateway_fdi.structure.incidence import counted
from gateway_fdi.structure.model import Model

Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class Isolability:
    """Detectability and isolability of the faults.

    Attributes:
        faults: their names.
        detectable: shape (faults,).
        confused: shape (faults, faults): if fault i is there, fault j explains it too. The identity is full
            isolability.
    """

    faults: tuple[str, ...]
    detectable: Bools
    confused: Bools

    @property
    def full(self) -> bool:
        """Whether every fault can be detected, and told from every other."""
        return bool(self.detectable.all()) and bool((self.confused == np.eye(len(self.faults), dtype=np.bool_)).all())


def incidence_of_faults(model: Model) -> Sets:
    """Return which equation contains which fault, shape (equations, faults)."""
    return np.array([[f in e.faults for f in model.faults] for e in model.equations], np.bool_).reshape(
        len(model.equations), len(model.faults)
    )


def signatures(model: Model, sets: Sets) -> Sets:
    """Return the fault signature matrix of tests on sets of equations, shape (sets, faults)."""
    return (sets.astype(np.int64) @ incidence_of_faults(model).astype(np.int64)) > 0


def isolability_of_tests(faults: Iterable[str], signature: Sets) -> Isolability:
    """Return what tests with a fault signature matrix, shape (tests, faults), tell."""
    names = tuple(faults)
    s = signature.reshape(len(signature), len(names))
    told: Bools = np.any(s[:, :, None] & ~s[:, None, :], axis=0)
    detectable: Bools = np.any(s, axis=0)
    return Isolability(names, detectable, ~told)


def isolability_of_model(model: Model, subset: Bools | None = None) -> Isolability:
    """Return what the structure of a model tells at best, however it is used.

    Args:
        subset: the equations that are there, shape (equations,); None: all. Faults of others are not detectable.
    """
    structure = counted(model)
    there = np.ones(len(model.equations), np.bool_) if subset is None else subset
    where = incidence_of_faults(model) & there[:, None]
    over = overdetermined(structure, there)
    detectable: Bools = np.any(where & over[:, None], axis=0)
    n = len(model.faults)
    confused: Bools = np.ones((n, n), np.bool_)
    for j in range(n):
        without = overdetermined(structure, there & ~where[:, j])
        confused[:, j] = ~np.any(where & without[:, None], axis=0)
    return Isolability(model.faults, detectable, confused)

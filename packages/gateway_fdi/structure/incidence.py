"""Which variable stands in which equation, as bit masks: the structure that kernels work on."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gateway_fdi.masks import Masks, Sets, pack, unpack
from gateway_fdi.structure.model import Equation, Model

#: A flag for each equation.
Flags = NDArray[np.bool_]


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

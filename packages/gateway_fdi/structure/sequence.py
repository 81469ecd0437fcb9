"""Computation sequences: how the unknowns of a set are computed when one of its equations is kept for the check.

Paper 004, Definition 1, in the explicit form, where the relation between a state and its derivative is an equation too.
A set without its consistency relation is matched and falls into blocks in order of computation:

- the relation of a state alone, solved for the state: **integral causality**; solved for the derivative: **derivative
  causality** (II-C);
- another equation alone: solved for its variable;
- a block of several without such a relation: an **algebraic loop**;
- a block with such relations: a **differential loop**. Their states are integrated, and so known within the block; the
  rest is matched and falls into blocks again. If it cannot be matched, the loop is singular (of higher index), and
  cannot be computed without differentiating equations.
"""

from __future__ import annotations

from collections.abc import Sequence as Seq
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from gateway_fdi.masks import BITS, words
from gateway_fdi.structure.incidence import full
from gateway_fdi.structure.matching import match_set, new_matching
from gateway_fdi.structure.model import Equation, Model, state_of
from gateway_fdi.structure.steps import (
    DIFFERENTIATE,
    INTEGRATE,
    SINGULAR,
    SOLVE,
    Explicit,
    Steps,
    order_steps,
    workspace,
)


class Kind(Enum):
    """Kinds of steps of a computation sequence."""

    SOLVE = SOLVE
    INTEGRATE = INTEGRATE
    DIFFERENTIATE = DIFFERENTIATE
    SINGULAR = SINGULAR


@dataclass(frozen=True)
class Step:
    """A step of a computation sequence.

    Attributes:
        kind: of the step.
        equations: by which; for INTEGRATE and DIFFERENTIATE the relation of the state.
        variables: computed ones.
        block: number of the block of the sequence that it is in: those of a differential loop share one.
    """

    kind: Kind
    equations: tuple[str, ...]
    variables: tuple[str, ...]
    block: int


class Structure:
    """A model's explicit form with scratch for the kernels, for one question after the other."""

    def __init__(self, model: Model) -> None:
        self.model = model
        self.incidence = full(model)
        self.size = m, n = len(self.incidence.equations), len(self.incidence.variables)
        self.place = {name: k for k, name in enumerate(self.incidence.equations)}
        self.column = {name: k for k, name in enumerate(self.incidence.variables)}
        state: NDArray[np.int64] = np.array(
            [self.column[e.differential] if e.differential else -1 for e in model.full_equations],
            np.int64,
        )
        everything: NDArray[np.int64] = np.full(words(n), (1 << BITS) - 1, np.int64)
        self.explicit = Explicit(self.incidence.rows, state, everything)
        #: For each equation, the tacit relations that come with it in the explicit form.
        self.tacit = tuple(self._tacit(model, e) for e in model.full_equations)
        self.matching = new_matching(*self.size)
        self.order = Steps(np.zeros(m, np.int64), np.zeros(m, np.int64), np.zeros(m + 1, np.int64))
        self.work = workspace(m, words(n))

    def _tacit(self, model: Model, equation: Equation) -> tuple[int, ...]:
        return tuple(self.place[f"d/dt {x}"] for x in equation.derivatives if x in model.lumped_states)

    def members(self, equations: Seq[str] | frozenset[str]) -> NDArray[np.int64]:
        """Return the numbers of equations, and of the tacit relations that come with them, in order.

        Raises:
            ValueError: there is no such equation.
        """
        numbers: set[int] = set()
        for name in equations:
            if name not in self.place:
                raise ValueError(f'there is no equation "{name}"')
            numbers.add(self.place[name])
            numbers.update(self.tacit[self.place[name]])
        return np.array(sorted(numbers), np.int64)

    def sequence(self, equations: frozenset[str], consistency: str) -> tuple[Step, ...]:
        """Return the computation sequence of a set of equations with one of them as the consistency relation.

        Args:
            equations: the set, an MSO set or another with one equation more than unknowns.
            consistency: the equation that is not used.

        Raises:
            ValueError: the consistency relation is not in the set, or the others do not determine the unknowns.
        """
        if consistency not in equations:
            raise ValueError(f"{consistency} is not among {', '.join(sorted(equations))}")
        members = self.members(equations)
        used = members[members != self.place[consistency]]
        x, matching = self.explicit, self.matching
        free = match_set(x.rows, used, len(used), matching, x.everything)
        dense = self.incidence.dense[members].any(0)
        if free or int(dense.sum()) != len(used):
            raise ValueError(
                f"without {consistency}, {len(used)} equations do not determine {int(dense.sum())} unknowns"
            )
        count = order_steps(x, used, len(used), matching, self.order, self.work)
        return tuple(self._step(used, k) for k in range(count))

    def _step(self, used: NDArray[np.int64], number: int) -> Step:
        rows = [int(e) for e in used if self.order.step[e] == number]
        kind = Kind(int(self.order.kind[number]))
        variables: list[int]
        if kind is Kind.SINGULAR:
            mine = self.incidence.dense[rows].any(0)
            outside = [e for e in used if self.order.step[e] != number]
            others = {int(self.matching.mate[e]) for e in outside if self.matching.mate[e] >= 0}
            variables = [int(v) for v in np.flatnonzero(mine) if int(v) not in others]
        else:
            variables = [int(self.matching.mate[e]) for e in rows]
        return Step(
            kind,
            tuple(self.incidence.equations[e] for e in rows),
            tuple(self.incidence.variables[v] for v in variables),
            int(self.order.block[rows[0]]),
        )


def shown(model: Model, steps: Seq[Step]) -> str:
    """Return a sequence as the paper writes it: ``({x}, {e1}), ({y, z}, {e2, e3})``, lumped states as one variable."""
    blocks: dict[int, tuple[list[str], list[str]]] = {}
    lumped = set(model.lumped_states)
    for step in steps:
        variables, equations = blocks.setdefault(step.block, ([], []))
        variables += [state_of(v) if state_of(v) in lumped else v for v in step.variables]
        equations += [name for name in step.equations if name in model.by_name]
    parts = []
    for variables, equations in blocks.values():
        if equations:
            names = dict.fromkeys(variables)
            parts.append(f"({{{', '.join(names)}}}, {{{', '.join(equations)}}})")
    return ", ".join(parts)

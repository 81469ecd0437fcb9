"""Every equation of every MSO set as the consistency relation of a sequential residual generator, classified.

FINDRESIDUALGENERATORS and FINDRESIDUALGENERATORSMOD of paper 004, II-B and II-D. Of each candidate:

- **status**: the worst of its steps: each equation that is solved and each algebraic loop is unique, multiple or none;
- **causality**: which of integration (I) and differentiation (D) it needs beside static expressions (S). The modified
  algorithm also looks at the consistency relation: one that contains a derivative differentiates (Table I).

A candidate is **realizable** with unique or multiple solutions. The classes of Table IV are sets: SDI all, SI those
without D, SD those without I, S those without either.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gateway_fdi.jit import i8s, kernel
from gateway_fdi.masks import Masks, Sets, clear, include, pack
from gateway_fdi.structure.matching import Matching, copy_pairs, make_free, match_set, new_matching
from gateway_fdi.structure.model import Model, Solvable
from gateway_fdi.structure.sequence import Structure
from gateway_fdi.structure.steps import (
    DIFFERENTIATE,
    INTEGRATE,
    SINGULAR,
    Explicit,
    Steps,
    Workspace,
    order_steps,
)

#: Classes of causality of Table IV, widest first.
CAUSALITIES = ("SDI", "SI", "SD", "S")
ALGORITHMS = ("modified", "original")
#: Algebraic constraints of Table IV, by the least status that they allow.
ALGEBRAIC: Mapping[str, Solvable] = {"unique": Solvable.UNIQUE, "realizable": Solvable.MULTIPLE}

#: Sets classified between two reports of progress.
PORTION = 500

_NONE, _UNIQUE = int(Solvable.NONE), int(Solvable.UNIQUE)


class Solvability(NamedTuple):
    """How equations and loops can be solved, each a :class:`Solvable`.

    Attributes:
        alone: of each equation, for each variable, int64 (equations, variables).
        loop_equations: equations of each loop that the model declares, masks (loops, words of equations).
        loop_variables: its variables, masks (loops, words of variables).
        loop: of each loop, int64 (loops,).
        equations: scratch, the equations of a loop that was found, mask.
        variables: scratch, its variables, mask.
    """

    alone: i8s
    loop_equations: Masks
    loop_variables: Masks
    loop: i8s
    equations: Masks
    variables: Masks


class Portion(NamedTuple):
    """Some sets with the choices of their consistency relations, one after the other.

    Attributes:
        members: equations of all sets, with the tacit relations, int64.
        starts: where each set begins in ``members``, and where the last one ends, int64 (sets + 1,).
        choices: consistency relations to try, of all sets, int64 (candidates,).
        choice_starts: where each set begins in ``choices``, and where the last one ends, int64 (sets + 1,).
        used: scratch, the equations of a candidate, int64 (equations,).
    """

    members: i8s
    starts: i8s
    choices: i8s
    choice_starts: i8s
    used: i8s


@kernel
def _same(a: Masks, b: Masks) -> bool:
    """Return whether two masks are the same set."""
    same = True
    for w in range(len(a)):
        same = same and a[w] == b[w]
    return bool(same)


@kernel
def _loop_status(solve: Solvability, used: i8s, count: int, mate: i8s, order: Steps, step: int) -> int:
    """Return how the loop that a step is can be solved; one that is not declared cannot."""
    clear(solve.equations)
    clear(solve.variables)
    for k in range(count):
        e = used[k]
        if order.step[e] == step:
            include(solve.equations, e)
            include(solve.variables, mate[e])
    for k in range(len(solve.loop)):
        if _same(solve.loop_equations[k], solve.equations) and _same(solve.loop_variables[k], solve.variables):
            return int(solve.loop[k])
    return _NONE


@kernel
def _classify_one(solve: Solvability, used: i8s, count: int, mate: i8s, order: Steps, steps: int, result: i8s) -> None:
    """Write status, whether it integrates, and how often it differentiates, of one sequence into ``result``."""
    result[0], result[1], result[2] = _UNIQUE, 0, 0
    for number in range(steps):
        if order.kind[number] == INTEGRATE:
            result[1] = 1
            continue
        if order.kind[number] == DIFFERENTIATE:
            result[2] += 1
            continue
        if order.kind[number] == SINGULAR:
            result[0] = _NONE
            result[1] = 1
            continue
        size, last = 0, 0
        for k in range(count):
            if order.step[used[k]] == number:
                size += 1
                last = used[k]
        if size == 1:
            result[0] = min(result[0], solve.alone[last, mate[last]])
        else:
            result[0] = min(result[0], _loop_status(solve, used, count, mate, order, number))


@kernel
def _classify(
    explicit: Explicit, solve: Solvability, portion: Portion, matching: Matching, changed: Matching,
    order: Steps, work: Workspace, results: i8s,
) -> None:  # fmt: skip
    """Classify all choices of all sets.

    Args:
        explicit: the model.
        solve: how its equations can be solved.
        portion: sets and choices.
        matching: scratch, of a set.
        changed: scratch, as a candidate's sequence leaves it.
        order: scratch.
        work: scratch.
        results: written: status, integration, differentiations; int64 (candidates, 3).
    """
    rows, members, used = explicit.rows, portion.members, portion.used
    for k in range(len(portion.starts) - 1):
        first, size = portion.starts[k], portion.starts[k + 1] - portion.starts[k]
        for i in range(size):
            used[i] = members[first + i]
        match_set(rows, used, size, matching, explicit.everything)
        for c in range(portion.choice_starts[k], portion.choice_starts[k + 1]):
            check = portion.choices[c]
            make_free(rows, rows.shape[0], matching, check)
            count = 0
            for i in range(size):
                if members[first + i] != check:
                    used[count] = members[first + i]
                    count += 1
            copy_pairs(changed, matching)
            steps = order_steps(explicit, used, count, changed, order, work)
            _classify_one(solve, used, count, changed.mate, order, steps, results[c])


@dataclass(frozen=True)
class Candidates:
    """All candidates of some MSO sets; arrays of shape (candidates,).

    Attributes:
        model: the model.
        msos: the sets, shape (sets, equations of the model).
        mso: which set.
        equation: which equation is the consistency relation.
        status: a :class:`Solvable`.
        integral: whether a state is integrated.
        derivative: whether a variable is differentiated, in the sequence or in the consistency relation.
        derivative_in_sequence: whether one is in the sequence: the original algorithm looks at this.
    """

    model: Model
    msos: Sets
    mso: NDArray[np.int64]
    equation: NDArray[np.int64]
    status: NDArray[np.int64]
    integral: NDArray[np.bool_]
    derivative: NDArray[np.bool_]
    derivative_in_sequence: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.mso)

    def chosen(
        self, causality: str = "SDI", algebraic: str = "realizable", algorithm: str = "modified"
    ) -> NDArray[np.bool_]:
        """Return which candidates fulfil a row of Table IV.

        Args:
            causality: one of :data:`CAUSALITIES`.
            algebraic: one of :data:`ALGEBRAIC`.
            algorithm: one of :data:`ALGORITHMS`.

        Raises:
            KeyError: another algebraic constraint.
            ValueError: another causality or algorithm.
        """
        if causality not in CAUSALITIES or algorithm not in ALGORITHMS:
            raise ValueError(f"{causality}, {algorithm}: one of {CAUSALITIES}, of {ALGORITHMS}")
        derivative = self.derivative if algorithm == "modified" else self.derivative_in_sequence
        found = self.status >= ALGEBRAIC[algebraic]
        if "I" not in causality:
            found &= ~self.integral
        if "D" not in causality:
            found &= ~derivative
        return found

    def sets(self, chosen: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return which MSO sets have a candidate among the chosen, shape (sets,)."""
        there = np.zeros(len(self.msos), np.bool_)
        there[self.mso[chosen]] = True
        return there

    def causality(self, k: int) -> str:
        """Return what candidate ``k`` needs, by the modified algorithm: S, SI, SD or SDI."""
        return "S" + "D" * bool(self.derivative[k]) + "I" * bool(self.integral[k])

    @cached_property
    def table(self) -> dict[str, dict[str, dict[str, tuple[int, int]]]]:
        """Table IV: algorithm, algebraic constraint, causality: (MSO sets, residual generators)."""
        table: dict[str, dict[str, dict[str, tuple[int, int]]]] = {}
        for algorithm in ALGORITHMS:
            for algebraic in ALGEBRAIC:
                row = table.setdefault(algorithm, {}).setdefault(algebraic, {})
                for causality in CAUSALITIES:
                    chosen = self.chosen(causality, algebraic, algorithm)
                    row[causality] = (int(self.sets(chosen).sum()), int(chosen.sum()))
        return table


def _solvability(model: Model, structure: Structure) -> Solvability:
    m, n = structure.incidence.dense.shape
    alone = np.zeros((m, n), np.int64)
    for k, equation in enumerate(model.full_equations):
        for v, solvable in equation.solvable.items():
            alone[k, structure.column[v]] = solvable
    equations = pack([[structure.place[e] for e in loop.equations] for loop in model.loops], m)
    variables = pack([[structure.column[v] for v in loop.variables] for loop in model.loops], n)
    return Solvability(
        alone,
        equations,
        variables,
        np.array([x.solvable for x in model.loops], np.int64),
        np.zeros(equations.shape[1], np.int64),
        np.zeros(variables.shape[1], np.int64),
    )


def _portion(msos: Sets, choices: NDArray[np.int64], tacit: Sequence[tuple[int, ...]]) -> Portion:
    """Return sets, shape (sets, equations), with the choices of all of them one after the other."""
    members = []
    for row in msos:
        own = np.flatnonzero(row)
        members.append(np.array([*own, *(t for e in own for t in tacit[int(e)])], np.int64))
    return Portion(
        np.concatenate(members),
        np.cumsum([0, *(len(x) for x in members)]),
        choices,
        np.concatenate([[0], np.cumsum(msos.sum(1))]),
        np.zeros(max(len(x) for x in members), np.int64),
    )


def classify(model: Model, msos: Sets, *, progress: Callable[[int], None] | None = None) -> Candidates:
    """Classify every candidate of some MSO sets.

    Args:
        msos: sets of its equations, shape (sets, equations), as :func:`gateway_fdi.structure.mso.find_msos` gives.
        progress: called now and then with the number of sets done.
    """
    s = Structure(model)
    solve = _solvability(model, s)
    matching, changed = new_matching(*s.size), new_matching(*s.size)
    mso, equation = np.nonzero(msos)
    results = np.zeros((len(mso), 3), np.int64)
    done = 0
    for begin in range(0, len(msos), PORTION):
        sets = msos[begin : begin + PORTION]
        choices = equation[done : done + int(sets.sum())]
        _classify(
            s.explicit, solve, _portion(sets, choices, s.tacit), matching, changed,
            s.order, s.work, results[done : done + len(choices)],
        )  # fmt: skip
        done += len(choices)
        if progress is not None:
            progress(min(begin + PORTION, len(msos)))
    # A lumped consistency relation's derivatives are steps of the explicit sequence; the paper's has none for them.
    of_consistency = np.array([len(s.tacit[int(e)]) for e in equation], np.int64)
    return Candidates(
        model,
        msos,
        mso,
        equation,
        results[:, 0],
        results[:, 1] > 0,
        (results[:, 2] > 0) | (s.explicit.state[equation] >= 0),
        results[:, 2] > of_consistency,
    )

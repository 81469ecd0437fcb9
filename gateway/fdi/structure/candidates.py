"""Every equation of every MSO set as the consistency relation of a sequential residual generator, classified.

FINDRESIDUALGENERATORS and FINDRESIDUALGENERATORSMOD of paper 004, II-B and II-D. Of each candidate:

- **status**: the worst of its steps: each equation that is solved and each algebraic loop is unique, multiple or none;
- **causality**: which of integration (I) and differentiation (D) it needs beside static expressions (S). The modified
  algorithm also looks at the consistency relation: one that contains a derivative differentiates (Table I).

A candidate is **realizable** with unique or multiple solutions. The classes of Table IV are sets: SDI all, SI those
without D, SD those without I, S those without either.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gateway.fdi.structure.incidence import BITS, Flags, Masks, Sets, pack
from gateway.fdi.structure.matching import make_free
from gateway.fdi.structure.model import Model, Solvable
from gateway.fdi.structure.sequence import (
    DIFFERENTIATE,
    INTEGRATE,
    SINGULAR,
    Structure,
    match_set,
    sequence,
)
from gateway.jit import i8s, kernel

#: Classes of causality of Table IV, widest first.
CAUSALITIES = ("SDI", "SI", "SD", "S")
ALGORITHMS = ("modified", "original")
#: Algebraic constraints of Table IV, by the least status that they allow.
ALGEBRAIC: Mapping[str, Solvable] = {"unique": Solvable.UNIQUE, "realizable": Solvable.MULTIPLE}

#: Sets classified between two reports of progress.
PORTION = 500

_NONE, _UNIQUE = int(Solvable.NONE), int(Solvable.UNIQUE)


@kernel
def _loop_status(loops: Masks, solvable: i8s, equations: Masks, variables: Masks) -> int:
    """Return how a loop can be solved; one that is not declared cannot."""
    split = len(equations)
    for k in range(loops.shape[0]):
        same = True
        for w in range(split):
            same = same and loops[k, w] == equations[w]
        for w in range(len(variables)):
            same = same and loops[k, split + w] == variables[w]
        if same:
            return int(solvable[k])
    return _NONE


@kernel
def _classify_one(
    used: i8s, count: int, steps: int, mate: i8s, step: i8s, kind: i8s, solve: i8s,
    loops: Masks, loop_solvable: i8s, equations: Masks, variables: Masks, bits: int, result: i8s,
) -> None:  # fmt: skip
    """Write status, whether it integrates, and how often it differentiates, of one sequence into ``result``."""
    result[0], result[1], result[2] = _UNIQUE, 0, 0
    for number in range(steps):
        if kind[number] == INTEGRATE:
            result[1] = 1
            continue
        if kind[number] == DIFFERENTIATE:
            result[2] += 1
            continue
        if kind[number] == SINGULAR:
            result[0] = _NONE
            result[1] = 1
            continue
        size, last = 0, 0
        for k in range(count):
            if step[used[k]] == number:
                size += 1
                last = used[k]
        if size == 1:
            result[0] = min(result[0], solve[last, mate[last]])
            continue
        for w in range(len(equations)):
            equations[w] = 0
        for w in range(len(variables)):
            variables[w] = 0
        for k in range(count):
            e = used[k]
            if step[e] == number:
                equations[e // bits] |= 1 << (e % bits)
                variables[mate[e] // bits] |= 1 << (mate[e] % bits)
        result[0] = min(result[0], _loop_status(loops, loop_solvable, equations, variables))


@kernel
def _classify(
    rows: Masks, members: i8s, starts: i8s, choices: i8s, choice_starts: i8s, state: i8s, solve: i8s,
    loops: Masks, loop_solvable: i8s, bits: int, everything: Masks, mate: i8s, owner: i8s, came: i8s, queue: i8s,
    flags: Flags, seen: Masks, block: i8s, step: i8s, kind: i8s, scratch: i8s, rest: Masks, masks: Masks, one: i8s, mate_one: i8s, owner_one: i8s, equations: Masks, variables: Masks,
    results: i8s,
) -> None:  # fmt: skip
    """Classify all choices of all sets into ``results``: status, integration, differentiations."""
    m, n = rows.shape[0], len(owner)
    for k in range(len(starts) - 1):
        first, size = starts[k], starts[k + 1] - starts[k]
        for i in range(size):
            one[i] = members[first + i]
        match_set(rows, one, size, mate, owner, came, queue, flags, seen, everything)
        for c in range(choice_starts[k], choice_starts[k + 1]):
            left = choices[c]
            make_free(rows, m, mate, owner, left, came, queue, flags, seen)
            count = 0
            for i in range(size):
                if members[first + i] != left:
                    one[count] = members[first + i]
                    count += 1
            for i in range(m):
                mate_one[i] = mate[i]
            for v in range(n):
                owner_one[v] = owner[v]
            steps = sequence(
                rows, one, count, state, mate_one, owner_one,
                block, step, kind, scratch, rest, masks, flags,
            )  # fmt: skip
            _classify_one(
                one, count, steps, mate_one, step, kind, solve,
                loops, loop_solvable, equations, variables, bits, results[c],
            )  # fmt: skip


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
        derivative_in_sequence: whether one is in the sequence: what the original algorithm looks at.
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


def _solvability(model: Model, structure: Structure) -> NDArray[np.int64]:
    solve = np.zeros(structure.incidence.dense.shape, np.int64)
    for k, equation in enumerate(model.full_equations):
        for v, solvable in equation.solvable.items():
            solve[k, structure.column[v]] = solvable
    return solve


def _loops(model: Model, structure: Structure) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    m, n = structure.incidence.dense.shape
    equations = pack([[structure.place[e] for e in loop.equations] for loop in model.loops], m)
    variables = pack([[structure.column[v] for v in loop.variables] for loop in model.loops], n)
    return np.hstack([equations, variables]), np.array([x.solvable for x in model.loops], np.int64)


def classify(
    model: Model, msos: Sets, *, progress: Callable[[int], None] | None = None
) -> Candidates:
    """Classify every candidate of some MSO sets.

    Args:
        model: the model.
        msos: sets of its equations, shape (sets, equations), as :func:`gateway.fdi.structure.mso.find_msos` gives.
        progress: called now and then with the number of sets done.
    """
    s = Structure(model)
    solve = _solvability(model, s)
    loops, loop_solvable = _loops(model, s)
    m = len(model.equations)
    tacit = s.tacit[:m]
    mso, equation = np.nonzero(msos)
    results = np.zeros((len(mso), 3), np.int64)
    one, mate_one, owner_one = (
        np.zeros(size, np.int64) for size in (len(s.rows), len(s.rows), len(s.owner))
    )
    variables = np.zeros(s.rows.shape[1], np.int64)
    equations = np.zeros(loops.shape[1] - len(variables), np.int64)
    done = 0
    for begin in range(0, len(msos), PORTION):
        portion = msos[begin : begin + PORTION]
        members = []
        for row in portion:
            own = np.flatnonzero(row)
            with_tacit = tacit[own]
            members.append(np.concatenate([own, with_tacit[with_tacit >= 0]]))
        choices = equation[done : done + int(portion.sum())]
        _classify(
            s.rows, np.concatenate(members), np.cumsum([0, *(len(x) for x in members)]),
            choices, np.concatenate([[0], np.cumsum(portion.sum(1))]), s.state, solve,
            loops, loop_solvable, BITS, s.everything, s.mate, s.owner, s.came, s.queue,
            s.flags, s.seen, s.block, s.step, s.kind, s.scratch, s.rest, s.masks,
            one, mate_one, owner_one, equations, variables,
            results[done : done + len(choices)],
        )  # fmt: skip
        done += len(choices)
        if progress is not None:
            progress(min(begin + PORTION, len(msos)))
    # A lumped consistency relation's derivative is a step of the explicit sequence; the paper's has none for it.
    of_consistency = (tacit[equation] >= 0).astype(np.int64)
    return Candidates(
        model,
        msos,
        mso,
        equation,
        results[:, 0],
        results[:, 1] > 0,
        (results[:, 2] > 0) | (s.state[equation] >= 0),
        results[:, 2] > of_consistency,
    )

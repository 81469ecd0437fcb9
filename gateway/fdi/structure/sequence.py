"""Computation sequences: how the unknowns of a set are computed when one of its equations is kept for the check.

Paper 004, Definition 1, in the explicit form, where the relation between a state and its derivative is an equation too.
A set without its consistency relation is matched and falls into blocks in order of computation:

- the relation of a state alone, solved for the state: **integral causality**; solved for the derivative: **derivative
  causality** (II-C);
- another equation alone: solved for its variable;
- a block of several without such a relation: an **algebraic loop**;
- a block with such relations: a **differential loop**. Their states are integrated, and so known within the block; what
  is left is matched and falls into blocks again. If it cannot be matched, the loop is singular (of higher index), and
  cannot be computed without differentiating equations.
"""

from __future__ import annotations

from collections.abc import Sequence as Seq
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from gateway.fdi.structure.blocks import find_blocks
from gateway.fdi.structure.incidence import BITS, Flags, Masks, full, words
from gateway.fdi.structure.matching import ABSENT, FREE, augment
from gateway.fdi.structure.model import Equation, Model, state_of
from gateway.jit import i8s, kernel

#: Kinds of step, as the kernel numbers them.
SOLVE, INTEGRATE, DIFFERENTIATE, SINGULAR = 0, 1, 2, 3


class Kind(Enum):
    """What a step of a computation sequence does."""

    SOLVE = SOLVE
    INTEGRATE = INTEGRATE
    DIFFERENTIATE = DIFFERENTIATE
    SINGULAR = SINGULAR


@kernel
def _put(masks: Masks, v: int) -> None:
    masks[v // BITS] |= 1 << (v % BITS)


@kernel
def sequence(
    rows: Masks, members: i8s, count: int, state: i8s, mate: i8s, owner: i8s,
    block: i8s, step: i8s, kind: i8s, scratch: i8s, rest: Masks, masks: Masks, flags: Flags,
) -> int:  # fmt: skip
    """Order a matched set of equations into steps.

    Args:
        rows: variables of each equation, int64 (equations, words).
        members: the equations, all matched.
        count: how many of them.
        state: for the relation of a state, the variable that the state is; else -1.
        mate: variable of each equation; changed within differential loops.
        owner: equation of each variable; changed within differential loops.
        block: written: the block of each equation, as in a sequence of the paper.
        step: written: the step of each equation, several in one are a loop.
        kind: written: SOLVE, INTEGRATE, DIFFERENTIATE or SINGULAR, for each step.
        scratch: int64 (6, larger of equations and variables).
        rest: int64 (equations, words).
        masks: int64 (2, words).
        flags: bool (equations,).

    Returns:
        number of steps.
    """
    within, own = masks[0], masks[1]
    for w in range(len(within)):
        within[w] = 0
    for k in range(count):
        _put(within, mate[members[k]])
    blocks = find_blocks(rows, members, count, owner, within, 0, block, scratch, rest)
    inside, came, queue = scratch[4], scratch[5], scratch[0]
    steps = 0
    for b in range(blocks):
        size = 0
        for k in range(count):
            if block[members[k]] == b:
                inside[size] = members[k]
                size += 1
        if size == 1:
            e = inside[0]
            step[e] = steps
            if state[e] < 0:
                kind[steps] = SOLVE
            elif mate[e] == state[e]:
                kind[steps] = INTEGRATE
            else:
                kind[steps] = DIFFERENTIATE
            steps += 1
            continue
        for w in range(len(own)):
            own[w] = 0
        relations = 0
        for k in range(size):
            _put(own, mate[inside[k]])
            relations += state[inside[k]] >= 0
        if relations == 0:
            for k in range(size):
                step[inside[k]] = steps
            kind[steps] = SOLVE
            steps += 1
            continue
        # A differential loop: its states are known, and the other equations are matched without them.
        left = 0
        for k in range(size):
            e = inside[k]
            owner[mate[e]] = -1
            mate[e] = FREE
        for k in range(size):
            e = inside[k]
            if state[e] < 0:
                inside[left] = e
                left += 1
                continue
            v = state[e]
            own[v // BITS] &= ~(1 << (v % BITS))
            mate[e] = v
        solved = True
        for k in range(left):
            if not augment(rows, mate, owner, inside[k], own, came, queue, flags, within):
                solved = False
        # Only now: before, a path would have led through a state.
        for k in range(count):
            e = members[k]
            if block[e] == b and state[e] >= 0:
                owner[state[e]] = e
        if not solved:
            for k in range(count):
                if block[members[k]] == b:
                    step[members[k]] = steps
            kind[steps] = SINGULAR
            steps += 1
            continue
        behind = find_blocks(rows, inside, left, owner, own, steps, step, scratch, rest)
        for number in range(steps, behind):
            kind[number] = SOLVE
        steps = behind
        for k in range(count):
            e = members[k]
            if block[e] == b and state[e] >= 0:
                step[e] = steps
                kind[steps] = INTEGRATE
                steps += 1
    return steps


@kernel
def match_set(
    rows: Masks, members: i8s, count: int, mate: i8s, owner: i8s,
    came: i8s, queue: i8s, flags: Flags, seen: Masks, everything: Masks,
) -> int:  # fmt: skip
    """Match a set of equations from nothing; returns how many stay free. Others are absent."""
    for i in range(len(mate)):
        mate[i] = ABSENT
    for v in range(len(owner)):
        owner[v] = -1
    free = 0
    for k in range(count):
        mate[members[k]] = FREE
    for k in range(count):
        if not augment(rows, mate, owner, members[k], everything, came, queue, flags, seen):
            free += 1
    return free


@dataclass(frozen=True)
class Step:
    """A step of a computation sequence.

    Attributes:
        kind: what is done.
        equations: by which; for INTEGRATE and DIFFERENTIATE the relation of the state.
        variables: what is computed.
        block: number of the block of the sequence that it is in: those of a differential loop share one.
    """

    kind: Kind
    equations: tuple[str, ...]
    variables: tuple[str, ...]
    block: int


class Structure:
    """A model's explicit form with scratch for the kernels, for one question after the other.

    Args:
        model: the model.
    """

    def __init__(self, model: Model) -> None:
        self.model = model
        self.incidence = full(model)
        m, n = len(self.incidence.equations), len(self.incidence.variables)
        w, most = words(n), max(m, n)
        self.place = {name: k for k, name in enumerate(self.incidence.equations)}
        self.column = {name: k for k, name in enumerate(self.incidence.variables)}
        self.rows = self.incidence.rows
        #: For the relation of a state the column of the state, else -1.
        self.state: NDArray[np.int64] = np.array(
            [self.column[e.differential] if e.differential else -1 for e in model.full_equations],
            np.int64,
        )
        #: For each equation, the tacit relation that comes with it in the explicit form, else -1.
        self.tacit: NDArray[np.int64] = np.array(
            [self._tacit(model, e) for e in model.full_equations], np.int64
        )
        self.mate = np.zeros(m, np.int64)
        self.owner = np.zeros(n, np.int64)
        self.came = np.zeros(n, np.int64)
        self.queue = np.zeros(most, np.int64)
        self.flags = np.zeros(m, np.bool_)
        self.seen = np.zeros(w, np.int64)
        self.everything: NDArray[np.int64] = np.full(w, (1 << BITS) - 1, np.int64)
        self.block = np.zeros(m, np.int64)
        self.step = np.zeros(m, np.int64)
        self.kind = np.zeros(m + 1, np.int64)
        self.scratch = np.zeros((6, most), np.int64)
        self.rest = np.zeros((m, w), np.int64)
        self.masks = np.zeros((2, w), np.int64)

    def _tacit(self, model: Model, equation: Equation) -> int:
        state = equation.derivative
        return self.place.get(f"d/dt {state}", -1) if state in model.lumped_states else -1

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
            if self.tacit[self.place[name]] >= 0:
                numbers.add(int(self.tacit[self.place[name]]))
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
        free = match_set(
            self.rows, used, len(used), self.mate, self.owner,
            self.came, self.queue, self.flags, self.seen, self.everything,
        )  # fmt: skip
        dense = self.incidence.dense[members].any(0)
        if free or int(dense.sum()) != len(used):
            raise ValueError(
                f"without {consistency}, {len(used)} equations do not determine {int(dense.sum())} unknowns"
            )
        count = sequence(
            self.rows, used, len(used), self.state, self.mate, self.owner,
            self.block, self.step, self.kind, self.scratch, self.rest, self.masks, self.flags,
        )  # fmt: skip
        return tuple(self._step(used, k) for k in range(count))

    def _step(self, used: NDArray[np.int64], number: int) -> Step:
        rows = [int(e) for e in used if self.step[e] == number]
        kind = Kind(int(self.kind[number]))
        variables: list[int]
        if kind is Kind.SINGULAR:
            mine = self.incidence.dense[rows].any(0)
            outside = [e for e in used if self.step[e] != number]
            others = {int(self.mate[e]) for e in outside if self.mate[e] >= 0}
            variables = [int(v) for v in np.flatnonzero(mine) if int(v) not in others]
        else:
            variables = [int(self.mate[e]) for e in rows]
        return Step(
            kind,
            tuple(self.incidence.equations[e] for e in rows),
            tuple(self.incidence.variables[v] for v in variables),
            int(self.block[rows[0]]),
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

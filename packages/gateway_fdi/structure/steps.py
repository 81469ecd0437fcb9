"""Kernel of computation sequences: the steps of a matched set of equations, in order of computation.

:mod:`gateway_fdi.structure.sequence` explains the steps.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from gateway_fdi.jit import i8s, kernel
from gateway_fdi.masks import Masks, clear, exclude, include
from gateway_fdi.structure.blocks import BlockSearch, block_search, find_blocks
from gateway_fdi.structure.matching import FREE, Matching, augment

#: Kinds of step.
SOLVE, INTEGRATE, DIFFERENTIATE, SINGULAR = 0, 1, 2, 3


class Explicit(NamedTuple):
    """A model in explicit form, for kernels.

    Attributes:
        rows: variables of each equation, int64 (equations, words).
        state: for the relation of a state the variable that the state is, else -1, int64 (equations,).
        everything: mask of all variables, int64 (words,).
    """

    rows: Masks
    state: i8s
    everything: Masks


class Steps(NamedTuple):
    """The steps of a computation sequence.

    Attributes:
        block: block of each equation, as in a sequence of the paper, int64 (equations,).
        step: step of each equation; several in one are a loop, int64 (equations,).
        kind: SOLVE, INTEGRATE, DIFFERENTIATE or SINGULAR, for each step, int64 (equations + 1,).
    """

    block: i8s
    step: i8s
    kind: i8s


class Workspace(NamedTuple):
    """Scratch of :func:`order_steps`.

    Attributes:
        equations: of the block that is looked at; of a differential loop those that are no relation of a state, int64
            (equations,).
        relations: of the states in a differential loop, int64 (equations,).
        computed: mask of the variables that the set, and then the block, computes, int64 (words,).
        search: for blocks.
    """

    equations: i8s
    relations: i8s
    computed: Masks
    search: BlockSearch


def workspace(equations: int, words: int) -> Workspace:
    """Return scratch for a number of equations, and masks of a number of words."""
    of_block, relations = np.zeros((2, equations), np.int64)
    return Workspace(of_block, relations, np.zeros(words, np.int64), block_search(equations, words))


@kernel
def _take_block(block: i8s, members: i8s, count: int, number: int, equations: i8s) -> int:
    """Write the equations of a block, in the order of the members; returns how many there are."""
    size = 0
    for k in range(count):
        if block[members[k]] == number:
            equations[size] = members[k]
            size += 1
    return size


@kernel
def _kind_alone(state: int, mate: int) -> int:
    """Return what an equation alone does, from its state (-1: none) and the variable it is solved for."""
    if state < 0:
        return SOLVE
    return INTEGRATE if mate == state else DIFFERENTIATE


@kernel
def _count_relations(state: i8s, equations: i8s, size: int) -> int:
    """Return how many of some equations are relations of states."""
    relations = 0
    for k in range(size):
        relations += state[equations[k]] >= 0
    return relations


@kernel
def _know_states(state: i8s, matching: Matching, work: Workspace, size: int) -> int:
    """Match the relations in a differential loop to their states, and nothing else.

    Leaves the other equations in ``work.equations``, free, and the variables that they have to compute in
    ``work.computed``; the relations are written into ``work.relations``. The owners of the states are not set yet.

    Returns:
        how many other equations there are.
    """
    mate = matching.mate
    clear(work.computed)
    for k in range(size):
        e = work.equations[k]
        include(work.computed, mate[e])
        matching.owner[mate[e]] = -1
        mate[e] = FREE
    others = 0
    for k in range(size):
        e = work.equations[k]
        if state[e] < 0:
            work.equations[others] = e
            others += 1
        else:
            work.relations[k - others] = e
            exclude(work.computed, state[e])
            mate[e] = state[e]
    return others


@kernel
def _match_others(explicit: Explicit, matching: Matching, work: Workspace, others: int, relations: int) -> bool:
    """Match the equations of a differential loop beside its states' relations; False: not all can be matched."""
    solved = True
    for k in range(others):
        if not augment(explicit.rows, matching, work.equations[k], work.computed):
            solved = False
    # Only now: before, a path would have led through a state.
    for k in range(relations):
        e = work.relations[k]
        matching.owner[explicit.state[e]] = e
    return solved


@kernel
def _differential_loop(
    explicit: Explicit, matching: Matching, order: Steps, work: Workspace, size: int, steps: int
) -> int:
    """Order a differential loop, the ``size`` equations in ``work``: its states are known, the rest is solved.

    Args:
        explicit: the model.
        matching: of the set; that of the loop is changed.
        order: the loop's steps are written.
        work: holds the loop.
        size: equations of the loop.
        steps: how many steps there are before it.

    Returns:
        how many there are after it.
    """
    others = _know_states(explicit.state, matching, work, size)
    relations = size - others
    if not _match_others(explicit, matching, work, others, relations):
        for k in range(others):
            order.step[work.equations[k]] = steps
        for k in range(relations):
            order.step[work.relations[k]] = steps
        order.kind[steps] = SINGULAR
        return steps + 1
    behind = find_blocks(
        explicit.rows, work.equations, others, matching.owner, work.computed, steps, order.step, work.search
    )  # fmt: skip
    for number in range(steps, behind):
        order.kind[number] = SOLVE
    for k in range(relations):
        order.step[work.relations[k]] = behind + k
        order.kind[behind + k] = INTEGRATE
    return behind + relations


@kernel
def order_steps(explicit: Explicit, members: i8s, count: int, matching: Matching, order: Steps, work: Workspace) -> int:
    """Order a matched set of equations into steps.

    Args:
        explicit: the model.
        members: the equations, all matched.
        count: how many of them.
        matching: of them; changed within differential loops.
        order: written for the members.
        work: scratch.

    Returns:
        number of steps.
    """
    clear(work.computed)
    for k in range(count):
        include(work.computed, matching.mate[members[k]])
    blocks = find_blocks(explicit.rows, members, count, matching.owner, work.computed, 0, order.block, work.search)
    steps = 0
    for number in range(blocks):
        size = _take_block(order.block, members, count, number, work.equations)
        if size > 1 and _count_relations(explicit.state, work.equations, size) > 0:
            steps = _differential_loop(explicit, matching, order, work, size, steps)
            continue
        e = work.equations[0]
        order.kind[steps] = _kind_alone(explicit.state[e], matching.mate[e]) if size == 1 else SOLVE
        for k in range(size):
            order.step[work.equations[k]] = steps
        steps += 1
    return steps

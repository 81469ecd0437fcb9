"""[Phi, Gamma] of a plant whose entries are off by what a filter estimates, and their derivatives by each entry.

    A(theta) = A_0 + sum of theta_k E_k,   B(theta) = B_0 + sum of theta_k F_k
    Phi = exp(A T),   Gamma = phi1(A T) B T,   phi1(z) = (exp(z) - 1) / z

or of the matrices themselves where they are of discrete time. A filter's theta moves with every sample, so that this is
computed while the monitor runs, in a kernel: that by which generated residuals step
(:mod:`gateway_fdi.structure.generator.runtime`). The tests hold it against SciPy's.
"""

from __future__ import annotations

from math import sqrt
from typing import Annotated

from gateway_fdi.jit import Record, f8, f8s, i8, i8s, kernel, means
from gateway_fdi.linear_algebra import copy as copy_row
from gateway_fdi.structure.generator.runtime import exponentials
from gateway_plants.linear.mathematics.plant import MOST_INPUTS, MOST_OUTPUTS, MOST_STATES

#: Uncertain entries of A and B.
MOST_ENTRIES = 40
#: Filters, each with an estimate of its own: healthy; offset and gain of each actuator; offset and silence of each
#: sensor; a plant whose entries vary.
MOST_HYPOTHESES = 2 + 2 * MOST_INPUTS + 2 * MOST_OUTPUTS
#: [A, B] with the rows of the commands.
BLOCK = MOST_STATES + MOST_INPUTS
#: Step of the differences, in an entry's bound.
STEP = 1e-4


class Const(Record):
    """Constants."""

    n: i8 = means("states")
    m: i8 = means("inputs")
    q: i8 = means("uncertain entries")
    discrete: i8 = means("1: the matrices are of discrete time")
    matrix: Annotated[f8s, MOST_STATES, BLOCK] = means("[A, B] T, or [Phi, Gamma]")
    row: Annotated[i8s, MOST_ENTRIES] = means("row of each entry in matrix")
    column: Annotated[i8s, MOST_ENTRIES] = means("column of each entry in matrix")
    scale: f8 = means("what an entry's error is taken by in matrix")
    bound: Annotated[f8s, MOST_ENTRIES] = means("bound of each entry, squared")


class State(Record):
    """State, of each filter.

    ``now`` is computed for the errors ``at``, ``by_entry`` for the errors ``derived``.
    """

    now: Annotated[f8s, MOST_HYPOTHESES, MOST_STATES, BLOCK] = means("[Phi, Gamma]")
    at: Annotated[f8s, MOST_HYPOTHESES, MOST_ENTRIES] = means("errors of the entries")
    by_entry: Annotated[f8s, MOST_HYPOTHESES, MOST_ENTRIES, MOST_STATES, BLOCK] = means("its derivatives by each entry")
    derived: Annotated[f8s, MOST_HYPOTHESES, MOST_ENTRIES] = means("errors of the entries")
    whole: Annotated[f8s, MOST_STATES, BLOCK] = means("scratch: [A, B] T with the errors")
    made: Annotated[f8s, MOST_STATES, BLOCK] = means("scratch: [Phi, Gamma] of it")
    square: Annotated[f8s, MOST_STATES * MOST_STATES] = means("scratch: A T, row by row")
    phi: Annotated[f8s, 3 * MOST_STATES * MOST_STATES] = means("scratch: its exponential, phi1, phi2")
    space: Annotated[f8s, 2 * MOST_STATES * MOST_STATES] = means("scratch")


@kernel(inlined=False)
def _make(s: State, c: Const, errors: f8s, entry: int, step: float) -> None:
    """Put [Phi, Gamma] into ``made``, for the errors of all entries, one of them moved by a step."""
    n, size = c.n, c.n * c.n
    for i in range(n):
        copy_row(s.whole[i], c.matrix[i], n + c.m)
    for k in range(c.q):
        s.whole[c.row[k], c.column[k]] += c.scale * (errors[k] + (step if k == entry else 0.0))
    for i in range(n):
        copy_row(s.made[i], s.whole[i], n + c.m)
        copy_row(s.square[i * n :], s.whole[i], n)
    if c.discrete == 1:
        return
    exponentials(s.square[:size], s.phi[: 3 * size], s.space[: 2 * size], n)
    for i in range(n):
        copy_row(s.made[i], s.phi[i * n :], n)
        for j in range(c.m):
            s.made[i, n + j] = 0.0
            for k in range(n):
                s.made[i, n + j] += s.phi[size + i * n + k] * s.whole[k, n + j]


@kernel(inlined=False)
def refresh(s: State, c: Const, h: int, errors: f8s) -> None:
    """Compute [Phi, Gamma] of filter ``h`` from its estimate of the entries' errors."""
    _make(s, c, errors, 0, 0.0)
    for i in range(c.n):
        copy_row(s.now[h, i], s.made[i], c.n + c.m)
    copy_row(s.at[h], errors, c.q)


@kernel(inlined=False)
def derive(s: State, c: Const, h: int, errors: f8s) -> None:
    """Compute [Phi, Gamma] of filter ``h`` and its derivatives by the entries, as differences."""
    refresh(s, c, h, errors)
    for k in range(c.q):
        s.derived[h, k] = errors[k]
        step = STEP * sqrt(c.bound[k])
        _make(s, c, errors, k, step)
        for i in range(c.n):
            for j in range(c.n + c.m):
                s.by_entry[h, k, i, j] = (s.made[i, j] - s.now[h, i, j]) / step


@kernel
def copy(s: State, c: Const, source: int, target: int) -> None:
    """Let a filter go on with another one's matrices."""
    for i in range(c.n):
        copy_row(s.now[target, i], s.now[source, i], c.n + c.m)
        for k in range(c.q):
            copy_row(s.by_entry[target, k, i], s.by_entry[source, k, i], c.n + c.m)
    copy_row(s.at[target], s.at[source], c.q)
    copy_row(s.derived[target], s.derived[source], c.q)

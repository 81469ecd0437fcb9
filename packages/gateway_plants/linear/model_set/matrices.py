"""[Phi, Gamma] of a plant whose entries are off by what a filter estimates, and their derivatives by each entry.

    [Phi, Gamma](theta) = top rows of exp([[A_0 + sum of theta_k E_k, B_0 + sum of theta_k F_k], [0, 0]] T)

or of the matrices themselves where they are of discrete time. A filter's theta moves with every sample, so that this is
computed while the monitor runs, in a kernel: SciPy's exponential, which discretises the plant as it was told
(:mod:`gateway_plants.linear.mathematics.plant`), cannot be called there. Taylor's series of a matrix that was halved
until its norm is at most a half, squared as often, is enough: a plant's A T is small, since it is sampled fast enough
to be watched. The tests hold it against SciPy's.
"""

from __future__ import annotations

from math import sqrt
from typing import Annotated

from gateway_fdi.jit import Record, f8, f8s, i8, i8s, kernel, means
from gateway_fdi.linear_algebra import copy as copy_row
from gateway_plants.linear.pi_bank.bank import MOST_INPUTS, MOST_OUTPUTS, MOST_STATES

#: Uncertain entries of A and B.
MOST_ENTRIES = 40
#: Filters, each with an estimate of its own: healthy; offset and gain of each actuator; offset and silence of each
#: sensor; a plant whose entries vary.
MOST_HYPOTHESES = 2 + 2 * MOST_INPUTS + 2 * MOST_OUTPUTS
#: [A, B] with the rows of the commands.
BLOCK = MOST_STATES + MOST_INPUTS
#: Step of the differences, in an entry's bound.
STEP = 1e-4
#: Terms of Taylor's series: they leave 1e-13 of a norm of a half.
TERMS = 12


class Const(Record):
    """Constants."""

    n: i8 = means("states")
    m: i8 = means("inputs")
    q: i8 = means("uncertain entries")
    discrete: i8 = means("1: the matrices are of discrete time")
    matrix: Annotated[f8s, MOST_STATES, BLOCK] = means("[[A, B], [0, 0]] T, or [Phi, Gamma]")
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
    block: Annotated[f8s, BLOCK, BLOCK] = means("scratch: the matrix")
    term: Annotated[f8s, BLOCK, BLOCK] = means("scratch: a term of the series")
    next: Annotated[f8s, BLOCK, BLOCK] = means("scratch")


@kernel
def _multiply(a: f8s, b: f8s, into: f8s, size: int) -> None:
    """Multiply two square matrices."""
    for i in range(size):
        for j in range(size):
            total = 0.0
            for k in range(size):
                total += a[i, k] * b[k, j]
            into[i, j] = total


@kernel
def _halvings(s: State, n: int, size: int) -> int:
    """Return how often ``block`` is halved until its largest sum of a row is at most 0.5; 40 times at most."""
    largest = 0.0
    for i in range(n):
        total = 0.0
        for j in range(size):
            total += abs(s.block[i, j])
        largest = max(largest, total)
    halvings = 0
    while largest > 0.5 and halvings < 40:
        largest *= 0.5
        halvings += 1
    return halvings


@kernel(inlined=False)
def _exponential(s: State, c: Const, errors: f8s, entry: int, step: float) -> None:
    """Put [Phi, Gamma] into ``term``, for the errors of all entries, one of them moved by a step."""
    size = c.n + c.m
    for i in range(size):
        for j in range(size):
            s.block[i, j] = c.matrix[i, j] if i < c.n else 0.0
    for k in range(c.q):
        s.block[c.row[k], c.column[k]] += c.scale * (errors[k] + (step if k == entry else 0.0))
    if c.discrete == 1:
        for i in range(size):
            copy_row(s.term[i], s.block[i], size)
        return
    halvings = _halvings(s, c.n, size)
    share = 0.5**halvings
    for i in range(size):
        for j in range(size):
            s.block[i, j] *= share
            s.term[i, j] = 1.0 if i == j else 0.0
    # Horner: 1 + X (1 + X/2 (1 + X/3 (...))).
    for order in range(TERMS, 0, -1):
        _multiply(s.block, s.term, s.next, size)
        for i in range(size):
            for j in range(size):
                s.term[i, j] = s.next[i, j] / order + (1.0 if i == j else 0.0)
    for _ in range(halvings):
        _multiply(s.term, s.term, s.next, size)
        for i in range(size):
            copy_row(s.term[i], s.next[i], size)


@kernel(inlined=False)
def refresh(s: State, c: Const, h: int, errors: f8s) -> None:
    """Compute [Phi, Gamma] of filter ``h`` from its estimate of the entries' errors."""
    _exponential(s, c, errors, 0, 0.0)
    for i in range(c.n):
        copy_row(s.now[h, i], s.term[i], c.n + c.m)
    copy_row(s.at[h], errors, c.q)


@kernel(inlined=False)
def derive(s: State, c: Const, h: int, errors: f8s) -> None:
    """Compute [Phi, Gamma] of filter ``h`` and its derivatives by the entries, as differences."""
    refresh(s, c, h, errors)
    for k in range(c.q):
        s.derived[h, k] = errors[k]
        step = STEP * sqrt(c.bound[k])
        _exponential(s, c, errors, k, step)
        for i in range(c.n):
            for j in range(c.n + c.m):
                s.by_entry[h, k, i, j] = (s.term[i, j] - s.now[h, i, j]) / step


@kernel
def copy(s: State, c: Const, source: int, target: int) -> None:
    """Let a filter go on with another one's matrices."""
    for i in range(c.n):
        copy_row(s.now[target, i], s.now[source, i], c.n + c.m)
        for k in range(c.q):
            copy_row(s.by_entry[target, k, i], s.by_entry[source, k, i], c.n + c.m)
    copy_row(s.at[target], s.at[source], c.q)
    copy_row(s.derived[target], s.derived[source], c.q)

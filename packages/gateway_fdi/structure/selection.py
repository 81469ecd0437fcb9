"""The fewest tests that isolate what all of them isolate.

A set of tests does it if it hits, for each fault that can be detected and each pair that can be told apart, a test that
does so: a minimum hitting set, solved as an integer program (HiGHS, by SciPy). A very large one is chosen greedily:
always the test that does most of what is missing, and in the end none that the others make superfluous.

The fewest tests may be poor ones: each equation brings the errors of its parameters and its sensors. Where it is said
how many equations each test has, nothing hangs on a test with far more of them than another one that would do.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from gateway_fdi.masks import Sets

#: Requirements times tests, up to which the choice is an integer program: some seconds' work there.
MOST_EXACT = 100_000
#: Equations of a test that a fault, or a pair, may hang on: times those of the smallest that would do, and beyond that.
MOST_TIMES, MOST_BEYOND = 1.5, 8
#: And that sees the fault worse than another one, by this factor.
MOST_WORSE = 3.0


def requirements(
    signature: Sets,
    sizes: NDArray[np.int64] | None = None,
    quality: NDArray[np.float64] | None = None,
    *,
    together: int = 1,
) -> Sets:
    """Return which test fulfils which requirement, shape (requirements, tests).

    Args:
        signature: fault signature matrix, shape (tests, faults).
        sizes: equations of each test, shape (tests,): those with far more than need be do not count.
        quality: how well a test sees a fault, shape of the matrix: those that see it far worse do not count.
        together: faults that may be there at once: each other one is to be told from them, a test that sees it and
            none of them (Krysander, Frisk 2008, for modes of several faults).
    """
    tests, faults = signature.shape
    wanted = [(i, signature[:, i]) for i in range(faults)]
    for there in combinations(range(faults), min(together, max(faults - 1, 0))):
        blind = ~signature[:, there].any(1)
        wanted += [(i, signature[:, i] & blind) for i in range(faults) if i not in there]
    rows = []
    for i, row in wanted:
        if quality is not None and row.any():
            row = row & (quality[:, i] >= quality[row, i].max() / MOST_WORSE)  # noqa: PLW2901 - what is left of it
        rows.append(row)
    if together > 1:  # where no test tells two, one may still tell each of them
        rows += list(requirements(signature, sizes, quality, together=together - 1))
    possible = [row for row in rows if row.any()]
    if sizes is not None:
        possible = [row & (sizes <= MOST_TIMES * sizes[row].min() + MOST_BEYOND) for row in possible]
    return np.unique(np.array(possible), axis=0) if possible else np.zeros((0, tests), np.bool_)


def _needed(wanted: Sets) -> Sets:
    """Return the requirements that no other one implies: a smaller row fulfilled fulfils each that contains it."""
    counts = wanted.sum(1)
    rows = wanted[np.argsort(counts, kind="stable")]
    packed = np.packbits(rows, axis=1)
    left = np.ones(len(rows), np.bool_)
    for k in range(len(rows)):
        if left[k]:
            later = k + 1 + np.flatnonzero(left[k + 1 :])
            left[later] = (packed[k] & ~packed[later]).any(1)
    return rows[left]


def _greedy(wanted: Sets, weight: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return tests that fulfil all requirements, none of which can be left out."""
    missing = np.ones(len(wanted), np.bool_)
    chosen: list[int] = []
    while missing.any():
        best = int(np.argmax(wanted[missing].sum(0) / weight))
        chosen.append(best)
        missing &= ~wanted[:, best]
    for test in sorted(chosen, key=lambda k: -weight[k]):
        others = [k for k in chosen if k != test]
        if wanted[:, others].any(1).all():
            chosen = others
    return np.sort(np.array(chosen, np.int64))


def fewest_tests(
    signature: Sets,
    cost: NDArray[np.float64] | None = None,
    sizes: NDArray[np.int64] | None = None,
    quality: NDArray[np.float64] | None = None,
    *,
    together: int = 1,
) -> NDArray[np.int64]:
    """Return the fewest tests that detect and isolate as much as all of them do.

    Args:
        signature: fault signature matrix, shape (tests, faults).
        cost: decides between choices of as many tests, shape (tests,), not negative; for instance the number of
            equations of each.
        sizes: equations of each, shape (tests,); see :func:`requirements`.
        quality: shape of the matrix; see :func:`requirements`.
        together: faults at once; see there.

    Returns:
        the numbers of the tests, rising.
    """
    tests = signature.shape[0]
    wanted = requirements(signature, sizes, quality, together=together)
    if wanted.size > MOST_EXACT:
        wanted = _needed(wanted)
    if not len(wanted):
        return np.zeros(0, np.int64)
    weight = np.ones(tests)
    if cost is not None and cost.max() > 0:
        weight += cost / (2.0 * max(cost.sum(), 1.0))  # all of them together weigh less than one test
    if wanted.size > MOST_EXACT:
        return _greedy(wanted, weight)
    from scipy.optimize import Bounds, LinearConstraint, milp  # noqa: PLC0415 - slow to load

    result = milp(
        weight,
        integrality=np.ones(tests),
        bounds=Bounds(0, 1),
        constraints=LinearConstraint(wanted.astype(np.float64), lb=1.0),
        options={"mip_rel_gap": 0.0},
    )
    if result.x is None:
        raise ValueError(f"the choice of tests was not solved: {result.message}")
    return np.flatnonzero(result.x > 0.5)

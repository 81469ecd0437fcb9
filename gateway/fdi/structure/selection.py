"""The fewest tests that isolate what all of them isolate.

A set of tests does it if it hits, for each fault that can be detected and each pair that can be told apart, a test that
does so: a minimum hitting set, solved as an integer program (HiGHS, by SciPy).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gateway.fdi.structure.incidence import Sets


def requirements(signature: Sets) -> Sets:
    """Return which test fulfils which requirement, shape (requirements, tests).

    Args:
        signature: fault signature matrix, shape (tests, faults).
    """
    tests, faults = signature.shape
    rows = [signature[:, i] for i in range(faults)]
    rows += [signature[:, i] & ~signature[:, j] for i in range(faults) for j in range(faults) if i != j]
    possible = [row for row in rows if row.any()]
    return np.unique(np.array(possible), axis=0) if possible else np.zeros((0, tests), np.bool_)


def fewest_tests(signature: Sets, cost: NDArray[np.float64] | None = None) -> NDArray[np.int64]:
    """Return the fewest tests that detect and isolate as much as all of them do.

    Args:
        signature: fault signature matrix, shape (tests, faults).
        cost: what decides between choices of as many tests, shape (tests,), not negative; for instance the number of
            equations of each.

    Returns:
        the numbers of the tests, rising.
    """
    from scipy.optimize import Bounds, LinearConstraint, milp  # noqa: PLC0415 - slow to load

    tests = signature.shape[0]
    wanted = requirements(signature)
    if not len(wanted):
        return np.zeros(0, np.int64)
    weight = np.ones(tests)
    if cost is not None and cost.max() > 0:
        weight += cost / (2.0 * max(cost.sum(), 1.0))  # all of them together weigh less than one test
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

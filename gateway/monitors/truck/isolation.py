"""Which faults explain the tests that have fired: consistency, with the structural model's fault signature matrix.

A single fault explains what has fired if it is in the signature of every test that has. It is isolated when its own
tests, all of them and no others, have fired: no other fault has that column. Until then the faults that explain are
ranked by how near their tests are to firing.
"""

from __future__ import annotations

from typing import Annotated

from gateway.fdi.structure.model import Model
from gateway.jit import Record, f8s, i8s, kernel
from gateway.monitors.truck.faults import STRUCTURAL

#: Tests that decide, by system: residuals of the structural model. RDS is beyond the paper.
TESTS = {
    "ICDS": ("T1", "T2", "T3_ICDS", "T4_ICDS"),
    "MCDS": ("T1", "T2", "T3_MCDS", "T4_MCDS"),
    "RDS": ("T1", "T2", "T5", "T6", "T7"),
}
MOST_TESTS = max(map(len, TESTS.values()))


class Const(Record):
    """Of each fault, the tests that it makes fire, as bits."""

    signature: Annotated[i8s, len(STRUCTURAL)]


def prepare(c: Const, model: Model, system: str) -> None:
    """Fill a record of Const from the faults that stand in the equations of the tests' sets."""
    for k, fault in enumerate(STRUCTURAL):
        bits = 0
        for place, test in enumerate(TESTS[system]):
            equations = model.residuals[test].equations
            if any(fault in model.by_name[name].faults for name in equations):
                bits |= 1 << place
        c.signature[k] = bits


@kernel
def candidates(c: Const, fired: int) -> int:
    """Return the faults, as bits, that explain what has fired; none if nothing has."""
    found = 0
    for k in range(len(c.signature)):
        if fired != 0 and fired & ~c.signature[k] == 0:
            found |= 1 << k
    return found


@kernel
def isolated(c: Const, fired: int) -> int:
    """Return the fault whose tests, all and no others, have fired; -1 if there is none."""
    for k in range(len(c.signature)):
        if c.signature[k] == fired:
            return k
    return -1


@kernel
def support(c: Const, fault: int, levels: f8s) -> float:
    """Return how near a fault's tests are to firing, 1 when all have: mean of T_norm, each at most 1."""
    total, count = 0.0, 0
    for place in range(len(levels)):
        if c.signature[fault] >> place & 1 == 1:
            total += min(levels[place], 1.0)
            count += 1
    return total / count


@kernel
def ranked(c: Const, found: int, levels: f8s) -> int:
    """Return candidates as digits, likeliest first: 25 is the second fault, then the fifth; 0 if there is none.

    Args:
        c: constants.
        found: candidates, as bits.
        levels: T_norm of the tests that decide, shape (MOST_TESTS,).
    """
    digits = 0
    while found != 0:
        best = -1
        for k in range(len(c.signature)):
            if found >> k & 1 == 1 and (best < 0 or support(c, k, levels) > support(c, best, levels)):
                best = k
        found &= ~(1 << best)
        digits = 10 * digits + best + 1
    return digits

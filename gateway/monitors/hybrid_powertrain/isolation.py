"""Which faults explain the tests that have fired: consistency, with the structural model's fault signature matrix.

A single fault explains what has fired if it is in the signature of every test that has. It is isolated when its own tests,
all of them and no others, have fired: no other fault has that column.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from gateway.fdi.structure.model import Model
from gateway.jit import i8, kernel, record
from gateway.monitors.hybrid_powertrain.faults import STRUCTURAL

#: Of each fault, the tests that it makes fire, as bits.
CONST = record(signature=(i8, len(STRUCTURAL)))

TESTS = ("T1", "T2", "T3_ICDS", "T4_ICDS")


def prepare(c: np.void, model: Model) -> None:
    """Fill a record of CONST from the faults that stand in the equations of the tests' sets."""
    for k, fault in enumerate(STRUCTURAL):
        bits = 0
        for place, test in enumerate(TESTS):
            equations = model.residuals[test].equations
            if any(fault in model.by_name[name].faults for name in equations):
                bits |= 1 << place
        c["signature"][k] = bits


@kernel
def candidates(c: Any, fired: int) -> int:
    """Return the faults, as bits, that explain what has fired; none if nothing has."""
    found = 0
    for k in range(len(c.signature)):
        if fired != 0 and fired & ~c.signature[k] == 0:
            found |= 1 << k
    return found


@kernel
def isolated(c: Any, fired: int) -> int:
    """Return the fault whose tests, all and no others, have fired; -1 if there is none."""
    for k in range(len(c.signature)):
        if c.signature[k] == fired:
            return k
    return -1

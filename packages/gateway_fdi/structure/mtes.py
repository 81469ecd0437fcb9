"""Minimal test equation supports (Krysander, Aslund, Frisk 2010).

A test equation support is the largest overdetermined set with the faults that it has: M = M+ with faults F, and no
equation without a fault outside F can be added that has redundancy. The minimal ones are those whose faults contain no
other's: there are far fewer of them than MSO sets, and they isolate as much.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gateway_fdi.masks import Sets
from gateway_fdi.structure.decomposition import equivalence_classes, overdetermined
from gateway_fdi.structure.incidence import Incidence, counted
from gateway_fdi.structure.isolability import incidence_of_faults
from gateway_fdi.structure.model import Model
from gateway_fdi.structure.mso import in_order

#: Default of the greatest number of sets looked at.
MOST_SETS = 100_000


def find_mtes(model: Model, *, limit: int = MOST_SETS, structure: Incidence | None = None) -> Sets:
    """Return the minimal test equation supports, shape (sets, equations), in order of size.

    Raises:
        ValueError: more sets than the limit have to be looked at.
    """
    structure = structure or counted(model)
    where: NDArray[np.bool_] = np.any(incidence_of_faults(model), axis=1)
    found: dict[bytes, NDArray[np.bool_]] = {}
    seen: set[bytes] = set()
    waiting = [overdetermined(structure)]
    while waiting:
        test = waiting.pop()
        key = test.tobytes()
        if key in seen or not (test & where).any():
            continue
        seen.add(key)
        if len(seen) > limit:
            raise ValueError(f"more than {limit} sets of equations with different faults: raise the limit")
        smaller = []
        for together in equivalence_classes(structure, test):
            if where[together].any():
                rest = test.copy()
                rest[together] = False
                rest = overdetermined(structure, rest)
                if (rest & where).any():
                    smaller.append(rest)
        if smaller:
            waiting += smaller
        else:
            found[key] = test
    if not found:
        return np.zeros((0, len(structure.equations)), np.bool_)
    return in_order(np.array(list(found.values())))

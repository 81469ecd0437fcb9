"""Random structural models."""

import numpy as np

from gateway_fdi.structure.model import Equation, Model, Solvable

SOLVABLE = list(Solvable)


def random_model(seed, unknowns, redundancy, *, faults=4, states=0, each=3, paired=False):
    """A model in which every variable can be computed: a chain through all of them, and random dependencies.

    ``paired``: derivatives stand two in an equation.
    """
    rng = np.random.default_rng(seed)
    names = [f"x{k}" for k in range(unknowns)]
    equations = []
    places = rng.choice(unknowns + redundancy, size=faults, replace=False)
    for k in range(unknowns + redundancy):
        own = {names[k]} if k < unknowns else set()
        size = int(rng.integers(1, each + 1))
        own |= {names[int(i)] for i in rng.choice(unknowns, size=min(size, unknowns), replace=False)}
        mine = names[k : min(k + 2, states)] if paired and k % 2 == 0 else names[k : k + 1] if not paired else []
        mine = mine if k < states else []
        variables = sorted(own | set(mine))
        variables = [f"der({v})" if v in mine else v for v in variables]
        order = [variables[int(i)] for i in rng.permutation(len(variables))]
        solvable = {v: SOLVABLE[int(rng.integers(0, 3))] for v in order}
        fault = tuple(f"f{i}" for i, where in enumerate(places) if where == k)
        equations.append(Equation(f"e{k}", tuple(order), (), fault, solvable))
    return Model(
        f"random {seed}",
        tuple(equations),
        tuple(names),
        faults=tuple(f"f{k}" for k in range(faults)),
    )

"""Where to put sensors so that faults can be detected, or told apart.

More sensors never make a fault of the model harder to find: the question is monotone, so that all minimal sets follow
from counterexamples. A set that is not enough is grown until one sensor more would be enough; the rest must contain a
sensor of every set that is enough. The minimal sets that hit all those are tried in turn, until each of them is enough
(:mod:`gateway_fdi.hitting`, one counterexample at a time). It does not matter whether the model has too few equations
somewhere, which Krysander and Frisk (2008) exclude; where theirs applies, the answers are the same.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from gateway_fdi.hitting import grown_by
from gateway_fdi.structure.isolability import isolability_of_model
from gateway_fdi.structure.model import Equation, Model

#: Greatest number of sets kept on the way.
MOST_SETS = 20_000


def minimal_sets(candidates: Sequence[int], enough: Callable[[frozenset[int]], bool]) -> list[frozenset[int]]:
    """Return all minimal sets that are enough, smallest first.

    Args:
        candidates: of what the sets are made.
        enough: a monotone question: if a set is enough, so is a larger one.

    Raises:
        ValueError: there are more than :data:`MOST_SETS` on the way.
    """
    if not enough(frozenset(candidates)):
        return []
    enough, hitting = cache(enough), [frozenset[int]()]
    while True:
        short = next((s for s in hitting if not enough(s)), None)
        if short is None:
            return sorted(hitting, key=lambda s: (len(s), sorted(s)))
        grown = set(short)
        for name in candidates:
            if name not in grown and not enough(frozenset(grown | {name})):
                grown.add(name)
        missing = [name for name in candidates if name not in grown]
        hitting = grown_by(hitting, missing)
        if len(hitting) > MOST_SETS:
            raise ValueError(f"more than {MOST_SETS} sets of sensors to look at: allow fewer places")


def place_sensors(model: Model, places: Sequence[str] | None = None, *, isolate: bool = True) -> list[tuple[str, ...]]:
    """Return all minimal sets of unknowns to be measured so that the model's faults can be found, smallest first.

    Faults that no choice of sensors finds are not asked for.

    Args:
        model: the model, with the sensors that it has.
        places: unknowns that could be measured; None: all.
        isolate: tell the faults apart; else detect them only.

    Raises:
        ValueError: a place is no unknown, or there are too many sets.
    """
    places = tuple(model.unknowns if places is None else places)
    for name in places:
        if name not in model.unknowns:
            raise ValueError(f'"{name}" is no unknown of the model')
    added = tuple(Equation(f"sensor of {x}", (x,), (), ()) for x in places)
    equipped = replace(model, equations=model.equations + added, residuals={})
    here = np.ones(len(model.equations), np.bool_)
    best = isolability_of_model(equipped)

    def enough(chosen: frozenset[int]) -> bool:
        subset = np.concatenate([here, [k in chosen for k in range(len(places))]])
        now = isolability_of_model(equipped, subset)
        if not _as_good(now.detectable, best.detectable):
            return False
        return not isolate or _as_good(~now.confused, ~best.confused)

    named = {tuple(sorted(places[k] for k in chosen)) for chosen in minimal_sets(range(len(places)), enough)}
    return sorted(named, key=lambda s: (len(s), s))


def _as_good(now: NDArray[np.bool_], best: NDArray[np.bool_]) -> bool:
    return bool((now | ~best).all())

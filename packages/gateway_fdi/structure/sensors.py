"""Where to put sensors so that faults can be detected, or told apart.

More sensors never make a fault of the model harder to find: the question is monotone, so that all minimal sets follow
from counterexamples. A set that is not enough is grown until one sensor more would be enough; the rest must contain a
sensor of every set that is enough. The minimal sets that hit all those are tried in turn, until each of them is enough
(:mod:`gateway_fdi.hitting`, one counterexample at a time). It does not matter whether the model has too few equations
somewhere, which Krysander and Frisk (2008) exclude; where theirs applies, the answers are the same.

A sensor that can fail itself adds a fault that must be found too. That is not monotone, so the minimal sets for the
model's own faults are grown, smallest first; a second sensor of the same variable may be what is needed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gateway_fdi.hitting import grown_by
from gateway_fdi.structure.isolability import isolability_of_model
from gateway_fdi.structure.model import Equation, Model

#: Default of the greatest number of sets kept on the way.
MOST_SETS = 20_000

_TOO_MANY = "more than {} sets of sensors to look at: allow fewer places, or raise the limit"


def minimal_sets(
    candidates: Sequence[int],
    enough: Callable[[frozenset[int]], bool],
    *,
    limit: int = MOST_SETS,
) -> list[frozenset[int]]:
    """Return all minimal sets that are enough, smallest first.

    Args:
        candidates: of what the sets are made.
        enough: a monotone question: if a set is enough, so is a larger one.
        limit: greatest number of sets on the way.

    Raises:
        ValueError: there are more on the way.
    """
    if not enough(frozenset(candidates)):
        return []
    hitting = [frozenset[int]()]
    confirmed: set[frozenset[int]] = set()
    while True:
        short = next((s for s in hitting if s not in confirmed and not _confirm(s, enough, confirmed)), None)
        if short is None:
            return sorted(hitting, key=lambda s: (len(s), sorted(s)))
        grown = set(short)
        for name in candidates:
            if name not in grown and not enough(frozenset(grown | {name})):
                grown.add(name)
        missing = [name for name in candidates if name not in grown]
        hitting = grown_by(hitting, missing)
        if len(hitting) > limit:
            raise ValueError(_TOO_MANY.format(limit))


def _confirm(
    sensors: frozenset[int],
    enough: Callable[[frozenset[int]], bool],
    confirmed: set[frozenset[int]],
) -> bool:
    if enough(sensors):
        confirmed.add(sensors)
        return True
    return False


def _equipped(model: Model, sensors: Sequence[str], fallible: frozenset[str]) -> Model:
    """Return the model with sensors after its own equations, those in ``fallible`` with a fault of their own."""
    added = tuple(
        Equation(
            f"sensor {k} of {x}",
            (x,),
            (),
            (f"fault of sensor {k} of {x}",) if x in fallible else (),
        )
        for k, x in enumerate(sensors)
    )
    return replace(
        model,
        equations=model.equations + added,
        faults=model.faults + tuple(name for e in added for name in e.faults),
        residuals={},
    )


def place_sensors(
    model: Model,
    places: Sequence[str] | None = None,
    *,
    isolate: bool = True,
    fallible: Iterable[str] = (),
    limit: int = MOST_SETS,
) -> list[tuple[str, ...]]:
    """Return all minimal sets of unknowns to be measured so that the model's faults can be found, smallest first.

    Faults that no choice of sensors finds are not asked for.

    Args:
        model: the model, with the sensors that it has.
        places: unknowns that could be measured; None: all.
        isolate: tell the faults apart; else detect them only.
        fallible: places whose sensor can fail; its fault must be found too, and such a place can have two sensors.
        limit: greatest number of sets on the way.

    Raises:
        ValueError: a place is no unknown, or there are too many sets.
    """
    places = tuple(model.unknowns if places is None else places)
    breaking = frozenset(fallible)
    for name in (*places, *breaking):
        if name not in model.unknowns:
            raise ValueError(f'"{name}" is no unknown of the model')
    sensors = places + tuple(x for x in places if x in breaking)
    equipped = _equipped(model, sensors, breaking)
    here = np.ones(len(model.equations), np.bool_)
    best = isolability_of_model(equipped)
    own = list(range(len(model.faults)))
    failing = {
        k: equipped.faults.index(e.faults[0])
        for k, e in enumerate(equipped.equations[len(model.equations) :])
        if e.faults
    }

    def found(chosen: frozenset[int], who: list[int]) -> bool:
        subset = np.concatenate([here, [k in chosen for k in range(len(sensors))]])
        now = isolability_of_model(equipped, subset)
        if not _as_good(now.detectable[who], best.detectable[who]):
            return False
        each = np.ix_(who, who)
        return not isolate or _as_good(~now.confused[each], ~best.confused[each])

    sets = minimal_sets(range(len(places)), lambda chosen: found(chosen, own), limit=limit)
    if breaking:
        sets = _grown(
            sets,
            range(len(sensors)),
            lambda chosen: found(chosen, own + [failing[k] for k in sorted(chosen) if k in failing]),
            limit,
        )
    named = {tuple(sorted(sensors[k] for k in chosen)) for chosen in sets}
    return sorted(named, key=lambda s: (len(s), s))


def _grown(
    starts: Sequence[frozenset[int]],
    places: Sequence[int],
    enough: Callable[[frozenset[int]], bool],
    limit: int,
) -> list[frozenset[int]]:
    """Return the minimal sets that contain one of ``starts`` and are enough, smallest first."""
    answer: list[frozenset[int]] = []
    level, looked = set(starts), 0
    size = min((len(s) for s in starts), default=0)
    while level:
        now = sorted((s for s in level if len(s) == size), key=sorted)
        level = {s for s in level if len(s) > size}
        for sensors in now:
            looked += 1
            if looked > limit:
                raise ValueError(_TOO_MANY.format(limit))
            if any(known <= sensors for known in answer):
                continue
            if enough(sensors):
                answer.append(sensors)
            else:
                level |= {sensors | {name} for name in places if name not in sensors}
        size += 1
    return answer


def _as_good(now: NDArray[np.bool_], best: NDArray[np.bool_]) -> bool:
    return bool((now | ~best).all())

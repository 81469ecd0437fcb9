"""The likeliest diagnoses of failed tests that share components."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from gateway_fdi.diagnosis.answer import Diagnosis, Group
from gateway_fdi.diagnosis.cluster import Cluster
from gateway_fdi.hitting import NEVER, HittingSet, HittingSets


@dataclass(frozen=True)
class Bounds:
    """How much is looked for.

    Attributes:
        diagnoses: listed for each group, at most; the search goes on behind them, to know how probable they are.
        least: a diagnosis so much less probable than the first is not looked for.
        steps: of the search, at most; a branch that has not been looked at then is counted as the likeliest set that
            it could hold.
    """

    diagnoses: int = 16
    least: float = 1e-6
    steps: int = 600


#: So many of the likeliest diagnoses are asked whether their sizes fit, and for parts that are wrong beside them, if
#: they are at least so probable against the first (its logarithm); those for parts that have got one, up to so many.
_LOOKED, _WEAKEST, _LARGER = 16, math.log(1e-6), 64
#: Logarithm of how probable it is that a further error has a size that no test has to fail by.
_CANCELS = math.log(0.1)
#: A test can still speak if it sees a component that is as probable as this.
_SUSPECTED = 0.01


def solve(cluster: Cluster, bounds: Bounds) -> Group:
    """Return the diagnoses of a cluster, likeliest first."""
    found, waiting = _found(cluster, bounds)
    found = _larger(cluster, found)
    for one in _likeliest(found):
        hidden = cluster.hidden_by(one.elements)
        if hidden:
            cluster, found = _beside(cluster, found, one, hidden)
            break
    top = found[0].weight
    shares = [math.exp(one.weight - top) for one in found]
    whole = sum(shares) + sum(math.exp(min(bound - top, 700.0)) for bound in waiting)
    listed = list(zip(found, shares, strict=True))[: bounds.diagnoses]
    told = tuple(_told(cluster, one, share / whole) for one, share in listed)
    suspected = {k for one, d in zip(found, told, strict=False) if d.probability >= _SUSPECTED for k in one.elements}
    rest = max(1.0 - sum(one.probability for one in told), 0.0)
    return Group(cluster.failed, _merged(cluster, told), rest, cluster.waiting(suspected))


def _merged(cluster: Cluster, told: tuple[Diagnosis, ...]) -> tuple[Diagnosis, ...]:
    """Return diagnoses of which those are one that differ only in the way in which a component fails."""
    merged: dict[tuple[str, ...], Diagnosis] = {}
    for one in told:
        name = cluster.told(one.components)
        known = merged.setdefault(name, one)
        if known is not one:
            merged[name] = replace(known, probability=known.probability + one.probability)
    return tuple(sorted(merged.values(), key=lambda one: -one.probability))


def _found(cluster: Cluster, bounds: Bounds) -> tuple[list[HittingSet], list[float]]:
    """Return the minimal diagnoses, likeliest first, and the bounds of what has not been looked at."""
    span = -math.log(bounds.least) if bounds.least > 0.0 else math.inf
    search = HittingSets(
        cluster.conflicts, cluster.weights.tolist(), cluster.prices, exact=cluster.weight, span=span,
        most_steps=bounds.steps,
    )  # fmt: skip
    found = list(search)
    if search.waiting and search.steps >= bounds.steps:
        near = _near(cluster)
        if all(near.elements != one.elements for one in found):
            found.append(near)
            found.sort(key=lambda one: -one.weight)
    return found, search.waiting


def _larger(cluster: Cluster, found: list[HittingSet]) -> list[HittingSet]:
    """Return the diagnoses, likeliest first, with those that are likelier than all of them with one part less.

    A minimal diagnosis explains what fails, but maybe badly: a part that sees a test hardly is enough. De Kleer and
    Williams (1987), section 4: any superset of a diagnosis is one, too.
    """
    known = {one.elements: one.weight for one in found}
    bases = _likeliest(found)
    looked = list(bases)
    for one in looked:
        for k in cluster.beside(one.elements) if len(looked) < _LARGER else ():
            elements = tuple(sorted({*one.elements, k}))
            if elements not in known:
                missed = tuple(t for t in one.missed if not cluster.power[t, k])
                known[elements] = weight = cluster.weight(elements, missed)
                looked.append(HittingSet(elements, missed, weight))

    larger = (one for one in looked[len(bases) :] if _is_likelier(one, known))
    return sorted([*found, *larger], key=lambda one: -one.weight)


def _likeliest(found: list[HittingSet]) -> list[HittingSet]:
    return [one for one in found[:_LOOKED] if one.weight >= found[0].weight + _WEAKEST]


def _is_likelier(one: HittingSet, known: Mapping[tuple[int, ...], float]) -> bool:
    """Return whether a set is likelier than all that are known with one part less."""
    less = (tuple(k for k in one.elements if k != out) for out in one.elements)
    return one.weight > max(known.get(each, NEVER) for each in less)


def _beside(
    cluster: Cluster, found: list[HittingSet], one: HittingSet, hidden: tuple[int, ...]
) -> tuple[Cluster, list[HittingSet]]:
    """Return the diagnoses with those that have one component more than one of them, and the cluster that they are of.

    De Kleer and Williams (1987), section 4: any superset of a diagnosis explains what fails; it is likelier only where
    what passes asks for it.
    """
    wide = cluster.widened(hidden)
    number = {int(c): k for k, c in enumerate(wide.suspects)}
    moved = [each._replace(elements=tuple(number[int(cluster.suspects[k])] for k in each.elements)) for each in found]
    base = moved[found.index(one)]
    known = {each.elements: each.weight for each in moved}
    for c in hidden:
        elements = tuple(sorted({*base.elements, number[c]}))
        more = HittingSet(elements, base.missed, wide.weight(elements, base.missed) + _CANCELS)
        if elements not in known and _is_likelier(more, known):
            moved.append(more)
    return wide, sorted(moved, key=lambda each: -each.weight)


def _told(cluster: Cluster, one: HittingSet, probability: float) -> Diagnosis:
    return Diagnosis(
        components=tuple(int(cluster.suspects[k]) for k in one.elements),
        probability=probability,
        explains=tuple(t for k, t in enumerate(cluster.failed) if k not in one.missed),
        against=cluster.against(one.elements, one.missed),
    )


def _near(cluster: Cluster) -> HittingSet:
    """Return a diagnosis that is found at once: each time the component that saves most false alarms for its weight."""
    sees = cluster.power > 0.0
    priced, left = np.array(cluster.prices)[:, None] * sees, np.ones(len(cluster.failed), np.bool_)
    saved = cluster.weights - priced.sum(axis=0)
    chosen: list[int] = []
    while left.any():
        best = int(saved.argmax())
        if not saved[best] > 0.0 or best in chosen:
            break
        chosen.append(best)
        saved += priced[left & sees[:, best]].sum(axis=0)
        left &= ~sees[:, best]
    for k in list(chosen):  # the first ones may not be needed behind the last
        rest = [j for j in chosen if j != k]
        if not (sees[:, k] & ~sees[:, rest].any(axis=1)).any():
            chosen.remove(k)
    elements, missed = tuple(sorted(chosen)), tuple(np.flatnonzero(left).tolist())
    return HittingSet(elements, missed, cluster.weight(elements, missed))

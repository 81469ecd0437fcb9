"""The likeliest diagnoses of failed tests that share components."""

from __future__ import annotations

import math
from dataclasses import dataclass

from gateway_fdi.diagnosis.answer import Diagnosis, Group
from gateway_fdi.diagnosis.cluster import Cluster
from gateway_fdi.hitting import HittingSet, HittingSets


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
    steps: int = 1000


#: A test can still speak if it sees a component that is as probable as this.
_SUSPECTED = 0.01


def solve(cluster: Cluster, bounds: Bounds) -> Group:
    """Return the diagnoses of a cluster, likeliest first."""
    span = -math.log(bounds.least) if bounds.least > 0.0 else math.inf
    search = HittingSets(
        cluster.conflicts, cluster.weights.tolist(), cluster.prices, exact=cluster.weight, span=span,
        most_steps=bounds.steps,
    )  # fmt: skip
    found = list(search)
    waiting = search.waiting
    if waiting and search.steps >= bounds.steps:
        near = _near(cluster)
        if all(near.elements != one.elements for one in found):
            found.append(near)
            found.sort(key=lambda one: -one.weight)
    top = found[0].weight
    shares = [math.exp(one.weight - top) for one in found]
    whole = sum(shares) + sum(math.exp(min(bound - top, 700.0)) for bound in waiting)
    listed = list(zip(found, shares, strict=True))[: bounds.diagnoses]
    told = tuple(_told(cluster, one, share / whole) for one, share in listed)
    suspected = {k for one, d in zip(found, told, strict=False) if d.probability >= _SUSPECTED for k in one.elements}
    rest = max(1.0 - sum(one.probability for one in told), 0.0)
    return Group(cluster.failed, told, rest, cluster.waiting(suspected))


def _told(cluster: Cluster, one: HittingSet, probability: float) -> Diagnosis:
    return Diagnosis(
        components=tuple(int(cluster.suspects[k]) for k in one.elements),
        probability=probability,
        explains=tuple(t for k, t in enumerate(cluster.failed) if k not in one.missed),
        against=cluster.against(one.elements, one.missed),
        sizes=cluster.sizes(one.elements),
    )


def _near(cluster: Cluster) -> HittingSet:
    """Return a diagnosis that is found at once: each time the component that saves most false alarms for its weight."""
    sees = cluster.power > 0.0
    prices, left = cluster.prices, set(range(len(cluster.failed)))
    chosen: list[int] = []
    while left:
        rows = sorted(left)
        saved = cluster.weights - sum(prices[k] * sees[k] for k in rows)
        best = int(saved.argmax())
        if not saved[best] > 0.0 or best in chosen:
            break
        chosen.append(best)
        left -= {k for k in rows if sees[k, best]}
    for k in list(chosen):  # the first ones may not be needed behind the last
        rest = [j for j in chosen if j != k]
        if not (sees[:, k] & ~sees[:, rest].any(axis=1)).any():
            chosen.remove(k)
    elements, missed = tuple(sorted(chosen)), tuple(sorted(left))
    return HittingSet(elements, missed, cluster.weight(elements, missed))

"""Minimal hitting sets: sets of elements that have something in common with every conflict, and no element too many.

Two questions are asked. All of them, as conflicts come one by one: :func:`grown_by` (Berge's transversals). The few
heaviest of very many, where elements have weights: :class:`HittingSets`. Neither stands in for the other: the second,
started again for each new conflict, took 200 times as long to find all of 20 sets; the first cannot stop early.

Reiter, "A theory of diagnosis from first principles" (1987): the minimal diagnoses are the minimal hitting sets of the
conflicts (theorem 4.4); his tree branches on the elements of a conflict that is not hit yet (section 4.2). Here each
set is reached once, since a branch leaves out the elements of the branches before it, and branches are searched best
first, by probability (de Kleer, "Focusing on probable diagnoses", 1991). No branch is
pruned that Reiter's tree would keep (Greiner, Smith and Wilkerson 1989 correct its pruning; nothing is pruned by
other sets here, only where an element of the set itself is needed for no conflict any more).

A conflict may be *missed*, at a price: as an element of its own that hits nothing else. A set is minimal if each of
its elements is needed: without it, one conflict more would be missed.

The reach of a branch is bounded by conflicts that have no element in common: each needs an element, or to be
missed. Sets of elements and of conflicts are bits of integers.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from heapq import heappop, heappush
from itertools import count
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

#: Price of a conflict that must not be missed.
NEVER = -math.inf
#: Default of the greatest number of branches that are looked at.
MOST_STEPS = 4000
#: Number of branches that an exact weight counts as.
_WEIGHED = 4

#: Entries of the queue: a set that is whole, a set that is not, elements that a set may get next.
_WHOLE, _PART, _NEXT = range(3)


class HittingSet(NamedTuple):
    """A minimal hitting set.

    Attributes:
        elements: in ascending order.
        missed: conflicts that it does not hit, in ascending order.
        weight: logarithm.
    """

    elements: tuple[int, ...]
    missed: tuple[int, ...]
    weight: float


class _Set(NamedTuple):
    """A set on the way.

    Attributes:
        elements: in the order in which they came.
        left: conflicts that are neither hit nor missed, by rank.
        out: elements that it must not get.
        once: conflicts that one element hits alone.
        often: conflicts that several hit.
        missed: conflicts that are missed.
        weight: of elements and prices.
        bound: that no set made of it exceeds.
    """

    elements: tuple[int, ...]
    left: int
    out: int
    once: int
    often: int
    missed: int
    weight: float
    bound: float


def grown_by(sets: Sequence[frozenset[int]], conflict: Iterable[int]) -> list[frozenset[int]]:
    """Return all minimal hitting sets of some conflicts and one more.

    Args:
        sets: all minimal hitting sets of those before; of none: the empty set.
        conflict: elements of the new one.
    """
    conflict = list(conflict)
    kept = [s for s in sets if not s.isdisjoint(conflict)]
    more = [s | {element} for s in sets if s.isdisjoint(conflict) for element in conflict]
    return kept + [s for s in dict.fromkeys(more) if not any(k <= s for k in kept)]


def bits(mask: int) -> Iterator[int]:
    """Yield the places of the bits of a number, lowest first."""
    while mask:
        low = mask & -mask
        yield low.bit_length() - 1
        mask ^= low


def _matrix(masks: Sequence[int], size: int) -> NDArray[np.bool_]:
    """Return numbers as their bits, shape (masks, size)."""
    width = (size + 7) // 8
    packed = np.frombuffer(b"".join(mask.to_bytes(width, "little") for mask in masks), np.uint8)
    return np.unpackbits(packed.reshape(len(masks), width), axis=1, count=size, bitorder="little").astype(np.bool_)


class HittingSets:
    """Finds minimal hitting sets, heaviest first; iterate over it.

    Args:
        conflicts: elements of each, as bits of a number.
        weights: of each element, a logarithm, 0 at most, shape (elements,).
        prices: of each conflict that is missed, likewise; :data:`NEVER`: it must be hit; None: all must.
        exact: elements and missed conflicts -> weight of a set, if it can be less than the sum of weights and prices.
        span: sets lighter than the heaviest by more are not looked for.
        most_steps: branches that are looked at, and about as much work for exact weights.

    Attributes:
        steps: of them so far.
    """

    def __init__(
        self,
        conflicts: Sequence[int],
        weights: Sequence[float],
        prices: Sequence[float] | None = None,
        *,
        exact: Callable[[tuple[int, ...], tuple[int, ...]], float] | None = None,
        span: float = math.inf,
        most_steps: int = MOST_STEPS,
    ) -> None:
        count_ = len(conflicts)
        self._rank = sorted(range(count_), key=lambda k: (conflicts[k].bit_count(), k))  # small ones leave few branches
        self._masks = [conflicts[k] for k in self._rank]
        self._prices = [NEVER if prices is None else prices[k] for k in self._rank]
        self._weights, self._exact, self._span, self._most = weights, exact, span, most_steps
        there = _matrix(self._masks, len(weights))
        order = np.lexsort((np.arange(len(weights)), -np.asarray(weights, float)))
        by_weight = there[:, order]
        self._members: list[list[int]] = [order[row].tolist() for row in by_weight]
        packed = np.packbits(there.T, axis=1, bitorder="little")
        self._hits = [int.from_bytes(row.tobytes(), "little") for row in packed]  # conflicts of each element
        self._best = [
            max(price, weights[members[0]] if members else NEVER)
            for price, members in zip(self._prices, self._members, strict=True)
        ]
        self._apart = self._pack()
        self._reached: dict[int, tuple[float, float]] = {0: (0.0, 0.0)}
        self._queue: list[tuple[float, int, int, int, _Set, int]] = []
        self._number = count()
        self.steps = 0

    def _pack(self) -> int:
        """Return conflicts that have no element in common, the dearest first."""
        apart = taken = 0
        for k in sorted(range(len(self._masks)), key=lambda k: (self._best[k], k)):
            if not self._masks[k] & taken:
                apart |= 1 << k
                taken |= self._masks[k]
        return apart

    @property
    def waiting(self) -> list[float]:
        """Bounds of what has not been looked at, logarithms; empty: all sets have been found."""
        return [-entry[0] for entry in self._queue]

    def __iter__(self) -> Iterator[HittingSet]:
        """Yield the sets, heaviest first, until all are found or enough has been looked at."""
        whole = (1 << len(self._masks)) - 1
        self._queue, self.steps = [], 0
        start = _Set((), whole, 0, 0, 0, 0, 0.0, self._reach(whole))
        if start.bound > NEVER:
            self._push(start.bound, _PART if whole else _WHOLE, start)
        least = NEVER
        while self._queue and self.steps < self._most and -self._queue[0][0] >= least:
            bound, _, _, _, one, at = heappop(self._queue)
            if at >= 0:
                self._branch(one, at)
            elif one.left:
                self._open(one)
            else:
                least = max(least, -bound - self._span)
                yield HittingSet(tuple(sorted(one.elements)), self._names(one.missed), -bound)
                continue  # costs no step
            self.steps += 1

    def _push(self, bound: float, kind: int, one: _Set, at: int = -1) -> None:
        heappush(self._queue, (-bound, kind, len(one.elements), next(self._number), one, at))

    def _names(self, ranks: int) -> tuple[int, ...]:
        return tuple(sorted(self._rank[k] for k in bits(ranks)))

    def _reach(self, left: int) -> float:
        """Return what conflicts that are left cost at least, as the weight that cannot be exceeded."""
        apart = left & self._apart
        if apart:
            return self._cost(apart)[0]
        return self._best[(left & -left).bit_length() - 1] if left else 0.0

    def _cost(self, apart: int) -> tuple[float, float]:
        """Return what conflicts that have no element in common cost together, and the dearest of them alone."""
        known = self._reached.get(apart)
        if known is None:
            costs = [self._best[k] for k in bits(apart)]
            known = self._reached[apart] = (math.fsum(costs), min(costs))
        return known

    def _open(self, one: _Set) -> None:
        """Look at the first conflict that is left: an element hits it, or it is missed."""
        first = (one.left & -one.left).bit_length() - 1
        self._wait(one, first, 0)
        if self._prices[first] > NEVER:
            left, out, missed = one.left ^ (1 << first), one.out | self._masks[first], one.missed | 1 << first
            weight = one.weight + self._prices[first]
            self._put(one.elements, left, out, one.once, one.often, missed, weight, one.bound)

    def _wait(self, one: _Set, first: int, at: int) -> None:
        """Have the next element of a conflict wait, from a place among them on."""
        members = self._members[first]
        while at < len(members) and one.out >> members[at] & 1:
            at += 1
        if at == len(members):
            return
        apart = one.left & self._apart
        rest, dearest = self._cost(apart)
        if apart:  # an element hits one of them at most
            rest -= self._best[first] if apart >> first & 1 else dearest
        self._push(min(one.bound, one.weight + self._weights[members[at]] + rest), _NEXT, one, at)

    def _branch(self, one: _Set, at: int) -> None:
        """Give a set an element; the later ones of the same conflict wait, without this one."""
        first = (one.left & -one.left).bit_length() - 1
        element = self._members[first][at]
        self._wait(one._replace(out=one.out | 1 << element), first, at + 1)
        hits = self._hits[element]
        often = one.often | (one.once & hits)
        once = (one.once & ~hits) | (hits & ~one.once & ~one.often)
        for other in one.elements:
            if not self._hits[other] & once:
                return  # it is needed no more
        weight = one.weight + self._weights[element]
        self._put((*one.elements, element), one.left & ~hits, one.out, once, often, one.missed, weight, one.bound)

    def _put(
        self, elements: tuple[int, ...], left: int, out: int, once: int, often: int, missed: int, weight: float,
        bound: float,
    ) -> None:  # fmt: skip
        """Put a set into the queue, by what can come of it."""
        if left:
            bound = min(bound, weight + self._reach(left))
        elif self._exact is None:
            bound = weight
        else:
            bound = self._exact(tuple(sorted(elements)), self._names(missed))
            self.steps += _WEIGHED
        if bound > NEVER:
            one = _Set(elements, left, out, once, often, missed, weight, bound)
            self._push(bound, _PART if left else _WHOLE, one)

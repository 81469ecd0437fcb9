"""Minimal hitting sets, heaviest first, against all subsets."""

import math
from itertools import combinations

import numpy as np
import pytest
from amount import amount

from gateway_fdi.hitting import NEVER, HittingSets, bits, grown_by

SEED = 4701


def by_brute_force(conflicts, weights, prices):
    """Return elements -> (missed, weight) of every set each of whose elements is needed."""
    found = {}
    used = sorted({e for conflict in conflicts for e in conflict})
    for size in range(len(used) + 1):
        for chosen in combinations(used, size):
            hit = [set(chosen) & conflict for conflict in conflicts]
            needed = {next(iter(h)) for h in hit if len(h) == 1}
            missed = tuple(k for k, h in enumerate(hit) if not h)
            weight = sum(weights[e] for e in chosen) + sum(prices[k] for k in missed)
            if needed == set(chosen) and weight > NEVER:
                found[chosen] = (missed, weight)
    return found


def a_case(rng):
    elements = int(rng.integers(1, 11))
    conflicts = [
        {e for e in range(elements) if rng.random() < rng.uniform(0.1, 0.7)} for _ in range(int(rng.integers(0, 8)))
    ]
    weights = np.log(rng.uniform(1e-4, 1.0, elements)).tolist()
    prices = [NEVER if rng.random() < 0.4 else math.log(rng.uniform(1e-6, 0.5)) for _ in conflicts]
    return conflicts, weights, prices


def masks(conflicts):
    return [sum(1 << e for e in conflict) for conflict in conflicts]


def test_they_are_those_of_all_subsets_heaviest_first():
    print("seed", SEED)
    rng = np.random.default_rng(SEED)
    for _ in range(amount(5000, 300, 60)):
        conflicts, weights, prices = a_case(rng)
        search = HittingSets(masks(conflicts), weights, prices, most_steps=100_000)
        found = list(search)
        wanted = by_brute_force(conflicts, weights, prices)
        assert {one.elements for one in found} == set(wanted)
        assert len(found) == len(wanted)
        assert not search.waiting
        for one in found:
            missed, weight = wanted[one.elements]
            assert one.missed == missed
            assert one.weight == pytest.approx(weight)
        told = [one.weight for one in found]
        assert told == sorted(told, reverse=True)


def test_those_that_grow_by_conflicts_are_the_same():
    rng = np.random.default_rng(SEED + 2)
    for _ in range(amount(2000, 200, 60)):
        conflicts, weights, _ = a_case(rng)
        grown = [frozenset()]
        for conflict in conflicts:
            grown = grown_by(grown, conflict)
        found = [frozenset(one.elements) for one in HittingSets(masks(conflicts), weights, most_steps=100_000)]
        assert set(grown) == set(found)
        assert len(grown) == len(found)


def test_a_search_that_is_cut_off_has_the_heaviest_and_says_what_waits():
    rng = np.random.default_rng(SEED + 1)
    for _ in range(amount(1000, 60)):
        conflicts, weights, prices = a_case(rng)
        every = [one.weight for one in HittingSets(masks(conflicts), weights, prices, most_steps=100_000)]
        search = HittingSets(masks(conflicts), weights, prices, most_steps=8)
        found = [one.weight for one in search]
        assert found == pytest.approx(every[: len(found)])
        if len(found) < len(every):
            assert max(search.waiting) >= every[len(found)] - 1e-9


def test_an_exact_weight_below_the_sum_changes_the_order():
    exact = {(0,): -9.0, (1,): -5.0, (2,): -6.0}
    search = HittingSets([0b111], [-1.0, -2.0, -3.0], exact=lambda elements, missed: exact[elements])
    assert [one.elements for one in search] == [(1,), (2,), (0,)]


def test_without_conflicts_nothing_is_needed():
    assert [(one.elements, one.weight) for one in HittingSets([], [])] == [((), 0.0)]
    assert list(HittingSets([0], [])) == []


def test_bits():
    assert list(bits(0b101001)) == [0, 3, 5]

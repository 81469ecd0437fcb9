"""Random structures: against brute force, and against SciPy's graph algorithms."""

from itertools import combinations, product

import numpy as np
import pytest
from amount import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from random_models import random_model
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components, maximum_bipartite_matching

from gateway_fdi.masks import BITS, pack, unpack
from gateway_fdi.structure.candidates import classify
from gateway_fdi.structure.decomposition import decompose, overdetermined
from gateway_fdi.structure.incidence import counted, full
from gateway_fdi.structure.isolability import isolability_of_model, isolability_of_tests
from gateway_fdi.structure.model import Equation, Model, Solvable, differential
from gateway_fdi.structure.mso import TooManySetsError, find_msos
from gateway_fdi.structure.selection import fewest_tests
from gateway_fdi.structure.sensors import minimal_sets, place_sensors
from gateway_fdi.structure.sequence import Kind, Structure


def rank(dense, rows):
    """Size of a maximum matching, by SciPy."""
    if not len(rows):
        return 0
    return int((maximum_bipartite_matching(csr_matrix(dense[list(rows)]), "column") >= 0).sum())


def brute_force_msos(dense):
    """Sets with one equation more than variables of which each proper subset can be matched."""
    m = len(dense)
    found = []
    for size in range(1, m + 1):
        for rows in combinations(range(m), size):
            variables = int(dense[list(rows)].any(0).sum())
            if size == variables + 1 and all(rank(dense, rows[:k] + rows[k + 1 :]) == size - 1 for k in range(size)):
                found.append(frozenset(rows))
    return set(found)


def structure_of(dense):
    m, n = dense.shape
    equations = tuple(Equation(f"e{i}", tuple(f"x{j}" for j in range(n) if dense[i, j])) for i in range(m))
    return Model("random", equations, tuple(f"x{j}" for j in range(n)))


matrices = st.integers(2, 8).flatmap(
    lambda m: st.integers(1, 6).flatmap(
        lambda n: st.lists(
            st.lists(st.booleans(), min_size=n, max_size=n).filter(any), min_size=m, max_size=m
        )
    )
).map(np.array)  # fmt: skip


@settings(max_examples=examples(150), deadline=None)
@given(matrices)
def test_msos_are_those_of_brute_force(dense):
    structure = counted(structure_of(dense))
    found = find_msos(structure)
    assert {frozenset(np.flatnonzero(row)) for row in found} == brute_force_msos(dense)
    assert len({row.tobytes() for row in found}) == len(found)


@settings(max_examples=examples(150), deadline=None)
@given(matrices, st.data())
def test_overdetermined_part_is_that_of_brute_force(dense, data):
    """An equation is in M+ if the rank stays the same without it."""
    m = len(dense)
    there = np.array(data.draw(st.lists(st.booleans(), min_size=m, max_size=m)))
    rows = [int(i) for i in np.flatnonzero(there)]
    expected = [i for i in rows if rank(dense, [j for j in rows if j != i]) == rank(dense, rows)]
    assert list(np.flatnonzero(overdetermined(counted(structure_of(dense)), there))) == expected


@settings(max_examples=examples(100), deadline=None)
@given(matrices)
def test_parts_cover_the_model(dense):
    model = structure_of(dense)
    parts = decompose(counted(model))
    equations = [*parts.under.equations, *parts.over.equations]
    variables = [*parts.under.variables, *parts.over.variables]
    for block in parts.just:
        equations += block.equations
        variables += block.variables
        assert len(block.equations) == len(block.variables)
    assert sorted(equations) == sorted(e.name for e in model.equations)
    assert sorted(variables) == sorted(model.unknowns)
    assert sorted(e for c in parts.classes for e in c.equations) == sorted(parts.over.equations)
    for c in parts.classes:
        assert len(c.variables) == len(c.equations) - 1


def test_masks_of_many_words():
    rng = np.random.default_rng(3)
    dense = rng.random((7, 3 * BITS + 5)) < 0.3
    assert (unpack(pack([np.flatnonzero(row) for row in dense], dense.shape[1]), dense.shape[1]) == dense).all()


@pytest.mark.costly
def test_a_large_model_takes_several_words():
    """A chain of 150 variables, both ends and the middle measured: three sets, of more equations than a word
    has bits.
    """
    names = [f"x{k}" for k in range(150)]
    chain = tuple(Equation(f"e{k}", (names[k], names[k + 1])) for k in range(149))
    model = Model("chain", chain, tuple(names)).with_sensors(["x0", "x75", "x149"])
    found = find_msos(counted(model))
    assert sorted(found.sum(1)) == [76, 77, 151]
    assert len(classify(model, found)) == 304


def block_sets(structure, rows, columns):
    """Strongly connected blocks of a square part, by SciPy: (equations, variables) of each."""
    dense = structure.dense[np.ix_(rows, columns)]
    pairs = maximum_bipartite_matching(csr_matrix(dense), "column")
    assert (pairs >= 0).all()
    depends = dense[:, pairs]
    _, label = connected_components(csr_matrix(depends), directed=True, connection="strong")
    blocks = []
    for k in range(label.max() + 1):
        mine = np.flatnonzero(label == k)
        blocks.append((frozenset(rows[i] for i in mine), frozenset(columns[pairs[i]] for i in mine)))
    return blocks


@pytest.mark.parametrize("paired", [False, True])
@pytest.mark.parametrize("seed", range(12))
def test_sequences_and_classes(seed, paired):
    """Each candidate of random models, classified again with SciPy's blocks and the rules as they are written."""
    model = random_model(seed, 7 + seed % 3, 2, states=4 if paired else 3, paired=paired)
    msos = find_msos(counted(model))
    found = classify(model, msos)
    structure, s = full(model), Structure(model)
    index = {e.name: k for k, e in enumerate(model.full_equations)}
    column = {v: k for k, v in enumerate(model.full_variables)}
    relation = {index[f"d/dt {x}"]: (column[x], column[f"der({x})"]) for x in model.lumped_states}
    for k in range(len(found)):
        names = frozenset(counted(model).names(msos[found.mso[k]]))
        check = model.equations[found.equation[k]].name
        rows = [int(i) for i in s.members(names) if i != index[check]]
        columns = [int(v) for v in np.flatnonzero(structure.dense[s.members(names)].any(0))]
        status, integral, derivative = Solvable.UNIQUE, False, False
        for equations, variables in block_sets(structure, rows, columns):
            inside = [relation[e] for e in equations if e in relation]
            if len(equations) == 1:
                (e,), (v,) = equations, variables
                if e in relation:
                    integral |= v == relation[e][0]
                    derivative |= v == relation[e][1]
                else:
                    name = model.full_variables[v]
                    status = min(status, model.full_equations[e].solvable.get(name, Solvable.NONE))
                continue
            integral |= bool(inside)
            rest = sorted(e for e in equations if e not in relation)
            left = sorted(v for v in variables if v not in {x for x, _ in inside})
            if rank(structure.dense[:, left], rest) < len(rest):
                status = Solvable.NONE
                continue
            for smaller, own in block_sets(structure, rest, left):
                if len(smaller) > 1:
                    status = Solvable.NONE  # no loop is declared
                else:
                    (e,), (v,) = smaller, own
                    name = model.full_variables[v]
                    status = min(status, model.full_equations[e].solvable.get(name, Solvable.NONE))
        assert (found.status[k], found.integral[k], found.derivative[k]) == (
            status,
            integral,
            derivative,
        )
        steps = s.sequence(names, check)
        assert all((step.kind is Kind.SINGULAR) or len(step.equations) == len(step.variables) for step in steps)
        computed = set()
        for step in steps:  # each step needs only what is there: computed before, states, its own variables
            if step.kind is Kind.SOLVE:
                needed = {v for e in step.equations for v in model.full_equations[index[e]].variables}
                known = computed | set(step.variables)
                known |= {v for other in steps if other.kind is Kind.INTEGRATE for v in other.variables}
                assert needed <= known
            computed |= set(step.variables)


def test_a_singular_differential_loop():
    """Both states of e3 are integrated, and then nothing is left that determines their rates' cause: higher index."""
    model = Model(
        "pendulum-like",
        (
            Equation("e1", ("der(x)", "a"), solvable={"der(x)": Solvable.UNIQUE, "a": Solvable.UNIQUE}),
            Equation("e2", ("der(y)", "a", "b"), solvable={"der(y)": Solvable.UNIQUE, "a": Solvable.UNIQUE}),
            Equation("e3", ("x", "y"), solvable={"x": Solvable.UNIQUE, "y": Solvable.UNIQUE}),
            Equation("e4", ("b", "x"), solvable={"b": Solvable.UNIQUE}),
            Equation("e5", ("b",), ("z",), solvable={"b": Solvable.UNIQUE}),
        ),
        ("x", "y", "a", "b"),
        ("z",),
    )  # fmt: skip
    everything = frozenset(e.name for e in model.equations)
    steps = Structure(model).sequence(everything, "e4")
    singular = [s for s in steps if s.kind is Kind.SINGULAR]
    assert len(singular) == 1
    assert {"e1", "e2", "e3"} <= set(singular[0].equations)
    msos = find_msos(counted(model))
    found = classify(model, msos)
    e4 = found.equation == 3
    assert e4.sum() == 1
    assert found.status[e4][0] == Solvable.NONE


@pytest.mark.costly
def test_the_limit_says_what_to_do():
    model = random_model(1, 20, 5)
    count = len(find_msos(counted(model)))
    seen = []
    with pytest.raises(TooManySetsError, match=r"more than 50 MSO sets .*raise the limit") as error:
        find_msos(counted(model), limit=50, progress=lambda n, share: seen.append((n, share)))
    assert error.value.redundancy == 5
    assert seen[-1][0] == 51
    assert 0 <= seen[-1][1] < 1
    assert len(find_msos(counted(model), limit=count)) == count


@settings(max_examples=examples(60), deadline=None)
@given(st.lists(st.lists(st.booleans(), min_size=4, max_size=4), min_size=1, max_size=7).map(np.array))
def test_fewest_tests_are_those_of_brute_force(signature):
    chosen = fewest_tests(signature)
    names = [f"f{k}" for k in range(4)]
    best = isolability_of_tests(names, signature)

    def as_good(rows):
        mine = isolability_of_tests(names, signature[list(rows)])
        return (mine.detectable == best.detectable).all() and (mine.confused == best.confused).all()

    assert as_good(chosen)
    for rows in combinations(range(len(signature)), max(len(chosen) - 1, 0)):
        assert not as_good(rows) or len(chosen) == 0


def test_no_fault_hangs_on_a_test_that_sees_it_far_worse_than_another_one():
    """The first test alone would tell f0 and f1 apart; it sees f0 only while it changes, the second for good."""
    signature = np.array([[True, False], [True, False], [True, True]])
    quality = np.array([[0.0, np.inf], [4.0, np.inf], [5.0, 5.0]])
    assert list(fewest_tests(signature, np.array([1.0, 9.0, 1.0]))) == [0, 2]
    assert list(fewest_tests(signature, np.array([1.0, 9.0, 1.0]), quality=quality)) == [1, 2]
    assert list(fewest_tests(signature[[0, 2]], quality=quality[[0, 2]])) == [0, 1], "else it counts"


@settings(max_examples=examples(60), deadline=None)
@given(st.lists(st.lists(st.booleans(), min_size=4, max_size=4), min_size=1, max_size=7).map(np.array))
def test_tests_for_pairs_tell_each_fault_from_one_and_from_two_others(signature):
    chosen = signature[fewest_tests(signature, together=2)]

    def told(rows, fault, *others):
        return (rows[:, fault] & ~rows[:, others].any(1)).any()

    for fault, one, other in product(range(4), repeat=3):
        if fault not in (one, other):
            assert told(chosen, fault, one, other) == told(signature, fault, one, other)


@settings(max_examples=examples(60), deadline=None)
@given(st.lists(st.frozensets(st.integers(0, 6), min_size=1, max_size=3), max_size=4))
def test_minimal_sets_are_those_of_brute_force(ways):
    """Enough is what contains one of ``ways``."""
    found = minimal_sets(range(7), lambda s: any(way <= s for way in ways))
    expected = {way for way in ways if not any(other < way for other in ways)}
    assert set(found) == expected
    assert [len(s) for s in found] == sorted(len(s) for s in found)


@pytest.mark.parametrize("seed", range(6))
def test_sensor_places_are_those_of_brute_force(seed):
    model = random_model(seed, 5, 1, faults=2, each=2)
    found = place_sensors(model)
    best = isolability_of_model(model.with_sensors(model.unknowns))
    enough = set()
    for size in range(len(model.unknowns) + 1):
        for places in combinations(model.unknowns, size):
            if any(set(known) <= set(places) for known in enough):
                continue
            mine = isolability_of_model(model.with_sensors(places))
            if (mine.detectable == best.detectable).all() and (mine.confused == best.confused).all():
                enough.add(tuple(sorted(places)))
    assert set(found) == enough


def test_states_must_have_one_meaning():
    twice = (Equation("e1", ("der(x)", "y")), Equation("e2", ("der(x)",), ("u",)))
    with pytest.raises(ValueError, match=r"der\(x\) stands in e1, e2.*differential"):
        Model("m", twice, ("x", "y"), ("u",))
    explicit = Model("m", (*twice, differential("x", "e3")), ("x", "y"), ("u",))
    assert explicit.variables == ("x", "y", "der(x)")
    with pytest.raises(ValueError, match="stands in e1, e2"):
        explicit.lumped()

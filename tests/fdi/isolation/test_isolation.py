"""The isolation's table and state machine against sets of Python and a reading of docs/isolation.md."""

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gateway_fdi.isolation import fault_size, machine, table
from gateway_fdi.jit import zeros
from gateway_fdi.masks import pack, unpack
from tests.support.amount import examples

S = 1_000_000_000
#: Tests beyond one word of a mask.
TESTS = 70
LENGTHS = {"tests": TESTS, "faults": 6, "groups": 8, "words": 2}
NOT_ISOLATED = 5


class Const(machine.Const, lengths=LENGTHS):
    """Of this file's tables."""


class State(machine.State, lengths=LENGTHS):
    """Likewise."""


#: f0 to f4; f2 and f3 are not told apart, f4 fires a part of what f0 does.
MAY = ({0, 1, 65}, {1, 2}, {2, 3}, {2, 3}, {0})
GROUPS = ((0,), (1,), (2, 3), (4,), (0, 4))


def rig(*, must=None, sure=None, may=MAY, groups=GROUPS, confirm_s=1, hold_s=2, pending_s=5):
    s, c = zeros(1, State)[0], zeros(1, Const)[0]
    table.prepare(c, may, groups, tests=TESTS, size=TESTS, must=must, sure=sure)
    machine.prepare(s, c, confirm_ns=confirm_s * S, hold_ns=hold_s * S, pending_ns=pending_s * S)
    return s, c


def step(s, c, up, seconds=1, use=None, level=None):
    """Let some seconds pass, each a sample in which tests are up; what is told after each."""
    told = []
    for _ in range(seconds):
        s.up[:] = pack([up], TESTS)[0]
        machine.stand(s, c, S, S if use is None else use * S)
        shown = np.zeros(TESTS) if level is None else level
        machine.decide(s, c, shown, table.answer(s, c), machine.contradicted(s))
        told.append(int(s.found))
    return told


def members(mask):
    return set(unpack(np.array(mask)[None, :], TESTS)[0].nonzero()[0].tolist())


sets = st.sets(st.integers(0, TESTS - 1), max_size=5)


@settings(max_examples=examples(30), deadline=None)
@given(st.lists(sets, min_size=1, max_size=6), sets, st.data())
def test_the_table_says_what_sets_say(may, fired, data):
    must = [data.draw(st.sets(st.sampled_from(sorted(row)), max_size=2)) if row else set() for row in may]
    groups = data.draw(
        st.lists(st.sets(st.integers(0, len(may) - 1), min_size=1), max_size=8, unique_by=frozenset).map(list)
    )
    s, c = rig(may=may, must=must, groups=groups)
    s.fired[:] = pack([fired], TESTS)[0]
    said = table.answer(s, c)
    explain = {k for k, row in enumerate(may) if fired and fired <= row}
    assert members(s.explained) == explain
    alone = {k for k in explain if must[k] <= fired}
    expected = [k for k, group in enumerate(groups) if group == alone]
    assert said == (expected[0] if expected else table.OPEN if fired else table.NOTHING)


def test_a_test_that_may_not_see_a_fault_is_no_evidence_against_it_when_the_wait_is_over():
    """f0 needs tests 0 and 1, f1 needs 1 and 2; f1 shows in 2 only now and then, f0 in 0 always."""
    may = ({0, 1}, {1, 2})
    s, c = rig(may=may, must=may, sure=({0, 1}, {1}), groups=((0,), (1,)))
    assert step(s, c, {1}, 6) == [table.NOTHING] * 5 + [1]
    assert step(s, c, {1, 2}, 2) == [1, 1]
    for up, told in (({2}, 2), ({0}, 2), ({0, 1}, 0)):
        s, c = rig(may=may, must=may, sure=({0, 1}, {1}), groups=((0,), (1,)))
        assert step(s, c, up, 6)[-1] == told
    s, c = rig(may=may, must=may, sure=({0, 1}, {1}), groups=((0,), (1,)))
    c.near, c.latest_ns = 0.5, 5 * S
    level = np.zeros(TESTS)
    level[0] = 0.6  # f0's own test is on its way: nobody is named
    assert step(s, c, {1}, 6, level=level)[-1] == 2


def test_faults_are_ranked_by_how_near_their_tests_are():
    s, c = rig()
    s.fired[:] = pack([{2}], TESTS)[0]
    table.explain(s, c)
    level = np.zeros(TESTS)
    level[1], level[2], level[3] = 0.9, 3.0, 0.2
    assert table.support(c, 1, level) == pytest.approx(0.95)
    assert table.ranked(s, c, level, 10.0, 6) == 234
    level[1], level[3] = 0.1, 0.8
    assert table.ranked(s, c, level, 100.0, 2) == 304
    assert members(s.explained) == {1, 2, 3}, "ranking leaves what explains as it is"


def test_a_name_waits_for_its_confirmation_and_stands_until_the_last_test_has_left():
    s, c = rig()
    assert step(s, c, {0, 1}, 3) == [-1, 0, 0]
    assert step(s, c, {1}, 3) == [0, 0, 0]  # the first test has left: no more is said than before
    assert step(s, c, (), 3) == [0, -1, -1]


def test_one_fault_is_told_once():
    """Its tests fire one after the other: the first ones alone fit nothing that can be told."""
    s, c = rig(groups=((0,), (1,), (2, 3)))  # {0} is f0 or f4, which are no group here
    assert step(s, c, {0}, 4) == [-1] * 4
    assert step(s, c, {0, 65}, 2) == [-1, 0]


def test_what_has_no_name_is_told_once_no_name_can_be_expected():
    s, c = rig()
    assert step(s, c, {0, 3}, 8) == [-1] * 5 + [NOT_ISOLATED] * 3
    assert step(s, c, (), 4) == [NOT_ISOLATED, -1, -1, -1]


def test_a_group_is_told_as_one():
    s, c = rig()
    assert step(s, c, {2, 3}, 2) == [-1, 2]
    s, c = rig()
    assert step(s, c, {0}, 2) == [-1, 4]


def test_a_test_that_was_up_for_a_moment_names_nobody():
    s, c = rig()
    assert step(s, c, {65}) == [-1]
    assert step(s, c, (), 5) == [-1] * 5
    assert not members(s.fired)


def test_a_name_that_a_test_contradicts_stands_while_another_is_awaited():
    s, c = rig()
    step(s, c, {1, 2}, 2)
    assert s.found == 1
    assert step(s, c, {1, 2, 65}, 7) == [1] * 5 + [NOT_ISOLATED] * 2
    s, c = rig()
    c.withdraw_ns = 0
    step(s, c, {1, 2}, 2)
    assert step(s, c, {1, 2, 65}, 7) == [-1] * 5 + [NOT_ISOLATED] * 2


def test_a_further_test_of_the_same_fault_changes_nothing():
    s, c = rig()
    step(s, c, {0, 1}, 2)
    assert step(s, c, {0, 1, 65}, 9) == [0] * 9
    assert members(s.basis) == {0, 1, 65}


def test_a_better_name_takes_the_place_of_one_that_is_contradicted():
    s, c = rig()
    step(s, c, {0}, 2)
    assert s.found == 4
    assert step(s, c, {0, 65}, 2) == [4, 0]


def test_with_all_its_tests_required_a_fault_is_named_by_them_alone():
    s, c = rig(must=MAY, groups=[(k,) for k in range(5)], pending_s=100)
    assert step(s, c, {0}, 2) == [-1, 3 + 1]
    assert step(s, c, {0, 1}, 2) == [4, 4]  # contradicted, and f0 is not complete
    assert step(s, c, {0, 1, 65}, 2) == [4, 0]


def test_a_test_on_its_way_is_waited_for_but_not_for_ever():
    s, c = rig(pending_s=3)
    c.near, c.latest_ns = 0.5, 10 * S
    level = np.zeros(TESTS)
    level[65] = 0.7
    assert step(s, c, {0, 1}, 12, level=level) == [-1] * 10 + [NOT_ISOLATED] * 2
    level[65] = 0.4
    assert step(s, c, {0, 1}, 1, level=level) == [0]
    s, c = rig(pending_s=3)
    c.near, c.latest_ns = 0.5, 10 * S
    level[40] = 0.7  # no fault that explains has it: nothing is awaited
    assert step(s, c, {0, 1}, 5, level=level) == [-1] * 3 + [NOT_ISOLATED] * 2


def test_what_no_fault_explains_need_not_wait():
    s, c = rig()
    c.hopeless_ns = 0
    assert step(s, c, {0, 3}) == [NOT_ISOLATED]


def test_time_without_use_does_not_count_but_for_the_latest():
    s, c = rig(pending_s=3)
    c.latest_ns, c.near = 20 * S, 0.5
    assert step(s, c, {0, 1}, 15, use=0) == [-1] * 15
    assert step(s, c, {0, 1}, 1) == [0]
    assert step(s, c, (), 30, use=0) == [0] * 30
    assert step(s, c, (), 2) == [0, -1]
    s, c = rig(groups=((1,),), pending_s=3)
    c.latest_ns = 20 * S
    assert step(s, c, {0}, 22, use=0) == [-1] * 20 + [c.groups] * 2


def test_tests_that_leave_together_stay_while_one_of_them_is_up():
    s, c = rig()
    c.together, c.heal_ns = 1, 4 * S
    step(s, c, {0, 1}, 2)
    step(s, c, {1}, 20)
    assert members(s.fired) == {0, 1}
    assert step(s, c, (), 5) == [0, 0, 0, -1, -1]  # a name heals after a longer time
    step(s, c, {40}, 1)
    step(s, c, (), 2)
    assert not members(s.fired)


@settings(max_examples=examples(20), deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_nothing_is_ever_named_that_does_not_explain_what_has_fired(seed):
    """And what is named was confirmed: no test had joined for so long."""
    rng = np.random.default_rng(seed)
    s, c = rig(pending_s=int(rng.integers(1, 6)), hold_s=int(rng.integers(0, 4)))
    may = [set(row) for row in MAY]
    some = [set(pair) for pair in combinations((0, 1, 2, 3, 65), 2)]
    before, calm, fired, basis = -1, 0, set(), set()
    for _ in range(60):
        up = some[rng.integers(len(some))] if rng.random() < 0.5 else set()
        (found,) = step(s, c, up)
        now = members(s.fired)
        calm = 0 if now - fired else calm + 1
        fired = now
        if found not in (before, -1, NOT_ISOLATED):
            basis = now
            assert calm >= 1
            assert up
            assert all(now <= may[k] for k in GROUPS[found])
            assert all(k in GROUPS[found] for k, row in enumerate(may) if now <= row), "and no other fault fits too"
        elif found != before and before not in (-1, NOT_ISOLATED):
            assert not now or not now <= basis, "a name stands as long as nothing contradicts it"
        if members(s.basis) != basis:
            assert found == before, "a further test of the same fault"
            basis = members(s.basis)
        before = found


def test_a_suspect_is_confirmed_doubted_or_gone():
    s = zeros(1, fault_size.State)[0]
    assert [fault_size.follow(s, False, False, 3, 2) for _ in range(4)] == [fault_size.STANDS] * 3 + [
        fault_size.DOUBTED
    ]
    fault_size.begin(s)
    assert fault_size.follow(s, True, False, 3, 2) == fault_size.STANDS
    assert [fault_size.follow(s, False, False, 3, 2) for _ in range(9)] == [fault_size.STANDS] * 9, "confirmed stays"
    assert [fault_size.follow(s, False, small, 3, 2) for small in (True, False, True, True)] == [
        *[fault_size.STANDS] * 3,
        fault_size.GONE,
    ]

"""What holds of every diagnosis, whatever the tests say."""

import math

import numpy as np
import pytest
from amount import amount
from random_systems import a_system, ran, some_updates

from gateway_fdi.diagnosis.diagnoser import Diagnoser
from gateway_fdi.diagnosis.search import Bounds
from gateway_fdi.diagnosis.state import FAILED, NOT_TESTED, PASSED, Sized
from gateway_fdi.diagnosis.system import Component, Link, Test
from gateway_fdi.errors import InputError

SEED = 4713


def cases(seed, whole, part):
    print("seed", seed)
    rng = np.random.default_rng(seed)
    for case in range(amount(whole, part, 30)):
        components, tests = a_system(rng, most=40)
        yield case, rng, components, tests, some_updates(rng, components, tests)


def test_a_diagnosis_hits_all_conflicts_and_a_component_that_none_needs_makes_it_likelier():
    for case, _, components, tests, updates in cases(SEED, 3000, 150):
        sees = [{int(link.component[1:]) for link in t.links} for t in tests]
        sized = {int(link.component[1:]) for t in tests for link in t.links if math.isfinite(link.gain)}
        for group in ran(components, tests, updates).diagnose():
            told = [one.probability for one in group.diagnoses]
            every = {frozenset(one.components): one.probability for one in group.diagnoses}
            assert sum(told) + group.rest == pytest.approx(1.0), case
            assert told == sorted(told, reverse=True)
            for one in group.diagnoses:
                chosen = set(one.components)
                alarms = {a.test for a in one.against if a.why == "false alarm"}
                for t in group.failed:
                    assert bool(sees[t] & chosen) == (t in one.explains) != (t in alarms), case
                idle = [c for c in chosen if all(sees[t] & chosen != {c} for t in group.failed)]
                less = [every.get(frozenset(chosen - {c}), 0.0) for c in idle]
                # with it, all is likelier than without, or sizes ask for it
                assert not idle or min(less) < one.probability or chosen & sized, case


def test_ways_in_which_one_component_fails_are_told_as_one():
    ways = [Component("m", "message"), Component("frozen", prior=3e-4, of="m"), Component("s", "signal")]
    tests = [Test("t", (Link("m", 0.01), Link("frozen", 0.3), Link("s", 0.3)))]
    told = dict(ran(ways, tests, [("t", FAILED, 0)]).causes())
    assert told[("s",)] / told[("m",)] == pytest.approx(1e-3 * 0.3 / (3e-4 * 0.31), rel=0.01)
    assert sum(told.values()) == pytest.approx(1.0)


def test_the_order_of_updates_of_different_tests_does_not_matter():
    for case, rng, components, tests, updates in cases(SEED + 1, 2000, 100):
        once = ran(components, tests, updates).diagnose()
        mixed = Diagnoser(components, tests)
        own = {t.name: [u for u in updates if u[0] == t.name] for t in tests}
        while any(own.values()):
            name = str(rng.choice([n for n, left in own.items() if left]))
            mixed.update(*own[name].pop(0))
            if rng.random() < 0.5:
                mixed.diagnose()
        assert mixed.diagnose() == once, case


def test_groups_share_no_component():
    for case, _, components, tests, updates in cases(SEED + 2, 1000, 60):
        seen = set()
        for group in ran(components, tests, updates).diagnose():
            mine = {link.component for t in group.failed for link in tests[t].links}
            assert not mine & seen, case
            seen |= mine


# What counts, one by one ---------------------------------------------------------------------------------------------


def a_diagnoser(*tests, **priors):
    names = sorted({link.component for t in tests for link in t.links})
    return Diagnoser([Component(n, prior=priors.get(n, 1e-3)) for n in names], tests)


def probabilities(diagnoser):
    names = [c.name for c in diagnoser.system.components]
    (group,) = diagnoser.diagnose()
    return {" ".join(names[c] for c in one.components): one.probability for one in group.diagnoses}


def seconds(value):
    return round(value * 1e9)


def test_a_pass_clears_as_much_as_it_would_have_seen():
    fails = Test("fails", (Link("a", 0.99), Link("b", 0.99)))
    for power in (0.01, 0.5, 0.99):
        diagnoser = a_diagnoser(fails, Test("passes", (Link("b", power),)))
        diagnoser.update("fails", FAILED, 0)
        diagnoser.update("passes", PASSED, 0)
        told = probabilities(diagnoser)
        assert told["b"] / told["a"] == pytest.approx(1.0 - power)


def test_what_a_message_alone_explains_is_wrong_with_its_signal_wherever_that_is_seen():
    """Of four wheels one does not fit the speed: the message with the speed would be wrong for all four."""
    wheels = [
        Test(f"wheel{k}", (Link(f"wheel {k}", 0.9), Link("speed", 0.9), Link("second", 0.3, via="speed")))
        for k in range(4)
    ]
    diagnoser = a_diagnoser(*wheels, Test("range", (Link("coolant", 0.9), Link("second", 0.3, via="coolant"))))
    for k in range(4):
        diagnoser.update(f"wheel{k}", PASSED, 0)
    diagnoser.update("wheel2", FAILED, seconds(1))
    diagnoser.update("range", FAILED, seconds(1))
    for k in (0, 1, 3):
        diagnoser.update(f"wheel{k}", PASSED, seconds(3))
    found = probabilities(diagnoser)
    assert max(found, key=found.get) == "coolant wheel 2"
    assert found["second"] < 0.1, "0.97 by its own powers"


def test_a_pass_before_the_fault_could_show_clears_nothing_and_is_waited_for():
    diagnoser = a_diagnoser(
        Test("fails", (Link("a", 0.99), Link("b", 0.99))), Test("slow", (Link("b", 0.99),), delay_s=10.0)
    )
    diagnoser.update("slow", PASSED, 0)
    diagnoser.update("fails", FAILED, seconds(5))
    diagnoser.update("slow", PASSED, seconds(14.9))
    told = probabilities(diagnoser)
    assert told["a"] == pytest.approx(told["b"])
    (group,) = diagnoser.diagnose()
    assert [(w.test, w.until_ns) for w in group.waiting] == [(1, seconds(15))]
    assert group.cause is None
    diagnoser.update("slow", PASSED, seconds(15))
    (group,) = diagnoser.diagnose()
    assert group.cause is None  # one false alarm in 10^4 is a tenth of one fault in 10^3
    assert not group.waiting
    assert probabilities(diagnoser)["b"] < 0.01


def test_while_symptoms_heal_one_after_the_other_nobody_else_is_the_cause():
    """Two messages of an ECU come again, the slow one later: until then it is not the slow message's own fault."""
    tests = (
        Test("fast", (Link("ecu", 0.95), Link("m0", 0.6)), 1e-8, 0.1),
        Test("slow", (Link("ecu", 0.95), Link("m1", 0.6)), 1e-8, 2.0),
    )
    diagnoser = a_diagnoser(*tests)
    diagnoser.update("fast", FAILED, 0)
    diagnoser.update("slow", FAILED, seconds(1))
    names = [c.name for c in diagnoser.system.components]
    (group,) = diagnoser.diagnose()
    assert [names[c] for c in group.cause.components] == ["ecu"]
    diagnoser.update("fast", PASSED, seconds(10))
    (group,) = diagnoser.diagnose()
    assert group.cause is None
    assert [(wait.test, wait.until_ns) for wait in group.waiting] == [(1, seconds(12))]
    diagnoser.update("fast", PASSED, seconds(12))
    (group,) = diagnoser.diagnose()
    assert [names[c] for c in group.cause.components] == ["m1"]


def test_a_false_alarm_is_a_diagnosis():
    diagnoser = a_diagnoser(Test("nervous", (Link("a", 0.9),), false_alarm=0.1))
    diagnoser.update("nervous", FAILED, 0)
    told = probabilities(diagnoser)
    assert told[""] > 0.98
    (group,) = diagnoser.diagnose()
    assert group.cause is None


def test_two_where_one_cannot_explain_all():
    one = Test("one", (Link("a", 0.99),), 1e-6)
    other = Test("other", (Link("b", 0.99),), 1e-6)
    both = Test("both", (Link("a", 0.9), Link("b", 0.9), Link("c", 0.9)), 1e-6)
    diagnoser = a_diagnoser(one, other, both)
    for name in ("one", "other", "both"):
        diagnoser.update(name, FAILED, 0)
    (group,) = diagnoser.diagnose()
    assert group.cause is not None
    assert group.cause.components == (0, 1)
    assert group.cause.explains == (0, 1, 2)


def test_one_size_has_to_fit_all():
    """Two residuals that the speed moves alike, and one that it moves the other way: SPEED, not the three others."""
    tests = [
        Test(f"rule {k}", (Link("speed", 0.9, gain), Link(f"s{k}", 0.9, 1.0)), 1e-5, noise=1.0)
        for k, gain in enumerate((1.0, 1.0, -1.0))
    ]
    for residuals, wrong in (((40.0, 41.0, -39.0), False), ((40.0, -41.0, -39.0), True), ((40.0, 9.0, -39.0), True)):
        diagnoser = a_diagnoser(*tests)
        for k, residual in enumerate(residuals):
            diagnoser.update(f"rule {k}", FAILED, 0, residual)
        (group,) = diagnoser.diagnose()
        speed = next(one for one in group.diagnoses if one.components == (3,))
        assert (any(a.why == "size" for a in speed.against)) is wrong
        assert (group.cause == speed) is not wrong


@pytest.mark.parametrize("cancels", [True, False])
def test_two_errors_that_cancel_each_other_are_found(cancels):
    """The rule of a wheel that is off as the speed is holds: no failed test needs the wheel, but sizes do."""
    tests = [Test(f"rule {k}", (Link("speed", 0.3, -1.0), Link(f"s{k}", 0.3, 1.0)), 1e-6, noise=1.0) for k in range(4)]
    diagnoser = a_diagnoser(*tests)
    for k in range(3):
        diagnoser.update(f"rule {k}", FAILED, 0, -40.0)
    diagnoser.update("rule 3", PASSED, 0, 0.3 if cancels else math.nan)
    (group,) = diagnoser.diagnose()
    names = [c.name for c in diagnoser.system.components]
    assert [names[c] for c in group.cause.components] == (["s3", "speed"] if cancels else ["speed"])
    if cancels:
        diagnoser.update("rule 3", PASSED, 1, -40.0)
        (group,) = diagnoser.diagnose()
        assert [names[c] for c in group.cause.components] == ["speed"]


def test_a_test_that_passes_has_to_fit_the_size_too():
    sized = [Test(f"t{k}", (Link("a", 0.9, 1.0), Link("b", 0.9, 1.0)), 1e-5, noise=1.0) for k in range(2)]
    diagnoser = a_diagnoser(*sized, Test("small", (Link("a", 0.9, 0.01), Link("c", 0.9, 1.0)), noise=1.0))
    diagnoser.update("t0", FAILED, 0, 30.0)
    diagnoser.update("t1", FAILED, 0, 30.0)
    diagnoser.update("small", PASSED, 0, 0.4)  # of size 30 it would have seen 0.3: nothing
    told = probabilities(diagnoser)
    assert told["a"] == pytest.approx(told["b"], rel=0.3)


def test_a_cause_does_not_begin_after_its_symptoms():
    """The sensor's own test would have failed at once; it failed long behind the rule that the sensor is in."""
    tests = (
        Test("rule", (Link("sensor", 0.99), Link("other", 0.99)), 1e-6),
        Test("own", (Link("sensor", 0.99), Link("wire", 0.99)), 1e-6, delay_s=1.0),
    )
    for t, likely in ((1.5, "sensor"), (30.0, "other wire")):
        diagnoser = a_diagnoser(*tests, sensor=1e-4, other=1e-2, wire=1e-3)
        diagnoser.update("own", PASSED, 0)
        diagnoser.update("rule", FAILED, seconds(1))
        diagnoser.update("own", FAILED, seconds(t))
        told = probabilities(diagnoser)
        assert max(told, key=told.get) == likely
        (group,) = diagnoser.diagnose()
        sensor = next(one for one in group.diagnoses if one.components == (diagnoser.system.place["sensor"],))
        assert ("late" in {one.why for one in sensor.against}) is (t > 2)


def test_a_test_that_was_not_tested_before_is_not_late():
    tests = (
        Test("rule", (Link("sensor", 0.99), Link("other", 0.99)), 1e-6),
        Test("own", (Link("sensor", 0.99),), 1e-6, delay_s=1.0),
    )
    diagnoser = a_diagnoser(*tests)
    diagnoser.update("rule", FAILED, seconds(1))
    diagnoser.update("own", FAILED, seconds(30))
    (group,) = diagnoser.diagnose()
    assert group.cause is not None
    assert group.cause.components == (1,)
    assert not group.cause.against


# Work ----------------------------------------------------------------------------------------------------------------


def test_without_a_change_there_is_no_work_and_a_change_touches_its_group_only():
    tests = [Test(f"t{k}", (Link(f"c{k // 2}", 0.9),)) for k in range(8)]
    diagnoser = a_diagnoser(*tests)
    for k in range(0, 8, 2):
        diagnoser.update(f"t{k}", FAILED, 0)
    first = diagnoser.diagnose()
    assert (len(first), diagnoser.solved) == (4, 4)
    assert not diagnoser.update("t0", FAILED, 5)
    assert diagnoser.diagnose() is first
    assert diagnoser.solved == 4
    diagnoser.update("t3", PASSED, 1)
    diagnoser.diagnose()
    assert diagnoser.solved == 5
    diagnoser.update("t2", NOT_TESTED, 2)
    assert len(diagnoser.diagnose()) == 3
    assert diagnoser.solved == 5


def test_a_search_that_is_cut_off_has_a_diagnosis_and_is_not_certain():
    rng = np.random.default_rng(SEED + 3)
    links = [tuple(Link(f"c{c}", 0.5) for c in rng.choice(60, 8, replace=False)) for _ in range(40)]
    diagnoser = Diagnoser(
        [Component(f"c{k}", prior=0.01) for k in range(60)],
        [Test(f"t{k}", each, 1e-9) for k, each in enumerate(links)],
        Bounds(steps=50),
    )
    for k in range(40):
        diagnoser.update(f"t{k}", FAILED, 0)
    (group,) = diagnoser.diagnose()
    chosen = set(group.diagnoses[0].components)
    assert all(chosen & {int(link.component[1:]) for link in each} for each in links)
    assert group.cause is None


@pytest.mark.parametrize(
    ("components", "tests", "text"),
    [
        (["a", "a"], [], "two components are called a"),
        (["a"], [Test("t", ()), Test("t", ())], "two tests are called t"),
        (["a"], [Test("t", (Link("b", 0.5),))], "there is no component 'b'"),
        (["a"], [Test("t", (Link("a", 1.0),))], "power for a = 1.0: above 0, below 1"),
        (["a"], [Test("t", (Link("a", 0.5), Link("a", 0.5)))], "linked twice"),
        (["a"], [Test("t", (), false_alarm=0.0)], "false_alarm = 0.0"),
        (["a"], [Test("t", (), delay_s=math.nan)], "delay_s = nan"),
        (["a"], [Test("t", (), noise=0.0)], "noise above 0"),
    ],
)
def test_what_is_wrong_is_named(components, tests, text):
    with pytest.raises(InputError, match=text):
        Diagnoser([Component(name) for name in components], tests)


def test_a_prior_is_a_probability():
    with pytest.raises(InputError, match=r"component a: prior = 0.6: above 0, at most 0.5"):
        Diagnoser([Component("a", prior=0.6)], [])


def test_gains_may_move_with_the_operating_point():
    """Power is voltage times current: which of the two is wrong is told by a sensor of the current."""
    tests = [
        Test("power", (Link("u", 0.9), Link("i", 0.9)), 1e-5),
        Test("second", (Link("i", 0.9), Link("j", 0.9)), 1e-5),
    ]
    for other, wanted in ((0.0, "u"), (2.0, "i")):
        diagnoser = a_diagnoser(*tests)
        diagnoser.update("power", FAILED, 0)
        diagnoser.update("second", FAILED if other else PASSED, seconds(1))
        diagnoser.size("power", Sized(24.0, 1.0, {"u": 2.0, "i": 12.0}))
        diagnoser.size("second", Sized(other, 0.1, {"i": 1.0, "j": -1.0}))
        told = probabilities(diagnoser)
        assert max(told, key=told.get) == wanted
        assert told[wanted] > 0.9
        diagnoser.size("second", None)
        assert probabilities(diagnoser) != told


def test_a_model_is_seldom_far_off():
    """Just beyond its limit a relation may be wrong itself; at ten times the limit it is hardly that."""
    diagnoser = Diagnoser(
        [Component("s", prior=1e-3), Component("m", "model", prior=1e-3)],
        [Test("t", (Link("s", 0.3), Link("m", 0.9)), 1e-6)],
    )
    diagnoser.update("t", FAILED, 0)
    near = probabilities(diagnoser)
    assert near["m"] > near["s"]
    diagnoser.size("t", Sized(math.nan, math.nan, {}, 0.0, 10.0))
    far = probabilities(diagnoser)
    assert far["m"] / far["s"] == pytest.approx(near["m"] / near["s"] / 100.0, rel=1e-3)

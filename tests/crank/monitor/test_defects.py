"""Teeth broken off and pulses too many in each turn, from the start on: named, and proven where the wheel fits once."""

import numpy as np
import pytest

from gateway_fdi.jit import COMPILED, zeros
from gateway_plants.crank.ecu.kinematics import tooth_times
from gateway_plants.crank.monitor import competing_hypothesis, defects, sync_state
from gateway_plants.crank.monitor.faults import FAULTS
from gateway_plants.crank.monitor.monitor import Params
from gateway_plants.crank.study.follow import follower
from gateway_plants.crank.wheel import Wheel

compiled = pytest.mark.skipif(not COMPILED, reason="statistics need the compiled kernels")


def engine(text, rpm, turns, seed):
    """Pulse times [us] of a healthy engine, and the tooth of each."""
    wheel = Wheel.parse(text)
    rng = np.random.default_rng(seed)
    ripple = [(2.0, min(0.05, 40 / rpm), rng.uniform(0, 6))]
    times = tooth_times(wheel, [(0, rpm)], turns * 60 / rpm, ripple=ripple, jitter=0.01, tooth_error=0.003, rng=rng)
    return times / 1e3, np.arange(len(times)) % wheel.pulses


def with_extra(times, teeth, at, shares):
    """Put a pulse behind each of some teeth, at a share of the interval, in each turn."""
    extra = [times[:-1][teeth[:-1] == k] + s * np.diff(times)[teeth[:-1] == k] for k, s in zip(at, shares, strict=True)]
    both = np.concatenate([times, *[np.rint(k) for k in extra]])
    order = np.argsort(both, kind="stable")
    return both[order], np.concatenate([teeth, np.full(len(both) - len(times), -1)])[order]


def told(result):
    """Names of the faults, and the teeth that were told with missed or added pulses.

    Left out is the wheel's fault that the tooth of a missed pulse has when it stays away.
    """
    names = np.array([FAULTS[k].name for k in result.fault], object)
    missed = set(result.tooth[names == "missed_pulse"].tolist())
    assert broken_teeth(result) <= missed
    return set(names) - {"damaged_tooth"}, missed | set(result.tooth[names == "added_pulse"].tolist())


def broken_teeth(result):
    """Teeth that were told as the wheel's own fault."""
    names = [FAULTS[k].name for k in result.fault]
    return {int(k) for k, name in zip(result.count, names, strict=True) if name == "damaged_tooth"}


@pytest.mark.parametrize("text", ["12-1", "24-1", "36-1"])
def test_a_tooth_broken_off_before_the_start_is_told_at_both_places(text):
    """Two equal gaps: half of these runs proved the wrong one. Three teeth, two speeds."""
    wheel = Wheel.parse(text)
    for broken in (wheel.pulses // 4, wheel.pulses // 2, wheel.pulses - 4):
        for rpm in (900.0, 4000.0):
            times, teeth = engine(text, rpm, 16, [5, broken])
            found = follower("adaptive", wheel)(times[teeth != broken])
            assert not found.proven.any(), (broken, rpm)
            if text != "36-1" and broken == wheel.pulses // 2:
                # What is left are the pulses of 12-1 and 6-1 at half the speed: that may be a wrong configuration.
                assert told(found)[0] == {"wrong_wheel"}, rpm
                continue
            assert told(found)[0] == {"two_places"}, (broken, rpm)
            assert broken in (found.count[-1], found.tooth[-1]), (broken, rpm)


@compiled
@pytest.mark.parametrize("text", ["60-2", "36-2", "36-2-1", "36-2-2-2"])
@pytest.mark.parametrize("number", [2, 3])
def test_teeth_broken_off_before_the_start_are_named(text, number):
    """The gap is the only one of its size: the place is proven and each tooth told. It was "gap never comes"."""
    print("seed 51")
    wheel = Wheel.parse(text)
    follow = follower("adaptive", wheel)
    for broken in ((3, 9, 26), (4, 23, 28)):
        times, teeth = engine(text, 1500.0, 24, [51, *broken])
        left = ~np.isin(teeth, broken[:number])
        for begin in (0, 11):
            found = follow(times[left][begin:])
            assert told(found) == ({"missed_pulse"}, set(broken[:number])), (broken, begin)
            assert broken_teeth(found) == set(broken[:number]), (broken, begin)
            assert found.proven[-12 * wheel.pulses :].mean() > 0.8
            assert not (found.proven & (found.teeth != teeth[left][begin + 1 :])).any(), (broken, begin)


@compiled
@pytest.mark.parametrize("text", ["36-1", "24-1", "60-2"])
def test_a_pulse_too_many_beside_a_broken_tooth_is_named(text):
    """A tooth off from turn 25 on, one pulse more in turn 50: it was "synchronisation lost", and no place any more."""
    print("seed 60")
    wheel = Wheel.parse(text)
    times, teeth = engine(text, 1500.0, 80, [60, wheel.pulses])
    left = (teeth != 12) | (np.arange(len(teeth)) < 25 * wheel.pulses)
    times, teeth = times[left], teeth[left]
    for at in (17, 3):
        k = np.flatnonzero(teeth == at)[50]
        found = follower("adaptive", wheel)(np.insert(times, k + 1, times[k] + 0.45 * (times[k + 1] - times[k])))
        assert told(found) == ({"missed_pulse", "added_pulse"}, {12, at}), at
        assert broken_teeth(found) == {12}
        last = slice(-20 * wheel.pulses, None)
        assert found.proven[last].mean() > 0.9
        assert (found.teeth[last] == teeth[last])[found.proven[last]].all()


@compiled
@pytest.mark.parametrize(
    ("text", "broken"), [("36-1", (8, 20)), ("24-1", (4, 10, 19)), ("60-2", (20, 21)), ("36-2", (10, 14, 15))]
)
def test_teeth_broken_off_that_leave_the_gap_twice_are_told_at_two_places(text, broken):
    """Two single gaps more on 36-1; two neighbours on 60-2 leave its own gap once more: one of these proved it."""
    print("seed 52")
    wheel = Wheel.parse(text)
    for begin in (0, 13, 30):
        times, teeth = engine(text, 2000.0, 24, [52, begin])
        found = follower("adaptive", wheel)(times[~np.isin(teeth, broken)][begin:])
        assert not found.proven.any(), begin
        assert told(found)[0] == {"two_places"}, begin


@compiled
@pytest.mark.parametrize("text", ["60-2", "36-1", "36-2-2-2"])
def test_pulses_too_many_at_several_teeth_are_named(text):
    """Three teeth with two pulses each, from the start on: "gap never comes" before."""
    print("seed 53")
    wheel = Wheel.parse(text)
    for at in ((4, 10, 20), (6, 21, 26)):
        times, teeth = with_extra(*engine(text, 1200.0, 24, [53, *at]), at, (0.3, 0.7, 0.4))
        found = follower("adaptive", wheel)(times)
        assert told(found) == ({"added_pulse"}, set(at))
        assert found.proven[-12 * wheel.pulses :].mean() > 0.7
        real = teeth[1:] >= 0
        assert not (found.proven & real & (found.teeth != teeth[1:])).any()


def test_what_comes_again_is_told_from_what_comes_once():
    """Turns of a wheel of 58: the same two, two decided as one, one of the other sign, one that came late."""
    de = zeros(1, defects.Defects)[0]

    def take(*faults):
        defects.clear(de)
        return [defects.take(de, 58, tooth, net, number, False) for tooth, net, number in faults]

    assert take((20, 1, 20), (24, 1, 23), (20, 1, 76), (24, 1, 79)) == [True] * 4
    assert de.turns == 1
    assert defects.missing(de) == 2
    assert defects.knows(de, 24, 1)
    assert not defects.knows(de, 25, 1)
    assert take((20, 1, 20), (24, 1, 23), (20, 2, 79), (20, 1, 133), (24, 1, 136)) == [True] * 5
    assert de.turns == 2
    assert take((20, 1, 20), (24, -1, 25)) == [True, False]
    assert take((20, 1, 20), (20, 1, 134)) == [True, False]
    assert take((20, 1, 20), (24, 1, 23), (24, 1, 80)) == [True, True, False]


def test_lost_pulses_are_counted_with_what_comes_in_each_turn():
    """15 pulses behind tooth 10 in frames that were lost: a tooth missing, or a pulse too many, is among them."""
    de = zeros(1, defects.Defects)[0]
    for net, teeth in ((1, 16), (-1, 14)):
        defects.clear(de)
        for number in (20, 78 - net):
            assert defects.take(de, 58, 20, net, number, False)
        assert defects.passed(de, 58, 10, 15, 100) == teeth
        assert defects.take(de, 58, 20, net, de.pulses[0] + 58 - net, False), "it is expected a turn later"
    defects.clear(de)
    defects.take(de, 58, 20, 1, 20, False)
    assert defects.passed(de, 58, 10, 15, 30) == 15
    assert de.count == 0, "what came once may not come again"


@compiled
@pytest.mark.parametrize("text", ["60-2", "36-1", "36-2-2-2"])
@pytest.mark.parametrize("share", [1 / 3, 1 / 2, 2 / 3])
def test_a_gap_that_is_filled_from_a_later_turn_on_keeps_the_place(text, share):
    """A pulse in the gap of turns 10 to 29: at two thirds that was told as a wrong place, and lost."""
    print("seed 54")
    wheel = Wheel.parse(text)
    times, teeth = filled(text, share, 10, 30)
    found = follower("adaptive", wheel)(times)
    assert told(found) == ({"added_pulse"}, {wheel.pulses - 1})
    real = teeth[1:] >= 0
    assert not (found.proven & real & (found.teeth != teeth[1:])).any()
    assert found.proven[15 * wheel.pulses :].mean() > 0.9


@compiled
@pytest.mark.parametrize("text", ["60-2", "36-2", "36-2-2-2"])
@pytest.mark.parametrize("share", [1 / 3, 1 / 2, 2 / 3])
def test_a_gap_that_is_filled_from_the_start_on_is_told(text, share):
    """At a third of the gap they are those of 60-1 as well: nothing is proven. In its middle they tell the place."""
    print("seed 54")
    wheel = Wheel.parse(text)
    times, teeth = filled(text, share, 0, 20)
    found = follower("adaptive", wheel)(times)
    if text == "36-2" and share != 1 / 2:  # these are the pulses of 36-1, which may be there
        assert told(found)[0] == {"wrong_wheel"}
    else:
        assert told(found) == ({"added_pulse"}, {wheel.pulses - 1})
    assert found.proven[: 20 * (wheel.pulses + 1) - 2].any() == (text == "36-2-2-2" or share == 1 / 2)
    assert found.proven[-10 * wheel.pulses :].mean() > 0.9
    real = teeth[1:] >= 0
    assert not (found.proven & real & (found.teeth != teeth[1:])).any()


@compiled
@pytest.mark.parametrize("text", ["12-1", "8-1", "6-1"])
def test_a_gap_of_few_pulses_that_is_filled_proves_no_wrong_place(text):
    """The turn looks as if its edges jittered, and the index slipped by one each turn: one of seven was proven then."""
    print("seed 58")
    wheel = Wheel.parse(text)
    follow = follower("adaptive", wheel)
    for k, share in enumerate(np.linspace(0.2, 0.85, 14)):
        times, teeth = filled(text, share, 0, 40, [58, k], 700.0 * (k + 1) ** 0.7)
        found = follow(times)
        assert told(found)[1] <= {-1, wheel.pulses - 1}, share
        assert not (found.proven & (teeth[1:] >= 0) & (found.teeth != teeth[1:])).any(), share


def filled(text, share, first, last, seed=(54,), rpm=1800.0):
    """Pulse times [us] of 40 turns, in some of them with a pulse at a share of the gap, and the tooth of each."""
    pulses = Wheel.parse(text).pulses
    times, teeth = engine(text, rpm, 40, [*seed, pulses])
    turn = np.arange(len(times) - 1) // pulses
    at = np.flatnonzero((teeth[:-1] == pulses - 1) & (turn >= first) & (turn < last))
    both = np.concatenate([times, np.rint(times[at] + share * np.diff(times)[at])])
    order = np.argsort(both, kind="stable")
    return both[order], np.concatenate([teeth, np.full(len(at), -1)])[order]


@compiled
@pytest.mark.parametrize("text", ["60-2", "36-2", "6-1"])
@pytest.mark.parametrize("side", [0, -1])
def test_a_tooth_broken_off_beside_the_gap_is_told_on_either_side_of_it(text, side):
    """A gap wider by one: the last tooth before it or the first one behind. It was "gap never comes"."""
    print("seed 55")
    wheel = Wheel.parse(text)
    times, teeth = engine(text, 1500.0, 40, [55, wheel.pulses])
    found = follower("adaptive", wheel)(times[teeth != side % wheel.pulses])
    assert told(found)[0] == {"two_places"}
    assert {found.count[-1], found.tooth[-1]} == {0, wheel.pulses - 1}
    assert not found.proven.any()


@compiled
def test_a_tooth_broken_off_beside_one_of_several_gaps_is_named():
    """The other gap tells which tooth it is: "gap never comes" before. 36-2-1 without tooth 16 has equal halves."""
    print("seed 57")
    for text, side in (("36-2-1", 0), ("36-2-1", 16), ("36-2-2-2", 29)):
        times, teeth = engine(text, 1500.0, 40, [57, side])
        found = follower("adaptive", Wheel.parse(text))(times[teeth != side])
        assert told(found) == ({"missed_pulse"}, {side})
        assert broken_teeth(found) == {side}, "the wheel is its cause"
        assert not found.proven.any(), text


@compiled
@pytest.mark.parametrize("text", ["6-1", "8-1", "12-1", "24-1"])
@pytest.mark.parametrize("off", [-0.4, 0.4])
def test_a_gap_that_is_not_as_long_as_the_wheel_says_is_no_runout(text, off):
    """Its error is in the first order of the pitches as well: "runout" at 3000 rpm before."""
    print("seed 56")
    pitches = Wheel.parse(text).pitches
    real = Wheel("", (*pitches[:-1], pitches[-1] + off))
    times = tooth_times(real, [(0, 3000.0)], 1.5, jitter=0.01, tooth_error=0.003, rng=np.random.default_rng(56)) / 1e3
    assert told(follower("adaptive", Wheel.parse(text))(times)) == (set(), set())


def rival(text, pulses):
    """Defects of a turn with pulses at these places [pitch], the latest one a tooth, and whether there is a rival."""
    p = Params(wheel=text)
    s, c = zeros(1, sync_state.State)[0], zeros(1, sync_state.Const)[0]
    sync_state.prepare(s, c, p.wheel, p.acceleration, p.runout, p.reversal_rpm)
    turns = np.concatenate([np.asarray(pulses) + k * p.wheel.turn for k in (0, 1)])
    size = int(c.anchor.length)
    s.anchor.intervals[:size] = 1000.0 * np.diff(turns[-size - 1 :])
    index = p.wheel.positions.index(pulses[-1])
    cost, missing = competing_hypothesis.seek(s.rival, s.anchor, size, c.wheel, p.wheel.repeats, index, 1000.0, 0.0)
    return (round(cost / competing_hypothesis.DEFECT), missing), s.rival.other != competing_hypothesis.NONE


@pytest.mark.parametrize(
    "text", ["60-2", "36-1", "24-1", "12-1", "36-2-1", "36-2-2-2", "16*1,3,14*1,3", "7*1,3,23*1,3"]
)
def test_a_place_has_a_rival_where_the_teeth_left_fit_another_one(text):
    """Against sets of places, shifted: each tooth broken off but the latest, and each two that are neighbours."""
    wheel = Wheel.parse(text)
    whole, turn = set(wheel.positions), round(wheel.turn)
    for number in (1, 2):
        for k in range(wheel.pulses - 1 - number):
            left = [p for n, p in enumerate(wheel.positions) if not k <= n < k + number]
            # The latest pulse is a tooth at each place that is asked: one that takes it for a pulse too many is not.
            shifts = {round(p - left[-1]) % turn for p in whole} - {0}
            others = [{round(p + shift) % turn for p in left} for shift in shifts]
            fits = any(len(whole - o) + len(o - whole) <= number for o in others)
            assert rival(text, left) == ((number, number), fits), (k, number)


@pytest.mark.parametrize(
    ("text", "at", "fits"),
    [("60-2", 58, True), ("60-2", 58.5, False), ("36-1", 35, True), ("36-2-2-2", 34.5, False), ("12-1", 11.5, False)],
)
def test_a_pulse_in_the_gap_leaves_a_rival_where_it_may_be_a_tooth(text, at, fits):
    wheel = Wheel.parse(text)
    pulses = sorted({*wheel.positions, at})
    latest = pulses.index(wheel.positions[5])
    turned = [p - wheel.turn for p in pulses[latest + 1 :]] + pulses[: latest + 1]
    assert rival(text, turned) == ((1, 0), fits)

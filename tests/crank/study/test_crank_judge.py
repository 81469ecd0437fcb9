"""Wheels that nobody chose: a sample of what bench/crank_judge.py judges."""

import importlib.util
import sys
from pathlib import Path

import pytest
from amount import amount

from gateway_fdi.jit import COMPILED
from gateway_plants.crank.monitor.monitor import Params, _facts
from gateway_plants.crank.wheel import Wheel

compiled = pytest.mark.skipif(not COMPILED, reason="statistics need the compiled kernels")
PATH = Path(__file__).parents[3] / "bench/crank_judge.py"


@pytest.fixture(scope="module")
def judge():
    spec = importlib.util.spec_from_file_location("crank_judge", PATH)
    module = importlib.util.module_from_spec(spec)
    sys.modules["crank_judge"] = module
    spec.loader.exec_module(module)
    return module


@compiled
def test_wheels_at_random_synchronise_within_six_turns_and_prove_no_wrong_tooth(judge):
    """1 to 4 gaps of 2 to 4 pitches, 4 to 180 pulses, in pitches, scaled, in degrees; 36-2-2 never synchronised."""
    seed = 70
    print("seed", seed)
    rows = [row for k in range(amount(1000, 40, 10)) if (row := judge.one_wheel((seed, k)))]
    assert len(rows) > 0.8 * amount(1000, 40, 10)
    assert [row for row in rows if row[1] > judge.FOUND or row[2] or row[3]] == []


@pytest.mark.parametrize(
    "text",
    [
        *("70,110,70,110", "57*6,18", "27*12,36", "10*30,60", "27*2,6", "57*0.5,1.5"),
        *("72-1", "72-2", "120-2", "120+1"),
    ],
)
def test_wheels_in_degrees_and_of_many_teeth_are_taken(text):
    """They ended in an IndexError of `gateway check`."""
    assert _facts(Params(wheel=text))
    wheel = Wheel.parse(text)
    assert wheel.pitches.count(1.0) > wheel.pulses / 2 or sum(wheel.pitches) == pytest.approx(wheel.pulses)


@compiled
@pytest.mark.parametrize(
    ("seed", "number"),
    [
        *((81001, k) for k in (44, 880)),  # a gap in the frames that were lost: which of two it was nobody saw
        *((81001, k) for k in (406,)),  # a doubled tooth among the pulses that were lost
        *((81001, k) for k in (208, 965)),  # a gap that fills while another place was as likely
        *((81002, k) for k in (257, 881, 2108)),  # no gap for turns, and no pulse decided to be added
        *((81002, k) for k in (1104, 2242, 4954)),  # a broken tooth among the pulses that were lost
        *((81002, k) for k in (895, 2668, 3052, 4301)),
        *((550101, k) for k in (2943, 4707)),  # what had to be chosen among hypotheses was proven
        *((550101, k) for k in (218, 699, 5727, 5979)),  # a gap that was filled, at the starter's speed
        *((770077, k) for k in (1067, 2780, 8660)),  # one of two equal gaps, behind frames that were lost
        *((225577, k) for k in (1915, 3369, 3465, 7241, 8353)),  # a pulse believed missed, before the next gap
        *((225577, k) for k in (389, 9425)),  # a broken tooth like the gap, behind a turning back
        *((225577, k) for k in (6835,)),  # what comes again in each turn was as dear as what comes once
        *((331199, k) for k in (6521, 8610)),
        *((510007, k) for k in (4899, 5106)),
        *((225577, k) for k in (508, 3419)),  # a gap that fills, whose piece looked like it, or like another place's
        *((510007, k) for k in (365, 1463, 8852)),
        *((225577, k) for k in (2225,)),  # twelve teeth less one, whose edges a defect made look noisy
        *((331199, k) for k in (2285, 6833)),
        *((70001, k) for k in (388, 2224)),  # pieces of a filled gap like the gap and a pitch, behind lost frames
        *((331199, k) for k in (2438,)),  # a sender that began to count anew
        *((440777, k) for k in (3689, 7508, 9908)),  # a guess of lost pulses that was wrong
        *((331199, k) for k in (1893, 3994, 5555)),  # one turn in many that spoke for the place; noisy edges of 12+1
        *((773311, k) for k in (297, 4153, 6301, 6421, 7414, 8829)),
        *((440777, k) for k in (215, 6289, 6357, 7641)),  # a pulse believed added, before the next gap
        *((773311, k) for k in (1353, 2001, 2037)),  # turns that spoke for another place
        *((773311, 5112), (271828, 3094)),  # a rival that one turn of several did not show
        *((773311, 6945), (618033, 2781), (618033, 6520)),  # a place that fitted badly, and a cam that had moved
        *((773311, 7073), (440777, 8045)),  # a broken tooth like the gap, at both ends of the turn that was asked
        *((141421, 348), (141421, 9807), (662607, 4642)),  # one tooth off, from which a turn was laid wrongly
        *((618033, 1378), (331199, 5333), (141421, 9629)),  # a place that was proven without the odds of a turn
    ],
)
def test_runs_that_once_proved_a_wrong_tooth(judge, seed, number):
    """Each had up to 77 wrong labels, proven, later than two turns behind an event."""
    assert judge.one_run((seed, number))[4] == 0


@compiled
@pytest.mark.parametrize(
    "number",
    [
        *(236, 251, 259),  # a bent tooth on an old wheel: it was learned in forty turns
        *(132, 298),  # a bent tooth where a pulse too many comes in each turn: such a turn taught nothing
        *(165, 597, 801, 1161),  # a defect of each turn on 12+1, whose tooth nothing tells
        *(1125, 2133),  # a bent tooth that made the edges look noisy
    ],
)
def test_a_later_fault_that_was_not_named_is_named(judge, number):
    row = judge.one_run((70001, number))
    assert (row[4], row[5], row[6]) == (0, True, [])


@compiled
@pytest.mark.parametrize("number", [1335, 2116, 4312])
def test_an_index_that_the_gap_puts_right_accuses_no_sensor(judge, number):
    """One pulse missed or added was told, behind frames that were lost."""
    assert judge.one_run((141421, number))[6] == []


@compiled
@pytest.mark.parametrize(
    ("seed", "number"),
    [
        # A tooth of 12+1 that is far off: a pulse missed and one added, each turn.
        *((818283, k) for k in (465, 921, 3273, 3729, 6429, 7005)),
        *((818283, k) for k in (119, 8965)),  # a tooth that is far off, at the starter's speed
        *((930133, 9167), (930132, 4852), (818283, 7593)),
        # An engine that turned back, decided long after its slowest interval.
        *((818283, k) for k in (3352, 3597, 4533, 4993, 7082, 8081)),
        *((930133, k) for k in (2502, 6777, 9015)),
        *((930132, 3635), (930132, 8445), (141421, 7513), (662607, 409)),
        *((818283, 6233), (930133, 3604), (930133, 4312)),  # an index that was wrong since the engine turned back
        *((930133, 1094), (930132, 6380)),  # one that was thrown back in a silence, and had its speed at once
        *((930133, 8508), (662607, 1071)),  # pitches followed as if the starter made ripple beyond any engine's
        *((818283, k) for k in (6237, 9497)),  # a tooth that was told as damaged once
        *((818283, k) for k in (5449,)),  # edges too noisy to count by
    ],
)
def test_no_healthy_part_is_proven_as_the_cause(judge, seed, number):
    """Each had the crankshaft sensor for certain."""
    assert judge.one_run((seed, number))[9] == []


@pytest.mark.parametrize(
    ("failed", "proven"),
    [
        (("sync_lost",), set()),
        (("no_gap",), set()),
        (("pulses_lost",), {"crankshaft sensor"}),
        (("damaged_tooth", "sync_lost"), {"wheel"}),
        (("damaged_tooth", "missed_pulse", "cam_correlation"), set()),
        (("damaged_tooth", "sync_lost", "cam_correlation"), set()),
    ],
)
def test_which_part_is_proven_by_what_fails(judge, failed, proven):
    """A symptom of sensor and wheel alike proves neither, and a cam that moved is no crankshaft sensor's fault."""
    assert judge.proven_causes(failed) == proven


@compiled
@pytest.mark.parametrize("number", [309, 1233])
def test_a_tooth_that_each_turn_lacks_is_the_wheels_where_nothing_tells_which(judge, number):
    row = judge.one_run((331199, number))
    assert (row[6], row[9]) == ([], [])
    assert {"missed_pulse", "damaged_tooth"} <= set(row[7])


@compiled
def test_behind_two_places_a_missing_gap_is_not_reported(judge):
    """Why no place is proven was told already."""
    assert set(judge.one_run((331199, 1321))[7]) == {"two_places"}


def test_the_page_has_the_table_of_wheels_that_cannot_be_told(judge):
    assert "\n".join(judge.same_rows()) in (PATH.parents[1] / "docs/crank/crank.md").read_text()
    assert judge.defects_of(Wheel.parse("36-1"), Wheel.parse("36-2")) == (1, 0)
    assert judge.defects_of(Wheel.parse("24-1"), Wheel.parse("36-1")) is None

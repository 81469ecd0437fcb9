"""Performance ratios and what the vehicle was driven: counted once a cycle, kept, and reset by nothing but what may."""

import random
import sqlite3

import pytest
from amount import amount
from fault_examples import catalogue, event, nothing

from gateway.faults.dtc import ALL_DTCS, EMISSION_DTCS
from gateway.faults.memory import FaultMemory
from gateway.faults.performance import MOST, Ratio
from gateway.faults.store import Store, StoreError
from gateway.faults.usage import KEPT_S, TimedCondition, UsageParams

GROUPS = ("catalyst", "catalyst", "egr")
USAGE = UsageParams(
    speed="V.Speed", running=({"signal": "V.Speed", "min": 1},), denominator=(TimedCondition(signal="V.Speed", min=1),)
)


def faults(**settings):
    return catalogue(readiness=GROUPS, **settings)


def memory(path=None, known=None, usage=USAGE):
    return FaultMemory(known or faults(), Store(path), usage=usage)


def passes(kept, k):
    kept.apply(event(k, False), nothing)


def fails(kept, k):
    kept.apply(event(k, True), nothing)


@pytest.mark.evidence("AUTOSAR DEM: IUMPR")
def test_a_result_counts_once_a_cycle():
    kept = memory()
    kept.start_cycle(0)
    passes(kept, 2)
    fails(kept, 2)
    passes(kept, 2)
    assert kept.performance.of("m.f2") == (1, 0)
    kept.start_cycle(1)
    fails(kept, 2)
    assert kept.performance.of("m.f2") == (2, 0), "a failure is a result too"
    assert kept.performance.ignition_cycles == 2


@pytest.mark.evidence("AUTOSAR DEM: IUMPR")
def test_a_clear_resets_nothing_and_lets_nothing_count_twice():
    kept = memory()
    kept.start_cycle(0)
    fails(kept, 2)
    kept.performance.conditions_met()
    kept.clear(ALL_DTCS)
    passes(kept, 2)
    kept.performance.conditions_met()
    counted = kept.performance
    assert counted.by_group() == {"catalyst": (0, 1), "egr": (1, 1)}
    assert (counted.ignition_cycles, counted.conditions) == (1, 1)


def test_nothing_counts_outside_its_cycle():
    kept = memory(known=faults(cycle=("driving",) * 3), usage=USAGE.model_copy(update={"cycle": "driving"}))
    kept.start_cycle(0)
    passes(kept, 2)
    kept.performance.conditions_met()
    assert kept.performance.by_group()["egr"] == (0, 0)
    kept.start_cycle(1, "driving")
    passes(kept, 2)
    kept.performance.conditions_met()
    kept.end_cycle(2, "driving")
    passes(kept, 2)
    kept.performance.conditions_met()
    assert kept.performance.by_group()["egr"] == (1, 1)
    assert kept.performance.ignition_cycles == 1
    kept.start_cycle(3, "driving")
    kept.end_cycle(4, "driving")
    kept.performance.conditions_met()
    assert kept.performance.by_group()["egr"] == (1, 1), "the second one is over, and had none"


def test_faults_of_other_cycles_and_others_than_emission_related_have_no_ratio():
    kept = memory(known=faults(cycle=("power", "driving", "power"), emission_related=(True, True, False)))
    kept.start_cycle(0)
    kept.start_cycle(0, "driving")
    for k in range(3):
        passes(kept, k)
    kept.performance.conditions_met()
    assert kept.performance.by_group() == {"catalyst": (1, 1)}


@pytest.mark.evidence("AUTOSAR DEM: IUMPR groups")
def test_of_a_group_the_lowest_ratio_is_shown_and_of_alike_ones_that_of_more_chances():
    assert min(Ratio(1, 2), Ratio(2, 3), key=lambda r: r.order) == (1, 2)
    assert min(Ratio(1, 2), Ratio(2, 4), key=lambda r: r.order) == (2, 4)
    assert min(Ratio(0, 0), Ratio(5, 5), key=lambda r: r.order) == (5, 5), "one without a chance says nothing"
    assert min(Ratio(1, 0), Ratio(0, 0), key=lambda r: r.order) == (0, 0)
    assert min(Ratio(0, 3), Ratio(0, 0), key=lambda r: r.order) == (0, 3)


@pytest.mark.evidence("AUTOSAR DEM: IUMPR groups")
def test_counts_at_their_end_are_halved_together():
    kept = memory()
    kept.ledger.set_fact("numerator.m.f2", MOST)
    kept.ledger.set_fact("denominator.m.f2", MOST - 1)
    kept.start_cycle(0)
    passes(kept, 2)
    assert kept.performance.of("m.f2") == (MOST // 2 + 1, (MOST - 1) // 2)
    kept.ledger.set_fact("ignition_cycles", MOST)
    kept.start_cycle(1)
    assert kept.performance.ignition_cycles == 0, "this one begins anew"


def test_without_a_denominator_nothing_is_counted():
    kept = memory(usage=None)
    kept.start_cycle(0)
    passes(kept, 2)
    kept.performance.conditions_met()
    assert not kept.performance.offered
    assert kept.performance.by_group() == {}
    assert kept.ledger.store.facts() == {}


def test_counts_against_a_model_over_restarts_and_kills(tmp_path):
    """Numerators, denominators and cycles by a model of its own, with clears, restarts, and kills in between."""
    seed = 27
    print(f"seed {seed}")
    rng = random.Random(seed)
    path = tmp_path / "f.sqlite"
    kept = memory(path)
    kept.start_cycle(0)
    numerators, denominator, cycles = [0, 0, 0], 0, 1
    done, met = set(), False
    for step in range(amount(20_000, 1500, 300)):
        kind = rng.random()
        k = rng.randrange(3)
        if kind < 0.45:
            (passes if rng.random() < 0.5 else fails)(kept, k)
            numerators[k] += k not in done
            done.add(k)
        elif kind < 0.6:
            kept.performance.conditions_met()
            denominator += not met
            met = True
        elif kind < 0.7:
            kept.clear(ALL_DTCS)
        elif kind < 0.72:
            kept.commit()
            kept.ledger.store.close()  # kill: the cycle is not ended
            kept = memory(path)
            kept.start_cycle(step)  # it goes on: nothing counts again
        elif kind < 0.9:
            kept.end_cycle(step)
            kept.start_cycle(step)
            cycles, done, met = cycles + 1, set(), False
        ratios = [kept.performance.of(f"m.f{n}") for n in range(3)]
        assert ratios == [(n, denominator) for n in numerators]
        assert (kept.performance.ignition_cycles, kept.performance.conditions) == (cycles, denominator)
    assert min(numerators) > 0
    kept.ledger.store.close()


def test_what_was_driven_is_kept_written_seldom_and_reset_by_a_clear_of_all(tmp_path):
    path = tmp_path / "f.sqlite"
    kept = memory(path)
    kept.start_cycle(0)
    before = kept.commits
    for _ in range(5000):  # 650 s at 36 km/h
        kept.usage.add(1.3, 0.13, lit=False)
        kept.commit()
    assert kept.commits - before <= 650 / KEPT_S + 1
    lit_m, cleared_m, lit_s, cleared_s = kept.usage.driven()
    assert (lit_m, lit_s) == (0, 0)
    assert (cleared_m, cleared_s) == (pytest.approx(6500), pytest.approx(650))
    kept.usage.flush()
    kept.commit()
    kept.ledger.store.close()
    kept = memory(path)
    assert kept.usage.driven().cleared_m == pytest.approx(6500, abs=1)
    kept.clear(0x030011)
    assert kept.usage.driven().cleared_m == pytest.approx(6500, abs=1), "one DTC is not all"
    kept.clear(EMISSION_DTCS)
    assert kept.usage.driven() == (0, 0, 0, 0)
    kept.ledger.store.close()


def test_with_the_mil_on_begins_anew_when_it_is_lit():
    kept = memory()
    kept.usage.add(100.0, 10.0, lit=True)
    kept.usage.add(100.0, 10.0, lit=False)
    assert kept.usage.driven() == (100, 200, 10, 20), "out: it stays"
    kept.usage.add(50.0, 5.0, lit=True)
    assert kept.usage.driven() == (50, 250, 5, 25)


def test_what_nobody_measures_is_not_known():
    kept = memory(usage=UsageParams(running=({"signal": "V.Speed", "min": 1},)))
    assert kept.usage.driven() == (None, None, 0, 0)
    assert memory(usage=None).usage.driven() == (None, None, None, None)


def test_a_clear_that_cannot_be_written_resets_nothing(tmp_path, monkeypatch):
    kept = memory(tmp_path / "f.sqlite")
    kept.start_cycle(0)
    kept.usage.add(700.0, 30.0, lit=True)
    monkeypatch.setattr("gateway.faults.rows.write", lambda *_: (_ for _ in ()).throw(sqlite3.OperationalError("full")))
    with pytest.raises(StoreError):
        kept.clear(ALL_DTCS)
    monkeypatch.undo()
    assert kept.usage.driven() == (700, 700, 30, 30)
    kept.clear(ALL_DTCS)
    assert kept.usage.driven() == (0, 0, 0, 0)

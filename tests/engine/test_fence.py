"""A monitor from outside that misbehaves is switched off, and told; it takes nothing else with it."""

from dataclasses import replace
from typing import Annotated

import numpy as np
import pytest
from battery_bus import PERIOD_NS, battery_database, voltages

from gateway.engine.build import build_engine
from gateway.engine.events import MONITOR_OFF, QUALIFIED_FAILED, QUALIFIED_PASSED
from gateway.engine.instances import MonitorInstance
from gateway.monitors import contract
from gateway.monitors.contract import (
    LEAST_SLEEP_NS,
    NOT_TESTED,
    Debounce,
    Fault,
    Monitor,
    MonitorParams,
    Signal,
    report,
)
from gateway_fdi.jit import BOUNDSCHECK, COMPILED, Record, f8, f8s, failure_of, i8, kernel


class State(Record):
    history: Annotated[f8s, 3]
    steps: i8


class Const(Record):
    at: i8
    bad: f8


class Inputs(contract.Inputs):
    volts: f8


@kernel
def healthy(s, c, u, out):
    s.steps += 1
    report(out, 0, u.volts < 11.0, u.volts, 11.0)


@kernel
def beyond(s, c, u, out):
    report(out, 0, u.volts < 11.0, u.volts, 11.0)
    if u.volts > 20.0:
        s.history[c.at] = u.volts


@kernel
def beyond_below(s, c, u, out):
    deeper(s.history, c.at if u.volts > 20.0 else 0)
    report(out, 0, u.volts < 11.0, u.volts, 11.0)


@kernel
def deeper(history, at):
    history[at] = 1.0


@kernel
def raises(s, c, u, out):
    report(out, 0, u.volts < 11.0, u.volts, 11.0)
    if u.volts > 20.0:
        raise ValueError("too much")


@kernel
def no_number(s, c, u, out):
    value = c.bad if u.volts > 20.0 else u.volts
    report(out, 0, value < 11.0, value, 11.0)


@kernel
def no_threshold(s, c, u, out):
    report(out, 0, u.volts < 11.0, u.volts, c.bad if u.volts > 20.0 else 11.0)


@kernel
def sleepless(s, c, u, out):
    s.steps += 1
    out.wake_ns = u.t_ns + 1


@kernel
def backwards(s, c, u, out):
    s.steps += 1
    out.wake_ns = u.t_ns - 1_000


def prepare(_, s, c):
    c.at, c.bad = 3, np.nan


GOOD = Monitor(
    type="slips",
    api=2,
    params=MonitorParams,
    state=State,
    const=Const,
    inputs=Inputs,
    step=healthy,
    connect=lambda _: {"volts": Signal("BATT.Volts", triggers=True)},
    prepare=prepare,
    faults=lambda _: (Fault("low", "P0562-16", "too low"),),
)


@pytest.fixture(scope="module")
def database(tmp_path_factory):
    return battery_database(tmp_path_factory.mktemp("dbc"))


class Rig:
    """An engine with a monitor that slips at 30 V, and a healthy one; takes voltages, one a millisecond."""

    def __init__(self, database, step, **changed):
        self.slips = replace(GOOD, step=step, **changed)
        names = {"slips": self.slips, "other": replace(GOOD, type="other")}
        instances = [MonitorInstance(name, monitor, MonitorParams()) for name, monitor in names.items()]
        self.engine = build_engine([(0, database)], instances, [])
        self.t_ns, self.told, self.verdicts = 0, [], []

    def feed(self, *volts):
        self.engine.process(voltages(volts, self.t_ns), self.sink)
        self.t_ns += len(volts) * PERIOD_NS
        return self

    def sink(self, events):
        for event in events:
            if event["kind"] == MONITOR_OFF:
                self.told.append((int(event["fault"]), int(event["t_ns"])))
            elif event["kind"] in (QUALIFIED_FAILED, QUALIFIED_PASSED):
                failed = event["kind"] == QUALIFIED_FAILED
                self.verdicts.append((self.engine.faults[int(event["fault"])].id, failed))

    def of(self, name):
        return self.engine.tables.handlers[self.engine.place_of(name)]

    def last(self, name):
        return self.engine.tables.debounces[self.of(name)["fault"]]["last"]


@pytest.mark.evidence("Nothing is silent: monitor")
@pytest.mark.parametrize("step", [beyond, beyond_below, raises], ids=lambda s: s.__name__)
def test_a_step_that_fails_switches_its_monitor_off_and_nothing_else(database, step):
    rig = Rig(database, step).feed(12.0, 30.0, 10.0, 10.0)
    assert rig.told == [(rig.engine.place_of("slips"), 2 * PERIOD_NS)], "told once"
    assert (rig.of("slips")["steps"], rig.of("slips")["skipped"]) == (1, 3)
    assert rig.last("slips") == NOT_TESTED
    assert ("other.low", True) in rig.verdicts
    assert ("slips.low", True) not in rig.verdicts
    assert rig.of("other")["steps"] == 4
    assert not rig.engine.state_of(rig.engine.place_of("slips"))["history"][0][1:].any(), "nothing was written"
    reason = failure_of(int(rig.of("slips")["off"]))
    assert reason.startswith("ValueError: too much" if step is raises else "IndexError: index")
    if step is raises or not COMPILED:
        line = step.py_func.__code__ if COMPILED else step.__code__
        at = line.co_firstlineno if step is not beyond_below else deeper.__code__.co_firstlineno
        place, _, number = reason.rpartition("(")[2].rstrip(")").rpartition(":")
        assert (place, at < int(number) <= at + 4) == (__file__, True)


def test_what_was_reported_before_the_step_failed_does_not_count(database):
    rig = Rig(database, beyond).feed(30.0)
    assert not [verdict for verdict in rig.verdicts if verdict[0] == "slips.low"]


@pytest.mark.skipif(not COMPILED or BOUNDSCHECK, reason="indices are checked in any case")
@pytest.mark.parametrize("author", [True, False])
@pytest.mark.parametrize("person", [True, False])
def test_only_who_is_trusted_by_author_and_person_runs_without_checks(author, person):
    monitor = replace(GOOD, trusted=author)
    entry = MonitorInstance("a", monitor, MonitorParams(), trusted=person).entry
    assert entry == (monitor.entry if author and person else monitor.checked_entry)
    assert monitor.entry != monitor.checked_entry


def test_ours_are_not_checked():
    from gateway_plants.crank.monitor.monitor import MONITOR

    assert not MONITOR.outside
    assert GOOD.outside


@pytest.mark.evidence("Healthy parts: NaN")
@pytest.mark.parametrize("step", [no_number, no_threshold], ids=lambda s: s.__name__)
def test_no_number_neither_passes_nor_heals_and_is_counted(database, step):
    rig = Rig(database, step).feed(10.0, 30.0, 30.0)
    assert [verdict for verdict in rig.verdicts if verdict[0] == "slips.low"] == [("slips.low", True)]
    assert rig.last("slips") == NOT_TESTED
    assert rig.engine.counters()["results_no_number"] == 2
    rig.feed(12.0, 12.0)
    assert rig.verdicts.count(("slips.low", False)) == 1, "a number heals it"


def test_no_number_does_not_qualify_by_time(database):
    timed = lambda _: (Fault("low", "P0562-16", "", (), Debounce(failed_ms=2.0, passed_ms=2.0)),)  # noqa: E731
    rig = Rig(database, no_number, faults=timed).feed(10.0, 30.0, 30.0, 30.0, 30.0)
    assert not [verdict for verdict in rig.verdicts if verdict[0] == "slips.low"]


@pytest.mark.parametrize("step", [sleepless, backwards], ids=lambda s: s.__name__)
def test_who_wakes_himself_at_once_is_put_off_and_counted(database, step):
    rig = Rig(database, step).feed(12.0, 12.0)
    steps = int(rig.of("slips")["steps"])
    assert steps == 2 + PERIOD_NS // LEAST_SLEEP_NS
    assert rig.engine.counters()["wakes_moved"] >= steps - 2

"""Two faults, their gates, times and cycles against a model in plain Python, written from the definitions."""

from fractions import Fraction
from math import ceil, floor, inf

import pytest
from amount import amount
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from gateway.bus.frames import EXTENDED
from gateway.engine.events import (
    CYCLE_BEGAN,
    CYCLE_ENDED,
    FDC_REACHED,
    QUALIFIED_FAILED,
    QUALIFIED_PASSED,
    RESULT_CHANGED,
)
from gateway.engine.gate import Condition, CycleWatch, Gate
from gateway.monitors.contract import Debounce
from gateway.signals.tables import SignalRef

GAMMA = SignalRef(0, "Gamma", "Value")
GAMMA_ID = 2566844926 & 0x1FFFFFFF
MS = 10**6
#: The cycle begins where Gamma is in the first range, ends in the second; the condition holds in the third.
BEGINS, ENDS, ENABLES = (20, 60), (40, 80), (10, 55)
OPEN, OVER = True, False


class Debounced:
    """AUTOSAR DEM 7.7.3: a counter of results, or the time that results have said the same."""

    def __init__(self, debounce, trigger_fdc):
        self.d = debounce
        self.top = int(debounce.failed_ms * MS) if debounce.timed else debounce.failed_after
        self.bottom = -int(debounce.passed_ms * MS) if debounce.timed else -debounce.passed_after
        self.trigger = ceil(Fraction(trigger_fdc * self.top, 127))
        self.active, self.peak, self.near = False, 0, 0
        self.start()

    def start(self):
        """An operation cycle begins, or the fault is cleared: nothing is known."""
        self.counter, self.last, self.verdict = 0, None, None
        self.forget()

    def forget(self):
        """The rise that goes on is over, and was no near miss."""
        self.greatest, self.asked, self.failed = 0, False, False

    def counter_at(self, t):
        """Time counts only from the last result on, and while the gate was open then."""
        if not self.d.timed or self.last is None:
            return self.counter
        passed = t - self.since
        return min(self.counter + passed, self.top) if self.last else max(self.counter - passed, self.bottom)

    def fdc(self, t):
        counter = self.counter_at(t)
        return floor(Fraction(127 * counter, self.top)) if counter >= 0 else ceil(Fraction(-128 * counter, self.bottom))

    def due(self):
        """When time alone makes the next event."""
        if not self.d.timed or self.last is None or self.verdict == self.last:
            return inf
        if not self.last:
            return self.since + self.counter - self.bottom
        goal = self.trigger if self.trigger and not self.asked else self.top
        return self.since + goal - self.counter

    def settle(self):
        """The counter has moved: its verdict, the trigger of the freeze frame, near misses; returns the event."""
        kind = None
        self.peak, self.greatest = max(self.peak, self.counter), max(self.greatest, self.counter)
        if self.counter == self.top and self.verdict is not True:
            self.verdict, self.active, self.asked, kind = True, True, True, QUALIFIED_FAILED
        elif self.counter == self.bottom and self.verdict is not False:
            self.verdict, self.active, kind = False, False, QUALIFIED_PASSED
        elif self.trigger and self.trigger <= self.counter < self.top and not self.asked:
            self.asked, kind = True, FDC_REACHED
        self.failed = self.failed or self.counter == self.top
        if self.counter <= 0:
            self.near += 2 * self.greatest >= self.top and not self.failed
            self.forget()
        return kind

    def pass_time(self, t, closed):
        """Time has made an event; behind a closed gate its time starts again, and nothing is made."""
        self.counter = self.counter if closed else self.counter_at(t)
        self.since = t
        return self.settle()

    def take(self, t, failed):
        changed, kind = self.last is not failed, None
        if self.d.timed:
            self.counter = self.counter_at(t)
            kind = self.settle()
            if changed:
                self.counter = max(self.counter, 0) if failed else min(self.counter, 0)
            self.last, self.since = failed, t
            kind = kind or self.settle()
        else:
            self.last = failed
            if failed:
                lifted = max(self.counter, self.d.jump_up_to) if self.d.jump_up else self.counter
                self.counter = min(lifted + self.d.failed_step, self.top)
            else:
                lowered = min(self.counter, self.d.jump_down_to) if self.d.jump_down else self.counter
                self.counter = max(lowered - self.d.passed_step, self.bottom)
            kind = self.settle()
        return kind or (RESULT_CHANGED if changed else None)

    def hold(self, t, resets):
        """The gate is closed: the counter stands still, or all is given up; told once."""
        self.counter = self.counter_at(t)
        self.settle_statistics()
        changed, self.last = self.last is not None, None
        if resets:
            self.counter, self.verdict = 0, None
            self.forget()
        return RESULT_CHANGED if changed else None

    def settle_statistics(self):
        self.peak, self.greatest = max(self.peak, self.counter), max(self.greatest, self.counter)


class Life:
    """Both faults: ``physics`` counts only while ``sensor`` is well, Gamma in its range, and its cycle runs."""

    def __init__(self, sensor, physics, trigger_fdc, asks, resets):
        self.faults = {"sensor": Debounced(sensor, trigger_fdc), "physics": Debounced(physics, trigger_fdc)}
        self.asks, self.resets = asks, resets
        self.cycle, self.gamma, self.held = OVER, None, False
        self.events = []

    def closed(self, name, t):
        root, (low, high) = self.faults["sensor"], ENABLES
        return self.held or (
            name == "physics"
            and (
                ("root" in self.asks and (root.active or root.fdc(t) > 0))
                or ("condition" in self.asks and not (self.gamma is not None and low <= self.gamma <= high))
                or ("cycle" in self.asks and self.cycle is OVER)
            )
        )

    def tell(self, t, name, kind):
        if kind is not None:
            self.events.append((t, name, kind))

    def until(self, t):
        while (first := min(self.faults, key=lambda name: self.faults[name].due())) and self.faults[first].due() <= t:
            due = self.faults[first].due()
            self.tell(due, first, self.faults[first].pass_time(due, self.closed(first, due)))

    def frame(self, t, message, value):
        self.until(t)
        if message == "gamma":
            self.gamma = value
            if self.cycle is OPEN and ENDS[0] <= value <= ENDS[1]:
                self.cycle = OVER
                self.tell(t, "cycle", CYCLE_ENDED)
            if self.cycle is OVER and BEGINS[0] <= value <= BEGINS[1]:
                self.cycle = OPEN
                self.tell(t, "cycle", CYCLE_BEGAN)
            return
        name = {"alpha": "physics", "beta": "sensor"}[message]
        fault = self.faults[name]
        if self.closed(name, t):
            self.tell(t, name, fault.hold(t, self.resets and name == "physics" and self.asks))
        else:
            self.tell(t, name, fault.take(t, value > 10))


COUNTED = st.builds(
    Debounce,
    failed_after=st.sampled_from([1, 2, 3, 64, 100, 127, 128, 200]),
    passed_after=st.sampled_from([1, 2, 3, 90]),
    jump_up=st.booleans(),
    jump_down=st.booleans(),
    failed_step=st.sampled_from([1, 1, 2, 50]),
    passed_step=st.sampled_from([1, 1, 40]),
    jump_up_to=st.integers(-2, 2),
    jump_down_to=st.integers(-2, 2),
)


def timed(part):
    """By time; ``part`` of a millisecond keeps the two faults from being due at once."""
    return st.builds(
        lambda a, b: Debounce(failed_ms=a + part, passed_ms=b + part), st.integers(1, 40), st.integers(1, 40)
    )


STEPS = st.one_of(
    st.tuples(st.just("beta"), st.integers(0, 9), st.sampled_from([0, 20])),
    st.tuples(st.just("alpha"), st.integers(0, 9), st.sampled_from([0, 20])),
    st.tuples(st.just("alpha"), st.integers(0, 9), st.sampled_from([0, 20])),
    st.tuples(st.just("gamma"), st.integers(0, 9), st.sampled_from([9, 10, 30, 50, 55, 56, 70, 90])),
    st.tuples(st.sampled_from(["hold", "clear", "fold", "look", "know"]), st.integers(0, 60), st.sampled_from([0, 1])),
)
FAILS, WELL = ("alpha", 1, 20), ("alpha", 1, 0)


@pytest.mark.evidence(
    "AUTOSAR DEM: debounce counter",
    "AUTOSAR DEM: debounce time",
    "AUTOSAR DEM: enable conditions",
    "AUTOSAR DEM: event dependencies",
    "AUTOSAR DEM: cycle signals",
)
@example(Debounce(3, 3), Debounce(2, 2), 0, {"cycle"}, True, [("gamma", 1, 30), ("gamma", 1, 50), FAILS, FAILS])
@example(Debounce(100, 3), Debounce(2, 2), 0, {"root"}, False, [("beta", 1, 20), FAILS, FAILS])
@example(Debounce(), Debounce(failed_ms=30.0, passed_ms=9.0), 60, set(), False, [FAILS, ("look", 60, 0)])
@example(
    Debounce(),
    Debounce(2, 2),
    0,
    {"condition"},
    True,
    [("gamma", 1, 30), FAILS, FAILS, ("gamma", 1, 9), FAILS, ("gamma", 1, 30), FAILS, WELL, ("fold", 0, 1)],
)
@example(
    Debounce(),
    Debounce(4, 4),
    60,
    {"condition"},
    True,
    [("gamma", 1, 30), *[FAILS] * 4, ("gamma", 1, 9), FAILS, ("gamma", 1, 30), *[FAILS] * 4],
)
@example(Debounce(), Debounce(2, 2), 0, set(), True, [FAILS, ("hold", 0, 1), FAILS, ("hold", 0, 0), FAILS])
@example(Debounce(), Debounce(2, 2), 0, {"root"}, False, [("know", 0, 0), FAILS, ("beta", 1, 0), FAILS, FAILS])
@settings(max_examples=amount(2000, 60, 20), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.one_of(COUNTED, timed(0.0)),
    st.one_of(COUNTED, timed(0.5)),
    st.sampled_from([0, 1, 60, 127]),
    st.sets(st.sampled_from(["root", "condition", "cycle"])),
    st.booleans(),
    st.lists(STEPS, max_size=60),
)
def test_events_counters_and_statistics_are_those_of_the_definitions(
    build, tools, sensor, physics, trigger_fdc, asks, resets, steps
):
    engine = build(
        ("sensor", 0, {"messages": ["Beta"], "signals": ["Beta.Value"]}),
        ("physics", 1, {}),
        debounces={"sensor.high": vars(sensor), "physics.high": vars(physics)},
        gates={
            "physics.high": Gate(
                roots=("sensor.high",) if "root" in asks else (),
                conditions=(Condition(GAMMA, *ENABLES),) if "condition" in asks else (),
                cycle=0 if "cycle" in asks else -1,
                resets=resets,
                trigger_fdc=trigger_fdc,
            ),
            "sensor.high": Gate(trigger_fdc=trigger_fdc),
        },
        cycles=[CycleWatch(Condition(GAMMA, *BEGINS), Condition(GAMMA, *ENDS))],
    )
    places = {slot.id.removesuffix(".high"): k for k, slot in enumerate(engine.faults)}
    names = {k: name for name, k in places.items()}
    life, seen, t = Life(sensor, physics, trigger_fdc, asks, resets), tools.Collector(), 0
    for step, wait, value in steps:
        t += wait
        if step in ("alpha", "beta", "gamma"):
            life.frame(t * MS, step, value)
            row = {"alpha": tools.alpha, "beta": tools.beta, "gamma": gamma}[step](t, value)
            engine.process(tools.batch(row), seen)
            continue
        life.until(t * MS)
        engine.advance(t * MS, seen)
        name = ("sensor", "physics")[value]
        if step == "hold":
            life.held = bool(value)
            engine.hold_results(life.held)
        elif step == "clear":
            life.faults[name].start()
            engine.reset_debounce([places[name]])
        elif step == "know":
            life.faults[name].active = True
            engine.set_active(places[name], True)
        elif step == "fold":
            fault = life.faults[name]
            assert engine.fold_statistics(places[name]) == (fault.near, 127 * fault.peak // fault.top)
            fault.near = fault.peak = 0
        for name, fault in life.faults.items():
            assert engine.fault_detection_counter(places[name]) == fault.fdc(t * MS), name
    cycle = (CYCLE_BEGAN, CYCLE_ENDED)
    told = [(e[0], "cycle" if e[2] in cycle else names[e[1]], e[2]) for e in seen.events]
    assert told == life.events


def gamma(t_ms, value):
    return (t_ms, GAMMA_ID | EXTENDED, value.to_bytes(2, "little") + bytes(6))

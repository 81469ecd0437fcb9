"""An engine that takes over from another one: the same configuration changes nothing, a changed one only what
changed.
"""

import numpy as np
import pytest
from amount import examples
from everywhere import everywhere
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gateway.bus import conditions as c
from gateway.bus.frames import ERROR
from gateway.engine.adopt import adopt
from gateway.engine.checks.bus_health import BusInstance, Health, HealthPlace, HealthState
from gateway.engine.checks.communication import COUNTED_IN, Check, CheckConst, CheckPlace, CheckRun, CheckState
from gateway.engine.checks.senders import SenderConst, SenderState
from gateway.engine.debounce import DebounceConst, DebouncePlace, DebounceRow, DebounceState
from gateway.engine.emission import Emit, EmitConst, EmitPlace, EmitState
from gateway.engine.events import QUALIFIED_FAILED
from gateway.engine.gate import Condition, CycleWatch, Watch, WatchConst, WatchPlace, WatchState
from gateway.engine.tables import (
    Clock,
    ClockPass,
    ClockState,
    Handler,
    HandlerPlace,
    HandlerState,
    Vector,
    VectorPlace,
    VectorState,
)
from gateway.monitors.contract import Debounce
from gateway.signals.tables import SignalRef

CHECK = {"message": "Alpha", "timeout_ms": 50.0, "counter": {"signal": "Count"}}
MONITOR = ("m", 0, {"wake_ms": 70.0, "tag": 1.0})


def make(build, *monitors, check=CHECK, debounce=None, **options):
    return build(
        *(monitors or (MONITOR,)),
        checks=[check],
        buses=[BusInstance("a")],
        debounces=everywhere(debounce),
        **options,
    )


def run(engines, pieces, tools, until):
    """Feed each engine a piece, each taking over from the one before; returns the events and the last engine."""
    seen = tools.Collector()
    old = None
    for engine, piece in zip(engines, pieces, strict=True):
        if old is not None:
            adopt(engine, old, {0: 0}, {})
        if piece:
            engine.process(tools.batch(*piece), seen)
        old = engine
    old.advance(round(until * 1e6), seen)
    return seen.events, old


def frame(kind, t_ms, value, tools):
    if kind == "error":
        return (t_ms, ERROR | (c.PROTOCOL if value % 3 else c.BUS_OFF), bytes(8))
    if kind == "condition":
        return (t_ms, ERROR, bytes([1 + value % 3, 0, 0, 0, value, 0, 0, 0]))
    return tools.alpha(t_ms, value - 8.0, count=value % 16)


@pytest.mark.evidence("Live is replay: reload")
@pytest.mark.parametrize("timed", [False, True])
@settings(max_examples=examples(60), suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.lists(
        st.tuples(
            st.sampled_from(["frame"] * 5 + ["error"] * 3 + ["condition"]),
            st.integers(0, 120),
            st.integers(0, 31),
        ),
        min_size=2,
        max_size=60,
    ),
    st.data(),
)
def test_taking_over_at_any_frame_changes_nothing(build, tools, timed, rows, data):
    now, frames = 0.0, []
    for kind, gap, value in rows:
        now += gap
        frames.append(frame(kind, now, value, tools))
    cuts = sorted(data.draw(st.lists(st.integers(1, len(frames) - 1), max_size=3)))
    pieces = [frames[a:b] for a, b in zip([0, *cuts], [*cuts, None], strict=True)]
    debounce = Debounce(failed_ms=30.0, passed_ms=40.0) if timed else None
    engines = [make(build, debounce=debounce) for _ in pieces]
    whole, one = run([make(build, debounce=debounce)], [frames], tools, now + 3000)
    parts, last = run(engines, pieces, tools, now + 3000)
    assert parts == whole
    assert last.counters() == one.counters()
    assert last.readout() == one.readout()
    assert last.error_counters(0) == one.error_counters(0)
    faults = range(len(one.faults))
    assert [last.fold_statistics(k) for k in faults] == [one.fold_statistics(k) for k in faults]


def failures(events, engine):
    return [(e[0] / 1e6, engine.faults[e[1]].id) for e in events if e[2] == QUALIFIED_FAILED]


def test_a_changed_timeout_starts_anew_and_nothing_else(build, tools):
    old, new = make(build), make(build, check={**CHECK, "timeout_ms": 20.0})
    frames = [tools.alpha(k, 0, count=k) for k in range(5)]
    # The old deadline would be at 54 ms; the new check waits its own 20 ms from the change on.
    events, last = run([old, new], [frames, []], tools, 40)
    assert (24.0, "comm.Alpha.timeout") in failures(events, last)
    old, new = make(build), make(build, check={**CHECK, "timeout_ms": 500.0})
    events, last = run([old, new], [frames, [tools.alpha(5, 0, count=9)]], tools, 490)
    assert "comm.Alpha.timeout" not in {name for _, name in failures(events, last)}
    counter = [slot.id for slot in last.faults].index("comm.Alpha.counter")
    assert last.fault_detection_counter(counter) > 0, "4, then 9: the last counter is known"


def test_a_changed_monitor_starts_anew(build, tools):
    old, new = make(build), make(build, ("m", 0, {"wake_ms": 70.0, "tag": 2.0}))
    frames = [tools.alpha(k, 1.0, count=k) for k in range(6)]
    _, last = run([old, new], [frames[:4], frames[4:]], tools, 10)
    assert last.readout()["m"]["steps"] == 2
    assert last.readout()["m"]["total"] == 2.0
    assert last.counters()["frames"] == 6


def test_a_changed_debounce_starts_anew(build, tools):
    old = make(build, debounce=Debounce(failed_after=100, passed_after=100))
    new = make(build, debounce=Debounce(failed_after=3, passed_after=3))
    bad = [tools.alpha(k, 99.0, count=k % 16) for k in range(60)]
    events, last = run([old, new], [bad[:57], bad[57:59]], tools, 59)
    assert "m.high" not in {name for _, name in failures(events, last)}, "57 of 100 are not 57 of 3"
    events, last = run([old, new], [[], bad[59:]], tools, 60)
    assert (59.0, "m.high") in failures(events, last)


def test_settings_of_the_health_are_the_new_ones(build, tools):
    old = make(build)
    new = build(
        MONITOR,
        checks=[CHECK],
        buses=[BusInstance("a", BusInstance("a").params.model_copy(update={"errors": 3}))],
    )
    errors = [(k, ERROR | c.PROTOCOL, bytes(8)) for k in range(4)]
    events, last = run([old, new], [errors[:2], errors[2:]], tools, 10)
    assert (2.0, "a.bus_errors") in failures(events, last), "two before, the third after the change"


RECORDS = {
    "debounces": (DebounceConst, DebounceState),
    "checks": (CheckConst, CheckState),
    "handlers": (None, HandlerState),
    "health": (None, HealthState),
    "vectors": (None, VectorState),
}
SCRIPTS = st.fixed_dictionaries({"limit": st.sampled_from([5.0, 10.0]), "wake_ms": st.sampled_from([0.0, 70.0])})
CONFIGURATIONS = st.fixed_dictionaries(
    {
        "monitors": st.dictionaries(st.sampled_from("mnop"), SCRIPTS, max_size=4),
        "check": st.fixed_dictionaries(
            {"timeout_ms": st.sampled_from([50.0, 80.0]), "length": st.booleans()},
            optional={"counter": st.just({"signal": "Count"})},
        ),
        "failed_after": st.sampled_from([1, 3]),
    }
)


def built(build, configuration):
    debounce = Debounce(configuration["failed_after"], 2)
    monitors = [(name, k, params) for k, (name, params) in enumerate(configuration["monitors"].items())]
    return build(
        *monitors, checks=[{"message": "Alpha", **configuration["check"]}], buses=[BusInstance("a")],
        debounces=everywhere(debounce),
    )  # fmt: skip


def named(engine, table):
    """Return the rows of a table by what they are of."""
    rows = getattr(engine.tables, table)
    names = {
        "debounces": [slot.id for slot in engine.faults],
        "handlers": [instance.name for instance in engine.monitors],
        "vectors": [name for _, name in engine.plan.message_names],
    }.get(table, [*range(len(rows))])
    return dict(zip(names, rows, strict=False))


@settings(max_examples=examples(80), suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(CONFIGURATIONS, CONFIGURATIONS, st.lists(st.integers(0, 31), min_size=1, max_size=30))
def test_between_random_configurations_all_state_is_kept_whose_constants_are_equal(build, tools, before, after, values):
    old, new = built(build, before), built(build, after)
    frames = [tools.alpha(20.0 * k, value - 8.0, count=value % 16) for k, value in enumerate(values)]
    old.process(tools.batch(*frames), tools.Collector())
    adopt(new, old, {0: 0}, {})
    now = new.now_ns
    assert now == old.now_ns
    same = {name for name, params in after["monitors"].items() if before["monitors"].get(name) == params}
    for table, (const, state) in RECORDS.items():
        theirs = named(old, table)
        for name, row in named(new, table).items():
            other = theirs.get(name)
            if other is None or (table == "handlers" and name not in same):
                continue
            groups = {state.dtype.names: () if const is None else const.dtype.names}
            for names, constants in COUNTED_IN.items() if table == "checks" else groups.items():
                equal = all(_constant(row, f) == _constant(other, f) for f in constants)
                kept = all(np.array_equal(row[f], other[f], equal_nan=True) for f in names)
                assert kept or not equal, (table, name, names)
    for k, instance in enumerate(new.monitors):
        if instance.name in same:
            place = [other.name for other in old.monitors].index(instance.name)
            assert new.state_of(k).tobytes() == old.state_of(place).tobytes()
        else:
            assert new.state_of(k)["steps"] == 0
    for ref, slot in zip(new.plan.slot_names, new.tables.mailbox[:-1], strict=True):
        if ref in old.plan.slot_names:
            assert slot == old.tables.mailbox[old.plan.slot_names.index(ref)]


def test_what_begins_a_cycle_remembers_how_low_its_signal_was(build, tools):
    """It was forgotten once: a signal that rose before a reload began its cycle again behind it."""
    place = SignalRef(0, "Alpha", "Value")
    watch = CycleWatch(begins=Condition(place, 5.0, rise=2.0), ends=Condition(place, high=-5.0))
    old, new = (make(build, cycles=[watch]) for _ in range(2))
    old.process(tools.batch(tools.alpha(0.0, -3.0), tools.alpha(10.0, 4.0, count=1)), tools.Collector())
    adopt(new, old, {0: 0}, {0: 0})
    assert new.tables.watches["lowest"].tolist() == old.tables.watches["lowest"].tolist()
    new.process(tools.batch(tools.alpha(20.0, 6.0, count=2)), tools.Collector())
    assert new.tables.cycles[0] == 1, "it has risen by 9 V since the lowest"


def _constant(row, path):
    for name in path.split("."):
        row = row[name]
    return row


def test_every_state_of_a_check_is_counted_in_something():
    states = [name for names in COUNTED_IN for name in names]
    assert sorted(states) == sorted((*CheckState.dtype.names, *SenderState.dtype.names))
    row = np.zeros(1, Check.dtype)[0]
    for constants in COUNTED_IN.values():
        for path in constants:
            _constant(row, path)


def test_every_field_of_the_engine_s_records_is_said_to_be_one_thing():
    for whole, *parts in (
        (DebounceRow, DebouncePlace, DebounceConst, DebounceState),
        (Check, CheckPlace, CheckConst, SenderConst, CheckState, SenderState, CheckRun),
        (Health, HealthPlace, HealthState),
        (Watch, WatchPlace, WatchConst, WatchState),
        (Emit, EmitPlace, EmitConst, EmitState),
        (Handler, HandlerPlace, HandlerState),
        (Vector, VectorPlace, VectorState),
        (Clock, ClockPass, ClockState),
    ):
        names = [name for part in parts for name in part.dtype.names]
        assert sorted(names) == sorted(whole.dtype.names)
    with pytest.raises(TypeError, match="two of its bases have bus"):

        class Both(HandlerPlace, CheckPlace):
            pass

"""Frames that pass as the ones before are counted in runs: what is kept and told is as if each had been reported."""

import numpy as np
import pytest
from amount import examples
from crccheck.crc import Crc8SaeJ1850
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from gateway.bus import conditions as c
from gateway.engine.adopt import adopt
from gateway.engine.checks.bus_health import BusInstance
from gateway.engine.checks.communication import CheckRun
from gateway.engine.gate import Gate

ROOTS = ("a.bus_off", "a.bus_lost")
CHECKS = [
    {"message": "Alpha", "timeout_ms": 30.0, "counter": {"signal": "Count"}, "crc": {"signal": "Crc"}},
    {"message": "Beta", "timeout_ms": 25.0},
]
#: So that runs begin soon.
QUICK = {
    f"comm.{name}": {"passed_after": 2, "failed_after": 2}
    for name in ("Alpha.counter", "Alpha.crc", "Alpha.length", "Beta.length")
}
BENT = 5  # of the frames most pass


@pytest.fixture
def make(build):
    def made():
        gates = {f"comm.{message}.timeout": Gate(roots=ROOTS) for message in ("Alpha", "Beta")}
        return build(("m", 0, {}), checks=CHECKS, debounces=QUICK, gates=gates, buses=[BusInstance("a")])

    return made


def alpha(t_ms, count, *, wrong=False, short=False):
    data = bytes([count % 16]) + (7).to_bytes(2, "little") + bytes(4)
    payload = bytes([Crc8SaeJ1850.calc(data) ^ wrong]) + data
    return (t_ms, 256, payload[:3] if short else payload)


def rows_of(kinds):
    """Make frames of both messages of what is to happen, one thing a step of 5 ms."""
    rows, count = [], 0
    for k, kind in enumerate(kinds):
        t_ms = 5.0 * k + 1
        count += {"repeated": 0, "jump": 3}.get(kind, 1)
        if kind == "late":
            t_ms -= 40
        if kind in ("lost", "running"):
            rows.append((t_ms, 0x2000_0000, bytes([c.LOST if kind == "lost" else c.RUNNING]) + bytes(7)))
        elif kind != "gap":
            rows.append(alpha(t_ms, count, wrong=kind == "wrong", short=kind == "short"))
        if kind not in ("gap", "lost"):
            rows.append((t_ms + 1, 257, bytes(8)))
    return rows


def state_of(engine):
    """Everything that a run might have changed, without the account of the run itself."""
    t = engine.tables
    own = CheckRun.dtype.names
    kept = {"checks": [n for n in t.checks.dtype.names if n not in own and n not in ("samples", "protection")]}
    kept |= {"debounces": t.debounces.dtype.names, "vectors": t.vectors.dtype.names}
    return {
        (table, name): np.array(getattr(t, table)[name]).tolist() for table, names in kept.items() for name in names
    }


KINDS = ("wrong", "short", "repeated", "jump", "gap", "late", "lost", "running")
kinds = st.lists(st.one_of(*[st.just("good")] * BENT, st.sampled_from(KINDS)), min_size=20, max_size=80)
asked = st.lists(st.tuples(st.integers(0, 80), st.sampled_from(["look", "reset", "hold", "free", "step"])), max_size=5)


@settings(max_examples=examples(60), suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(kinds, asked)
@example(["good"] * 16 + ["wrong", "good", "gap", "good"], [])  # a frame is lost right after a rejected one
def test_a_run_leaves_behind_what_its_frames_would_have_left_one_by_one(make, tools, kinds, asked):
    engine, twin = make(), make()
    seen, seen_by_twin = tools.Collector(), tools.Collector()
    runs = 0
    for k, row in enumerate(rows_of(kinds)):
        frame = tools.batch(row)
        engine.process(frame, seen)
        twin.tables.checks["steady"] = 0  # so that each result is reported
        twin.process(frame, seen_by_twin)
        runs = max(runs, int(engine.tables.checks["run"].max()))
        for what in [what for at, what in asked if at == k]:
            for each, sink in ((engine, seen), (twin, seen_by_twin)):
                if what == "look":
                    each.last_buckets = each.take_buckets()
                elif what == "reset":
                    each.reset_debounce()
                elif what == "step":
                    each.process(c.step_frame(each.now_ns, 3_000_000), sink)
                else:
                    each.hold_results(what == "hold")
            if what == "look":
                assert engine.last_buckets.tolist() == twin.last_buckets.tolist()
        assert not twin.tables.checks["run"].any()
    assert seen.events == seen_by_twin.events
    assert engine.take_buckets().tolist() == twin.take_buckets().tolist()
    assert state_of(engine) == state_of(twin)
    assert engine.counters() == twin.counters()
    if kinds[-6:] == ["good"] * 6 and "gap" not in kinds and not asked and "late" not in kinds and "lost" not in kinds:
        assert runs > 0, "it is runs that are compared"


def test_most_frames_are_in_runs(make, tools):
    engine = make()
    engine.process(tools.batch(*rows_of(["good"] * 200)), tools.Collector())
    assert (engine.tables.checks["run"] > 190).all()
    counts = engine.take_buckets()["count"]
    assert not engine.tables.checks["run"].any(), "told when somebody looks"
    names = [slot.id for slot in engine.faults]
    assert {name: int(count) for name, count in zip(names, counts, strict=True) if name.startswith("comm.")} == {
        **{f"comm.Alpha.{kind}": 200 for kind in ("timeout", "counter", "crc", "length")},
        **{f"comm.Beta.{kind}": 200 for kind in ("timeout", "length")},
        "comm.Alpha.rule": 1,
    }


def test_a_cause_on_its_way_ends_the_runs_of_what_it_explains(make, tools):
    engine, seen = make(), tools.Collector()
    engine.process(tools.batch(*rows_of(["good"] * 20)), seen)
    assert engine.tables.checks["run"].all()
    off = next(k for k, slot in enumerate(engine.faults) if slot.id == "a.bus_off")
    engine.set_active(off, True)
    count = engine.take_buckets()["count"]
    engine.process(tools.batch(*[(100.0 + k, 257, bytes(8)) for k in range(5)]), seen)
    place = next(k for k, slot in enumerate(engine.faults) if slot.id == "comm.Beta.timeout")
    assert engine.take_buckets()["count"][place] == 0 < count[place], "its results do not count meanwhile"


def test_a_reload_loses_no_run(make, tools):
    old, new = make(), make()
    old.process(tools.batch(*rows_of(["good"] * 50)), tools.Collector())
    adopt(new, old, {0: 0}, {})
    new.process(tools.batch(*rows_of(["good"] * 66)[100:]), tools.Collector())
    place = next(k for k, slot in enumerate(new.faults) if slot.id == "comm.Beta.length")
    assert new.take_buckets()["count"][place] == 66

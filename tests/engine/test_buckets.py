"""Buckets: no test result is missed, however seldom somebody looks."""

import math

import numpy as np
import pytest
from amount import examples
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gateway.engine.adopt import adopt
from gateway.engine.buckets import Bucket, merge, nearness
from gateway.engine.gate import Condition, Gate
from gateway.signals.tables import SignalRef

FIELDS = ("count", "failed", "numbers", "low", "high", "last", "threshold", "ratio", "worst", "limit", "worst_ns")


def shown(row):
    return {name: row[name].item() for name in FIELDS}


def expected(samples, limit=10.0):
    """What one bucket of (time [ms], value) must say; the monitor fails above its limit."""
    values = [value for _, value in samples]
    at, worst = max(samples, key=lambda s: s[1])
    return {
        "count": len(samples), "failed": sum(v > limit for v in values), "numbers": len(samples), "low": min(values),
        "high": max(values), "last": values[-1], "threshold": limit,
        "ratio": pytest.approx(max(worst / limit, 0.0)), "worst": worst,
        "limit": limit, "worst_ns": round(at * 1e6),
    }  # fmt: skip


def test_a_peak_of_one_sample_is_in_its_bucket_and_in_no_other(build, tools):
    engine = build(("m", 0, {}))
    samples = [(k, 9.5 if k == 137 else 1.0 + k % 3) for k in range(300)]
    for begin in range(0, 300, 50):
        part = samples[begin : begin + 50]
        engine.process(tools.batch(*(tools.alpha(t, v) for t, v in part)), tools.Collector())
        row = engine.take_buckets()[0]
        assert shown(row) == expected(part)
        assert (row["high"] == 9.5) == (begin == 100)
    assert not engine.take_buckets()["count"].any(), "reset when read"


@settings(max_examples=examples(60), suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    # 20 is the limit itself, of which a pass has no scale
    # and a result is often as the one before
    st.lists(
        st.one_of(st.integers(-40, 40).filter(lambda value: value != 20), st.sampled_from([6, 30])),
        min_size=1,
        max_size=40,
    ),
    st.lists(st.integers(1, 39), max_size=4),
)
def test_buckets_of_pieces_merge_into_the_bucket_of_all(build, tools, values, cuts):
    engine = build(("m", 0, {}))
    samples = [(k, value / 2) for k, value in enumerate(values)]
    merged = np.zeros(len(engine.faults), Bucket.dtype)
    for low, high in zip([0, *sorted(cuts)], [*sorted(cuts), len(samples)], strict=True):
        engine.process(tools.batch(*(tools.alpha(t, v) for t, v in samples[low:high])), tools.Collector())
        merge(merged, engine.take_buckets())
    got, want = shown(merged[0]), expected(samples)
    if max(value for _, value in samples) <= 0.0:  # none is nearer than another: the first of them
        for name in ("worst", "worst_ns"):
            got.pop(name), want.pop(name)
    assert got == want


def test_results_that_do_not_count_are_in_no_bucket(build, tools):
    gate = Gate(conditions=(Condition(SignalRef(0, "Alpha", "Value"), high=5.0),))
    engine = build(("m", 0, {}), gates={"m.high": gate})
    engine.process(tools.batch(tools.alpha(0, 3.0), tools.alpha(1, 99.0), tools.alpha(2, 4.0)), tools.Collector())
    row = engine.take_buckets()[0]
    assert (row["count"], row["high"]) == (2, 4.0)


def test_a_reload_loses_no_result(build, tools):
    old, new = build(("m", 0, {})), build(("n", 0, {}), ("m", 1, {}))
    old.process(tools.batch(tools.alpha(0, 8.0), tools.alpha(1, 2.0)), tools.Collector())
    adopt(new, old, {0: 0}, {})
    place = [slot.id for slot in new.faults].index("m.high")
    assert new.take_buckets()[place]["high"] == 8.0


@pytest.mark.parametrize(
    ("failed", "value", "limit", "near"),
    [
        (False, 5.0, 10.0, 0.5), (True, 15.0, 10.0, 1.5), (False, -3.0, 10.0, 0.0),  # from above
        (False, 15.0, 10.0, 0.5), (True, 5.0, 10.0, 1.5),  # from below
        (False, -2.5, -5.0, 0.5), (True, -10.0, -5.0, 2.0),
        (False, -8.0, -4.0, 0.0), (True, -3.0, -4.0, 1.25),
        (False, 0.0, 0.0, 0.0), (True, 1.0, 0.0, 2.0), (False, 10.0, 10.0, 0.0), (True, 10.0, 10.0, 1.0),
    ],
)  # fmt: skip
def test_nearness_is_above_one_for_what_failed_and_below_for_what_passed(failed, value, limit, near):
    assert nearness(failed, value, limit) == pytest.approx(near)
    assert near == 1.0 or (near > 1.0) == failed


def test_what_is_no_number_is_counted_and_spoils_nothing():
    """Through the fold of two buckets: one of NaN alone, then one of numbers."""
    rows = np.zeros(3, Bucket.dtype)
    rows["count"], rows["odd"] = 2, 2
    later = np.zeros(3, Bucket.dtype)
    later[0] = (3, 1, 0, 3, 1.0, 4.0, 2.0, 8.0, 0.5, 4.0, 8.0, 77, 90)
    merge(rows, later)
    assert (rows[0]["count"], rows[0]["odd"], rows[0]["low"], rows[0]["high"]) == (5, 2, 1.0, 4.0)
    assert rows[0]["ratio"] == 0.5
    assert rows[1]["numbers"] == 0
    assert not math.isnan(rows[1]["low"])

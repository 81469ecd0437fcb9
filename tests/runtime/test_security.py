"""Security events: the first is told at once, further ones are counted, and none is lost."""

from __future__ import annotations

from typing import Any

import numpy as np

from gateway.runtime.security import EVERY_NS, MOST, OTHERS, Security


def test_a_flood_is_told_at_a_bounded_rate_and_no_event_is_lost() -> None:
    seed = 5301
    rng = np.random.default_rng(seed)
    told: list[dict[str, Any]] = []
    security = Security(told.append)
    t_ns, given = 0, 0
    for _ in range(20_000):
        t_ns += int(rng.integers(0, EVERY_NS // 500))
        count = int(rng.integers(1, 4))
        given += count
        security.note(t_ns, "powertrain.SPEED", "mac", {"freshness": 7}, count)
    assert told[0]["t_ns"] < EVERY_NS // 500, f"seed {seed}: the first is told at once"
    assert np.diff([event["t_ns"] for event in told]).min() >= EVERY_NS
    security.pass_time(t_ns, final=True)
    assert sum(event["count"] for event in told) == told[-1]["total"] == given, f"seed {seed}"
    assert security.counters() == {"security_events": given}


def test_what_waits_is_told_when_time_passes_also_after_the_clock_was_set_back() -> None:
    told: list[dict[str, Any]] = []
    security = Security(told.append)
    for _ in range(3):
        security.note(10 * EVERY_NS, "powertrain", "unknown", {"identifier": "0x123"})
    security.pass_time(10 * EVERY_NS + 1)
    assert [event["count"] for event in told] == [1]
    security.pass_time(EVERY_NS)
    assert [event["count"] for event in told] == [1, 2]


def test_sensors_beyond_the_most_have_one_place() -> None:
    told: list[dict[str, Any]] = []
    security = Security(told.append)
    for k in range(MOST + 20):
        security.note(k, f"bus.M{k}", "early", {})
    security.pass_time(MOST + 20, final=True)
    assert len(told) == MOST + 2
    assert {(event["sensor"], event["kind"]) for event in told[MOST:]} == {OTHERS}
    assert sum(event["count"] for event in told) == MOST + 20

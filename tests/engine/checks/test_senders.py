"""Who sends a message: its rate over a window, counters that run twice, and nobody else accused meanwhile."""

import numpy as np
import pytest
from checked import MS, frame, run

from gateway.engine.checks.communication import SenderConst, senders
from gateway.engine.checks.message import Params

PERIOD = 10.0
MOST = {"frames": 15, "ms": 100.0}


def failed(seen):
    return {name for name, _ in seen if not name.endswith(" passed")}


def first(seen, name):
    return next(t_ms for each, t_ms in seen if each == name)


def merged(*senders_rows):
    return sorted((row for rows in senders_rows for row in rows), key=lambda row: row[0])


def healthy(count, first_counter=0, pt0=100, phase=0.0):
    return [frame(phase + PERIOD * k, first_counter + k, pt0) for k in range(count)]


@pytest.mark.evidence("Healthy parts: queue")
@pytest.mark.parametrize("seed", range(4))
def test_frames_that_queue_are_no_second_sender(seed):
    """A healthy sender whose frames come up to 40 ms late, and then at once."""
    rng = np.random.default_rng(7100 + seed)
    stamps, now = [], 0.0
    for k in range(3000):
        now = max(now + 0.1, PERIOD * k + (40.0 * rng.random() if rng.random() < 0.2 else 0.0))
        stamps.append(now)
    rows = [frame(stamp, k) for k, stamp in enumerate(stamps)]
    _, seen, _ = run(rows, most=MOST)
    assert failed(seen) == set(), f"seed {7100 + seed}"
    assert {"early passed", "second_sender passed"} <= {name for name, _ in seen}


@pytest.mark.evidence("Healthy parts: second sender")
@pytest.mark.parametrize("offset", [1, 3, 100, 254])
def test_a_second_sender_is_named_and_no_other_check_accuses(offset):
    """Two counts, at an unknown phase: the values of both are used no more, and those before stay."""
    alone, both = healthy(100), healthy(200, 100)
    second = [frame(1000.0 + PERIOD * k + 3.7, 100 + k + offset, 60) for k in range(200)]
    rows = [*alone, *merged([(t + 1000 * MS, data) for t, data in both], second)]
    engine, seen, value = run(rows, most=MOST)
    assert "early" in failed(seen)
    assert failed(seen) <= {"early", "second_sender"}
    if offset > 1:  # one count of two that differ by one is as frames that are repeated
        assert 1000 <= first(seen, "second_sender") < 1100
    assert 1000 <= first(seen, "early") < 1200
    counters = engine.counters()
    assert counters["doubtful"] + counters["repeated"] > 350
    assert value in (60, 100)


def test_frames_sent_twice_fail_by_their_rate_alone():
    rows = merged(healthy(300), [(t + MS, data) for t, data in healthy(300)[100:]])
    _, seen, _ = run(rows, most=MOST)
    assert failed(seen) == {"early"}
    assert 1000 <= first(seen, "early") < 1150


def test_one_sender_with_another_cycle_is_used_and_told():
    rows = [frame(4.0 * k, k, 55) for k in range(500)]
    engine, seen, value = run(rows, most=MOST)
    assert failed(seen) == {"early"}
    assert value == 55
    assert engine.counters()["doubtful"] == 0, "its counter runs once: there is one sender"


def test_it_heals_when_the_second_one_is_gone():
    second = [frame(300.0 + PERIOD * k + 5.0, 77 + k) for k in range(100)]
    engine, seen, _ = run(merged(healthy(600), second), most=MOST)
    last = max(t_ms for name, t_ms in seen if name in ("early", "second_sender"))
    assert any(name == "early passed" and t_ms > last for name, t_ms in seen)
    assert any(name == "second_sender passed" and t_ms > last for name, t_ms in seen)
    before = engine.counters()["doubtful"]
    assert 100 < before < 300


def test_lost_frames_are_no_second_sender():
    """Half of the rows lost in bursts: the counter fails as before, nothing speaks of another sender."""
    seed = 7200
    rng = np.random.default_rng(seed)
    rows = [row for k, row in enumerate(healthy(4000)) if rng.random() < 0.7 or k < 10]
    _, seen, _ = run(rows, most=MOST)
    assert "counter" in failed(seen), f"seed {seed}"
    assert failed(seen) == {"counter"}, f"seed {seed}"


@pytest.mark.parametrize(("frames", "expected"), [(1, 1), (7, 7), (8, 8), (9, 10), (15, 16), (100, 104), (799, 800)])
def test_a_window_keeps_few_stamps_at_the_same_rate(frames, expected):
    row = np.zeros(1, [*SenderConst.dtype.descr, ("left", "<i4")])[0]
    senders.fill(row, Params(message="M", most={"frames": frames, "ms": 50.0}).most)
    assert row["stride"] * row["slots"] == expected
    assert row["most_ns"] / expected == pytest.approx(50.0 * MS / frames, rel=1e-6)
    rows = [frame(0.02 * k, k) for k in range(frames + 40)]
    _, seen, _ = run(rows, most={"frames": frames, "ms": 1000.0}, timeout_ms=None)
    assert "early" in failed(seen)
    assert first(seen, "early") == int(0.02 * expected)


def test_a_frame_of_another_length_is_told_and_not_used():
    rows = [frame(10 * k, k) for k in range(10)] + [
        (t, data + b"\0") for t, data in [frame(100 + 10 * k, 10 + k, 60) for k in range(5)]
    ]
    _, seen, value = run(rows, length=8)
    assert failed(seen) == {"length"}
    assert value == 100
    _, seen, value = run(rows)
    assert "length" not in failed(seen)


@pytest.mark.parametrize("phase", [0.1, 0.4, 0.6, 0.9])
def test_wrong_checksums_between_right_frames_are_not_the_senders(phase):
    """Payloads by chance beside a healthy sender: its rate is told, its checksum never; a broken sender's is."""
    seed = 7300
    rng = np.random.default_rng(seed)
    fuzz = [
        (round((300.0 + PERIOD * (k + phase)) * MS), bytes(rng.integers(0, 256, 8, np.uint8).tolist()))
        for k in range(40)
    ]
    _, seen, _ = run(merged(healthy(120), fuzz), most=MOST)
    assert failed(seen) == {"early"}, f"seed {seed}"
    broken = [frame(PERIOD * k, k, corrupt=k > 60) for k in range(100)]
    _, seen, _ = run(broken, most=MOST)
    assert failed(seen) == {"crc"}

"""Frames that wait, because a sender or a gateway gets no turn: the steering monitor blames nobody for it."""

import numpy as np
import pytest
from amount import amount
from hypothesis import given
from hypothesis import strategies as st

from gateway.config.load import load_config
from gateway.monitors import sampling
from gateway.monitors.sampling import Sampling
from gateway.runtime.app import Gateway
from gateway_bench.vecu.player import Player
from gateway_bench.vecu.scenario import load_scenario
from gateway_fdi.common.resources import shipped
from gateway_fdi.jit import COMPILED, zeros
from gateway_plants.steering.monitor import kinematics
from gateway_replay.replay import replay

PERIOD = 10_000_000
compiled = pytest.mark.skipif(not COMPILED, reason="thousands of steps of the whole monitor")


def paused(frames, rng, per_second, longest_ns):
    """Return frames that come as if all senders stood still now and then, and caught up in a burst."""
    t = frames["t_ns"].copy()
    at = 0.0
    while (at := at + rng.exponential(1e9 / per_second)) < frames["t_ns"][-1]:
        until = int(at + rng.uniform(2e6, longest_ns))
        waits = (t >= at) & (t < until)
        t[waits] = until + np.arange(waits.sum()) * 60_000  # frames take their time on the bus
    late = frames.copy()
    late["t_ns"] = np.maximum.accumulate(t)
    return late


def reported(name, seed, per_second, longest_ns):
    """Return (time [s], DTC) of everything that failed in a scenario with such pauses."""
    print("seed", seed)
    scenario = load_scenario(shipped(f"scenarios/{name}.toml"))
    player = Player(scenario, {"chassis": 0})
    gateway = Gateway(load_config(scenario.config))
    events = []
    gateway.listen(events.append)
    late = paused(player.frames, np.random.default_rng(seed), per_second, longest_ns)
    replay(gateway, np.array_split(late, 200))
    gateway.close()
    failed = [(e["t_ns"] / 1e9, e["dtc"]) for e in events if e["event"] == "dtc" and e["status"] & 1]
    return failed, scenario


@compiled
@pytest.mark.parametrize("seed", range(amount(8, 2)))
def test_long_pauses_blame_no_part(seed):
    """Pauses of up to 60 ms, four a second: messages may be called lost, but no sensor is."""
    failed, _ = reported("steering_healthy", seed, 4.0, 60e6)
    assert [dtc for _, dtc in failed if not dtc.startswith("U")] == []


@pytest.mark.long
@compiled
@pytest.mark.parametrize("seed", range(amount(4, 1)))
@pytest.mark.parametrize("name", ["steering_parts", "steering_angle"])
def test_short_pauses_hide_no_fault(name, seed):
    """Of up to 20 ms, three a second: each fault is named as without them, and nothing else."""
    failed, scenario = reported(name, seed, 3.0, 20e6)
    for expected in scenario.expect:
        times = [t for t, dtc in failed if dtc == expected.dtc]
        if expected.absent:
            assert times == []
        else:
            assert times, expected.dtc
            assert expected.by_s is None or times[0] <= expected.by_s
            assert times[0] >= expected.after_s
    allowed = {expected.dtc for expected in scenario.expect} | {"C1A01-64"}
    assert {dtc for _, dtc in failed} <= allowed


@pytest.mark.long
@compiled
@pytest.mark.parametrize("seed", range(amount(5, 1)))
@pytest.mark.parametrize("name", ["steering_parts", "steering_angle"])
def test_long_pauses_hide_hardly_a_fault(name, seed):
    """Of up to 60 ms, four a second: what is named is right, or said not to be known; at most one fault is late."""
    failed, scenario = reported(name, seed, 4.0, 60e6)
    due = [expected for expected in scenario.expect if not expected.absent]
    late = [e.dtc for e in due if not any(d == e.dtc and e.after_s <= t <= (e.by_s or np.inf) for t, d in failed)]
    assert len(late) <= 1, late
    others = {dtc for _, dtc in failed} - {expected.dtc for expected in due} - {"C1A01-64", "C1A07-62"}
    assert [dtc for dtc in others if not dtc.startswith("U")] == []


class Samples(sampling.State, lengths={"messages": 1}):
    """What has come."""


def dated(arrivals, counters):
    """Return when each frame was sampled, and whether that is sure; one that is no sample is not."""
    x, c, s = zeros(1, Samples)[0], zeros(1, sampling.Const)[0], zeros(1, kinematics.Dated)[0]
    sampling.prepare(c, Sampling("counter", PERIOD * 1e-6, np.inf, 1000.0 * PERIOD * 1e-6), 1)
    found = []
    for t, k in zip(arrivals, counters, strict=True):
        if sampling.take(x, c, 0, int(t), float(k)) != sampling.SAMPLE:
            found.append((int(t), False))
            continue
        kinematics.date(s, int(t), sampling.waited(x, c, 0, int(t)), float(x["gap"]), float(PERIOD))
        found.append((int(s["at_ns"]), kinematics.sure(s, float(PERIOD))))
    return found


@given(st.lists(st.integers(0, 9 * PERIOD), min_size=80, max_size=200), st.integers(0, 15))
def test_a_frame_that_waited_is_dated_like_one_that_did_not(waits, first):
    """Every fifth frame is punctual; the others wait for up to nine periods, in order."""
    k = np.arange(len(waits))
    sampled = 1_000_000_000 + k * PERIOD
    arrivals = np.maximum.accumulate(sampled + np.where(k % 5 == 0, 0, waits))
    punctual = np.flatnonzero(arrivals == sampled)
    dates = dated(arrivals, (first + k) % 16)
    if len(punctual):
        for j in range(punctual[0], len(k)):
            assert abs(dates[j][0] - sampled[j]) <= 1
    for date, arrived in zip(dates, arrivals, strict=True):
        assert date[0] <= arrived


@pytest.mark.parametrize("seed", range(3))
def test_a_slow_clock_lost_frames_and_waits(seed):
    """Frames of 10 ms, some up to 9 ms late, a sender's clock 100 ppm slow, one frame in 50 lost."""
    rng = np.random.default_rng(seed)
    print("seed", seed)
    k = np.flatnonzero(rng.random(2000) >= 0.02)
    sampled = 5_000_000_000 + k * 10_001_000
    dates = dated(sampled + rng.integers(0, 2, len(k)) * rng.integers(0, 9_000_000, len(k)), k % 16)
    errors = np.array([date for date, _ in dates]) - sampled
    assert np.abs(errors[20:]).max() < 150_000  # of two windows of 64 frames


@given(st.integers(1, 14), st.integers(20, 60))
def test_lost_frames_do_not_move_the_dates(lost, begin):
    k = np.delete(np.arange(100), np.arange(begin, begin + lost))
    dates = dated(k * PERIOD, k % 16)
    assert [date for date, _ in dates] == pytest.approx(k * PERIOD, abs=1)
    # Until it is sure that they were lost: a silence that the counter explains is no doubt.
    assert all(sure for _, sure in dates[kinematics.SETTLES + 1 :])


@pytest.mark.parametrize("shift", [3, 70, 143, 157, 1000])
def test_a_sender_that_starts_anew_is_dated_anew_and_not_relied_on_meanwhile(shift):
    """Its counter and its periods begin somewhere else; a wrong date is never called sure."""
    k = np.arange(60)
    before, after = k * PERIOD, 60 * PERIOD + shift * 1_000_000 + np.arange(300) * PERIOD
    dates = dated(np.concatenate([before, after]), np.concatenate([k % 16, np.arange(300) % 16]))
    assert dates[-1][1]
    assert after[-1] - dates[-1][0] <= kinematics.TOLERANCE_NS
    for (date, sure), t in zip(dates[60:], after, strict=True):
        assert not sure or t - date <= kinematics.TOLERANCE_NS


def test_behind_a_long_silence_the_date_is_that_of_arrival_and_soon_relied_on():
    """33 frames are lost: the counter says one."""
    k = np.concatenate([np.arange(40), np.arange(73, 120)])
    dates = dated(k * PERIOD, k % 16)
    assert dates[40][0] == k[40] * PERIOD
    assert not any(sure for _, sure in dates[40 : 40 + kinematics.SETTLES])
    assert all(sure for _, sure in dates[40 + kinematics.SETTLES :])


def test_what_comes_too_early_shows_that_all_before_had_waited():
    """All frames came 5 ms late until now: those dates were wrong, and the next are not relied on at once."""
    k = np.arange(80)
    dates = dated(k * PERIOD + np.where(k < 40, 5_000_000, 0), k % 16)
    assert dates[39][1]
    assert dates[40][0] == 40 * PERIOD
    assert not any(sure for _, sure in dates[40 : 40 + kinematics.SETTLES])
    assert dates[-1][1]

"""The crankshaft monitor on the bus: frames, losses, restarts, EngineSync."""

import cantools
import numpy as np
import pytest
from amount import SMALL, amount

import gateway_api as api
from gateway.bus.frames import payload
from gateway.engine.build import build_engine
from gateway.engine.instances import MonitorInstance
from gateway.monitors.contract import FAILED
from gateway.signals.database import load_database
from gateway_fdi.common.resources import shipped
from gateway_fdi.jit import COMPILED
from gateway_plants.crank.ecu.kinematics import tooth_times
from gateway_plants.crank.ecu.tooth_frames import tooth_frames
from gateway_plants.crank.monitor import MONITOR
from gateway_plants.crank.monitor.faults import FAULTS
from gateway_plants.crank.monitor.monitor import Params
from gateway_plants.crank.monitor.sync_state import CONFIRMED
from gateway_plants.crank.study.cases import healthy
from gateway_plants.crank.wheel import Wheel

GATEWAY_DBC = shipped("dbc/gateway.dbc")
SYNC = cantools.database.load_file(GATEWAY_DBC).get_message_by_name("GW_EngineSync")


def engine_of(form="classic", wheel="60-2", send=False, **params):
    database = load_database([shipped("dbc/crank.dbc")])
    emission = load_database([GATEWAY_DBC]).message("GW_EngineSync") if send else None
    chosen = Params(wheel=wheel, frame=form, **params)
    monitor = MonitorInstance("crank", MONITOR, chosen, emission=emission)
    return build_engine([(0, database)], [monitor], [])


def feed(engine, frames):
    """Feed frame by frame; returns the failed test results and the frames sent."""
    failed, sent = [], []
    for frame in frames:
        sent.append(
            engine.process(
                frame.reshape(1),
                lambda events: failed.extend(events["fault"][events["result"] == FAILED].tolist()),
            )
        )
    return failed, np.concatenate(sent)


def state_of(engine):
    state = engine._states[0][0]
    return state, state["fast"]


@pytest.mark.costly
@pytest.mark.parametrize("form", ["classic", "fd"])
@pytest.mark.parametrize("share", [0.01, 0.05, 0.2])
def test_frames_lost_on_the_bus_do_not_shift_the_labels(form, share):
    """A lost frame is known by its counter; its pulses were there."""
    w = Wheel.parse("60-2")
    times = tooth_times(w, [(0, 1500)], amount(20.0, 20.0, 1.5), rng=np.random.default_rng(4))
    frames = tooth_frames(times, form)
    rng = np.random.default_rng(6)
    print("seeds 4, 6")
    lost = rng.random(len(frames)) < share
    lost[: len(frames) // 5] = lost[-1] = False
    engine = engine_of(form)
    failed, _ = feed(engine, frames[~lost])
    assert lost.sum() > 3 or SMALL
    assert failed == []
    _, state = state_of(engine)
    # Interval k of the train is interval k % 58 of the wheel, lost frames or not.
    sent = len(times) - 1
    assert state["index"] == sent % w.pulses


@pytest.mark.costly
@pytest.mark.parametrize("form", ["classic", "fd"])
@pytest.mark.parametrize(("share", "told"), [(0.2, False), (0.6, True)])
def test_above_the_loss_where_diagnosis_ends_the_monitor_says_so(form, share, told):
    """Of six frames in ten nothing is known: the bus is told of, and nothing of the sensor."""
    times = tooth_times(Wheel.parse("60-2"), [(0, 3000)], 8.0, rng=np.random.default_rng(4))
    frames = tooth_frames(times, form)
    lost = np.random.default_rng(8).random(len(frames)) < share
    print("seeds 4, 8")
    lost[: len(frames) // 10] = lost[-1] = False
    failed, _ = feed(engine_of(form), frames[~lost])
    assert {FAULTS[k].name for k in failed} == ({"frames_lost"} if told else set())


@pytest.mark.long
def test_slow_teeth_lost_on_the_bus_are_put_right_by_the_base_frame():
    """At 150 rpm a frame leaves before it is full: how many pulses went with it only CTW_BASE tells."""
    w = Wheel.parse("60-2")
    times = tooth_times(w, [(0, 150)], 20.0, rng=np.random.default_rng(4))
    frames = tooth_frames(times, "classic")
    lost = np.random.default_rng(7).random(len(frames)) < 0.1
    print("seeds 4, 7")
    lost[: len(frames) // 4] = False
    lost[frames["can_id"] == 0x701] = False
    lost[-200:] = False
    engine = engine_of()
    failed, _ = feed(engine, frames[~lost])
    top, state = state_of(engine)
    assert lost.sum() > 10
    assert failed == []
    assert state["phase"] == CONFIRMED
    assert state["index"] == (len(times) - 1) % w.pulses
    assert top["count"] == (len(times) - 1) % 65536


@pytest.mark.long
@pytest.mark.parametrize("form", ["classic", "fd"])
def test_an_ecu_that_restarts_is_followed_again(form):
    w = Wheel.parse("60-2")
    times = tooth_times(w, [(0, 1500)], 3.0, rng=np.random.default_rng(4))
    first = tooth_frames(times[:5000], form)
    first = first[: 150 if form == "classic" else 40]
    again = tooth_frames(times, form)
    again["t_ns"] += int(first["t_ns"][-1])
    engine = engine_of(form)
    failed, _ = feed(engine, np.concatenate([first, again]))
    _, state = state_of(engine)
    assert failed == []
    assert state["phase"] == CONFIRMED
    assert state["index"] == (len(times) - 1) % w.pulses


@pytest.mark.long
def test_engine_sync_tells_angle_and_speed_in_the_same_batch():
    w = Wheel.parse("36-1")
    times = tooth_times(w, [(0, 3000)], 2.0, rng=np.random.default_rng(1))
    gone = np.delete(times, 35 * 60 + 12)
    frames = tooth_frames(gone, "fd")
    engine = engine_of("fd", wheel="36-1", send=True, tooth_0_deg=84.0)
    _, sent = feed(engine, frames)
    values = [SYNC.decode(payload(frame), decode_choices=False) for frame in sent]
    assert all(int(frame["can_id"]) == 0x6F1 for frame in sent)
    assert values[0]["SyncState"] == 0
    assert values[-1]["SyncState"] == 2
    assert values[-1]["EngineSpeed"] == pytest.approx(3000, rel=0.002)
    assert values[-1]["Corrections"] == 1
    assert [v["FrameCnt"] for v in values] == [k % 16 for k in range(len(values))]
    # The angle is that of the last tooth in the frame of the same time stamp.
    angles = np.array(w.positions) / w.turn * 360
    for frame, v in zip(sent, values, strict=True):
        if v["SyncState"]:
            last = int(np.searchsorted(times, frame["t_ns"] - 354_000, side="right")) - 1
            expected = (angles[last % 35] + 84.0) % 360
            assert v["CrankAngle"] == pytest.approx(expected, abs=0.02)
            assert v["ToothIndex"] == last % 35
    # Never more often than every 10 ms, but for a change.
    spacing = np.diff(sent["t_ns"])
    assert (spacing < 10_000_000).sum() <= 4


@pytest.mark.long
def test_no_message_is_sent_unless_asked():
    times = tooth_times(Wheel.parse("60-2"), [(0, 3000)], 1.0, rng=np.random.default_rng(1))
    _, sent = feed(engine_of(), tooth_frames(times, "classic"))
    assert len(sent) == 0


@pytest.mark.long
@pytest.mark.skipif(not COMPILED, reason="statistics need the compiled kernels")
@pytest.mark.parametrize("form", ["classic", "fd"])
@pytest.mark.parametrize("share", [0.0, 0.01, 0.05, 0.2])
def test_bus_loss_at_6000_rpm(form, share):
    """116,000 teeth with ripple and jitter: no report, wrong labels at most 0.03 % of those proven.

    Behind a hole the place is proven again by the next gap that no hole touches: seldom with a fifth of the small
    frames lost.
    """
    w = Wheel.parse("60-2")
    rng = np.random.default_rng(17)
    print("seed 17")
    times = (healthy(w, [(0.0, 6000.0)], 20.0, rng) * 1e3).astype(np.int64)
    frames = tooth_frames(times, form)
    lost = rng.random(len(frames)) < share  # from the first frame on: also before there is a place to lose
    engine = engine_of(form)
    _, state = state_of(engine)
    failed, told, wrong = [], 0, 0
    delay = 242_000 if form == "classic" else 354_000
    for frame in frames[~lost]:
        engine.process(frame.reshape(1), lambda events: failed.extend(events["result"] == FAILED))
        if frame["can_id"] != 0x701 and state["phase"] == CONFIRMED:
            last = int(np.searchsorted(times, frame["t_ns"] - delay, side="right")) - 1
            told += 1
            wrong += int(state["index"]) != last % w.pulses
    print(f"{form} {share}: {wrong} of {told} wrong")
    assert not any(failed)
    least = {("classic", 0.05): 0.6, ("classic", 0.2): 0.25, ("fd", 0.2): 0.75}.get((form, share), 0.9)
    assert told > least * (frames[~lost]["can_id"] != 0x701).sum()
    assert wrong <= 3e-4 * told


@pytest.mark.long
@pytest.mark.skipif(not COMPILED, reason="statistics need the compiled kernels")
@pytest.mark.parametrize("form", ["classic", "fd"])
def test_bus_loss_from_the_first_frame_is_not_blamed_on_the_sensor(form):
    """40 starts with 20 % lost: synchronisation is proven in spite of it, and no gap is called missing."""
    w = Wheel.parse("60-2")
    print("seeds (31, 0) to (31, 39)")
    for seed in range(40):
        rng = np.random.default_rng([31, seed])
        times = (healthy(w, [(0.0, 6000.0)], 1.0, rng) * 1e3).astype(np.int64)
        frames = tooth_frames(times, form)
        engine = engine_of(form, send=True)
        failed, sent = feed(engine, frames[rng.random(len(frames)) >= 0.2])
        assert failed == [], seed
        states = [SYNC.decode(payload(frame), decode_choices=False)["SyncState"] for frame in sent]
        assert CONFIRMED in states, seed


@pytest.mark.skipif(not COMPILED, reason="seconds of frames")
def test_a_base_frame_whose_crc_is_wrong_counts_no_pulses():
    """A bit of PulseCnt flipped in three of ten: "frames_lost" was told of the bus, as nothing checked CTW_BASE."""
    rng = np.random.default_rng(71)
    frames = tooth_frames(tooth_times(Wheel.parse("60-2"), [(0, 1500.0)], 6.0, rng=rng), "classic")
    print("seed 71")
    base = np.flatnonzero(frames["can_id"] == 0x701)[5:]
    damaged = base[rng.random(len(base)) < 0.3]
    bits = rng.integers(16, size=len(damaged))
    frames["data"][damaged, 2 + bits // 8] ^= (1 << bits % 8).astype(np.uint8)
    lost = (frames["can_id"] == 0x700) & (rng.random(len(frames)) < 0.05)
    with api.open("gateway.toml").session() as session:
        events = session.feed(frames[~lost], bus="powertrain")
    failed = {event["fault"] for event in events if event.get("result") == "failed"}
    assert failed == {"powertrain.CTW_PT4.counter", "powertrain.CTW_BASE.crc"}

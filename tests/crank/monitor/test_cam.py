"""The cam sensor: which half of the working cycle it is, and when it does not fit."""

import cantools
import numpy as np
import pytest
from amount import amount

from gateway.bus.frames import payload
from gateway.engine.build import build_engine
from gateway.engine.instances import MonitorInstance
from gateway.monitors.contract import FAILED
from gateway.signals.database import load_database
from gateway_fdi.common.resources import shipped
from gateway_plants.crank.ecu.kinematics import cam_edges
from gateway_plants.crank.ecu.tooth_frames import cam_frames, tooth_frames
from gateway_plants.crank.monitor import MONITOR
from gateway_plants.crank.monitor.faults import CAM_CORRELATION, CAM_SILENT, DAMAGED, FAULTS, MISSED, TWO_PLACES
from gateway_plants.crank.monitor.monitor import Params
from gateway_plants.crank.study.cases import healthy
from gateway_plants.crank.wheel import Wheel

GATEWAY_DBC = shipped("dbc/gateway.dbc")
SYNC = cantools.database.load_file(GATEWAY_DBC).get_message_by_name("GW_EngineSync")
HALF_MOON = ((100.0, 1), (460.0, 0))
SPEED = [(0.0, 900.0), (2.0, 2500.0)]
SECONDS = amount(4.0, 4.0, 1.0)


def run(
    form, edges, told, *, drop=None, shift_deg=0.0, lost=0.0, silent_after=None, tooth_0=0.0, wheel="60-2", broken=None
):
    """Feed an engine with a cam; returns failed faults and (time, angle, cycle known) of EngineSync."""
    w = Wheel.parse(wheel)
    rng = np.random.default_rng(8)
    print("seed 8")
    times = (healthy(w, SPEED, SECONDS, rng, ripple=((2.0, 0.01),), jitter=0.005) * 1e3).astype(np.int64)
    if broken is not None:
        times = times[np.arange(len(times)) % w.pulses != broken]
    if drop is not None:
        times = np.delete(times, drop)
    at, levels = cam_edges([((a + shift_deg) % 720, v) for a, v in edges], SPEED, SECONDS)
    if silent_after is not None:
        at, levels = at[at < silent_after * 1e9], levels[at < silent_after * 1e9]
    frames = np.concatenate([tooth_frames(times, form), cam_frames(times, at, levels)])
    frames = frames[np.argsort(frames["t_ns"], kind="stable")]
    gone = rng.random(len(frames)) < lost
    gone[: len(frames) // 4] = False
    monitor = MonitorInstance(
        "crank",
        MONITOR,
        Params(wheel=wheel, frame=form, cam=told, tooth_0_deg=tooth_0),
        emission=load_database([GATEWAY_DBC]).message("GW_EngineSync"),
    )
    engine = build_engine([(0, load_database([shipped("dbc/crank.dbc")]))], [monitor], [])
    failed = []
    sent = engine.process(frames[~gone], lambda e: failed.extend(e["fault"][e["result"] == FAILED].tolist()))
    # Angles are compared where a frame of teeth has just come: its last tooth is the latest pulse.
    sent = sent[np.isin(sent["t_ns"], frames["t_ns"][np.isin(frames["can_id"], [0x700, 0x703])])]
    values = [SYNC.decode(payload(f), decode_choices=False) for f in sent]
    return failed, times, sent["t_ns"], values


def true_angle(times, stamp, form, teeth=58):
    """Angle of the last tooth told in a frame of a healthy train, 0..720."""
    delay = 242_000 if form == "classic" else 354_000
    last = int(np.searchsorted(times, stamp - delay, side="right")) - 1
    positions = np.array(Wheel.parse("60-2").positions) * 6
    return last // teeth % 2 * 360 + positions[last % teeth]


@pytest.mark.parametrize("form", ["classic", "fd"])
@pytest.mark.parametrize("edges", [HALF_MOON, ((350.0, 1), (10.0, 0)), ((0.0, 1), (180.0, 0), (300.0, 1), (500.0, 0))])
def test_the_half_of_the_cycle_is_known_and_right(form, edges):
    failed, times, stamps, values = run(form, edges, edges)
    assert failed == []
    known = [k for k, v in enumerate(values) if v["CycleKnown"]]
    assert len(known) > 0.7 * len(values)
    for k in known:
        assert values[k]["CrankAngle"] == pytest.approx(true_angle(times, stamps[k], form), abs=0.02)
    assert max(v["CrankAngle"] for v in values) > 600


@pytest.mark.costly
def test_the_half_counts_from_tooth_0_wherever_that_is():
    """The same cam described by crank angles of an engine whose tooth 0 stands at 84 degrees."""
    told = tuple(((angle + 84.0) % 720, level) for angle, level in HALF_MOON)
    failed, times, stamps, values = run("fd", HALF_MOON, told, tooth_0=84.0)
    assert failed == []
    known = [k for k, v in enumerate(values) if v["CycleKnown"]]
    assert known
    for k in known:
        expected = (true_angle(times, stamps[k], "fd") + 84.0) % 720
        assert values[k]["CrankAngle"] == pytest.approx(expected, abs=0.02)


@pytest.mark.parametrize("drop", [[58 * 10 - 1], [58 * 10, 58 * 10 + 1], [58 * 10 + 30]])
def test_a_missed_pulse_does_not_turn_the_half(drop):
    failed, times, stamps, values = run("fd", HALF_MOON, HALF_MOON, drop=drop)
    assert CAM_CORRELATION not in failed
    last = int(np.searchsorted(times, stamps[-1] - 354_000, side="right")) - 1 + len(drop)
    assert last > drop[-1] + 58
    positions = np.array(Wheel.parse("60-2").positions) * 6
    assert values[-1]["CycleKnown"] == 1
    expected = last // 58 % 2 * 360 + positions[last % 58]
    assert values[-1]["CrankAngle"] == pytest.approx(expected, abs=0.02)


@pytest.mark.parametrize("form", ["classic", "fd"])
def test_frames_lost_do_not_turn_the_half(form):
    failed, *_ = run(form, HALF_MOON, HALF_MOON, lost=0.05)
    assert failed == []


@pytest.mark.parametrize("shift", [60.0, -60.0, 360.0])
def test_a_cam_that_does_not_fit_the_crank(shift):
    """A tooth of the timing chain skipped: 60 degrees; a half turn of the cam only shows as the other half."""
    failed, *_ = run("classic", HALF_MOON, HALF_MOON, shift_deg=shift)
    assert set(failed) == (set() if shift == 360.0 else {CAM_CORRELATION})
    assert FAULTS[CAM_CORRELATION].dtc == "P0016-76"


def test_a_cam_that_falls_silent():
    failed, *_ = run("classic", HALF_MOON, HALF_MOON, silent_after=0.5)
    assert set(failed) == {CAM_SILENT}


@pytest.mark.costly
def test_edges_in_both_halves_tell_nothing_and_disturb_nothing():
    same = ((100.0, 1), (200.0, 0), (460.0, 1), (560.0, 0))
    failed, _, _, values = run("classic", same, same)
    assert failed == []
    assert not any(v["CycleKnown"] for v in values)


@pytest.mark.parametrize("broken", [8, 17, 26])
def test_the_cam_decides_which_of_two_equal_gaps_is_the_wheels_own(broken):
    """36-1 with a tooth broken off before the start: proven at the right place, though pulses fit two of them."""
    failed, times, stamps, values = run("fd", HALF_MOON, HALF_MOON, wheel="36-1", broken=broken)
    assert CAM_CORRELATION not in failed
    assert MISSED in failed
    assert set(failed) <= {TWO_PLACES, MISSED, DAMAGED}
    assert values[-1]["SyncState"] == 2
    last = int(np.searchsorted(times, stamps[-1] - 354_000, side="right")) - 1
    teeth = np.delete(np.arange(35), broken)
    assert values[-1]["ToothIndex"] == teeth[last % 34]

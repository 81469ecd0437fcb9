"""Wheels of 1 to 3 pulses a turn, and wheels of equal pitches: speed, faults, and a place by the cam."""

import cantools
import numpy as np
import pytest
from amount import amount, examples
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from gateway.bus.frames import payload
from gateway.engine.build import build_engine
from gateway.engine.instances import MonitorInstance
from gateway.monitors.contract import FAILED
from gateway.signals.database import load_database
from gateway_fdi.common.resources import shipped
from gateway_fdi.jit import zeros
from gateway_plants.crank.ecu.kinematics import cam_edges, tooth_times
from gateway_plants.crank.ecu.tooth_frames import cam_frames, tooth_frames
from gateway_plants.crank.monitor import MONITOR, sync_state
from gateway_plants.crank.monitor.faults import FAULTS
from gateway_plants.crank.monitor.monitor import Params, _facts, sure_rpm
from gateway_plants.crank.study.follow import follower
from gateway_plants.crank.wheel import Wheel

GATEWAY_DBC = shipped("dbc/gateway.dbc")
SYNC = cantools.database.load_file(GATEWAY_DBC).get_message_by_name("GW_EngineSync")
SPEED_ONLY, PROVEN = 3, 2
HALF_MOON = ((100.0, 1), (460.0, 0))
FOUR = ((0.0, 1), (180.0, 0), (300.0, 1), (500.0, 0))
FEW, EVEN = ("1", "2", "3"), ("6", "24", "135", "360")


def driven(
    wheel,
    form,
    *,
    real=None,
    cam=(),
    tolerance=25.0,
    speed=((0, 900), (3, 3500)),
    seconds=4.0,
    seed=1,
    gone=(),
    ripple=(),
    events=None,
    late_ns=0,
):
    """Drive an engine whose first pulse is any; returns failed faults, what was sent, and tooth and speed then.

    ``events`` takes those of faults. By ``late_ns`` the cam is late in the second half of the time.
    """
    print(f"seed {seed}")
    w, rng = Wheel.parse(real or wheel), np.random.default_rng([seed, 44])
    if not ripple and w.pulses < 12:
        ripple = [(0.5, 0.03, 1.0), (1.0, 0.02, 2.0)]
    times = tooth_times(w, speed, seconds, ripple=ripple, jitter=0.003, rng=rng)
    first = int(rng.integers(2, 2 * w.pulses + 2))
    teeth = np.delete(np.arange(len(times)), gone)[first:]
    times = np.delete(times, gone)[first:]
    frames = tooth_frames(times, form)
    if cam:
        at, levels = turned_cam(cam, speed, seconds, ripple) if w.pulses >= 12 else cam_edges(cam, speed, seconds)
        at = at + np.where(at > seconds * 5e8, late_ns, 0)
        frames = np.concatenate([frames, cam_frames(times, at[at > times[0]], levels[at > times[0]])])
        frames = frames[np.argsort(frames["t_ns"], kind="stable")]
    monitor = MonitorInstance(
        "crank",
        MONITOR,
        Params(wheel=wheel, frame=form, cam=cam, cam_tolerance_deg=tolerance),
        emission=load_database([GATEWAY_DBC]).message("GW_EngineSync"),
    )
    engine = build_engine([(0, load_database([shipped("dbc/crank.dbc")]))], [monitor], [])
    events = [] if events is None else events
    sent = engine.process(frames, lambda e: events.extend(e[e["result"] == FAILED].copy()))
    failed = [e["fault"] for e in events]
    alone = frames["t_ns"][np.isin(frames["can_id"], [0x700, 0x703])]
    sent = sent[np.isin(sent["t_ns"], alone)]
    last = np.searchsorted(times, sent["t_ns"] - (242_000 if form == "classic" else 354_000), side="right") - 1
    values = [SYNC.decode(payload(frame), decode_choices=False) for frame in sent]
    speeds = np.interp(sent["t_ns"] / 1e9, [t for t, _ in speed], [rpm for _, rpm in speed])
    return [FAULTS[k].name for k in failed], values, teeth[last], speeds


def turned_cam(edges, speed, seconds, ripple):
    """Times [ns] and levels of a cam's edges at whole degrees, of an engine whose speed has a ripple."""
    rng = np.random.default_rng(0)
    degrees = tooth_times(Wheel.parse("360"), speed, seconds, ripple=ripple, rng=rng)
    at = [(angle + 720 * k, level) for k in range(len(degrees) // 720) for angle, level in edges]
    return np.array([degrees[int(a)] for a, _ in at]), np.array([level for _, level in at])


@pytest.mark.parametrize("form", ["classic", "fd"])
@pytest.mark.parametrize("wheel", [*FEW, *EVEN])
def test_without_a_cam_the_speed_is_followed_and_nothing_else_is_told(wheel, form):
    failed, values, _, speeds = driven(wheel, form, seconds=amount(4.0, 4.0, 2.5))
    assert failed == []
    states = [v["SyncState"] for v in values]
    assert set(states) <= {0, 1, SPEED_ONLY}
    assert states[-1] == SPEED_ONLY
    for value, rpm in zip(values[len(values) // 2 :], speeds[len(values) // 2 :], strict=True):
        assert value["EngineSpeed"] == pytest.approx(rpm, rel=0.12)
        assert (value["ToothIndex"], value["CycleKnown"]) == (0, 0)


@pytest.mark.parametrize("form", ["classic", "fd"])
@pytest.mark.parametrize("cam", [HALF_MOON, FOUR])
@pytest.mark.parametrize("wheel", ["1", "2", "3", "24", "360"])
def test_with_a_cam_the_place_is_proven_and_right(wheel, cam, form):
    w = Wheel.parse(wheel)
    failed, values, teeth, _ = driven(wheel, form, cam=cam, tolerance=min(25.0, 144.0 / w.pulses), seed=7)
    assert failed == []
    proven = [k for k, v in enumerate(values) if v["SyncState"] == PROVEN]
    assert len(proven) > 0.3 * len(values)
    for k in proven:
        assert values[k]["ToothIndex"] == min(teeth[k] % w.pulses, 255)
        if values[k]["CycleKnown"]:
            assert values[k]["CrankAngle"] == pytest.approx(teeth[k] % (2 * w.pulses) * 360 / w.pulses, abs=0.02)


@pytest.mark.parametrize(("order", "amplitude"), [(1.0, 0.04), (1.5, 0.08), (2.0, 0.1), (3.0, 0.06)])
@pytest.mark.parametrize("wheel", ["24", "135"])
def test_ripple_does_not_hide_the_place_that_the_cam_tells(wheel, order, amplitude):
    """Idle of one to six cylinders: the ripple turns the cam's edges as well, the tooth before them is the same."""
    w = Wheel.parse(wheel)
    failed, values, teeth, _ = driven(
        wheel, "fd", cam=FOUR, tolerance=144.0 / w.pulses, speed=((0, 850),), seed=9, ripple=[(order, amplitude, 1.0)]
    )
    assert failed == []
    proven = [k for k, v in enumerate(values) if v["SyncState"] == PROVEN]
    assert len(proven) > 0.6 * len(values)
    assert all(values[k]["ToothIndex"] == min(teeth[k] % w.pulses, 255) for k in proven)


@pytest.mark.parametrize("wheel", ["1", "2", "3", "4-1"])
def test_of_few_pulses_each_pitch_may_be_half_a_wave_of_the_ripple(wheel):
    """Ripple A of order n changes r by up to 2 A n 2 pi / S a pitch; every other pitch longer is n = S / 2: 2 pi A.

    Orders of a turn cannot be told from each other there: none is learned.
    """
    state, const = zeros(1, sync_state.State)[0], zeros(1, sync_state.Const)[0]
    sync_state.prepare(state, const, Wheel.parse(wheel), 3000.0, 0.04, 30.0)
    assert const.ripple == pytest.approx(2 * np.pi * sync_state.RIPPLE)
    assert const.wheel.orders == 0


@pytest.mark.parametrize(("wheel", "tolerance", "tooth"), [("2", 25.0, 1), ("24", 5.0, 7), ("24", 25.0, -1)])
def test_a_tooth_is_named_where_the_cam_tells_it(wheel, tolerance, tooth):
    w = Wheel.parse(wheel)
    gone = w.pulses * 40 + tooth if tooth >= 0 else w.pulses * 40
    monitor_failed, values, *_ = driven(wheel, "fd", cam=HALF_MOON, tolerance=tolerance, gone=[gone], seed=3)
    assert "missed_pulse" in monitor_failed
    assert set(monitor_failed) <= {"missed_pulse", "cam_correlation"}  # one edge may come before the pulse is known
    assert values[-1]["SyncState"] == (PROVEN if tooth >= 0 else SPEED_ONLY)
    assert values[-1]["Corrections"] == 1


def test_a_cam_that_moves_does_not_take_the_place_with_it():
    """By 20 degrees, more than its tolerance: no pulse was missed, so the count is right, and the cam is told."""
    failed, values, teeth, _ = driven(
        "24", "fd", cam=FOUR, tolerance=7.0, speed=((0, 1500),), seed=3, ripple=[(2.0, 0.02, 1.0)], late_ns=2_222_222
    )
    assert set(failed) == {"cam_correlation"}
    proven = [value["SyncState"] == PROVEN for value in values]
    assert np.mean(proven[len(proven) // 2 :]) > 0.95
    wrong = [p and value["ToothIndex"] != tooth % 24 for p, value, tooth in zip(proven, values, teeth, strict=True)]
    assert not any(wrong)


def rippled(wheel, rpm, turns, rng, ripple):
    return (
        tooth_times(wheel, [(0, rpm)], turns * 60 / rpm, ripple=ripple, jitter=0.01, tooth_error=0.005, rng=rng) / 1e3
    )


@settings(max_examples=examples(20), deadline=None)
@given(
    st.sampled_from(["1", "2", "3", "4", "7", "3-1", "4-1", "1,3"]),
    st.sampled_from([(250.0, 0.4), (600.0, 0.2), (1500.0, 0.05), (8000.0, 0.02)]),
    st.sampled_from([0.5, 1.0, 1.5, 2.0, 3.0]),
    st.floats(0, 6.28),
    st.integers(0, 2**16),
)
@pytest.mark.costly
def test_a_healthy_engine_of_few_pulses_is_never_accused(text, case, order, phase, seed):
    wheel, (rpm, amplitude) = Wheel.parse(text), case
    times = rippled(wheel, rpm, 60, np.random.default_rng(seed), [(order, amplitude, phase)])
    found = follower("adaptive", wheel)(times)
    assert [FAULTS[k].name for k in found.fault] == []
    right = found.teeth % wheel.pulses == np.arange(1, len(times)) % wheel.pulses
    assert not (found.proven & ~right).any()
    assert not (found.proven.any() and wheel.even)


@pytest.mark.costly
@pytest.mark.parametrize("text", [*FEW, *EVEN, "3-1", "4-1"])
def test_one_pulse_missed_or_added_is_named_where_physics_decides(text):
    print("seed 21")
    wheel = Wheel.parse(text)
    rpm = 1.1 * max(sure_rpm(Params(wheel=wheel)), 700.0)
    follow = follower("adaptive", wheel)
    for k in range(amount(4, 4, 2)):
        rng = np.random.default_rng([21, k])
        ripple = [(0.5, 0.02, rng.uniform(0, 6)), (1.0, 0.02, rng.uniform(0, 6))]
        times = rippled(wheel, rpm, 200 if wheel.pulses < 8 else 40, rng, ripple)
        at = len(times) * 3 // 4 + k
        found = follow(np.delete(times, at))
        assert [FAULTS[j].name for j in found.fault] == ["missed_pulse"], k
        assert found.count.tolist() == [1]
        found = follow(np.insert(times, at, times[at - 1] + rng.uniform(0.35, 0.65) * (times[at] - times[at - 1])))
        assert [FAULTS[j].name for j in found.fault] == ["added_pulse"], k


@pytest.mark.costly
@pytest.mark.parametrize(
    ("told", "real", "cam", "gap"), [("6", "36-1", (), 2), ("36", "60-2", (), 3), ("24", "36", HALF_MOON, 1)]
)
def test_another_wheel_is_told(told, real, cam, gap):
    events = []
    failed, values, *_ = driven(told, "fd", real=real, cam=cam, tolerance=3.0, seconds=6.0, events=events)
    assert "wrong_wheel" in failed
    evidence = next(e["evidence"] for e in events if FAULTS[e["fault"]].name == "wrong_wheel")
    wheel = Wheel.parse(real)
    assert evidence[:3] == pytest.approx([wheel.pulses + gap - 1, wheel.pulses, gap], rel=0.05)
    assert set(failed) <= {"wrong_wheel", "missed_pulse", "pulses_lost"}
    assert {v["SyncState"] for v in values} <= {0, 1, SPEED_ONLY}
    assert values[-1]["SyncState"] == 0


def test_a_few_pulses_prove_their_place_only_where_no_ripple_can_make_it():
    """Of 1 : 1.3 a ripple of order 1 of 14 % shows as much; of 1 : 3 none at all."""
    assert sync_state.proof_rpm(Wheel.parse("1,3")) == 1.0
    assert sync_state.proof_rpm(Wheel.parse("24-1")) == 1.0
    wheel = Wheel.parse("1,1.3")
    slow, fast = 0.9 * sync_state.proof_rpm(wheel), 1.1 * sync_state.proof_rpm(wheel)
    for rpm, proven in ((slow, False), (fast, True)):
        found = follower("adaptive", wheel)(rippled(wheel, rpm, 80, np.random.default_rng(2), [(2.0, 0.01, 0.0)]))
        assert bool(found.proven.any()) == proven


@pytest.mark.parametrize(
    ("wheel", "options", "words"),
    [
        ("2", {}, ["from 60 rpm", "speed only", "missed or added", "not tested: runout"]),
        ("360", {}, ["from 30 rpm", "speed only", "another number of teeth", "not tested: no_gap"]),
        ("135", {"cam": HALF_MOON}, ["cam_tolerance_deg = 25 is not below half a tooth, 1.33 deg"]),
        ("135", {"cam": HALF_MOON, "cam_tolerance_deg": 1.0}, ["the cam's edges tell the place"]),
        ("4-1", {}, ["its place is proven from 697 rpm"]),
    ],
)
def test_check_says_what_such_a_wheel_can_tell(wheel, options, words):
    told = "\n".join(_facts(Params(wheel=wheel, **options)))
    for word in words:
        assert word in told
    assert "not tested" not in "\n".join(_facts(Params(wheel="60-2")))


def test_keys_of_the_papers_method_say_what_they_were():
    for key, value in (("method", "paper"), ("gain", 0.6), ("threshold", 1.0), ("follow_speed", False)):
        with pytest.raises(ValidationError, match=f"{key} = {value!r}: of the paper's method, which holds at constant"):
            Params(wheel="60-2", **{key: value})


@pytest.mark.parametrize(("text", "pulses"), [("1", 1), ("24-0", 24), ("360", 360), ("5*0.5", 5)])
def test_wheels_of_equal_pitches_are_read(text, pulses):
    wheel = Wheel.parse(text)
    assert (wheel.pulses, wheel.turn, wheel.even) == (pulses, pulses, True)
    assert str(wheel) == text


@pytest.mark.parametrize(("text", "turns"), [("1", 8), ("2", 4), ("3", 4), ("7", 2), ("12", 1), ("4-1", 4), ("6-1", 1)])
def test_few_pulses_are_laid_out_over_whole_working_cycles(text, turns):
    wheel = Wheel.parse(text)
    assert wheel.tiles == turns
    assert wheel.laid_out.pitches == wheel.pitches * turns


@pytest.mark.parametrize(("text", "followed"), [("6", False), ("9", False), ("12", True), ("60", True)])
def test_a_tooth_broken_off_a_wheel_of_equal_pitches_is_a_missed_pulse_each_turn(text, followed):
    """It is as well a wheel with a gap of two; as many pitches a turn as configured are no other wheel."""
    wheel = Wheel.parse(text)
    times = rippled(wheel, 1500, 60, np.random.default_rng(9), [(2.0, 0.02, 1.0)])
    found = follower("adaptive", wheel)(times[np.arange(len(times)) % wheel.pulses != 2])
    assert {FAULTS[k].name for k in found.fault} == {"missed_pulse"}
    assert len(found.fault) > 40
    assert set(found.tooth.tolist()) == {-1}
    assert bool((found.teeth >= 0).mean() > 0.9) == followed

"""Crankshaft trigger wheel: pulses missed and added, from packed tooth times to test results.

Source: Kim, Suh, Park, Yun, "A Method of Fault Diagnosis for Engine Synchronization Using Analytical
Redundancy" (2003); its method, for constant speed, is in the study. This one follows the speed (:mod:`.adaptive`) and
keeps the tooth index right through a fault; angle and speed go out as ``GW_EngineSync``.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Literal

from pydantic import Field

from gateway.monitors.contract import (
    TIMER,
    Blames,
    Connection,
    Emission,
    Fault,
    Monitor,
    MonitorParams,
    Notes,
    Out,
    Readout,
    Signal,
)
from gateway_fdi.jit import kernel
from gateway_plants.crank.monitor import cam, competing_hypothesis, frames, phase, place_proof, sync_state, wrong_wheel
from gateway_plants.crank.monitor.faults import BLAMES, FAULTS, Evidence
from gateway_plants.crank.monitor.records import (
    CLASSIC_INTERVALS,
    MOST_INTERVALS,
    Const,
    Inputs,
    Outputs,
    State,
)
from gateway_plants.crank.pulse_tracking.profile import FEWEST, MOST_SHARE
from gateway_plants.crank.tooth_codec import LONGEST_LONG_US
from gateway_plants.crank.wheel import WheelText

#: Longest interval of CTW_FD27: 16 bits of 0.5 us << 7 [us].
LONGEST_FD_US = 65535 * 64
#: Share of the angle since the last pulse by which a cam's edge may be off on a wheel of few pulses: the engine's speed
#: is not known better within one of its pitches.
UNEVEN = 0.25
#: Pitches since the last pulse from which on a pulse may have been missed before the edge.
OVERDUE = 1.2
#: Edges of the cam in a row that contradict the place that the cam has told, and end it, unless no pulse was missed or
#: added since: then the count is the stronger witness.
CONTRADICTED = 3
#: Largest tooth that the message carries; one beyond it is shown as this.
MOST_INDEX = 255
#: The engine's speed and angle go out at most so often without a change of synchronisation [ns].
SYNC_EVERY_NS = 10_000_000


class Params(MonitorParams):
    """Parameters of the crankshaft monitor."""

    moved: ClassVar[Mapping[str, str]] = dict.fromkeys(
        ("method", "gain", "threshold", "follow_speed"),
        "of the paper's method, which holds at constant speed only; leave the key out",
    )

    wheel: WheelText = Field(description='trigger wheel, e.g. "60-2"')
    frame: Literal["classic", "fd"] = Field(
        "classic", description="classic: CTW_PT4, 4 intervals a frame; fd: CTW_FD27"
    )
    stall_ms: float = Field(
        500.0,
        gt=0,
        le=3.6e6,
        description="no tooth for so long: the engine stands, synchronisation ends [ms]",
    )
    tooth_0_deg: float = Field(
        0.0, ge=0, lt=360, description="crank angle of tooth 0, the first behind the largest gap"
    )
    acceleration: float = Field(3000.0, gt=0, description="change of speed that is usual, standard dev. [rpm/s]")
    runout: float = Field(0.04, gt=0, lt=1, description="variation of the pitch once a turn, amplitude")
    reversal_rpm: float = Field(30.0, gt=0, description="below this speed the engine may turn back [rpm]")
    report_reversal: bool = Field(
        False, description="an engine that turned back sets P1335-00; it is no defect, and counted anyway"
    )
    cam: tuple[tuple[float, Literal[0, 1]], ...] = Field(
        (),
        max_length=cam.MOST_EDGES,
        description="[crank angle 0..720 deg, level after it] of each edge of a cam sensor",
    )
    cam_tolerance_deg: float = Field(
        25.0, gt=0, lt=90, description="of a cam edge, as much as valve timing moves it [deg]"
    )


def _connect(p: Params) -> Mapping[str, Connection]:
    fd = p.frame == "fd"
    teeth, count = ("CTW_FD27", MOST_INTERVALS) if fd else ("CTW_PT4", CLASSIC_INTERVALS)

    def signal(message: str, name: str) -> Signal:
        return Signal(f"{message}.{name}", triggers=True, optional=message != teeth)

    header: dict[str, Connection]
    if fd:
        header = {
            "counter": signal(teeth, "FrameCnt"),
            "pulses": signal(teeth, "PulseCnt"),
            "valid": signal(teeth, "NValid"),
            "shift": signal(teeth, "Shift"),
            "base_counter": None,
        }
    else:
        header = {
            "counter": signal(teeth, "FrameCnt"),
            "pulses": signal("CTW_BASE", "PulseCnt"),
            "valid": signal("CTW_BASE", "TeethCnt"),
            "shift": None,
            "base_counter": signal("CTW_BASE", "FrameCnt"),
        }
    of_cam = {"counter": "FrameCnt", "level": "Level", "pulse": "PulseCnt", "delay": "Delay"}
    intervals = [signal(teeth, f"Pt{k}") for k in range(count)]
    return {
        **header,
        **{f"cam_{k}": signal("CTW_CAM", name) if p.cam else None for k, name in of_cam.items()},
        "intervals": [*intervals, *[None] * (MOST_INTERVALS - count)],
    }


def lowest_rpm(p: Params) -> float:
    """Return the speed below which the wheel cannot be followed [rpm].

    Its gap must pass within the time that counts as standstill, and within the longest interval that a frame carries;
    below ``reversal_rpm`` each tooth may be of an engine that turns back.
    """
    longest_ms = min(p.stall_ms, (LONGEST_FD_US if p.frame == "fd" else LONGEST_LONG_US) / 1e3)
    by_gap = 60e3 / longest_ms * max(p.wheel.pitches) / p.wheel.turn
    return max(by_gap, p.reversal_rpm)


def sure_rpm(p: Params) -> float:
    """Return the speed above which one pulse missed cannot be the engine that slows down [rpm].

    An engine that takes two pitches' time over one has lost three quarters of the square of its speed v [pitch/s]:
    with a deceleration a, ``2 a = 3/4 v^2``. The deceleration is that which :data:`place.BRAKE` allows.
    """
    a = sync_state.BRAKE * p.acceleration / 60 * p.wheel.turn
    return float(60.0 / p.wheel.turn * (2.0 * a / 0.75) ** 0.5)


def _facts(p: Params) -> tuple[str, ...]:
    low = lowest_rpm(p)
    why = "reversal_rpm" if low == p.reversal_rpm else "stall_ms and the gap"
    return (f"wheel {p.wheel}: followed from {low:.0f} rpm on ({why})", *_limits(p))


def _limits(p: Params) -> tuple[str, ...]:
    """Return what can be found on a wheel that tells no place, or little of one, and what cannot."""
    wheel, told = p.wheel, []
    half = 180.0 / wheel.pulses
    if wheel.even and cam.tells(p.cam, p.cam_tolerance_deg, wheel.pulses):
        told.append(f"wheel {wheel}: its pitches are equal, so the cam's edges tell the place; until then speed only")
    elif wheel.even and p.cam:
        told.append(
            f"wheel {wheel}: speed only: cam_tolerance_deg = {p.cam_tolerance_deg:g} is not below half a tooth,"
            f" {half:.3g} deg, so the cam does not tell the place"
        )
    elif wheel.even:
        told.append(
            f"wheel {wheel}: speed only: its pitches are equal, so without a cam no place, angle or tooth is known,"
            " and another number of teeth looks like another speed"
        )
    untested = ["runout", "damaged_tooth", "reversed"] if wheel.tiles > 1 else []
    of_gap = wheel.lone and 3.0 * max(wheel.pitches) > MOST_SHARE * wheel.turn
    if not untested and (of_gap or wheel.pulses < FEWEST):
        untested = ["runout"]
    if wheel.even:
        untested += ["no_gap", "relocated", "two_places"] + ([] if untested else ["reversed"])
    if wheel.tiles > 1:
        told.append(
            f"wheel {wheel}: one pulse missed or added is named from {sure_rpm(p):.0f} rpm on, once the turns are"
            " learned; slower, an engine may change its speed as much"
        )
        if not wheel.even:
            told.append(f"wheel {wheel}: its place is proven from {sync_state.proof_rpm(wheel):.0f} rpm on (ripple)")
    if untested:
        told.append(f"wheel {wheel}: not tested: {', '.join(untested)}")
    return tuple(told)


def _faults(_: Params) -> tuple[Fault, ...]:
    return FAULTS


def _emits(_: Params) -> Emission:
    signals = {
        "sync": "SyncState", "angle": "CrankAngle", "speed": "EngineSpeed",
        "corrections": "Corrections", "index": "ToothIndex", "cycle_known": "CycleKnown",
    }  # fmt: skip
    return Emission("GW_EngineSync", signals)


def _prepare(p: Params, s: State, c: Const) -> None:
    c.fd = p.frame == "fd"
    c.stall_ns = int(p.stall_ms * 1e6)
    c.tooth_0_deg = p.tooth_0_deg
    sync_state.prepare(s.fast, c.fast, p.wheel, p.acceleration, p.runout, p.reversal_rpm)
    c.fast.told = p.report_reversal
    c.fast.longest_us = min(c.fast.longest_us, p.stall_ms * 1e3 * (1 - 1e-9))
    cam.prepare(s.cam, c.cam, p.cam, p.cam_tolerance_deg, p.tooth_0_deg, p.wheel.pulses)
    s.counter = -1
    s.base_counter = -1
    s.stray = -1


@kernel
def _degrees(c: Const, f: sync_state.State, tooth: int, delay_us: float) -> float:
    """Return the crank angle of an edge so long behind a tooth [deg], tooth 0 at zero."""
    total = c.fast.wheel.place[tooth] + min(delay_us / sync_state.period(f), c.fast.wheel.nominal[tooth])
    return float(total / c.fast.turn * 360.0)


@kernel
def _slack(c: Const, f: sync_state.State, delay_us: float) -> float:
    """Return by how much the angle of an edge so long behind a tooth may be wrong on a wheel of few pulses [deg]."""
    if c.fast.turns == 1:
        return 0.0
    return float(UNEVEN * min(delay_us / sync_state.period(f), c.fast.gap) / c.fast.turn * 360.0)


@kernel
def _place(s: State, c: Const, u: Inputs, since: int, out: Out[Evidence, Outputs]) -> None:
    """Take an edge of the cam as what tells the place on a wheel of equal pitches, and its number of pulses."""
    f, teeth = s.fast, c.fast.teeth
    part = min(u.cam_delay / sync_state.period(f), 1.0) if f.phase != sync_state.SEARCHING else 0.5
    pulses = phase.count(s.phase, c.cam, u.cam_pulse + part)
    if pulses > 0 and phase.another(pulses, teeth):
        wrong_wheel.counted(f, c.fast, 0.5 * pulses, out)
        return
    if pulses > 0:
        f.wrong = 0
    if f.phase != sync_state.CONFIRMED or c.cam.tells == 0:
        phase.restart(s.phase)
        return
    at = sync_state.revolutions(f, c.fast) % 2 * teeth + f.index % teeth + since
    number = phase.take(s.phase, c.cam, teeth, at + part, int(u.cam_level), _slack(c, f, u.cam_delay))
    if number != phase.NONE:
        place_proof.place_by_cam(f, c.fast, number)
        cam.forget(s.cam)


@kernel
def _cam(s: State, c: Const, u: Inputs, out: Out[Evidence, Outputs]) -> None:
    """Take CTW_CAM: an edge, so many microseconds after a pulse of the crank."""
    s.cam.counter = int(u.cam_counter)
    s.cam.quiet = 0
    f = s.fast
    two = f.phase == sync_state.TENTATIVE and f.rival.other != competing_hypothesis.NONE
    if s.counted == 0:
        return
    pulses = c.fast.pulses
    since = frames.wrapped(int(u.cam_pulse) - s.count)
    if abs(since) > pulses:
        return
    if f.placed == sync_state.NOT_TOLD:
        _place(s, c, u, since, out)
        return
    if not (sync_state.proven(f) or two):
        return
    at = f.index % c.fast.teeth + since
    tooth = at % c.fast.teeth
    if two:
        tooth = (f.index + since) % pulses
        other = competing_hypothesis.place_of(f.rival, c.fast.wheel, f.index)
        if other == competing_hypothesis.NONE:
            return
        other = (other + since) % pulses
        here = cam.fits(c.cam, _degrees(c, f, tooth, u.cam_delay), int(u.cam_level))
        there = cam.fits(c.cam, _degrees(c, f, other, u.cam_delay), int(u.cam_level))
        decided = competing_hypothesis.take_edge(f.rival, here, there)
        if decided > 0:
            place_proof.settle(f, c.fast, out, decided == 2)
        if decided > 0 or here != there or (not here and s.cam.half < 0):
            return  # one that fits neither, when others did before, is the cam's
    if f.placed == sync_state.BY_CAM and u.cam_delay > OVERDUE * sync_state.period(f):
        return  # the pulse before it may be one that was missed
    slack = _slack(c, f, u.cam_delay)
    cam.edge(s.cam, c.cam, _degrees(c, f, tooth, u.cam_delay), at // c.fast.teeth, int(u.cam_level), slack, out)
    if f.placed == sync_state.BY_CAM and s.cam.misfits >= CONTRADICTED and f.uneven != sync_state.NEVER:
        sync_state.displace(f)
        phase.restart(s.phase)
        cam.forget(s.cam)


@kernel
def _show(s: State, c: Const) -> None:
    """Bring what people and other monitors see up to date."""
    f = s.fast
    s.sync = sync_state.shown(f)
    s.revolutions = sync_state.revolutions(f, c.fast)
    s.speed_rpm = f.speed_rpm
    s.slowest_rpm = f.slowest_rpm
    s.fastest_rpm = f.fastest_rpm
    s.teeth = f.teeth
    s.missed = f.missed
    s.added = f.added
    s.corrections = f.corrections
    s.losses = f.losses
    s.reversals = f.reversal.total


@kernel
def _send(s: State, c: Const, t_ns: int, out: Out[Evidence, Outputs]) -> None:
    """Send angle and speed, when it is time or when synchronisation has changed."""
    changed = s.sync != s.sent_sync or s.corrections != s.sent_corrections
    if not changed and t_ns - s.sent_ns < SYNC_EVERY_NS:
        return
    s.sent_ns = t_ns
    s.sent_sync = s.sync
    s.sent_corrections = s.corrections
    turn = sync_state.angle(s.fast, c.fast) + max(s.cam.half, 0)
    index = max(sync_state.tooth_of(s.fast, c.fast, s.fast.index), 0)
    out.send = 1
    out.values.sync = s.sync
    cycle = 720.0 if s.cam.half >= 0 else 360.0
    out.values.angle = (turn * 360.0 + c.tooth_0_deg) % cycle
    out.values.speed = sync_state.speed(s.fast, c.fast)
    out.values.corrections = (s.corrections + 128) % 256 - 128
    out.values.index = min(index, MOST_INDEX)
    out.values.cycle_known = s.cam.half >= 0


@kernel
def step(s: State, c: Const, u: Inputs, out: Out[Evidence, Outputs]) -> None:
    """Take one frame of intervals, CTW_BASE, CTW_CAM, or the timer of a standing engine."""
    turns = sync_state.revolutions(s.fast, c.fast) if c.cam.edges > 0 else 0
    now = True
    if u.trigger == TIMER:
        frames.stand(s, c, out)
    elif c.cam.edges > 0 and u.cam_counter >= 0.0 and int(u.cam_counter) != s.cam.counter:
        _cam(s, c, u, out)  # NaN, while no edge has come, is not >= 0
    elif c.fd == 1:
        now = frames.fd(s, c, u, out)
    elif s.linked == 1 and int(u.counter) == s.counter:
        if u.base_counter >= 0.0 and int(u.base_counter) != s.base_counter:
            frames.base(s, c, u)
    else:
        now = frames.classic(s, c, u, out)
    if c.cam.edges > 0:
        if s.fast.phase == sync_state.CONFIRMED or s.fast.rival.other != competing_hypothesis.NONE:
            cam.turned(s.cam, out, sync_state.revolutions(s.fast, c.fast) - turns)
        else:
            cam.forget(s.cam)
    _show(s, c)
    if now:
        _send(s, c, u.t_ns, out)
    if s.stalls_ns > u.t_ns:
        out.wake_ns = s.stalls_ns


MONITOR = Monitor(
    type="crank_sync",
    api=2,
    params=Params,
    state=State,
    const=Const,
    inputs=Inputs,
    evidence=Evidence,
    outputs=Outputs,
    step=step,
    connect=_connect,
    prepare=_prepare,
    faults=_faults,
    emits=_emits,
    capabilities=(
        Blames(lambda _: BLAMES),
        Notes(_facts),
        Readout(
            (
                "sync",
                "revolutions",
                "speed_rpm",
                "slowest_rpm",
                "fastest_rpm",
                "teeth",
                "missed",
                "added",
                "corrections",
                "losses",
                "reversals",
            )
        ),
    ),
)

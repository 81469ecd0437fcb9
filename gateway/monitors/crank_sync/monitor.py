"""Crankshaft trigger wheel: pulses missed and added, from packed tooth times to test results.

Source: Kim, Suh, Park, Yun, "A Method of Fault Diagnosis for Engine Synchronization Using Analytical
Redundancy" (2003). Two methods: ``paper`` as printed, for constant speed
(:mod:`.constant_speed`), and ``adaptive``, which follows the speed (:mod:`.adaptive`). Both keep the
tooth index right through a fault; angle and speed go out as ``GW_EngineSync``.
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from pydantic import Field

from gateway.fdi.wheel import WheelText
from gateway.jit import f8, i8, kernel, record, u1
from gateway.monitors.crank_sync import cam, constant_speed, frames, place
from gateway.monitors.crank_sync.faults import FAULTS
from gateway.monitors.shape import (
    TIMER,
    Emission,
    Monitor,
    MonitorParams,
    Wiring,
    inputs,
)

#: The engine's speed and angle go out at most so often without a change of synchronisation [ns].
SYNC_EVERY_NS = 10_000_000


class Params(MonitorParams):
    """Parameters of the crankshaft monitor."""

    wheel: WheelText = Field(description='trigger wheel, e.g. "60-2"')
    method: Literal["adaptive", "paper"] = Field(
        "adaptive", description="adaptive: follows the speed; paper: constant speed, equation (6)"
    )
    frame: Literal["classic", "fd"] = Field(
        "classic", description="classic: CTW_PT4, 4 intervals a frame; fd: CTW_FD27"
    )
    stall_ms: float = Field(
        500.0,
        gt=0,
        description="no tooth for so long: the engine stands, synchronisation ends [ms]",
    )
    tooth_0_deg: float = Field(
        0.0, ge=0, lt=360, description="crank angle of tooth 0, the first behind the largest gap"
    )
    acceleration: float = Field(
        3000.0, gt=0, description="adaptive: change of speed that is usual, standard dev. [rpm/s]"
    )
    runout: float = Field(
        0.04, gt=0, lt=1, description="adaptive: variation of the pitch once a turn, amplitude"
    )
    reversal_rpm: float = Field(
        30.0, gt=0, description="adaptive: below this speed the engine may turn back [rpm]"
    )
    cam: tuple[tuple[float, Literal[0, 1]], ...] = Field(
        (),
        max_length=cam.MOST_EDGES,
        description="adaptive: [crank angle 0..720 deg, level after it] of each edge of a cam sensor",
    )
    cam_tolerance_deg: float = Field(
        25.0, gt=0, lt=90, description="of a cam edge, as much as valve timing moves it [deg]"
    )
    gain: float = Field(0.6, gt=0, lt=2, description="paper: observer gain D, (9)")
    threshold: float | None = Field(
        None,
        gt=0,
        description="paper: of the residual [pitch]; default half the smallest gap's step",
    )
    follow_speed: bool = Field(
        True,
        description="paper: learn the pitch time anew after every clean turn; false: as printed",
    )


CONST = record(
    adaptive=u1,
    fd=u1,
    stall_ns=i8,
    tooth_0_deg=f8,
    cam=cam.CONST,
    fast=place.CONST,
    paper=constant_speed.CONST,
)

#: ``count`` pulses, as the sender counts them (modulo 65536), once ``counted``; ``base_counter`` of the
#: last CTW_BASE, ``owed`` when it told of frames that are not here yet;
#: ``stray`` place after the last frame that came late, -1: none.
STATE = record(
    counter=i8,
    linked=u1,
    base_counter=i8,
    count=i8,
    counted=u1,
    owed=u1,
    owed_pulses=i8,
    owed_teeth=i8,
    stray=i8,
    stalls_ns=i8,
    sent_ns=i8,
    sent_sync=i8,
    sent_corrections=i8,
    sync=i8,
    revolutions=i8,
    speed_rpm=f8,
    slowest_rpm=f8,
    fastest_rpm=f8,
    teeth=i8,
    missed=i8,
    added=i8,
    corrections=i8,
    losses=i8,
    half=i8,
    cam=cam.STATE,
    fast=place.STATE,
    paper=constant_speed.STATE,
)

INPUTS = inputs(
    counter=f8,
    pulses=f8,
    valid=f8,
    shift=f8,
    base_counter=f8,
    cam_counter=f8,
    cam_level=f8,
    cam_pulse=f8,
    cam_delay=f8,
    intervals=(f8, frames.MOST_INTERVALS),
)


def _wire(p: Params) -> Wiring:
    fd = p.frame == "fd"
    teeth, count = (
        ("CTW_FD27", frames.MOST_INTERVALS) if fd else ("CTW_PT4", frames.CLASSIC_INTERVALS)
    )
    unused = f"{teeth}.FrameCnt"
    triggers, optional = [teeth], []
    if fd:
        header = [f"{teeth}.{s}" for s in ("FrameCnt", "PulseCnt", "NValid", "Shift", "FrameCnt")]
    else:
        base = "CTW_BASE"
        header = [unused, f"{base}.PulseCnt", f"{base}.TeethCnt", unused, f"{base}.FrameCnt"]
        optional.append(base)
    if p.cam:
        optional.append("CTW_CAM")
        header += [f"CTW_CAM.{s}" for s in ("FrameCnt", "Level", "PulseCnt", "Delay")]
    else:
        header += [unused] * 4
    signals = (*header, *(f"{teeth}.Pt{k}" for k in range(count)))
    return Wiring((*triggers, *optional), signals, optional=tuple(optional))


def _prepare(p: Params, s: np.void, c: np.void) -> None:
    c["adaptive"] = p.method == "adaptive"
    c["fd"] = p.frame == "fd"
    c["stall_ns"] = int(p.stall_ms * 1e6)
    c["tooth_0_deg"] = p.tooth_0_deg
    place.prepare(s["fast"], c["fast"], p.wheel, p.acceleration, p.runout, p.reversal_rpm)
    constant_speed.prepare(s["paper"], c["paper"], p.wheel, p.gain, p.threshold, p.follow_speed)
    cam.prepare(s["cam"], c["cam"], p.cam, p.cam_tolerance_deg, p.tooth_0_deg)
    s["counter"] = -1
    s["base_counter"] = -1
    s["stray"] = -1


@kernel
def _cam(s: Any, c: Any, u: Any, out: Any) -> None:
    """Take CTW_CAM: an edge, so many microseconds after a pulse of the crank."""
    s.cam.counter = int(u.cam_counter)
    f = s.fast
    if f.phase != place.CONFIRMED or s.counted == 0:
        return
    pulses = c.fast.pulses
    since = frames.wrapped(int(u.cam_pulse) - s.count)
    if abs(since) > pulses:
        return
    at = f.index + since
    ahead = at // pulses
    tooth = at % pulses
    total = 0.0
    for i in range(tooth):
        total += c.fast.wheel.nominal[i]
    total += min(u.cam_delay / place.period(f), c.fast.wheel.nominal[tooth])
    degrees = total / c.fast.wheel.whole * 360.0
    cam.edge(s.cam, c.cam, degrees, ahead, int(u.cam_level), out)


@kernel
def _show(s: Any, c: Any) -> float:
    """Bring what people and other monitors see up to date; returns the speed now [rpm]."""
    if c.adaptive == 1:
        f = s.fast
        s.sync = f.phase
        s.revolutions = f.revolutions
        s.speed_rpm = f.speed_rpm
        s.slowest_rpm = f.slowest_rpm
        s.fastest_rpm = f.fastest_rpm
        s.teeth = f.teeth
        s.missed = f.missed
        s.added = f.added
        s.corrections = f.corrections
        s.losses = f.losses
        s.half = s.cam.half
        return place.speed(f, c.fast)
    p = s.paper
    s.sync = p.phase
    s.revolutions = p.revolutions
    s.speed_rpm = p.speed_rpm
    s.slowest_rpm = p.slowest_rpm
    s.fastest_rpm = p.fastest_rpm
    s.teeth = p.teeth
    s.missed = p.missed
    s.added = p.added
    s.corrections = p.missed - p.added
    return 60e6 / (p.alpha * c.paper.turn) if p.phase > 0 else 0.0


@kernel
def _send(s: Any, c: Any, t_ns: int, speed_rpm: float, out: Any) -> None:
    """Send angle and speed, when it is time or when synchronisation has changed."""
    changed = s.sync != s.sent_sync or s.corrections != s.sent_corrections
    if not changed and t_ns - s.sent_ns < SYNC_EVERY_NS:
        return
    s.sent_ns = t_ns
    s.sent_sync = s.sync
    s.sent_corrections = s.corrections
    if c.adaptive == 1:
        turn = place.angle(s.fast, c.fast) + max(s.cam.half, 0)
        index = int(s.fast.index)
    else:
        turn = constant_speed.angle(s.paper, c.paper)
        index = int(s.paper.index)
    out.send = 1
    out.values[0] = s.sync
    cycle = 720.0 if s.cam.half >= 0 else 360.0
    out.values[1] = (turn * 360.0 + c.tooth_0_deg) % cycle
    out.values[2] = speed_rpm
    out.values[3] = (s.corrections + 128) % 256 - 128
    out.values[4] = index
    out.values[5] = s.cam.half >= 0


@kernel
def step(s: Any, c: Any, u: Any, out: Any) -> None:
    """Take one frame of intervals, CTW_BASE, CTW_CAM, or the timer of a standing engine."""
    turns = s.fast.revolutions
    if u.trigger == TIMER:
        frames.stand(s, c)
    elif c.cam.edges > 0 and u.cam_counter >= 0.0 and int(u.cam_counter) != s.cam.counter:
        _cam(s, c, u, out)  # NaN, while no edge has come, is not >= 0
    elif c.fd == 1:
        frames.fd(s, c, u, out)
    elif s.linked == 1 and int(u.counter) == s.counter:
        if u.base_counter >= 0.0 and int(u.base_counter) != s.base_counter:
            frames.base(s, c, u)
    else:
        frames.classic(s, c, u, out)
    if c.cam.edges > 0:
        if s.fast.phase == place.CONFIRMED:
            cam.turned(s.cam, out, s.fast.revolutions - turns)
        else:
            cam.forget(s.cam)
    _send(s, c, u.t_ns, _show(s, c), out)
    if s.stalls_ns > u.t_ns:
        out.wake_ns = s.stalls_ns


MONITOR = Monitor(
    type="crank_sync",
    params=Params,
    state=STATE,
    const=CONST,
    inputs=INPUTS,
    step=step,
    faults=FAULTS,
    wire=_wire,
    prepare=_prepare,
    readout=(
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
    ),
    emission=Emission(
        "GW_EngineSync",
        ("SyncState", "CrankAngle", "EngineSpeed", "Corrections", "ToothIndex", "CycleKnown"),
    ),
)

"""Crankshaft trigger wheel: pulses missed and added, from packed tooth times to test results.

Source: Kim, Suh, Park, Yun, "A Method of Fault Diagnosis for Engine Synchronization Using Analytical
Redundancy" (2003). Two methods: ``paper`` as printed, for constant speed
(:mod:`.constant_speed`), and ``adaptive``, which follows the speed (:mod:`.adaptive`). Both keep the
tooth index right through a fault; angle and speed go out as ``GW_EngineSync``.

A frame that is lost on the bus is known by its counter: its pulses were there, unseen. In CTW_PT4 the
number of pulses of a lost frame is known only when it was full; CTW_BASE puts it right.
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from pydantic import Field

from gateway.fdi.wheel import WheelText
from gateway.jit import f8, i8, kernel, record, u1
from gateway.monitors.crank_sync import adaptive, cam, constant_speed
from gateway.monitors.crank_sync.faults import FAULTS
from gateway.monitors.shape import (
    TIMER,
    Emission,
    Monitor,
    MonitorParams,
    Wiring,
    inputs,
)
from gateway.signals.tooth_codec import OVERFLOW_CODE, PADDING_CODE, period_us

#: Intervals that one frame can carry (CTW_FD27, CTW_PT4).
MOST_INTERVALS, CLASSIC_INTERVALS = 27, 4
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
    fast=adaptive.CONST,
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
    fast=adaptive.STATE,
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
    intervals=(f8, MOST_INTERVALS),
)


def _wire(p: Params) -> Wiring:
    fd = p.frame == "fd"
    teeth, count = ("CTW_FD27", MOST_INTERVALS) if fd else ("CTW_PT4", CLASSIC_INTERVALS)
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
    adaptive.prepare(s["fast"], c["fast"], p.wheel, p.acceleration, p.runout, p.reversal_rpm)
    constant_speed.prepare(s["paper"], c["paper"], p.wheel, p.gain, p.threshold, p.follow_speed)
    cam.prepare(s["cam"], c["cam"], p.cam, p.cam_tolerance_deg, p.tooth_0_deg)
    s["counter"] = -1
    s["base_counter"] = -1
    s["stray"] = -1


@kernel
def _stand(s: Any, c: Any) -> None:
    """The engine stands: synchronisation ends."""
    if c.adaptive == 1:
        adaptive.stand(s.fast)
    else:
        constant_speed.search(s.paper)


@kernel
def _lost(s: Any, c: Any, number: int) -> None:
    """Pass over pulses whose times were lost on the bus."""
    s.count = (s.count + number) % 65536
    if c.adaptive == 1:
        adaptive.lost(s.fast, c.fast, number)
    else:
        constant_speed.lost(s.paper, c.paper, number)


@kernel
def _wrapped(number: int) -> int:
    """Return a difference of two counters modulo 65536 as -32768..32767."""
    return (number + 32768) % 65536 - 32768


@kernel
def _base(s: Any, c: Any, u: Any) -> None:
    """Take CTW_BASE: the number of pulses sent, at the CTW_PT4 whose counter ends in ``valid``."""
    s.base_counter = int(u.base_counter)
    pulses, teeth = int(u.pulses), int(u.valid)
    if s.linked == 0:
        return
    if teeth != s.counter % 16:
        s.owed = 1
        s.owed_pulses = pulses
        s.owed_teeth = teeth
        return
    if s.counted == 1 and c.adaptive == 1:
        adaptive.recount(s.fast, c.fast, _wrapped(pulses - s.count))
    s.count = pulses
    s.counted = 1
    s.owed = 0


@kernel
def _missing(s: Any, frames: int, counter: int) -> int:
    """Return the pulses of lost CTW_PT4 frames: four each, or what CTW_BASE told meanwhile."""
    number = frames * CLASSIC_INTERVALS
    if s.owed == 1:
        later = (counter - 1 - s.owed_teeth) % 16
        if s.counted == 1 and later < frames:
            told = s.owed_pulses + later * CLASSIC_INTERVALS - s.count
            number = max(_wrapped(told), 0)
        s.count = (s.owed_pulses + later * CLASSIC_INTERVALS - number) % 65536
        s.counted = 1
        s.owed = 0
    return int(number)


@kernel
def _tooth(s: Any, c: Any, y: float, out: Any) -> None:
    """Take one interval [us]."""
    s.count = (s.count + 1) % 65536
    if c.adaptive == 1:
        adaptive.tooth(s.fast, c.fast, y, out)
    else:
        constant_speed.tooth(s.paper, c.paper, y, out)


@kernel
def _stray(s: Any, place: int, following: int) -> bool:
    """Tell whether a frame from the past came late; two that follow each other are a sender that restarted.

    Args:
        s: record of STATE.
        place: of the frame in the sender's count.
        following: place of the frame after it.
    """
    restarted = s.stray == place
    s.stray = -1 if restarted else following
    return bool(not restarted)


@kernel
def _classic(s: Any, c: Any, u: Any, out: Any) -> None:
    """Take a CTW_PT4."""
    counter = int(u.counter)
    if s.linked == 1:
        frames = (counter - s.counter - 1) % 256
        if frames >= 128 and _stray(s, counter, (counter + 1) % 256):
            return
        if frames >= 128:
            _stand(s, c)
        elif frames > 0:
            number = _missing(s, frames, counter)
            if number > 0:
                _lost(s, c, number)
    s.linked = 1
    s.counter = counter
    for k in range(CLASSIC_INTERVALS):
        code = int(u.intervals[k])
        if code == PADDING_CODE:
            continue
        if code == OVERFLOW_CODE:
            s.count = (s.count + 1) % 65536
            _stand(s, c)
            continue
        s.stalls_ns = u.t_ns + c.stall_ns
        _tooth(s, c, period_us(code), out)


@kernel
def _fd(s: Any, c: Any, u: Any, out: Any) -> None:
    """Take a CTW_FD27; it tells its first pulse's number."""
    pulses = int(u.pulses)
    if s.linked == 1:
        number = _wrapped(pulses - s.count)
        if number < 0 and _stray(s, pulses, (pulses + int(u.valid)) % 65536):
            return
        if number < 0:
            _stand(s, c)
        elif number > 0:
            _lost(s, c, number)
    s.linked = 1
    s.count = pulses
    s.counted = 1
    scale = float(1 << int(u.shift))
    for k in range(int(u.valid)):
        s.stalls_ns = u.t_ns + c.stall_ns
        _tooth(s, c, u.intervals[k] * scale, out)


@kernel
def _cam(s: Any, c: Any, u: Any, out: Any) -> None:
    """Take CTW_CAM: an edge, so many microseconds after a pulse of the crank."""
    s.cam.counter = int(u.cam_counter)
    f = s.fast
    if f.phase != adaptive.CONFIRMED or s.counted == 0:
        return
    pulses = c.fast.pulses
    since = _wrapped(int(u.cam_pulse) - s.count)
    if abs(since) > pulses:
        return
    place = f.index + since
    ahead = place // pulses
    tooth = place % pulses
    total = 0.0
    for i in range(tooth):
        total += c.fast.wheel.nominal[i]
    total += min(u.cam_delay / adaptive.period(f), c.fast.wheel.nominal[tooth])
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
        return adaptive.speed(f, c.fast)
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
        turn = adaptive.angle(s.fast, c.fast) + max(s.cam.half, 0)
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
        _stand(s, c)
    elif c.cam.edges > 0 and u.cam_counter >= 0.0 and int(u.cam_counter) != s.cam.counter:
        _cam(s, c, u, out)  # NaN, while no edge has come, is not >= 0
    elif c.fd == 1:
        _fd(s, c, u, out)
    elif s.linked == 1 and int(u.counter) == s.counter:
        if u.base_counter >= 0.0 and int(u.base_counter) != s.base_counter:
            _base(s, c, u)
    else:
        _classic(s, c, u, out)
    if c.cam.edges > 0:
        if s.fast.phase == adaptive.CONFIRMED:
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

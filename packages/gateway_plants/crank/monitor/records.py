"""What the crankshaft monitor works on: constants, state, inputs, and what it sends."""

from __future__ import annotations

from typing import Annotated

from gateway.monitors import contract
from gateway_fdi.jit import Record, f8, f8s, i8, means, u1
from gateway_plants.crank.monitor import cam, phase, place

#: Intervals that one frame can carry (CTW_FD27, CTW_PT4).
MOST_INTERVALS, CLASSIC_INTERVALS = 27, 4


class Const(Record):
    """Constants."""

    fd: u1
    stall_ns: i8
    tooth_0_deg: f8
    cam: cam.Const
    fast: place.Const


class State(Record):
    """State.

    ``count`` pulses, as the sender counts them (modulo 65536), once ``counted``; ``base_counter`` of the last
    CTW_BASE, ``owed`` when it told of frames that are not here yet; ``stray`` place after the last frame that
    came late, -1: none; ``intervals`` of the frame at hand [us].
    """

    counter: i8
    linked: u1
    base_counter: i8
    count: i8
    counted: u1
    owed: u1
    owed_pulses: i8
    owed_teeth: i8
    stray: i8
    intervals: Annotated[f8s, MOST_INTERVALS]
    stalls_ns: i8
    sent_ns: i8
    sent_sync: i8
    sent_corrections: i8
    sync: i8
    revolutions: i8
    speed_rpm: f8
    slowest_rpm: f8
    fastest_rpm: f8
    teeth: i8
    missed: i8
    added: i8
    corrections: i8
    losses: i8
    reversals: i8
    half: i8
    cam: cam.State
    phase: phase.Phase
    fast: place.State


class Inputs(contract.Inputs):
    """Inputs."""

    counter: f8
    pulses: f8
    valid: f8
    shift: f8
    base_counter: f8
    cam_counter: f8
    cam_level: f8
    cam_pulse: f8
    cam_delay: f8
    intervals: Annotated[f8s, MOST_INTERVALS]


class Outputs(Record):
    """What it sends."""

    sync: f8 = means("whether the place on the wheel is known: 0 no, 1 not proven, 2 proven, 3 speed only")
    angle: f8 = means("crank angle", "deg")
    speed: f8 = means(unit="rpm")
    corrections: f8 = means("pulses that were missed less those added")
    index: f8 = means("tooth")
    cycle_known: f8

"""What the crankshaft monitor works on: constants, state, inputs, and what it sends."""

from __future__ import annotations

from typing import Annotated

from gateway.monitors import contract
from gateway_fdi.jit import Record, f8, f8s, i8, means, u1
from gateway_plants.crank.monitor import cam, phase, sync_state

#: Intervals that one frame can carry (CTW_FD27, CTW_PT4).
MOST_INTERVALS, CLASSIC_INTERVALS = 27, 4


class Const(Record):
    """Constants."""

    fd: u1 = means("1: frames are CAN FD")
    stall_ns: i8 = means("time without a pulse after which the engine stands", "ns")
    tooth_0_deg: f8 = means("crank angle of tooth 0", "deg")
    cam: cam.Const = means("the cam")
    fast: sync_state.Const = means("place on the wheel")


class State(Record):
    """State."""

    counter: i8 = means("counter of the last frame of pulses")
    linked: u1 = means("1: there is one")
    base_counter: i8 = means("counter of the last CTW_BASE")
    count: i8 = means("pulses, as the sender counts them, modulo 65536")
    counted: u1 = means("1: count is known")
    guessed: u1 = means("1: of the last frames lost it is not known how many pulses they had")
    owed: u1 = means("1: the last CTW_BASE told of frames that are not here yet")
    owed_pulses: i8 = means("pulses that it told")
    owed_teeth: i8 = means("counter of the frame that it told of, modulo 16")
    stray: i8 = means("place after the last frame that came late; -1: none")
    intervals: Annotated[f8s, MOST_INTERVALS] = means("intervals of the frame at hand", "us")
    stalls_ns: i8 = means("when the engine stands, without another pulse", "ns")
    sent_ns: i8 = means("when a message was sent last", "ns")
    sent_sync: i8 = means("sync of that message")
    sent_corrections: i8 = means("corrections of that message")
    sync: i8 = means("whether the place on the wheel is known, as it is sent")
    revolutions: i8 = means("turns so far")
    speed_rpm: f8 = means("speed", "rpm")
    slowest_rpm: f8 = means("slowest speed so far", "rpm")
    fastest_rpm: f8 = means("fastest speed so far", "rpm")
    teeth: i8 = means("pulses so far")
    missed: i8 = means("pulses missed")
    added: i8 = means("pulses added")
    corrections: i8 = means("pulses missed less those added")
    losses: i8 = means("places lost")
    reversals: i8 = means("times that the engine turned back")
    cam: cam.State = means("the cam")
    phase: phase.Phase = means("place by the cam alone")
    fast: sync_state.State = means("place on the wheel")


class Inputs(contract.Inputs):
    """Inputs."""

    counter: f8 = means("counter of the frame of pulses")
    pulses: f8 = means("pulses sent so far, modulo 65536")
    valid: f8 = means("intervals in the frame; of CTW_BASE, the counter modulo 16 of the last frame that it counts")
    shift: f8 = means("intervals are in units of 2 to the power of this", "us")
    base_counter: f8 = means("counter of CTW_BASE")
    cam_counter: f8 = means("counter of the cam's frame")
    cam_level: f8 = means("level after the cam's edge")
    cam_pulse: f8 = means("pulses before the cam's edge, modulo 65536")
    cam_delay: f8 = means("time from the last pulse to the cam's edge", "us")
    intervals: Annotated[f8s, MOST_INTERVALS] = means("intervals between pulses, as sent")


class Outputs(Record):
    """What it sends."""

    sync: f8 = means("whether the place on the wheel is known: 0 no, 1 not proven, 2 proven, 3 speed only")
    angle: f8 = means("crank angle", "deg")
    speed: f8 = means(unit="rpm")
    corrections: f8 = means("pulses that were missed less those added")
    index: f8 = means("tooth")
    cycle_known: f8 = means("1: the half of the working cycle is known")

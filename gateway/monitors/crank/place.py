"""Where on the wheel the latest pulse was: the state of the adaptive method, and how it is set up and lost."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from gateway.fdi.pulse_tracking.acquisition import Search, restart
from gateway.fdi.pulse_tracking.profile import MOST_ORDERS, LearnedWheel, Profile
from gateway.fdi.pulse_tracking.tracker import Tracker, best
from gateway.fdi.wheel import MOST_TEETH, Wheel
from gateway.jit import Record, f8, f8s, i4, i8, kernel, u1
from gateway.monitors.crank.faults import RESIDUALS, Shape
from gateway.monitors.crank.reversal import Reversal

#: Synchronisation: none, a place that one more revolution has to prove, proven.
SEARCHING, TENTATIVE, CONFIRMED = range(3)
#: Torsional ripple that an engine may have before it is learned (2 per revolution), and the error of the
#: pitches at a gap [pitch].
RIPPLE, GAP_ERROR = 0.05, 0.1


class Const(Record):
    """Constants."""

    pulses: i4
    repeats: i4
    acceleration: f8
    ripple: f8
    unlearned: f8
    runout: f8
    slowest_us: f8
    gap: f8
    wheel: LearnedWheel
    logs: Annotated[f8s, MOST_TEETH]
    slack: Annotated[f8s, MOST_TEETH]


class State(Record):
    """State.

    ``index`` of the latest tooth; ``since`` pulses tracked without a doubt; ``unsynced`` pulses since
    synchronisation was last proven; ``held`` what a tentative place found; ``hole`` revolutions (the present and
    the next) in which frames were lost.
    """

    phase: i4
    index: i4
    since: i8
    unsynced: i8
    short: i8
    widest: f8
    teeth: i8
    revolutions: i8
    suspects: i4
    held_fault: i4
    held: Shape
    residuals: Annotated[f8s, RESIDUALS]
    missed: i8
    added: i8
    corrections: i8
    losses: i8
    recent_missed: i8
    recent_added: i8
    doubled: i8
    doubling: u1
    hole: i4
    decided: i8
    burst_missed: i4
    burst_added: i4
    speed_rpm: f8
    slowest_rpm: f8
    fastest_rpm: f8
    y1: f8
    y2: f8
    reversal: Reversal
    tracker: Tracker
    search: Search
    profile: Profile


def prepare(s: State, c: Const, wheel: Wheel, acceleration: float, runout: float, reversal_rpm: float) -> None:
    """Fill state and constants.

    Args:
        s: record of State.
        c: record of Const.
        wheel: the wheel.
        acceleration: that the engine can have [rpm/s].
        runout: variation of the pitch once a revolution that is a fault, amplitude as a share.
        reversal_rpm: below this speed the engine may have turned back [rpm].
    """
    pitches = np.asarray(wheel.pitches)
    count = len(pitches)
    c.pulses = count
    c.repeats = wheel.repeats
    c.acceleration = acceleration / 60 * wheel.turn
    c.ripple = RIPPLE * 2 * 2 * (2 * np.pi / wheel.turn)
    c.unlearned = (RIPPLE * 2 * (2 * 2 * np.pi / wheel.turn) ** 2) ** 2
    c.runout = runout
    c.slowest_us = 60e6 / (reversal_rpm * wheel.turn)
    c.gap = pitches.max()
    c.logs[:count] = np.log(pitches)
    gap = (pitches > 1.3) | (pitches < 0.7)
    gap |= np.roll(gap, 1)
    c.slack[:count] = np.where(gap, GAP_ERROR**2, 0.0)
    wh = c.wheel
    wh.gap[:count] = gap
    wh.pulses, wh.whole = count, wheel.turn
    wh.orders = min(MOST_ORDERS, count // 5)
    wh.nominal[:count] = pitches
    middle = 2 * np.pi * (np.asarray(wheel.positions) + pitches / 2) / wheel.turn
    wh.cosine[:count], wh.sine[:count] = np.cos(middle), np.sin(middle)
    tr = s.tracker
    tr.pitches[:count] = pitches
    tr.slack[:] = c.slack
    tr.wander = c.unlearned
    s.held_fault = -1
    s.reversal.index = -1


@kernel
def search(s: State) -> None:
    """Give the place on the wheel up and look for it again."""
    if s.phase == CONFIRMED:
        s.unsynced = 0
        s.short = 0
        s.widest = 0.0
    s.phase = SEARCHING
    s.since = 0
    s.suspects = 0
    s.held_fault = -1
    s.recent_missed = 0
    s.recent_added = 0
    s.doubled = 0
    s.doubling = 0
    s.hole = 0
    s.profile.clean = 0
    s.profile.last_us = 0.0
    restart(s.search)


@kernel
def stand(s: State) -> None:
    """The engine stands: no place, no speed, and nothing to wait for."""
    search(s)
    s.unsynced = 0
    s.y1 = 0.0
    s.y2 = 0.0
    s.reversal.index = -1


@kernel
def doubt(s: State) -> None:
    """Ask for one more revolution as a proof of the place on the wheel."""
    if s.phase == CONFIRMED:
        s.phase = TENTATIVE
        s.unsynced = 0
        s.short = 0
        s.widest = 0.0
    s.since = 0
    s.suspects = 0
    s.profile.clean = 0


@kernel
def speed(s: State, c: Const) -> float:
    """Return the speed at the last tooth [rpm], 0 while it is not known."""
    if s.phase == SEARCHING:
        return 0.0
    return float(60e6 / (best(s.tracker).period * c.wheel.whole))


@kernel
def period(s: State) -> float:
    """Return the time of one pitch at the last tooth [us]."""
    return float(best(s.tracker).period)


@kernel
def angle(s: State, c: Const) -> float:
    """Return the angle of the last tooth [share of a revolution], tooth 0 at zero."""
    total = 0.0
    for i in range(s.index):
        total += c.wheel.nominal[i]
    return float(total / c.wheel.whole)

"""A silence too long to count its teeth: whether pulses were lost in it, or the engine stopped."""

from __future__ import annotations

from gateway_fdi.jit import kernel
from gateway_plants.crank.monitor.faults import PULSES_LOST, Reports
from gateway_plants.crank.monitor.sync_state import CONFIRMED, Const, State, search, shape, tell_held
from gateway_plants.crank.pulse_tracking.tracker import best

#: Within what factor the speed is the same.
SAME = 1.5


@kernel
def fall_silent(s: State, c: Const, out: Reports, pitches: float) -> None:
    """Report a silence too long to count its teeth, and search.

    An engine that was slow enough can have come to rest in it, or have been thrown back: then it is held until a place
    is proven behind it, at the speed before.

    Args:
        s: record of State.
        c: record of Const.
        out: record of Out.
        pitches: that have passed at the speed before.
    """
    period = best(s.tracker).period
    proven = s.phase == CONFIRMED
    if proven:
        turns = int(pitches / c.wheel.whole)
        number, slot, span = turns * c.pulses - 1, int(s.index), turns * c.wheel.whole
        while span + 0.5 * c.wheel.nominal[slot] < pitches:
            span += c.wheel.nominal[slot]
            slot = slot + 1 if slot + 1 < c.pulses else 0
            number += 1
        shape(s, c, number, s.index + 1, s.held)
    search(s, c)
    if proven and period < c.turning_us:
        s.missed += int(s.held.count)
        s.losses += 1
        tell_held(s, PULSES_LOST, out)
    elif proven:
        s.held_fault = PULSES_LOST


@kernel
def steady(s: State, c: Const, y: float) -> bool:
    """Tell whether an interval [us] behind a silence is one of the engine as fast as before it."""
    period = 60e6 / (s.held.speed * c.turn)
    least = c.gap
    for k in range(c.pulses):
        least = min(least, c.wheel.nominal[k])
    return bool(least * period < SAME * y and y < SAME * c.gap * period)

"""A silence too long to count its teeth: whether pulses were lost in it, or the engine stopped."""

from __future__ import annotations

from gateway_fdi.jit import kernel
from gateway_plants.crank.monitor.faults import PULSES_LOST, Reports
from gateway_plants.crank.monitor.sync_state import CONFIRMED, Const, State, search, shape, tell_held
from gateway_plants.crank.pulse_tracking.tracker import best

#: Teeth behind a silence among which one has to show the speed before, and within what factor that is the same.
SILENT, SAME = 3, 1.5


@kernel
def fall_silent(s: State, c: Const, out: Reports, pitches: float) -> None:
    """Report a silence too long to count its teeth, and search.

    An engine that was too slow can have come to rest in it; then it depends on the teeth that follow
    (:func:`broken_silence`).

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
        _tell_silence(s, out)
    elif proven:
        s.silent_us = period
        s.silent = SILENT


@kernel
def _tell_silence(s: State, out: Reports) -> None:
    s.missed += int(s.held.count)
    s.losses += 1
    tell_held(s, PULSES_LOST, out)


@kernel
def broken_silence(s: State, y: float, out: Reports) -> None:
    """Take a tooth soon after a silence: an engine that has its speed at once has not stood still in between."""
    s.silent -= 1
    if s.silent_us / SAME < y < SAME * s.silent_us:
        s.silent = 0
        _tell_silence(s, out)

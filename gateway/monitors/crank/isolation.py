"""From what the hypotheses agree on to test results: each cause its own fault, with its evidence."""

from __future__ import annotations

from gateway.fdi.pulse_tracking import profile
from gateway.fdi.pulse_tracking.hypotheses import HOPELESS
from gateway.fdi.pulse_tracking.motion import Q3
from gateway.fdi.pulse_tracking.tracker import best, marginalise_decided
from gateway.jit import kernel
from gateway.monitors.contract import report
from gateway.monitors.crank.faults import (
    ADDED,
    CRANK_FAULTS,
    DOUBLED,
    MISSED,
    NO_GAP,
    PULSES_LOST,
    RESIDUALS,
    RUNOUT,
    SYNC_LOST,
    Reports,
    Shape,
)
from gateway.monitors.crank.place import CONFIRMED, TENTATIVE, Const, State, search, speed

#: Pulses missed in a row from which on it is loss of signal.
LOSS = 3
#: Pulses within which missed (or added) ones are one disturbance, its count their sum.
TOGETHER = 8
#: Revolutions, and pulses beyond, without synchronisation after which the reason is named.
PATIENCE, PATIENCE_PULSES = 4, 100
#: Share of the teeth with a second pulse from which on the edges are doubled.
DOUBLE_SHARE = 0.25
#: Revolutions that the pitches must have been learned from before they are believed.
LEARNED = 3
#: Runout is judged above this speed, where torsional ripple is small [rpm].
RUNOUT_RPM = 800.0


@kernel
def lose(s: State, c: Const, out: Reports, cost: float) -> None:
    """Report that synchronisation is lost, and search."""
    if s.phase == CONFIRMED and s.hole == 0:
        e = report(out, SYNC_LOST, True, cost, HOPELESS).sync_lost
        e.teeth, e.index, e.speed, e.cost = s.teeth, s.index, speed(s, c), cost
        s.losses += 1
    search(s)


@kernel
def _shape(s: State, c: Const, number: int, first: int, e: Shape) -> None:
    """Fill the evidence of missed or added pulses; ``first`` is the tooth concerned."""
    e.count = number
    e.tooth = first % c.pulses
    e.speed = speed(s, c)
    for k in range(RESIDUALS):
        e.residual[k] = s.residuals[(s.teeth + 1 + k) % RESIDUALS]


@kernel
def _fail(s: State, c: Const, out: Reports, fault: int, number: int) -> None:
    """Report missed or added pulses; a tentative place keeps them until it is proven."""
    first = s.index - (number if fault != ADDED else 1)
    if s.phase == TENTATIVE:
        s.held_fault = fault
        _shape(s, c, number, first, s.held)
        return
    _shape(s, c, number, first, report(out, fault, True, s.tracker.residual, 0.5).pulses)


@kernel
def decide(s: State, c: Const, out: Reports) -> None:
    """Act on missed or added pulses that all hypotheses agree on."""
    h = best(s.tracker)
    missed, added = int(h.missed), int(h.added)
    marginalise_decided(s.tracker)
    s.profile.clean = 0
    s.since = 0
    if s.hole > 0:
        return
    if s.phase == TENTATIVE:
        s.suspects += 1
        if s.suspects > 1:
            search(s)
            return
    s.corrections += missed - added
    missed, added = max(missed, 0), max(added, 0)
    s.recent_missed += missed
    s.recent_added += added
    if s.recent_missed > 0 and s.recent_added > 0 and s.recent_missed + s.recent_added > LOSS:
        lose(s, c, out, s.tracker.mean_cost)
        return
    if s.teeth - s.decided > TOGETHER:
        s.burst_missed = 0
        s.burst_added = 0
    s.decided = s.teeth
    s.burst_missed += missed
    s.burst_added += added
    if s.phase == CONFIRMED:
        s.missed += missed
        s.added += added
    if missed > 0:
        fault = PULSES_LOST if s.burst_missed >= LOSS else MISSED
        _fail(s, c, out, fault, s.burst_missed)
    if added > 0:
        s.doubled += added
        if s.doubling == 0:
            _fail(s, c, out, ADDED, s.burst_added)


@kernel
def fall_silent(s: State, c: Const, out: Reports, number: float) -> None:
    """Report a silence too long to count its teeth, and search."""
    if s.phase == CONFIRMED and s.hole == 0:
        s.burst_missed = int(number)
        s.missed += int(number)
        _fail(s, c, out, PULSES_LOST, int(number))
        s.losses += 1
    search(s)


@kernel
def confirm(s: State, out: Reports) -> None:
    """Take the place on the wheel for proven, and report what was held until then."""
    s.phase = CONFIRMED
    s.unsynced = 0
    s.short = 0
    s.widest = 0.0
    s.suspects = 0
    if s.held_fault >= 0:
        e = report(out, s.held_fault, True, s.held.residual[RESIDUALS - 1], 0.5).pulses
        e.count, e.tooth, e.speed = s.held.count, s.held.tooth, s.held.speed
        for k in range(RESIDUALS):
            e.residual[k] = s.held.residual[k]
        if s.held_fault == ADDED:
            s.added += int(s.held.count)
        else:
            s.missed += int(s.held.count)
        s.held_fault = -1


@kernel
def _trust(s: State, c: Const) -> None:
    """Trust the pitches as far as they are learned."""
    turns = s.profile.turns
    s.tracker.wander = c.unlearned if turns < LEARNED else Q3
    for i in range(c.pulses):
        s.tracker.slack[i] = c.slack[i] / (1 + turns * turns)


@kernel
def turned(s: State, c: Const, out: Reports) -> None:
    """End a revolution: speed, learning, passed results of a clean one, doubled edges, runout."""
    s.revolutions += 1
    us = s.profile.turn_us
    before = s.profile.turns
    clean = profile.turn(s.profile, c.wheel, s.tracker.pitches)
    if s.profile.turns != before and before <= LEARNED:
        _trust(s, c)
    doubled = s.doubled
    s.doubled = 0
    s.hole = max(s.hole - 1, 0)
    if s.phase != CONFIRMED:
        return
    s.doubling = 1 if doubled > DOUBLE_SHARE * c.pulses else 0
    if s.doubling == 1:
        share = doubled / c.pulses
        d = report(out, DOUBLED, True, share, DOUBLE_SHARE).doubled
        d.share, d.teeth, d.speed = share, s.teeth, speed(s, c)
    if not clean:
        return
    s.recent_missed = 0
    s.recent_added = 0
    s.speed_rpm = 60e6 / us
    s.fastest_rpm = max(s.fastest_rpm, s.speed_rpm)
    if s.slowest_rpm == 0.0 or s.speed_rpm < s.slowest_rpm:
        s.slowest_rpm = s.speed_rpm
    for fault in range(CRANK_FAULTS):
        if fault != RUNOUT:
            report(out, fault, False, 0.0, 0.0)
    if s.profile.turns > LEARNED and s.speed_rpm > RUNOUT_RPM:
        amplitude = s.profile.first
        r = report(out, RUNOUT, amplitude > c.runout, amplitude, c.runout).runout
        r.amplitude, r.tooth = amplitude, profile.worst(s.profile, c.wheel)
        r.speed = s.speed_rpm


@kernel
def wait(s: State, c: Const, y: float, out: Reports) -> None:
    """Count pulses without a proven place on the wheel, and name the reason in the end."""
    s.unsynced += 1
    if y < 0.45 * s.y1:
        s.short += 1
    if s.y1 > 0.0 and s.y2 > 0.0:
        s.widest = max(s.widest, s.y1 / (y * s.y2) ** 0.5)
    if s.unsynced < PATIENCE * c.pulses + PATIENCE_PULSES:
        return
    share = s.short / s.unsynced
    if share > DOUBLE_SHARE:
        d = report(out, DOUBLED, True, share, DOUBLE_SHARE).doubled
        d.share, d.teeth = share, s.teeth
    else:
        g = report(out, NO_GAP, True, s.widest, c.gap).no_gap
        g.teeth, g.widest = s.teeth, s.widest
    s.unsynced = 0
    s.short = 0
    s.widest = 0.0

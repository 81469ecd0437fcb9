"""The adaptive method: acquisition, hypotheses about every pulse, learned wheel, isolation.

See :mod:`gateway.fdi.pulse_tracking` for the observer. It keeps the paper's form - observer, input
generator, residual, correction - with the time of the next pulse as its output, so that it holds
while the speed changes.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from gateway.fdi.pulse_tracking import profile
from gateway.fdi.pulse_tracking.acquisition import SEARCH, restart, seek
from gateway.fdi.pulse_tracking.hypotheses import (
    HOPELESS,
    MOST_MISSED,
    MOST_PULSES,
    TRACKER,
    agreed,
    begin,
    best,
    jump,
    keep_best,
    rebase,
    settle,
    shift,
    speaker,
    take,
)
from gateway.fdi.pulse_tracking.motion import Q3
from gateway.fdi.pulse_tracking.profile import MOST_ORDERS, PROFILE, WHEEL
from gateway.fdi.wheel import Wheel
from gateway.jit import f8, i4, i8, kernel, record, u1
from gateway.monitors.crank_sync import reversal
from gateway.monitors.crank_sync.faults import (
    ADDED,
    CRANK_FAULTS,
    DOUBLED,
    MISSED,
    NO_GAP,
    PULSES_LOST,
    RUNOUT,
    SYNC_LOST,
)
from gateway.monitors.crank_sync.reversal import REVERSAL
from gateway.monitors.shape import EVIDENCE, report

#: Synchronisation: none, a place that one more revolution has to prove, proven.
SEARCHING, TENTATIVE, CONFIRMED = range(3)
#: Pulses missed in a row from which on it is loss of signal.
LOSS = 3
#: Pulses within which missed (or added) ones are one disturbance, its count their sum.
TOGETHER = 8
#: Revolutions, and pulses beyond, without synchronisation after which the reason is named.
PATIENCE, PATIENCE_PULSES = 4, 100
#: Share of the teeth with a second pulse from which on the edges are doubled.
DOUBLE_SHARE = 0.25
#: Torsional ripple that an engine may have before it is learned (2 per revolution), and the error of the
#: pitches at a gap [pitch].
RIPPLE, GAP_ERROR = 0.05, 0.1
#: Revolutions that the pitches must have been learned from before they are believed.
LEARNED = 3
#: Mean cost of a pulse [nat] above which the hypotheses are given up.
MOST_STRESS = 8.0
#: An engine does not slow down by this factor from one tooth to the next.
ABRUPT = 4.0
#: Residuals kept as the shape of a fault.
RESIDUALS = 5
#: Runout is judged above this speed, where torsional ripple is small [rpm].
RUNOUT_RPM = 800.0

CONST = record(
    pulses=i4,
    repeats=i4,
    acceleration=f8,
    ripple=f8,
    unlearned=f8,
    runout=f8,
    slowest_us=f8,
    gap=f8,
    wheel=WHEEL,
    logs=(f8, MOST_PULSES),
    slack=(f8, MOST_PULSES),
)

#: ``index`` of the latest tooth; ``since`` pulses tracked without a doubt; ``unsynced`` pulses since
#: synchronisation was last proven; ``held`` what a tentative place found; ``hole`` revolutions
#: (the present and the next) in which frames were lost.
STATE = record(
    phase=i4,
    index=i4,
    since=i8,
    unsynced=i8,
    short=i8,
    widest=f8,
    teeth=i8,
    revolutions=i8,
    suspects=i4,
    held_fault=i4,
    held=(f8, EVIDENCE),
    residuals=(f8, RESIDUALS),
    missed=i8,
    added=i8,
    corrections=i8,
    losses=i8,
    recent_missed=i8,
    recent_added=i8,
    doubled=i8,
    doubling=u1,
    hole=i4,
    decided=i8,
    burst_missed=i4,
    burst_added=i4,
    speed_rpm=f8,
    slowest_rpm=f8,
    fastest_rpm=f8,
    y1=f8,
    y2=f8,
    reversal=REVERSAL,
    tracker=TRACKER,
    search=SEARCH,
    profile=PROFILE,
)


def prepare(
    s: Any, c: Any, wheel: Wheel, acceleration: float, runout: float, reversal_rpm: float
) -> None:
    """Fill state and constants.

    Args:
        s: record of STATE.
        c: record of CONST.
        wheel: the wheel.
        acceleration: that the engine can have [rpm/s].
        runout: variation of the pitch once a revolution that is a fault, amplitude as a share.
        reversal_rpm: below this speed the engine may have turned back [rpm].
    """
    pitches = np.asarray(wheel.pitches)
    count = len(pitches)
    c["pulses"] = count
    c["repeats"] = wheel.repeats
    c["acceleration"] = acceleration / 60 * wheel.turn
    c["ripple"] = RIPPLE * 2 * 2 * (2 * np.pi / wheel.turn)
    c["unlearned"] = (RIPPLE * 2 * (2 * 2 * np.pi / wheel.turn) ** 2) ** 2
    c["runout"] = runout
    c["slowest_us"] = 60e6 / (reversal_rpm * wheel.turn)
    c["gap"] = pitches.max()
    c["logs"][:count] = np.log(pitches)
    gap = (pitches > 1.3) | (pitches < 0.7)
    gap |= np.roll(gap, 1)
    c["slack"][:count] = np.where(gap, GAP_ERROR**2, 0.0)
    wh = c["wheel"]
    wh["gap"][:count] = gap
    wh["pulses"], wh["whole"] = count, wheel.turn
    wh["orders"] = min(MOST_ORDERS, count // 5)
    wh["nominal"][:count] = pitches
    middle = 2 * np.pi * (np.asarray(wheel.positions) + pitches / 2) / wheel.turn
    wh["cosine"][:count], wh["sine"][:count] = np.cos(middle), np.sin(middle)
    tr = s["tracker"]
    tr["pitches"][:count] = pitches
    tr["slack"][:] = c["slack"]
    tr["wander"] = c["unlearned"]
    s["held_fault"] = -1
    s["reversal"]["index"] = -1


@kernel
def search(s: Any) -> None:
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
def stand(s: Any) -> None:
    """The engine stands: no place, no speed, and nothing to wait for."""
    search(s)
    s.unsynced = 0
    s.y1 = 0.0
    s.y2 = 0.0
    s.reversal.index = -1


@kernel
def speed(s: Any, c: Any) -> float:
    """Return the speed at the last tooth [rpm], 0 while it is not known."""
    if s.phase == SEARCHING:
        return 0.0
    return float(60e6 / (best(s.tracker).period * c.wheel.whole))


@kernel
def period(s: Any) -> float:
    """Return the time of one pitch at the last tooth [us]."""
    return float(best(s.tracker).period)


@kernel
def angle(s: Any, c: Any) -> float:
    """Return the angle of the last tooth [share of a revolution], tooth 0 at zero."""
    total = 0.0
    for i in range(s.index):
        total += c.wheel.nominal[i]
    return float(total / c.wheel.whole)


@kernel
def doubt(s: Any) -> None:
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
def lost(s: Any, c: Any, number: int) -> None:
    """Pass over pulses whose times were lost on the bus: they were there, unseen."""
    if s.phase == SEARCHING:
        restart(s.search)
    else:
        jump(s.tracker, c.pulses, number)
        s.revolutions += (s.index + number) // c.pulses
        s.index = best(s.tracker).index
        s.profile.clean = 0
        s.hole = 2
        s.since = 0
    s.y1 = 0.0
    s.y2 = 0.0
    s.reversal.index = -1


@kernel
def recount(s: Any, c: Any, number: int) -> None:
    """Put the index right by pulses that were lost on the bus and counted wrongly."""
    if number != 0 and s.phase != SEARCHING:
        shift(s.tracker, c.pulses, number)
        s.revolutions += (s.index + number) // c.pulses
        s.index = best(s.tracker).index
        doubt(s)
        s.hole = 2


@kernel
def lose(s: Any, c: Any, out: Any, cost: float) -> None:
    """Report that synchronisation is lost, and search."""
    if s.phase == CONFIRMED and s.hole == 0:
        place = report(out, SYNC_LOST, True, cost, HOPELESS)
        if place >= 0:
            r = out.results[place]
            r.evidence[0] = s.teeth
            r.evidence[1] = s.index
            r.evidence[2] = speed(s, c)
            r.evidence[3] = cost
        s.losses += 1
    search(s)


@kernel
def _shape(s: Any, c: Any, number: int, first: int, evidence: Any) -> None:
    """Fill the evidence of missed or added pulses; ``first`` is the tooth concerned."""
    evidence[0] = number
    evidence[1] = first % c.pulses
    evidence[2] = speed(s, c)
    for k in range(RESIDUALS):
        evidence[3 + k] = s.residuals[(s.teeth + 1 + k) % RESIDUALS]


@kernel
def _fail(s: Any, c: Any, out: Any, fault: int, number: int) -> None:
    """Report missed or added pulses; a tentative place keeps them until it is proven."""
    first = s.index - (number if fault != ADDED else 1)
    if s.phase == TENTATIVE:
        s.held_fault = fault
        _shape(s, c, number, first, s.held)
        return
    place = report(out, fault, True, s.tracker.residual, 0.5)
    if place >= 0:
        _shape(s, c, number, first, out.results[place].evidence)


@kernel
def _decide(s: Any, c: Any, out: Any) -> None:
    """Act on missed or added pulses that all hypotheses agree on."""
    h = best(s.tracker)
    missed, added = int(h.missed), int(h.added)
    settle(s.tracker)
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
        lose(s, c, out, s.tracker.stress)
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
def _fall_silent(s: Any, c: Any, out: Any, number: float) -> None:
    """Report a silence too long to count its teeth, and search."""
    if s.phase == CONFIRMED and s.hole == 0:
        s.burst_missed = int(number)
        s.missed += int(number)
        _fail(s, c, out, PULSES_LOST, int(number))
        s.losses += 1
    search(s)


@kernel
def _confirm(s: Any, out: Any) -> None:
    """Take the place on the wheel for proven, and report what was held until then."""
    s.phase = CONFIRMED
    s.unsynced = 0
    s.short = 0
    s.widest = 0.0
    s.suspects = 0
    if s.held_fault >= 0:
        place = report(out, s.held_fault, True, s.held[2 + RESIDUALS], 0.5)
        if place >= 0:
            for k in range(EVIDENCE):
                out.results[place].evidence[k] = s.held[k]
        if s.held_fault == ADDED:
            s.added += int(s.held[0])
        else:
            s.missed += int(s.held[0])
        s.held_fault = -1


@kernel
def _trust(s: Any, c: Any) -> None:
    """Trust the pitches as far as they are learned."""
    turns = s.profile.turns
    s.tracker.wander = c.unlearned if turns < LEARNED else Q3
    for i in range(c.pulses):
        s.tracker.slack[i] = c.slack[i] / (1 + turns * turns)


@kernel
def _turned(s: Any, c: Any, out: Any) -> None:
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
        place = report(out, DOUBLED, True, doubled / c.pulses, DOUBLE_SHARE)
        if place >= 0:
            out.results[place].evidence[0] = doubled / c.pulses
            out.results[place].evidence[1] = s.teeth
            out.results[place].evidence[2] = speed(s, c)
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
        place = report(out, RUNOUT, amplitude > c.runout, amplitude, c.runout)
        if place >= 0:
            out.results[place].evidence[0] = amplitude
            out.results[place].evidence[1] = profile.worst(s.profile, c.wheel)
            out.results[place].evidence[2] = s.speed_rpm


@kernel
def tooth(s: Any, c: Any, y: float, out: Any) -> None:
    """Take one interval between two pulses.

    Args:
        s: record of STATE.
        c: record of CONST.
        y: interval [us].
        out: record of RESULTS.
    """
    s.teeth += 1
    if s.reversal.index >= 0 and reversal.seen(s.reversal, c, s.y2, s.y1, y):
        reversal.tell(s.reversal, out)
        search(s)
    if s.phase == SEARCHING:
        _seek(s, c, y)
    else:
        span = s.tracker.pitches[s.index]
        period = best(s.tracker).period
        if y > c.slowest_us * span and period > c.slowest_us / ABRUPT:
            reversal.begin(s.reversal, c.pulses, s.index, y)
            doubt(s)
        if y > (MOST_MISSED + 1 + span) * ABRUPT * period:
            _fall_silent(s, c, out, y / period)
        else:
            _track(s, c, y, out)
    if s.phase != CONFIRMED:
        _wait(s, c, y, out)
    s.y2 = s.y1
    s.y1 = y


@kernel
def _seek(s: Any, c: Any, y: float) -> None:
    """Look for the place on the wheel."""
    index = seek(s.search, c.logs, c.repeats, y)
    if index >= 0:
        se = s.search
        begin(s.tracker, index, se.period, se.growth, se.variance)
        s.phase = TENTATIVE
        s.index = index
        s.since = 0
        s.suspects = 0
        s.profile.clean = 0
        s.profile.turn_us = 0.0


@kernel
def _wait(s: Any, c: Any, y: float, out: Any) -> None:
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
        place = report(out, DOUBLED, True, share, DOUBLE_SHARE)
        first = share
    else:
        place = report(out, NO_GAP, True, s.widest, c.gap)
        first = float(s.teeth)
    if place >= 0:
        out.results[place].evidence[0] = first
        out.results[place].evidence[1] = s.teeth if share > DOUBLE_SHARE else s.widest
    s.unsynced = 0
    s.short = 0
    s.widest = 0.0


@kernel
def _track(s: Any, c: Any, y: float, out: Any) -> None:
    """Follow the wheel by one pulse."""
    tr = s.tracker
    before = int(s.index)
    cost = take(tr, c.pulses, c.acceleration, c.ripple, y)
    s.residuals[s.teeth % RESIDUALS] = tr.residual
    if cost > HOPELESS or tr.stress > MOST_STRESS:
        lose(s, c, out, cost)
        return
    if tr.open > 5 * c.pulses // 2:
        keep_best(tr)
    h = speaker(tr)
    s.index = h.index
    s.since += 1
    behind = s.index - 1 if s.index > 0 else c.pulses - 1
    old_behind = profile.smooth(s.profile, behind)
    old_ahead = profile.smooth(s.profile, s.index)
    profile.follow(s.profile, c.wheel, h.period, tr.pitches)
    following = before + 1 if before + 1 < c.pulses else 0
    if h.fresh == 1 and s.index == following:
        profile.note(s.profile, before, y)
    else:
        s.profile.clean = 0
    first = best(tr)
    if first.fresh == 1 and (first.missed != 0 or first.added != 0) and agreed(tr):
        s.index = first.index
        _decide(s, c, out)
        if s.phase == SEARCHING:
            return
    if s.index < before and before - s.index > c.pulses // 2:
        _turned(s, c, out)
    elif s.index > before and s.index - before > c.pulses // 2:
        s.revolutions -= 1
    new_behind = profile.smooth(s.profile, behind)
    new_ahead = profile.smooth(s.profile, s.index)
    if new_behind != old_behind or new_ahead != old_ahead:
        rebase(tr, old_behind - new_behind, old_ahead - new_ahead)
    if s.phase == TENTATIVE and s.since >= c.pulses and agreed(tr):
        _confirm(s, out)

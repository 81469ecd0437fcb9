"""From what the hypotheses agree on to test results: each cause its own fault, with its evidence."""

from __future__ import annotations

from gateway.monitors.contract import report
from gateway_fdi.jit import kernel
from gateway_plants.crank.monitor import anchor, defects, noise, runout, turns, wrong_wheel
from gateway_plants.crank.monitor.faults import ADDED, MISSED, NOISE, PULSES_LOST, SYNC_LOST, Reports
from gateway_plants.crank.monitor.sync_state import (
    CONFIRMED,
    MARKED,
    NEVER,
    NOT_TOLD,
    TENTATIVE,
    Const,
    State,
    doubt,
    search,
    shape,
    speed,
    tooth_of,
    uncover,
)
from gateway_plants.crank.pulse_tracking.acquisition import begin_later
from gateway_plants.crank.pulse_tracking.hypotheses import HOPELESS
from gateway_plants.crank.pulse_tracking.tracker import best, expect, keep_best, marginalise_decided, unanimous

#: Pulses missed in a row from which on it is loss of signal.
LOSS = wrong_wheel.LOSS
#: Pulses within which missed (or added) ones are one disturbance, its count their sum.
TOGETHER = 8
#: A decision that took more pulses than this, or than half a turn, is held until the next gap has proven it.
LATE = 8
#: Parts of a turn: by one more the search begins later for each place that was refused. What follows in each turn may
#: be like the gap.
PARTS = 8


@kernel
def lose(s: State, c: Const, out: Reports, cost: float) -> None:
    """Report that synchronisation is lost, and search.

    A place that was proven until less than two turns ago, and is doubted by nothing but pulses too close for any
    engine, counts as proven, if nothing else has been told of these (as doubled edges); not at the starter's speed,
    where an engine that turns back has such pulses as well.
    """
    of_late = s.teeth - s.doubted < 2 * c.pulses and s.hole == 0 and s.reversal.stood == 0
    of_late = of_late and s.teeth - s.named > 2 * c.pulses and s.teeth - s.burst.crowded < 2 * c.pulses
    of_late = of_late and s.speed_rpm > runout.FIRING_RPM and s.doubling == 0 and not wrong_wheel.unsure(s, c)
    if s.phase == CONFIRMED or of_late:
        e = report(out, SYNC_LOST, True, cost, HOPELESS).sync_lost
        e.teeth, e.index, e.speed, e.cost = s.teeth, s.index, speed(s, c), cost
        s.losses += 1
    search(s, c)


@kernel
def fall_noisy(s: State, c: Const, count: int) -> None:
    """Doubt the place in a burst of pulses that nothing explains; it is told when it has ended (:mod:`.noise`).

    Args:
        s: record of State.
        c: record of Const.
        count: pulses of the burst so far.
    """
    began = s.burst.known == 1 and s.teeth - s.decided <= 2 * TOGETHER
    known = (s.phase == CONFIRMED or began) and unanimous(s.tracker)
    if s.phase == CONFIRMED:
        s.losses += 1
    keep_best(s.tracker)
    h = best(s.tracker)
    noise.begin(s.burst, count, h.elapsed, h.period, speed(s, c), tooth_of(s, c, h.index))
    s.burst.tooth, s.burst.known = h.index, known
    anchor.skip(s.anchor, c.anchor.length, c.pulses + anchor.EDGES)
    anchor.restart(s.anchor)
    doubt(s)


@kernel
def _fail(s: State, c: Const, out: Reports, fault: int, number: int, first: int) -> None:
    """Report missed or added pulses from tooth ``first`` on; a tentative place keeps them until it is proven.

    But not what came once where the place itself may have been wrong: frames were lost, the engine may have turned
    back, or it was found anew, and one more tooth than that moves it, or its gap was not seen.
    """
    guessed = s.hole == 1 or s.reversal.stood == 1 or (s.doubted == NEVER and (s.sure == 0 or number > 1))
    if s.phase == TENTATIVE and guessed and s.recurring == 0:
        return
    if s.phase == TENTATIVE:
        s.held_fault = fault
        shape(s, c, number, first, s.held)
        return
    s.named = s.teeth
    shape(s, c, number, first, report(out, fault, True, s.tracker.residual, 0.5).pulses)


@kernel
def _beside_gap(c: Const, tooth: int) -> bool:
    """Tell whether a tooth is next to a gap."""
    return bool(c.wheel.gap[tooth] == 1 or c.wheel.gap[tooth - 1 if tooth > 0 else c.pulses - 1] == 1)


@kernel
def _suspicious(s: State, c: Const, tooth: int, net: int) -> bool:
    """Tell whether a fault found at a place that is not proven speaks against the place.

    One fault does not: it is held until the place is proven. Nor do those that come again a turn later at the same
    teeth: they are defects of the wheel or the sensor (teeth broken off, pulses too many in each turn), not a wrong
    place (:mod:`.defects`); but a tooth missing beside the gap is a wrong edge, or a wrong wheel. Others do, unless
    frames were lost in between, and pulses with them.
    """
    beside = net > 0 and _beside_gap(c, tooth)
    if beside or not defects.take(s.defects, c.pulses, tooth, net, s.teeth, False):
        s.suspects += 1
        s.recurring = 0
        defects.clear(s.defects)
        if not beside:
            defects.take(s.defects, c.pulses, tooth, net, s.teeth, False)
        return s.suspects > 1 and s.hole == 0
    s.suspects = max(s.suspects, 1)
    s.recurring = 1 if s.defects.turns > 0 else 0
    if s.recurring == 1:
        expect(s.tracker, c.pulses, tooth, net)
    return False


@kernel
def _spoil(s: State, c: Const, tooth: int, net: int) -> None:
    """Learn nothing from a turn with pulses missed or added, but those that come again in each."""
    if s.phase != CONFIRMED or c.pulses < MARKED or not defects.knows(s.defects, tooth, net):
        s.profile.clean = 0


@kernel
def _disturb(s: State, c: Const, tooth: int, missed: int, added: int, own: bool) -> None:
    """Count missed or added pulses with those just before; the gap has to bear them out, or that they come again."""
    if own or s.teeth - s.decided > TOGETHER:
        s.burst_missed = 0
        s.burst_added = 0
        s.burst_tooth = tooth
    s.burst_missed += missed
    s.burst_added += added
    if not own:
        s.decided = s.teeth
        s.anchor.unchecked = 0 if c.even == 1 else 1


@kernel
def decide(s: State, c: Const, out: Reports) -> None:
    """Act on missed or added pulses that all hypotheses agree on."""
    h = best(s.tracker)
    missed, added = int(h.missed), int(h.added)
    tooth = int(h.missed_at if missed > 0 else h.added_at)
    added_at = int(h.added_at)
    marginalise_decided(s.tracker)
    _spoil(s, c, tooth, missed - added)
    s.fitted = -1  # this turn does not count
    crowd = added >= noise.BURST and noise.crowd(s.burst, s.teeth) >= noise.BURST
    burst = crowd and noise.close(s.burst, c.firing_us)
    s.burst.known = 1 if s.phase == CONFIRMED and added >= noise.BURST else 0
    if s.phase == CONFIRMED and (s.tracker.took > min(LATE, c.pulses // 2) or wrong_wheel.unsure(s, c)):
        doubt(s)
    if s.phase == TENTATIVE and not burst and _suspicious(s, c, tooth, missed - added):
        lose(s, c, out, s.tracker.mean_cost)
        s.refused += 1
        begin_later(s.search, s.refused * (c.pulses // PARTS + 1) % c.pulses if c.pulses >= anchor.FEW else 0)
        return
    s.since = 0
    if missed != added:
        uncover(s, c)
    if s.phase == TENTATIVE and s.sure == 0 and s.hole == 0 and missed != added and _beside_gap(c, tooth):
        # The place was a guess, and it is the gap that comes elsewhere: that is the place put right.
        s.suspects = 0
        s.sure = 1
        return
    s.corrections += missed - added
    s.uneven = s.teeth if missed != added else s.uneven
    own = defects.knows(s.defects, tooth, missed - added)
    if s.phase == CONFIRMED and missed != added:
        _learn(s, c, tooth, missed - added, own, out)
    missed, added = max(missed, 0), max(added, 0)
    s.recent_missed += 0 if own else missed
    s.recent_added += 0 if own else added
    if s.recent_missed > 0 and s.recent_added > 0 and s.recent_missed + s.recent_added > LOSS and not burst:
        lose(s, c, out, s.tracker.mean_cost)
        return
    if missed == added:
        # One missed and one too many: an edge far off. Only when it comes again it says that nothing fits (above).
        return
    _disturb(s, c, tooth, missed, added, own)
    if s.phase == CONFIRMED:
        s.missed += missed
        s.added += added
    if missed > 0:
        fault = PULSES_LOST if s.burst_missed >= LOSS else MISSED
        _fail(s, c, out, fault, s.burst_missed, s.burst_tooth)
    if added > 0:
        if crowd or s.teeth - s.burst.told <= TOGETHER:
            if noise.close(s.burst, c.firing_us):
                _tell_noise(s, c, out)
            else:
                doubt(s)  # pulses no closer than those of an engine that the starter turns may be an engine's
            return
        # Of teeth with a second pulse: several pulses behind one tooth are one.
        s.doubled += min(added, max((s.index - added_at) % c.pulses, 1))
        if s.doubling == 0:
            _fail(s, c, out, ADDED, s.burst_added, s.burst_tooth if missed == 0 else added_at)


@kernel
def _tell_noise(s: State, c: Const, out: Reports) -> None:
    """Report a burst whose teeth were counted all the same; a place that is not proven keeps nothing of it."""
    s.named = s.teeth
    s.burst.told = s.teeth
    e = report(out, NOISE, True, s.burst_added, noise.BURST).noise
    e.count, e.tooth, e.speed = s.burst_added, tooth_of(s, c, s.burst_tooth), speed(s, c)


@kernel
def _learn(s: State, c: Const, tooth: int, net: int, own: bool, out: Reports) -> None:
    """Learn what comes again in each turn; a tooth that is missing so is the wheel's.

    A pulse too many is not: ignition comes at the same angle as well.

    Args:
        s: record of State.
        c: record of Const.
        tooth: at which pulses were missed or added.
        net: pulses missed less those added.
        own: whether it is known to come again.
        out: record of Out.
    """
    if own:
        s.anchor.unchecked = 0
        expect(s.tracker, c.pulses, tooth, net)
    if own and s.teeth - s.decided > c.pulses - TOGETHER:  # nothing else is missing or added in this turn
        s.recent_missed = 0
        s.recent_added = 0
    defects.learn(s.defects, c.pulses, tooth, net, s.teeth)
    if own and net > 0 and s.placed > NOT_TOLD and c.turns == 1 and s.defects.turns >= defects.SURE:
        turns.tell_broken(tooth_of(s, c, tooth), net, speed(s, c), out)

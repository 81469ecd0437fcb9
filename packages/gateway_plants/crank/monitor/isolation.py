"""From what the hypotheses agree on to test results: each cause its own fault, with its evidence."""

from __future__ import annotations

from gateway.monitors.contract import report
from gateway_fdi.jit import kernel
from gateway_plants.crank.monitor import anchor, defects, noise, turns, wrong_wheel
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
)
from gateway_plants.crank.pulse_tracking.hypotheses import HOPELESS
from gateway_plants.crank.pulse_tracking.tracker import COARSE, best, expect, keep_best, marginalise_decided, unanimous

#: Pulses missed in a row from which on it is loss of signal.
LOSS = wrong_wheel.LOSS
#: Pulses within which missed (or added) ones are one disturbance, its count their sum.
TOGETHER = 8
#: A decision that took more pulses than this, or than half a turn, is held until the next gap has proven it.
LATE = 8
#: Parts of a turn by which the search begins later.
PARTS = 8
#: Behind an interval long enough for an engine to turn back in, one that took more is none of a pulse missed or added.
AT_ONCE = 3


@kernel
def lose(s: State, c: Const, out: Reports, cost: float) -> None:
    """Report that synchronisation is lost, if the place was proven, and search."""
    if s.phase == CONFIRMED:
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
    back, or it was found anew, and one more tooth than that moves it, or its gap was not seen; nor where edges are too
    noisy to count by.
    """
    guessed = s.hole == 1 or s.reversal.stood == 1 or (s.doubted == NEVER and (s.sure == 0 or number > 1))
    guessed = guessed or s.tracker.variance > COARSE
    if s.phase == TENTATIVE and guessed and s.recurring == 0:
        return
    if s.phase == TENTATIVE:
        s.held_fault = fault
        shape(s, c, number, first, s.held)
        return
    shape(s, c, number, first, report(out, fault, True, s.tracker.residual, 0.5).pulses)


@kernel
def _beside_gap(c: Const, tooth: int) -> bool:
    """Tell whether a tooth is next to a gap."""
    return bool(c.wheel.gap[tooth] == 1 or c.wheel.gap[tooth - 1 if tooth > 0 else c.pulses - 1] == 1)


@kernel
def _suspicious(s: State, c: Const, tooth: int, net: int, out: Reports) -> bool:
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
    if s.recurring == 1 and s.hole == 1 and s.doubted != NEVER:
        _tell_damaged(s, c, tooth, net, -1, out)
    return False


@kernel
def _tell_damaged(s: State, c: Const, tooth: int, net: int, named: int, out: Reports) -> None:
    """Report a tooth, as ``named``, that is missing or far from its place in each turn, when enough have shown it."""
    if c.turns == 1 and s.defects.turns >= defects.SURE and net > 0:
        turns.tell_broken(named, net, speed(s, c), out)
    elif c.turns == 1 and s.defects.turns >= defects.SURE and net == 0:
        turns.tell_bent(s, c, tooth, named, out)


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
    slow = s.reversal.slow == 1
    late = s.tracker.took > min(LATE, c.pulses // 2)
    if s.phase == CONFIRMED and (late or slow or wrong_wheel.unsure(s, c)):
        doubt(s)
    if slow and s.tracker.took > AT_ONCE:
        s.reversal.stood = 1
        s.held_fault = -1
    if s.phase == TENTATIVE and not burst and _suspicious(s, c, tooth, missed - added, out):
        lose(s, c, out, s.tracker.mean_cost)
        s.refused += 1
        # What follows in each turn may be like the gap: for each place that was refused it begins a part later.
        s.search.seen = -(s.refused * (c.pulses // PARTS + 1) % c.pulses) if c.pulses >= anchor.FEW else 0
        return
    s.since = 0
    if s.phase == TENTATIVE and s.sure == 0 and s.hole == 0 and missed != added and _beside_gap(c, tooth):
        # The place was a guess, and it is the gap that comes elsewhere: that is the place put right.
        s.suspects = 0
        s.sure = 1
        return
    s.corrections += missed - added
    s.uneven = s.teeth if missed != added else s.uneven
    if s.phase == CONFIRMED:
        _learn(s, c, tooth, missed - added, out)
    own = defects.knows(s.defects, tooth, missed - added)
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
    s.burst.told = s.teeth
    e = report(out, NOISE, True, s.burst_added, noise.BURST).noise
    e.count, e.tooth, e.speed = s.burst_added, tooth_of(s, c, s.burst_tooth), speed(s, c)


@kernel
def _learn(s: State, c: Const, tooth: int, net: int, out: Reports) -> None:
    """Learn what comes again in each turn; a tooth that is missing so, or far from its place, is the wheel's.

    A pulse too many is not: ignition comes at the same angle as well.

    Args:
        s: record of State.
        c: record of Const.
        tooth: at which pulses were missed or added.
        net: pulses missed less those added; 0: its edge is far off.
        out: record of Out.
    """
    defects.learn(s.defects, c.pulses, tooth, net, s.teeth)
    if not defects.knows(s.defects, tooth, net):
        return
    s.anchor.unchecked = 0
    expect(s.tracker, c.pulses, tooth, net)
    if s.teeth - s.decided > c.pulses - TOGETHER:  # nothing else is missing or added in this turn
        s.recent_missed = 0
        s.recent_added = 0
    if s.placed > NOT_TOLD:
        _tell_damaged(s, c, tooth, net, tooth_of(s, c, tooth), out)

"""From what the hypotheses agree on to test results: each cause its own fault, with its evidence."""

from __future__ import annotations

from gateway.monitors.contract import report
from gateway_fdi.jit import kernel
from gateway_plants.crank.monitor import (
    anchor,
    competing_hypothesis,
    defects,
    no_gap,
    noise,
    runout,
    turns,
    wrong_wheel,
)
from gateway_plants.crank.monitor.faults import (
    ADDED,
    DAMAGED,
    DOUBLED,
    MISSED,
    NO_GAP,
    NOISE,
    PULSES_LOST,
    RELOCATED,
    SYNC_LOST,
    TWO_PLACES,
    UNWATCHED,
    Reports,
)
from gateway_plants.crank.monitor.sync_state import (
    BY_CAM,
    CONFIRMED,
    NEVER,
    NOT_TOLD,
    TENTATIVE,
    Const,
    State,
    decides,
    doubt,
    search,
    shape,
    speed,
    tell_held,
    tooth_of,
    uncover,
)
from gateway_plants.crank.pulse_tracking import profile
from gateway_plants.crank.pulse_tracking.acquisition import begin_later
from gateway_plants.crank.pulse_tracking.hypotheses import HOPELESS
from gateway_plants.crank.pulse_tracking.tracker import (
    COARSE,
    agreed,
    best,
    expect,
    keep_best,
    marginalise_decided,
    shift,
    unanimous,
)

#: Pulses missed in a row from which on it is loss of signal.
LOSS = wrong_wheel.LOSS
#: Pulses within which missed (or added) ones are one disturbance, its count their sum.
TOGETHER = 8
#: Revolutions, and pulses beyond, without synchronisation after which the reason is named.
PATIENCE, PATIENCE_PULSES, LONG_PATIENCE = 4, 100, 10
#: A decision that took more pulses than this, or than half a turn, is held until the next gap has proven it.
LATE = 8
#: Parts of a turn: by one more the search begins later for each place that was refused. What follows in each turn may
#: be like the gap.
PARTS = 8
#: Pulses of a turn below which one too many in each turn makes the edges look as if they were noisy.
MARKED = 24
#: Turns that have to show the same teeth missing before two places are told: until then it may be another wheel.
SURE = 3
#: Turns of a wheel of equal pitches that have to show the same teeth missing again before it is followed all the same.
EVEN_TURNS = 2
#: Turns in a row that have to show the same place of a wheel of few pulses whose edges look noisy.
SHOWN = 2
#: Two places were told: which one is right, no later turn says.
TOLD = 2
#: Pairs of turns that have to show a whole wheel behind one that fitted twice, and what its teeth may be off [pitch].
WHOLE_PAIRS, WHOLE_OFF = 2, 0.1
#: Share of pulses without a frame, over about so many pulses, from which on nothing can be told.
MOST_UNSEEN, UNSEEN_PULSES = 0.4, 3000.0


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

    None where the engine may have turned back.
    """
    if s.phase == TENTATIVE and s.reversal.stood == 1:
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
    if beside or not defects.take(s.defects, c.pulses, tooth, net, s.teeth):
        s.suspects += 1
        s.recurring = 0
        defects.clear(s.defects)
        if not beside:
            defects.take(s.defects, c.pulses, tooth, net, s.teeth)
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
    """Count missed or added pulses with those just before; the gap has to bear out that one was missed.

    Not those that come again in each turn (``own``), and none beside the gap, which may be filled from now on.
    """
    if own or s.teeth - s.decided > TOGETHER:
        s.burst_missed = 0
        s.burst_added = 0
        s.burst_tooth = tooth
    s.burst_missed += missed
    s.burst_added += added
    if not own:
        s.decided = s.teeth
        if missed > 0 and c.even == 0 and not _beside_gap(c, tooth):
            s.anchor.unchecked = 1


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
        expect(s.tracker, c.pulses, tooth, net)
    if own and s.teeth - s.decided > c.pulses - TOGETHER:  # nothing else is missing or added in this turn
        s.recent_missed = 0
        s.recent_added = 0
    defects.learn(s.defects, c.pulses, tooth, net, s.teeth)
    if own and net > 0 and s.placed > NOT_TOLD and c.turns == 1 and s.defects.turns >= SURE:
        d = report(out, DAMAGED, True, net, turns.BENT).damaged
        d.tooth, d.off, d.speed = tooth_of(s, c, tooth), net, speed(s, c)


@kernel
def prove(s: State, c: Const, out: Reports) -> None:
    """Take a place for proven that a turn of pulses has fitted, and that by the whole turn is no other.

    Where the gap was not seen for what it is, or may be a turning point, one turn can fit by chance: a second one has
    to. Where single pulses cannot be told from noise the index may slip; if a defect of each turn alone can look like
    such noise, more turns have to show the gap where the turn before did than elsewhere, at first. None proves it while
    it is filled by a pulse each turn. A wheel of equal pitches has no place: its speed is followed then, with the teeth
    that are missing of it in each turn.
    """
    if c.even == 1:
        if s.since >= c.pulses or s.defects.turns >= EVEN_TURNS:
            confirm(s, out)
        return
    shown = s.sure == 1 and s.reversal.stood == 0
    proof = c.pulses if shown or c.anchor.ratio == 0.0 else 2 * c.pulses
    if s.since < proof or s.filled == 1 or _two_fit(s) or not decides(s, c) or _held_back(s, c):
        return
    if _noisy(s, c):
        return
    if s.held_fault >= 0 and not _alone(s, c, out):
        return
    if anchor.ask(s.anchor, c.anchor, c.pulses, c.repeats, s.index) == anchor.HERE:
        doubtful = c.anchor.ratio > 0.0 and (s.reversal.stood == 1 or s.refused > 1)
        confirm(s, out)
        s.anchor.unchecked = 1 if doubtful else 0


@kernel
def _noisy(s: State, c: Const) -> bool:
    """Tell whether the edges of a wheel of few pulses are so noisy that more turns have to show its place."""
    return bool(
        c.pulses < MARKED and c.anchor.ratio > 0.0 and s.tracker.variance > COARSE / 2 and s.waiting.row < SHOWN
    )


@kernel
def _two_fit(s: State) -> bool:
    """Tell whether another place that was seen may be the right one: its gap may be filled now, by a pulse that is off.

    The wheel then seems to have a bent tooth. Where it has none, what came before was none of its turns.
    """
    whole = s.profile.turns >= WHOLE_PAIRS and abs(s.profile.off) <= WHOLE_OFF
    return bool(s.twice == TOLD or (s.twice == 1 and not whole))


@kernel
def _held_back(s: State, c: Const) -> bool:
    """Return whether a fault is held until it is known that the wheel is the configured one."""
    return bool((s.held_fault >= 0 or s.recurring == 1) and wrong_wheel.unsure(s, c))


@kernel
def confirm(s: State, out: Reports) -> None:
    """Take the place on the wheel for proven, and report what was held until then."""
    s.phase = CONFIRMED
    s.anchor.unchecked = 0
    s.refused = 0
    no_gap.clear(s.waiting)
    s.suspects = 0
    s.hole = 0
    s.reversal.stood = 0
    if s.held_fault >= 0:
        tell_held(s, s.held_fault, out)
        if s.held_fault == ADDED:
            s.added += int(s.held.count)
        else:
            s.missed += int(s.held.count)
        s.held_fault = -1


@kernel
def hold_to_gap(s: State, c: Const, y: float, out: Reports) -> None:
    """Hold the place on the wheel to the gap: behind it when it comes where it is expected, else once a turn.

    What frames that were lost had hidden is proven by the gap that comes where it is expected, all hypotheses agreeing.
    The intervals of a turn in which pulses were missed or added are not those of the wheel, and say nothing of another
    place. A wheel of equal pitches has none.
    """
    an = s.anchor
    if s.index == 1:
        pitches = s.tracker.pitches
        odd = anchor.odd(c.anchor, pitches, c.pulses, s.y2, s.y1, y, s.tracker.variance <= COARSE)
        an.short = 1 if s.defects.turns == 0 and odd else 0
    if c.even == 1:
        if an.age >= c.pulses:
            an.age = c.pulses + anchor.EDGES - c.anchor.length
        an.verified = 1
    elif s.index == 1 and (anchor.seen(an, c.anchor, s.y2, s.y1, y) or _laid(s, c)):
        _witness(s, c, c.anchor.alone == 1 and anchor.level(s.tracker.pitches, c.pulses, s.y2, y), out)
    elif an.age >= c.pulses + anchor.EDGES and not decides(s, c):
        an.age = c.pulses + anchor.EDGES - c.anchor.length
        an.verified = 1
    elif an.age >= c.pulses + anchor.EDGES:
        an.age = c.pulses + anchor.EDGES - c.anchor.length
        an.verified = 0
        found = anchor.ask(an, c.anchor, c.pulses, c.repeats, s.index)
        if found == anchor.HERE:
            anchor.hold(an)
            if s.recurring == 1 or s.teeth - s.uneven > c.anchor.length:
                _witness(s, c, True, out)
        elif s.teeth - s.uneven <= c.anchor.length:
            if found == anchor.ABSENT and s.known == 0:
                doubt(s)
        elif found <= 0:
            # One turn alone never decides: it may be a burst.
            an.against += min(anchor.against(an, c.anchor, c.pulses, c.repeats, s.index), anchor.ODDS)
            if found == anchor.ABSENT or an.against > anchor.ODDS:
                an.against = 0.0
                doubt(s)
        else:
            an.wins = an.wins + 1 if found == an.shift else 1
            an.shift = found
            if an.wins >= anchor.WINS or (s.phase == TENTATIVE and s.suspects == 0 and s.hole == 0):
                relocate(s, c, out, found)


@kernel
def _told_apart(s: State, c: Const) -> bool:
    """Tell whether faults of each turn are no noise, and their pulses none that the wheel itself may have there.

    A pulse too many halfway between two teeth is what marks 12+1.
    """
    added = defects.missing(s.defects) == 0
    return bool(s.tracker.variance <= COARSE and not (added and c.anchor.ratio == 0.0))


@kernel
def _laid(s: State, c: Const) -> bool:
    """Tell whether it is the whole turn, laid onto the wheel, that proves a place with defects in each turn.

    Not on a wheel whose gap is no mark of its own (12+1).
    """
    return bool(s.phase == TENTATIVE and s.recurring == 1 and c.anchor.ratio > 0.0)


@kernel
def _alone(s: State, c: Const, out: Reports) -> bool:
    """Tell whether no other place explains the last turn as well; reports one, if teeth are missing in each turn."""
    period = best(s.tracker).period
    number, missing = competing_hypothesis.seek(s.rival, s.anchor, c.anchor.length, c.wheel, c.repeats, s.index, period)
    if s.recurring == 1 and (number > competing_hypothesis.MOST or missing != defects.missing(s.defects)):
        return False
    if s.rival.other == competing_hypothesis.NONE:
        return True
    if missing == 0 or s.recurring == 0 or s.defects.turns < SURE:
        return False
    no_gap.clear(s.waiting)
    s.twice = TOLD
    e = report(out, TWO_PLACES, True, s.defects.turns, SURE).two_places
    e.tooth, e.other, e.speed = s.rival.tooth, s.rival.other, speed(s, c)
    e.here, e.there = s.rival.here, s.rival.there
    return False


@kernel
def _move(s: State, c: Const, number: int) -> None:
    """Put the index on by so many teeth; what was learned at the wrong place is forgotten."""
    shift(s.tracker, c.pulses, number)
    s.index = best(s.tracker).index
    profile.forget(s.profile, c.wheel, s.tracker.pitches)
    runout.forget(s.law)
    turns.trust(s, c)
    anchor.restart(s.anchor)


@kernel
def settle(s: State, c: Const, out: Reports, other: bool) -> None:
    """Take one of two places for the right one, as the cam says; the other one goes.

    Args:
        s: record of State.
        c: record of Const.
        out: record of Out.
        other: whether it is the rival.
    """
    if other:
        _move(s, c, competing_hypothesis.place_of(s.rival, c.wheel, s.index) - s.index)
        s.held.tooth = s.rival.other
    competing_hypothesis.clear(s.rival)
    s.twice = 0
    s.recurring = 0
    confirm(s, out)


@kernel
def place_by_cam(s: State, c: Const, number: int) -> None:
    """Put the index of a wheel of equal pitches on by so many teeth: it is told by the cam then."""
    s.placed = BY_CAM
    s.uneven = NEVER
    if number != 0:
        _move(s, c, number)
        defects.clear(s.defects)


@kernel
def _witness(s: State, c: Const, sure: bool, out: Reports) -> None:
    """Take the gap at its place as the proof that lost frames, or a defect of every turn, leave to be given.

    Args:
        s: record of State.
        c: record of Const.
        sure: whether it can be no other gap, nor a piece of one.
        out: record of Out.
    """
    h = best(s.tracker)
    told = agreed(s.tracker) and h.missed == 0 and h.added == 0
    if told:
        s.sure = 1
    if s.phase != TENTATIVE or not told or not decides(s, c) or _held_back(s, c) or _noisy(s, c):
        return
    if s.recurring == 1 and not _told_apart(s, c):
        return
    if s.recurring == 1 and not _alone(s, c, out):
        return
    if s.recurring == 0 and s.doubted == NEVER and (s.uncovered > 0 or _two_fit(s)):
        return  # never proven: in what no frame brought may be another gap
    if s.hole == 1 and s.recurring == 0:
        if s.defects.turns == 0 and s.doubted < s.uneven > s.teeth - 2 * c.pulses:
            return  # a pulse too many in each turn may be in the gap
        if not sure and anchor.ask(s.anchor, c.anchor, c.pulses, c.repeats, s.index) != anchor.HERE:
            return
    if s.hole == 1 or s.recurring == 1:
        confirm(s, out)


@kernel
def unwatched(s: State, c: Const, number: int, out: Reports) -> None:
    """Count pulses that no frame brought; when they are too many to tell anything about the sensor, say so."""
    s.unseen += number * (1.0 - s.unseen / UNSEEN_PULSES)
    share = s.unseen / UNSEEN_PULSES
    if share > MOST_UNSEEN:
        e = report(out, UNWATCHED, True, share, MOST_UNSEEN).unwatched
        e.share, e.teeth = share, s.teeth


@kernel
def relocate(s: State, c: Const, out: Reports, found: int) -> None:
    """Put the index right by a shift that the whole turn proves."""
    _move(s, c, found)
    if s.phase == CONFIRMED and not wrong_wheel.unsure(s, c):
        off = found if 2 * found <= c.pulses else found - c.pulses
        e = report(out, RELOCATED, True, off, 0.0).relocated
        e.shift, e.tooth, e.speed = off, s.index, speed(s, c)
        s.corrections += off
    doubt(s)
    s.doubted = NEVER
    uncover(s, c)
    s.held_fault = -1


@kernel
def _open(s: State, c: Const) -> bool:
    """Return whether something else than a missing gap is about to be told: another wheel, defects of each turn."""
    defect = s.phase == TENTATIVE and s.recurring == 1
    return bool(defect or wrong_wheel.expected(s) or wrong_wheel.unsure(s, c))


@kernel
def wait(s: State, c: Const, y: float, out: Reports) -> None:
    """Count pulses without a proven place on the wheel, and name the reason in the end.

    There may be none: an engine whose ripple hides the gap is no defect, so that only what speaks against the wheel
    counts, for :data:`LONG_PATIENCE` times as long, and for ever while the starter turns it.
    """
    wa = s.waiting
    if _held_back(s, c):
        no_gap.clear(wa)  # the place may be known: it waits for the wheel, which is no reason to miss the gap
        return
    no_gap.note(wa, s.y2, s.y1, y)
    if c.even == 0:
        no_gap.look(wa, s.anchor, c.anchor, c.turned, c.polar == 1, c.pulses, c.repeats)
    patience = PATIENCE * c.pulses + PATIENCE_PULSES
    if wa.pulses < patience or (wa.pulses > patience and wa.pulses % c.pulses != 0):
        return
    share = wa.short / wa.pulses - c.short
    fires = no_gap.turn_us(s.anchor, c.anchor.length, c.pulses) < 60e6 / runout.FIRING_RPM * c.turns
    if share > turns.DOUBLE_SHARE:
        d = report(out, DOUBLED, True, share, turns.DOUBLE_SHARE).doubled
        d.share, d.teeth = share, s.teeth
    elif c.even == 1:
        pass  # it has no gap that could be missing
    elif fires and c.polar == 1 and no_gap.polarity(wa):
        _tell_gap(s, c, out, 1.0)
    elif fires and s.phase == TENTATIVE and s.recurring == 1 and s.defects.turns >= SURE and s.twice != TOLD:
        number = defects.missing(s.defects)
        shape(s, c, number if number > 0 else s.defects.count, 0, s.held)
        s.held.tooth = -1  # every place that is left has it, each at another tooth
        tell_held(s, MISSED if number > 0 else ADDED, out)
    elif _open(s, c) and wa.pulses < LONG_PATIENCE * patience:
        return
    elif no_gap.contradicts(wa, fires, c.teeth) or (fires and wa.pulses >= LONG_PATIENCE * patience):
        _tell_gap(s, c, out, 0.0)
        s.twice = max(s.twice, 1)
    else:
        return
    no_gap.clear(wa)


@kernel
def _tell_gap(s: State, c: Const, out: Reports, polarity: float) -> None:
    """Report that the gap never comes; 1: as reversed polarity makes it."""
    g = report(out, NO_GAP, True, s.waiting.widest, c.gap).no_gap
    g.teeth, g.widest, g.polarity = s.teeth, s.waiting.widest, polarity

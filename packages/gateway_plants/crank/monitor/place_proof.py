"""When a place on the wheel is proven, held to its gap, and put right."""

from __future__ import annotations

from gateway.monitors.contract import report
from gateway_fdi.jit import kernel
from gateway_plants.crank import wheel_estimation
from gateway_plants.crank.monitor import anchor, competing_hypothesis, defects, no_gap, runout, turns, wrong_wheel
from gateway_plants.crank.monitor.faults import ADDED, RELOCATED, TWO_PLACES, Reports
from gateway_plants.crank.monitor.sync_state import (
    BY_CAM,
    CONFIRMED,
    MARKED,
    NEVER,
    TENTATIVE,
    Const,
    State,
    decides,
    doubt,
    laid,
    speed,
    tell_held,
)
from gateway_plants.crank.pulse_tracking import profile
from gateway_plants.crank.pulse_tracking.tracker import COARSE, agreed, best, shift

#: Turns of a wheel of equal pitches that have to show the same teeth missing again before it is followed all the same.
EVEN_TURNS = 2
#: Turns in a row that have to show the same place of a wheel of few pulses whose edges look noisy.
SHOWN = 2
#: Two places were told: which one is right, no later turn says.
TOLD = 2
#: Pairs of turns that have to show a whole wheel behind one that fitted twice, and what its teeth may be off [pitch].
WHOLE_PAIRS, WHOLE_OFF = 2, 0.1


@kernel
def prove(s: State, c: Const, out: Reports) -> None:
    """Take a place for proven that a turn of pulses has fitted, and that by the whole turn is no other.

    Where the gap was not seen for what it is, or may be a turning point, one turn can fit by chance: a second one has
    to. Where single pulses cannot be told from noise the index may slip; if a defect of each turn alone can look like
    such noise, more turns have to show the gap where the turn before did than elsewhere, at first. None proves it
    while it is filled by a pulse each turn. A wheel of equal pitches has no place: its speed is followed then, with the
    teeth that are missing of it in each turn.
    """
    if c.even == 1:
        if s.since >= c.pulses or s.defects.turns >= EVEN_TURNS:
            confirm(s, out)
        return
    shown = s.sure == 1 and s.reversal.stood == 0
    proof = c.pulses if shown or c.anchor.ratio == 0.0 else 2 * c.pulses
    off = abs(s.tracker.residual) > competing_hypothesis.MOST_OFF  # the latest interval may be another gap
    if off or s.since < proof or s.filled == 1 or _two_fit(s) or not decides(s, c) or held_back(s, c):
        return
    seen = wheel_estimation.sure(s.seen)
    if _noisy(s, c) or (s.recurring == 0 and seen > 0 and seen != c.repeats):
        return
    if _alone(s, c, out):
        doubtful = c.anchor.ratio > 0.0 and (s.reversal.stood == 1 or s.refused > 1)
        confirm(s, out)
        s.anchor.unchecked = 1 if doubtful else 0


@kernel
def _noisy(s: State, c: Const) -> bool:
    """Tell whether the edges of a wheel of few pulses are so noisy that more turns have to show its place."""
    most = COARSE / 2 if c.anchor.ratio > 0.0 else COARSE  # one more pulse is told apart at coarser edges than a gap
    return bool(c.pulses < MARKED and s.tracker.variance > most and s.waiting.row < SHOWN)


@kernel
def _two_fit(s: State) -> bool:
    """Tell whether another place that was seen may be the right one: its gap may be filled now, by a pulse that is off.

    The wheel then seems to have a bent tooth. Where it has none, what came before was none of its turns.
    """
    whole = s.profile.turns >= WHOLE_PAIRS and abs(s.profile.off) <= WHOLE_OFF
    return bool(s.twice == TOLD or (s.twice == 1 and not whole))


@kernel
def held_back(s: State, c: Const) -> bool:
    """Return whether a fault is held until it is known that the wheel is the configured one."""
    return bool((s.held_fault >= 0 or s.recurring == 1) and wrong_wheel.unsure(s, c))


@kernel
def confirm(s: State, out: Reports) -> None:
    """Take the place on the wheel for proven, and report what was held until then."""
    s.phase = CONFIRMED
    anchor.hold(s.anchor)
    s.refused = 0
    no_gap.clear(s.waiting)
    s.suspects = 0
    s.hole = 0
    s.reversal.stood = 0
    s.reversal.slow = 0
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
        elif s.teeth - s.uneven <= c.anchor.length or (s.phase == CONFIRMED and s.defects.turns > 0):
            if found == anchor.ABSENT and s.known == 0 and laid(s, c) != s.index % c.repeats:
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
    return bool(s.tracker.variance <= COARSE and (defects.of_wheel(s.defects) or c.anchor.ratio > 0.0))


@kernel
def _laid(s: State, c: Const) -> bool:
    """Tell whether it is the whole turn, laid onto the wheel, that proves a place with defects in each turn.

    Not on a wheel whose gap is no mark of its own (12+1).
    """
    return bool(s.phase == TENTATIVE and s.recurring == 1 and c.anchor.ratio > 0.0)


@kernel
def _alone(s: State, c: Const, out: Reports) -> bool:
    """Tell whether no other place explains the last turn as well; reports one, if teeth are missing in each turn."""
    period, rv = best(s.tracker).period, s.rival
    if s.teeth - rv.asked < c.pulses // 2 or s.waiting.turned > s.waiting.same:
        return False  # each turn says it once, and none where it may be the polarity
    cost, missing = competing_hypothesis.seek(
        rv, s.anchor, c.anchor.length, c.wheel, c.repeats, s.index, period, s.tracker.variance
    )
    if cost > competing_hypothesis.most(c.anchor.length):  # ripple is too large: without defects, contrasts tell
        here = anchor.ask(s.anchor, c.anchor, c.pulses, c.repeats, s.index) == anchor.HERE
        return here and s.recurring == 0 and rv.other == competing_hypothesis.NONE
    rv.asked = s.teeth
    if s.recurring == 1 and missing != defects.missing(s.defects):
        return False
    if rv.other == competing_hypothesis.NONE:
        return True
    there = competing_hypothesis.place_of(rv, c.wheel, s.index)
    if rv.turns >= anchor.WINS and rv.odds < -competing_hypothesis.ODDS and there != competing_hypothesis.NONE:
        relocate(s, c, out, (there - s.index) % c.pulses)
        return False
    if missing == 0 or s.recurring == 0 or s.defects.turns < defects.SURE:
        return False
    no_gap.clear(s.waiting)
    s.twice = TOLD
    e = report(out, TWO_PLACES, True, s.defects.turns, defects.SURE).two_places
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
    competing_hypothesis.clear(s.rival)


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

    A place that was proven before the frames were lost needs no more than that it can be no other gap.

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
        s.reversal.slow = 0
    if s.phase != TENTATIVE or not told or not decides(s, c) or held_back(s, c) or _noisy(s, c):
        return
    if s.recurring == 1 and (s.twice == 1 or not _told_apart(s, c)):
        return
    if s.recurring == 0 and s.doubted == NEVER and _two_fit(s):
        return  # never proven: in what no frame brought may be another gap
    if s.hole == 1 and s.recurring == 0 and s.defects.turns == 0 and s.doubted < s.uneven > s.teeth - 2 * c.pulses:
        return  # a pulse too many in each turn may be in the gap
    kept = sure and s.recurring == 0 and s.doubted != NEVER and s.rival.other == competing_hypothesis.NONE
    if (s.hole == 1 or s.recurring == 1) and (kept or _alone(s, c, out)):
        confirm(s, out)


@kernel
def relocate(s: State, c: Const, out: Reports, found: int) -> None:
    """Put the index right by a shift that the whole turn proves."""
    _move(s, c, found)
    if s.phase == CONFIRMED and not wrong_wheel.unsure(s, c) and s.reversal.slow == 0:
        off = found if 2 * found <= c.pulses else found - c.pulses
        e = report(out, RELOCATED, True, off, 0.0).relocated
        e.shift, e.tooth, e.speed = off, s.index, speed(s, c)
        s.corrections += off
    doubt(s)
    s.doubted = NEVER
    s.held_fault = -1

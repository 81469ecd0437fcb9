"""A wheel that is not the configured one: told by the pulses themselves, not as a fault of the sensor.

Until the place is proven and the wheel is seen to be the configured one, each interval goes to
:mod:`gateway_plants.crank.wheel_estimation` as well. Another wheel is one whose turn has another number of pitches (a
wheel of equal parts shows one of them) and another number of pulses: ripple can make a gap look one pitch wider, but it
makes no pulse. With the same number of pitches it may be the configured wheel with a tooth broken off, or a pulse too
many in its gap. Which of these it is, pulses cannot say; a gap that is filled in each turn is told here as an added
pulse, and the monitor's other tests name the rest.
"""

from __future__ import annotations

from gateway.monitors.contract import report
from gateway_fdi.jit import kernel
from gateway_plants.crank import wheel_estimation, wheel_pairs
from gateway_plants.crank.monitor import anchor, candidate_wheels, defective_wheel, no_gap, runout, turns
from gateway_plants.crank.monitor.faults import ADDED, MISSED, PULSES_LOST, TWO_PLACES, WRONG_WHEEL, Reports
from gateway_plants.crank.monitor.sync_state import CONFIRMED, SEARCHING, Const, State, search
from gateway_plants.crank.wheel import MOST_GAPPED

#: Turns in a row that have to show another wheel, also behind an engine that may have turned back, and after which it
#: is told again.
TURNS, TURNED_BACK, AGAIN = 6, 12, 64
#: Two pitches are the same within this, and two turns [pitch].
EQUAL, SAME = defective_wheel.EQUAL, 0.75
#: Pulses that are waited for while the gaps do not repeat yet: eight turns of the largest wheel.
MOST_WAIT = 8 * MOST_GAPPED
#: Pulses since the start within which the turns of another wheel begin to repeat, five of 60-2, if it is one.
MOST_LOOKED = 300
#: Turns in a row that are the same, and show no wheel, behind which they are of none.
NO_WHEEL = 8
#: Teeth missing in a row from which on it is loss of signal.
LOSS = 3


@kernel
def note(s: State, c: Const, y: float, out: Reports) -> None:
    """Note an interval [us] while the wheel is looked at."""
    before = int(s.seen.turns)
    s.looked += 1
    wheel_estimation.note(s.seen, y)
    wheel_pairs.note(s.pairs, y)
    if c.even == 1 and s.phase == CONFIRMED and s.seen.run >= wheel_estimation.EVEN:
        s.looks = 0
    if s.seen.turns != before:
        _judge(s, c, out)
    elif s.pairs.count >= max(wheel_pairs.LEAST, 2 * c.pulses):
        _judge_pairs(s, c, out)


@kernel
def unsure(s: State, c: Const) -> bool:
    """Return whether the pulses may yet be shown to be of another wheel.

    Until then a pulse missed or added may be the other wheel's own: it is held, and told when the wheel is known.
    """
    if s.known == 1 or s.looks == 0 or c.seen == 0 or s.seen.turns >= _least(s):
        return False
    if s.seen.turns == 0 and s.seen.period > 0 and s.seen.matched >= NO_WHEEL * s.seen.period:
        return False
    return bool(s.looked < (2 * MOST_LOOKED if s.seen.period > 0 else MOST_LOOKED))


@kernel
def expected(s: State) -> bool:
    """Tell whether the pulses have gaps that are counted, so that the wheel may soon be seen."""
    counted = s.seen.period > 0 or s.waiting.pulses < MOST_WAIT
    return bool(s.seen.linked == 1 and counted and s.seen.turns < _least(s))


@kernel
def _least(s: State) -> int:
    """Return how many turns have to show another wheel."""
    return TURNED_BACK if s.reversal.stood == 1 else TURNS


@kernel
def _whole(s: State) -> float:
    """Return the pitches of a turn that is seen."""
    total = 0.0
    for k in range(s.seen.pulses):
        total += s.seen.pitches[k]
    return total


@kernel
def _cranked(s: State, c: Const) -> bool:
    """Return whether the engine is so slow that a compression may look like a gap to a wheel of few pulses."""
    return bool(no_gap.turn_us(s.anchor, c.anchor.length, c.pulses) > 60e6 / runout.FIRING_RPM * c.turns)


@kernel
def _speed(s: State, c: Const) -> float:
    """Return the speed by the pitch that is seen [rpm], and note it, which nothing else does without a place."""
    rpm = 60e6 / (s.seen.pitch * c.turn)
    turns.note_speed(s, rpm)
    return float(rpm)


@kernel
def _tell_pulses(s: State, c: Const, fault: int, count: int, tooth: int, out: Reports) -> None:
    """Report a pulse in a gap, or teeth broken off, from ``tooth`` on (-1: not known), in place of a missing gap."""
    e = report(out, fault, True, s.seen.turns, TURNS).pulses
    e.count, e.tooth, e.speed = count, tooth, _speed(s, c)
    no_gap.clear(s.waiting)


@kernel
def _tell_missing(s: State, c: Const, missing: int, tooth: int, out: Reports) -> None:
    """Report teeth broken off that the tracker could not take for missed ones."""
    _tell_pulses(s, c, MISSED if missing < LOSS else PULSES_LOST, missing, tooth, out)


@kernel
def _judge(s: State, c: Const, out: Reports) -> None:
    """Compare the wheel that is seen with the configured one, at the end of a turn."""
    s.filled = 0
    if wheel_estimation.sure(s.seen) == 0:
        s.wrong = 0
        return
    whole = _whole(s)
    same = abs(whole - c.turn) < SAME
    same = same or abs(whole * c.pulses - c.wheel.whole * c.repeats) < EQUAL * c.pulses
    same = same or s.seen.pulses == c.repeats
    if wheel_estimation.fits(s.seen, c.wheel.nominal, c.pulses):
        s.known = 1
    other = s.known == 0 and candidate_wheels.shown(c.made, s.seen)
    if not other and (same or (c.turns == 1 and defective_wheel.is_left(s, c, whole))):
        s.wrong = 0
        if s.phase == CONFIRMED:
            s.looks = 0
        elif s.seen.turns >= _least(s):
            _judge_defects(s, c, int(c.turn / whole + 0.5), out)
        return
    if s.seen.turns < _least(s) or (c.turns > 1 and _cranked(s, c)):
        return
    if s.wrong == 0 or s.seen.turns % AGAIN == 0:
        e = report(out, WRONG_WHEEL, True, s.seen.turns, TURNS).wrong_wheel
        e.teeth, e.pulses, e.gap = whole, s.seen.pulses, s.seen.pitches[s.seen.pulses - 1]
    _refuse(s, c)


@kernel
def _judge_defects(s: State, c: Const, parts: int, out: Reports) -> None:
    """Name what makes the configured wheel look as it is seen, ``parts`` times a turn, so that it is not proven."""
    missing = c.teeth - parts * s.seen.pulses
    if c.even == 1:
        _tell_missing(s, c, missing, defective_wheel.NONE, out)
        return
    gap = defective_wheel.filled(s, c)
    if gap != defective_wheel.NONE:
        s.filled = 1
        _tell_pulses(s, c, ADDED, 1, gap, out)
    elif s.recurring == 0 and c.turns == 1:
        _tell_beside(s, c, parts, missing, out)


@kernel
def _tell_beside(s: State, c: Const, parts: int, missing: int, out: Reports) -> None:
    """Report teeth that are missing beside a gap, on either side of it where that is the only one."""
    tooth, other = defective_wheel.left_at(s, c, parts, missing)
    if tooth == defective_wheel.NONE:
        return
    if other == defective_wheel.NONE:
        _tell_missing(s, c, missing, tooth, out)
        turns.tell_broken(tooth, missing, s.speed_rpm, out)
        return
    e = report(out, TWO_PLACES, True, s.seen.turns, TURNS).two_places
    e.tooth, e.other, e.speed = tooth, other, _speed(s, c)
    no_gap.clear(s.waiting)


@kernel
def _judge_pairs(s: State, c: Const, out: Reports) -> None:
    """Take two pitches that alternate for another wheel: between two gaps of the configured one they could not.

    Of a wheel of few pulses, an even number, ripple can make them while it is cranked.
    """
    ripple = c.pulses < anchor.FEW and c.pulses % 2 == 0 and _cranked(s, c)
    if c.even == 1 or c.turns > 1 or c.repeats == 2 or ripple:
        return
    if s.wrong == 0 or s.pairs.count % (2 * AGAIN) == 0:
        e = report(out, WRONG_WHEEL, True, s.pairs.count // 2, TURNS).wrong_wheel
        e.teeth, e.pulses, e.gap = 2.0, 2.0, wheel_pairs.longer(s.pairs)
    _refuse(s, c)


@kernel
def _refuse(s: State, c: Const) -> None:
    """Follow the pulses of another wheel no more."""
    s.wrong = 1
    no_gap.clear(s.waiting)
    if s.phase != SEARCHING:
        search(s, c)


@kernel
def counted(s: State, c: Const, teeth: float, out: Reports) -> None:
    """Tell of a wheel of equal pitches that the cam has counted another number of them a turn, several times."""
    if s.wrong == 0:
        e = report(out, WRONG_WHEEL, True, TURNS, TURNS).wrong_wheel
        e.teeth, e.pulses, e.gap = teeth, teeth, 1.0
    _refuse(s, c)

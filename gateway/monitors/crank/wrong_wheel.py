"""A wheel that is not the configured one: told by the pulses themselves, not as a fault of the sensor.

Until the place is proven and the wheel is seen to be the configured one, each interval goes to
:mod:`gateway.fdi.wheel_seen` as well. Another wheel is one whose turn has another number of pitches (a wheel of equal
parts shows one of them) and another number of pulses: ripple can make a gap look one pitch wider, but it makes no
pulse. With the same number of pitches it may be the configured wheel with a tooth broken off, or a pulse too
many in its gap. Which of these it is, pulses cannot say; a gap that is filled in each turn is told here as an added
pulse, and the monitor's other tests name the rest.
"""

from __future__ import annotations

from gateway.fdi import wheel_seen
from gateway.fdi.wheel import MOST_GAPPED
from gateway.jit import kernel
from gateway.monitors.contract import report
from gateway.monitors.crank import runout, waiting
from gateway.monitors.crank.faults import ADDED, MISSED, PULSES_LOST, WRONG_WHEEL, Reports
from gateway.monitors.crank.place import CONFIRMED, SEARCHING, Const, State, search

#: Turns in a row that have to show another wheel, and after which it is told again.
TURNS, AGAIN = 6, 64
#: Two pitches are the same within this, and two turns [pitch].
EQUAL, SAME = 0.4, 0.75
#: Pulses that are waited for while the gaps do not repeat yet: eight turns of the largest wheel.
MOST_WAIT = 8 * MOST_GAPPED
#: Teeth that may be missing of the configured wheel: one may be so by chance where all parts of the turn become equal,
#: two are not (36-1 without a tooth at 120 and at 240 degrees would be what 12-1 shows at three times the speed).
MOST_MISSING = 1
#: Teeth missing in a row from which on it is loss of signal.
LOSS = 3
#: A pitch from which on it is a gap, that a pulse can fill [pitch].
LEAST_GAP = 1.3


@kernel
def note(s: State, c: Const, y: float, out: Reports) -> None:
    """Note an interval [us] while the wheel is looked at."""
    before = int(s.seen.turns)
    wheel_seen.note(s.seen, y)
    if c.even == 1 and s.phase == CONFIRMED and s.seen.run >= wheel_seen.EVEN:
        s.looks = 0
    if s.seen.turns != before:
        _judge(s, c, out)


@kernel
def expected(s: State) -> bool:
    """Tell whether the pulses have gaps that are counted, so that the wheel may soon be seen."""
    counted = s.seen.period > 0 or s.waiting.pulses < MOST_WAIT
    return bool(s.seen.linked == 1 and counted and s.seen.turns < TURNS)


@kernel
def _whole(s: State) -> float:
    """Return the pitches of a turn that is seen."""
    total = 0.0
    for k in range(s.seen.pulses):
        total += s.seen.pitches[k]
    return total


@kernel
def _is_left(s: State, c: Const, whole: float) -> bool:
    """Tell whether what is seen, several times a turn, is the configured wheel without a tooth.

    Opposite to the gap of 12-1 a tooth broken off leaves what 6-1 shows at twice the speed.

    Args:
        s: record of State.
        c: record of Const.
        whole: pitches of the turn that is seen.
    """
    parts = int(c.wheel.whole / whole + 0.5)
    missing = c.pulses - parts * s.seen.pulses
    if abs(parts * whole - c.wheel.whole) > EQUAL or missing < 1 or missing > MOST_MISSING:
        return False
    for first in range(c.pulses):
        tooth, left, fits = first, missing, True
        for k in range(parts * s.seen.pulses):
            span = s.seen.pitches[k % s.seen.pulses] - c.wheel.nominal[tooth]
            tooth = tooth + 1 if tooth + 1 < c.pulses else 0
            while span > EQUAL and left > 0:
                span -= c.wheel.nominal[tooth]
                tooth = tooth + 1 if tooth + 1 < c.pulses else 0
                left -= 1
            if abs(span) > EQUAL:
                fits = False
                break
        if fits:
            return True
    return False


@kernel
def _filled(s: State, c: Const) -> int:
    """Return the tooth before the gap in which there is a pulse too many in each turn that is seen, -1: there is none.

    A pulse at a third of the gap of 60-2 leaves what 60-1 shows, and fits before and behind: the largest gap counts.
    """
    if s.seen.pulses != c.pulses + 1:
        return -1
    for back in range(c.pulses):
        gap = c.pulses - 1 - back
        if c.wheel.nominal[gap] < LEAST_GAP:
            continue
        for first in range(c.pulses + 1):
            fits, at = True, first
            for k in range(c.pulses):
                span = s.seen.pitches[at]
                at = at + 1 if at + 1 <= c.pulses else 0
                if k == gap:
                    span += s.seen.pitches[at]
                    at = at + 1 if at + 1 <= c.pulses else 0
                if abs(span - c.wheel.nominal[k]) > EQUAL:
                    fits = False
                    break
            if fits:
                return gap
    return -1


@kernel
def _cranked(s: State, c: Const) -> bool:
    """Return whether the engine is so slow that a compression may look like a gap to a wheel of few pulses."""
    return bool(waiting.turn_us(s.anchor, c.pulses) > 60e6 / runout.FIRING_RPM * c.turns)


@kernel
def _tell_filled(s: State, c: Const, tooth: int, out: Reports) -> None:
    """Report the pulse too many in a gap. Meanwhile nothing is proven, and the gap is not told as missing."""
    e = report(out, ADDED, True, s.seen.turns, TURNS).pulses
    e.count, e.tooth, e.speed = 1.0, tooth, 60e6 / (s.seen.pitch * c.turn)
    waiting.clear(s.waiting)


@kernel
def _tell_broken(s: State, c: Const, out: Reports) -> None:
    """Report teeth broken off a wheel of equal pitches, of so few that none of its turns is even enough to follow."""
    missing = c.teeth - s.seen.pulses
    e = report(out, MISSED if missing < LOSS else PULSES_LOST, True, s.seen.turns, TURNS).pulses
    e.count, e.tooth, e.speed = missing, -1.0, 60e6 / (s.seen.pitch * c.turn)


@kernel
def _judge(s: State, c: Const, out: Reports) -> None:
    """Compare the wheel that is seen with the configured one, at the end of a turn."""
    s.filled = 0
    if wheel_seen.sure(s.seen) == 0:
        s.wrong = 0
        return
    whole = _whole(s)
    same = abs(whole - c.turn) < SAME
    same = same or abs(whole * c.pulses - c.wheel.whole * c.repeats) < EQUAL * c.pulses
    same = same or s.seen.pulses == c.repeats
    if same or (c.turns == 1 and _is_left(s, c, whole)):
        s.wrong = 0
        if s.phase == CONFIRMED:
            s.looks = 0
        elif s.seen.turns >= TURNS and s.reversal.stood == 0:
            tooth = _filled(s, c)
            if c.even == 1:
                _tell_broken(s, c, out)
            elif tooth >= 0:
                s.filled = 1
                _tell_filled(s, c, tooth, out)
        return
    if s.seen.turns < TURNS or s.reversal.stood == 1 or (c.turns > 1 and _cranked(s, c)):
        return
    if s.wrong == 0 or s.seen.turns % AGAIN == 0:
        e = report(out, WRONG_WHEEL, True, s.seen.turns, TURNS).wrong_wheel
        e.teeth, e.pulses, e.gap = whole, s.seen.pulses, s.seen.pitches[s.seen.pulses - 1]
    _refuse(s, c)


@kernel
def _refuse(s: State, c: Const) -> None:
    """Follow the pulses of another wheel no more."""
    s.wrong = 1
    waiting.clear(s.waiting)
    if s.phase != SEARCHING:
        search(s, c)


@kernel
def counted(s: State, c: Const, teeth: float, out: Reports) -> None:
    """Tell of a wheel of equal pitches that the cam has counted another number of them a turn, several times."""
    if s.wrong == 0:
        e = report(out, WRONG_WHEEL, True, TURNS, TURNS).wrong_wheel
        e.teeth, e.pulses, e.gap = teeth, teeth, 1.0
    _refuse(s, c)

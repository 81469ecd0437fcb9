"""The gap as an anchor: each turn the raw intervals are asked where on the wheel they are.

The tracker takes a gap for one residual more, so that an index which is wrong could outlive any number of gaps. Here
the logarithms of the last turn's intervals are compared with the wheel's at every shift. Speed and acceleration are
taken off by the contrast of an interval with its neighbours, which a straight line does not enter::

    c_k = ln y_k - (ln y_{k-1} + ln y_{k+1}) / 2,        p_i = ln a_i - (ln a_{i-1} + ln a_{i+1}) / 2
    S(d) = sum over k of min((c_k - p_{i(k) + d})^2, MOST),    i(k) the slot that interval k is believed to be

``a`` the nominal pitches (what was learned may be what is wrong). With noise of variance v the log likelihood of
shift d against the present one is ``(S(0) - S(d)) / 2 v``. A shift that is likelier than the present place by
:data:`ODDS`, and than any third one by :data:`UNIQUE`, wins; two wins in a row of the same shift, a turn apart,
relocate. One disturbance is in one window only, because the windows do not overlap.

The whole test takes all pulses times all shifts, so it is spared while the gap comes where it is expected: there
``y_1^2 / (y y_2)`` is the wheel's own ratio and no other place is likelier.
"""

from __future__ import annotations

from math import exp, log
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from gateway_fdi.jit import Record, f8, f8s, i4, kernel, means, u1
from gateway_plants.crank.wheel import MOST_TEETH

#: [nat] by which a shift has to be likelier than the present place, and than any other shift.
ODDS, UNIQUE = 12.0, 4.0
#: Most that one contrast counts (a pulse missed or added is about so far off), least variance of a contrast.
MOST, LEAST_VARIANCE = 0.5, 0.05**2
#: Intervals of a turn whose contrast is not known, because a neighbour is not. Of a wheel of fewer pulses than
#: :data:`FEW` they would be half of all, the gap's among them: there two intervals more are looked at.
EDGES, FEW = 2, 10
#: A contrast that is not known, because one of its intervals is not.
UNKNOWN = 1e9
#: The gap is where it is expected when the square of its ratio is right within this factor.
RIGHT = 1.65
#: Neighbours of a gap are alike within this factor; a pitch, and a piece of a filled gap, are not.
LEVEL = 1.35
#: A gap whose squared ratio to its neighbours is less than this is no mark of its own.
DISTINCT = 2.4
#: Pulses since the gap, at most, where a place is found by it.
SEEN = 6
#: Wins of a shift in a row after which it is believed.
WINS = 2
#: What :func:`ask` found besides a shift: the turn is even, no gap is in it; it cannot tell; the present place is the
#: likeliest by far.
ABSENT, UNDECIDED, HERE = -2, -1, 0


class Const(Record):
    """Constants."""

    length: i4 = means("intervals that are looked at")
    ratio: f8 = means("largest gap squared over its neighbours; 0: not distinct")
    width: f8 = means("largest gap", "pitch")
    alone: u1 = means("1: no other slot of the pattern looks like the largest gap")
    largest: f8 = means("largest contrast")
    contrast: Annotated[f8s, MOST_TEETH] = means("p_i, contrasts of the wheel's slots")


class State(Record):
    """State."""

    at: i4 = means("place of the next interval")
    age: i4 = means("pulses since the gap was seen where it is expected, or since the last test")
    shift: i4 = means("shift that won last")
    wins: i4 = means("wins of that shift in a row")
    against: f8 = means("odds against the present place, of turns since it was seen", "nat")
    short: u1 = means("1: the gap came too short: a pulse may be in it, and so the place be wrong")
    verified: u1 = means("1: the gap was seen where it is expected since the last test")
    unchecked: u1 = means("1: a pulse is believed missed, or the engine turned back, and it was not seen so since")
    intervals: Annotated[f8s, MOST_TEETH] = means("intervals of the last turn; 0: not known", "us")
    logs: Annotated[f8s, MOST_TEETH] = means("c_k, contrasts of those intervals")


def prepare(c: Const, pitches: NDArray[np.float64]) -> None:
    """Fill the constants.

    Args:
        c: record of Const.
        pitches: shape (P,), nominal; the last one is the largest gap.
    """
    logs = np.log(pitches)
    c.length = len(logs) + (EDGES if len(logs) < FEW else 0)
    c.contrast[: len(logs)] = logs - (np.roll(logs, 1) + np.roll(logs, -1)) / 2
    c.largest = np.abs(c.contrast[: len(logs)]).max()
    c.width = pitches.max()
    ratio = float(np.exp(2 * (logs[-1] - (logs[-2] + logs[0]) / 2)))
    c.ratio = ratio if ratio >= DISTINCT else 0.0
    alike = int((2.0 * c.contrast[: len(logs)] + log(RIGHT) >= log(ratio)).sum())
    c.alone = alike == sum((np.roll(pitches, k) == pitches).all() for k in range(len(logs)))


@kernel
def restart(an: State) -> None:
    """Begin at a new place: what the intervals were stays, what they proved does not."""
    an.age = 0
    an.wins = 0
    an.against = 0.0
    an.short = 0
    an.verified = 0
    an.unchecked = 0


@kernel
def note(an: State, size: int, y: float) -> None:
    """Note one interval [us]."""
    an.at = put(an, int(an.at), size, y)
    an.age += 1


@kernel
def put(an: State, at: int, size: int, y: float) -> int:
    """Put an interval [us] at its place; returns the place of the next one."""
    an.intervals[np.uint64(at)] = y
    return at + 1 if at + 1 < size else 0


@kernel
def skip(an: State, size: int, number: int) -> None:
    """Pass over intervals that nobody told."""
    for _ in range(min(number, size)):
        an.at = put(an, int(an.at), size, 0.0)
    an.age += number
    an.verified = 0


@kernel
def seen(an: State, c: Const, y2: float, y1: float, y: float) -> bool:
    """Tell whether the gap ``y1`` [us], between its neighbours, is where it is expected; notes it."""
    if c.ratio == 0.0 or y1 == 0.0 or y2 == 0.0:
        return False
    ratio, expected = y1 * y1, c.ratio * y * y2
    if ratio * RIGHT < expected or ratio > RIGHT * expected:
        return False
    an.age = 0
    hold(an)
    return True


@kernel
def hold(an: State) -> None:
    """The gap is where it is expected: nothing speaks against the place."""
    an.wins = 0
    an.against = 0.0
    an.verified = 1
    an.unchecked = 0


@kernel
def odd(c: Const, pitches: f8s, pulses: int, y2: float, y1: float, y: float, quiet: bool) -> bool:
    """Tell whether a pulse may be in the gap ``y1`` [us]: it is too short, or one of its neighbours is.

    Args:
        c: record of Const.
        pitches: as learned; a bent tooth beside the gap is no pulse in it.
        pulses: of one turn.
        y2: interval before the gap [us]; 0: not known.
        y1: the gap.
        y: interval behind it.
        quiet: whether edges jitter so little that a neighbour is short for no other reason.
    """
    gap = pitches[pulses - 1]
    ratio = min(c.ratio, gap * gap / (pitches[pulses - 2] * pitches[0]))
    piece = quiet and c.ratio > 0.0 and not level(pitches, pulses, y2, y)
    return bool(y2 > 0.0 and (piece or y1 * y1 * RIGHT < ratio * y * y2))


@kernel
def level(pitches: f8s, pulses: int, y2: float, y: float) -> bool:
    """Tell whether the neighbours of the gap are as long as each other [us]: else one may be a piece of it."""
    one, other = y * pitches[pulses - 2], y2 * pitches[0]
    return bool(one < LEVEL * other and other < LEVEL * one)


@kernel
def shows(an: State, c: Const, index: int) -> bool:
    """Tell whether the largest gap is among the last intervals, and stands out from its neighbours as it should.

    A straight line through a few logarithms is not what an engine does that spins up over a compression: a place that
    was found without having seen the gap is a guess.

    Args:
        an: record of State.
        c: record of Const.
        index: of the latest tooth; the gap ended so many pulses ago.
    """
    if index > SEEN:
        return False
    at, ring = an.at - 1 - index, c.length
    before, here = an.intervals[(at - 1) % ring], an.intervals[at % ring]
    behind = an.intervals[(at + 1) % ring] if index > 0 else before
    squared, expected = here * here, c.ratio * before * behind
    return bool(c.ratio > 0.0 and expected > 0.0 and expected / RIGHT <= squared <= RIGHT * expected)


@kernel
def squares(an: State, c: Const, pulses: int, index: int, shift: int) -> float:
    """Return S of a shift; the contrasts are in ``logs``, that of the interval k pulses ago at k."""
    total = 0.0
    slot = index - 2 + shift
    while slot < 0:
        slot += pulses
    while slot >= pulses:
        slot -= pulses
    for k in range(1, c.length - 1):
        d = an.logs[k] - c.contrast[slot]
        if d < UNKNOWN:
            total += min(d * d, MOST)
        slot = slot - 1 if slot > 0 else pulses - 1
    return total


@kernel
def _fits(an: State, c: Const, pulses: int, index: int) -> bool:
    """Tell whether no contrast of the last turn is as far off as of a pulse missed or added."""
    slot = (index - 2) % pulses
    for k in range(1, c.length - 1):
        if an.logs[k] < UNKNOWN and (an.logs[k] - c.contrast[slot]) ** 2 >= MOST:
            return False
        slot = slot - 1 if slot > 0 else pulses - 1
    return True


@kernel
def contrasts(an: State, size: int) -> int:
    """Compute the contrasts; returns how many are known."""
    known = 0
    at = int(an.at)
    for k in range(1, size - 1):
        before, here, after = at - 2 - k, at - 1 - k, at - k
        y0 = an.intervals[before if before >= 0 else before + size]
        y1 = an.intervals[here if here >= 0 else here + size]
        y2 = an.intervals[after if after >= 0 else after + size]
        if y0 > 0.0 and y1 > 0.0 and y2 > 0.0:
            an.logs[k] = log(y1) - 0.5 * (log(y0) + log(y2))
            known += 1
        else:
            an.logs[k] = UNKNOWN
    return known


@kernel
def least_known(pulses: int) -> int:
    """Return how many contrasts a turn needs to be judged: half of them, five at least, or all of a small wheel."""
    return max((pulses + 1) // 2, min(5, pulses))


@kernel
def plain(an: State, size: int) -> float:
    """Return S of a wheel without a gap; the contrasts are in ``logs``."""
    total = 0.0
    for k in range(1, size - 1):
        d = an.logs[k]
        if d < UNKNOWN:
            total += min(d * d, MOST)
    return total


@kernel
def unique(first: float, known: int) -> float:
    """Return by how much the second S has to exceed the ``first``, for that to be likelier by :data:`UNIQUE`.

    The variance is not known but estimated from as many contrasts: the log likelihood is half their number times the
    logarithm of the ratio. Of two or three contrasts ripple may fit another place well by chance.
    """
    return float(max(first, LEAST_VARIANCE * (known - 1)) * (exp(2.0 * UNIQUE / known) - 1.0))


@kernel
def likeliest(an: State, c: Const, pulses: int, repeats: int, index: int) -> tuple[float, float, int]:
    """Return the least S, the second one, and the shift of the least; the contrasts are in ``logs``."""
    first, second, shift = np.inf, np.inf, 0
    for d in range(repeats):
        rest = squares(an, c, pulses, index, d)
        if rest < first:
            second, first, shift = first, rest, d
        elif rest < second:
            second = rest
    return first, second, shift


@kernel
def against(an: State, c: Const, pulses: int, repeats: int, index: int) -> float:
    """Return the odds [nat] that the last turn gives another place, or a wheel without a gap, against the present one.

    Nothing where the present place is the likeliest, however little: edges that are all a bit off say nothing of it.
    Arguments are those of :func:`ask`; for the variance see :func:`unique`.
    """
    known = contrasts(an, c.length)
    if known < least_known(pulses):
        return 0.0
    first, _second, _shift = likeliest(an, c, pulses, repeats, index)
    floor = LEAST_VARIANCE * (known - 1)
    other = max(min(first, plain(an, c.length)), floor)
    return 0.5 * known * log(max(squares(an, c, pulses, index, 0), floor) / other)


@kernel
def ask(an: State, c: Const, pulses: int, repeats: int, index: int) -> int:
    """Test the last turn against every shift, and against a wheel without a gap.

    Args:
        an: record of State.
        c: record of Const.
        pulses: of one turn.
        repeats: pulses after which the wheel's pattern repeats.
        index: of the latest tooth, as it is believed.

    Returns:
        the shift that is likelier than the present place, HERE, ABSENT or UNDECIDED.
    """
    known = contrasts(an, c.length)
    if known < least_known(pulses):
        return UNDECIDED
    first, second, shift = likeliest(an, c, pulses, repeats, index)
    variance = max(first / (known - 1), LEAST_VARIANCE)
    even = plain(an, c.length)
    if first - even > 2.0 * ODDS * max(even / (known - 1), LEAST_VARIANCE):
        return ABSENT
    if second - first < unique(first, known) or even - first < 2.0 * ODDS * variance:
        return UNDECIDED
    if shift == 0:
        return HERE if first < MOST or _fits(an, c, pulses, index) else UNDECIDED
    return shift if squares(an, c, pulses, index, 0) - first > 2.0 * ODDS * variance else UNDECIDED

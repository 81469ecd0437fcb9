"""Pulses without a proven place: whether they show the wheel's gap, before "no gap" is said.

Each turn of such pulses is asked as in :mod:`.anchor`. The gap is seen when one place on the wheel explains the
turn's contrasts better than any other, and better than a wheel without a gap; it is the ``same`` when the next turn
shows that place again. What speaks against the wheel: a turn that is even, so that nothing can hide a gap, and shows
none or several; and a gap that *moves*, so that the next turn shows it elsewhere: another number of teeth. An engine
whose ripple is as large as the gap is neither: then there is nothing to say for a long time.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from gateway_fdi.jit import Record, f8, i4, i8, kernel, means
from gateway_plants.crank.monitor import anchor

#: An interval this share of the one before is short: there was a pulse too many.
SHORT = 0.45
#: Share of the gap's contrast below which nothing stands out.
LEVEL = 0.55
#: Share of the contrasts that are small in an even turn.
EVEN = 0.6
#: The longest interval of a turn over its shortest, below which all are alike.
ALIKE = 1.5
#: What is found of a turn: it cannot be told; an even turn that is not one of this wheel.
UNDECIDED, AGAINST = -1, -2


class Waiting(Record):
    """What the pulses have shown since synchronisation was last proven, or a reason was last given."""

    pulses: i8 = means("pulses since")
    short: i8 = means("pulses whose interval is less than half of the one before")
    widest: f8 = means("widest interval over its neighbours")
    turns: i4 = means("turns asked")
    place: i4 = means("place that the last turn showed")
    same: i4 = means("turns that showed the same place as the one before")
    row: i4 = means("of these, since a turn showed another one")
    moved: i4 = means("turns that showed another place")
    shifted: i4 = means("moved ones that were even")
    against: i4 = means("turns that speak against the wheel")
    alike: i4 = means("turns whose intervals are all alike")
    turned: i4 = means("turns that show the wheel as reversed polarity does, not itself, at the same place as before")
    turned_place: i4 = means("place that these show")


@kernel
def clear(wa: Waiting) -> None:
    """Forget what was seen."""
    wa.pulses = 0
    wa.short = 0
    wa.widest = 0.0
    wa.turns = 0
    wa.place = UNDECIDED
    wa.same = 0
    wa.row = 0
    wa.moved = 0
    wa.shifted = 0
    wa.against = 0
    wa.alike = 0
    wa.turned = 0
    wa.turned_place = UNDECIDED


@kernel
def note(wa: Waiting, y2: float, y1: float, y: float) -> None:
    """Note one interval ``y`` [us], and the two before it (0: not known)."""
    wa.pulses += 1
    if y < SHORT * y1:
        wa.short += 1
    if y1 > 0.0 and y2 > 0.0:
        wa.widest = max(wa.widest, y1 / sqrt(y * y2))


@kernel
def turn_us(an: anchor.State, size: int, pulses: int) -> float:
    """Return the time that as many intervals take as a turn has, from those that are known [us]."""
    total, known = 0.0, 0
    for k in range(size):
        total += an.intervals[k]
        known += 1 if an.intervals[k] > 0.0 else 0
    return total * pulses / known if known > 0 else 0.0


@kernel
def look(
    wa: Waiting, an: anchor.State, c: anchor.Const, turned: anchor.Const, polar: bool, pulses: int, repeats: int
) -> None:
    """Look at the last turn, when it is time.

    Where the first and the last contrast of a turn are not known, a look two pulses earlier each turn sees the gap
    that hides there. The place then has gone on by the pulses in between.
    """
    step = c.length - anchor.EDGES
    if wa.pulses % step != 0:
        return
    found = _place(an, c, pulses, repeats)
    wa.turns += 1
    wa.alike += 1 if _alike(an, c.length) else 0
    if wa.turned_place >= 0:
        wa.turned_place = (wa.turned_place + step) % repeats
    if polar and found < 0:
        other = _place(an, turned, pulses, repeats)
        wa.turned += 1 if other >= 0 and other == wa.turned_place else 0
        wa.turned_place = other if other >= 0 else wa.turned_place
    if wa.place >= 0:
        wa.place = (wa.place + step) % repeats
    if found == AGAINST:
        wa.against += 1
    elif found >= 0 and wa.place >= 0:
        if found == wa.place:
            wa.same += 1
            wa.row += 1
        else:
            wa.row = 0
            wa.moved += 1
            wa.shifted += 1 if _even(an, c, anchor.contrasts(an, c.length)) else 0
    wa.place = found


@kernel
def contradicts(wa: Waiting, fires: bool, pulses: int) -> bool:
    """Tell whether what was seen speaks against the wheel: no gap, or one that moves, in three turns of four.

    At the starter's speed only turns whose intervals are all alike, and even ones in which the gap moves, count: in
    each compression of a weak battery's starter the gap may hide. Of a wheel of few pulses nothing is told then.

    Args:
        wa: record of Waiting.
        fires: whether the engine is faster than its starter turns it.
        pulses: of one turn of the wheel.
    """
    if not fires and pulses < anchor.FEW:
        return False
    against = wa.against + wa.moved if fires else wa.alike + wa.shifted
    return bool(wa.same == 0 and 4 * against >= 3 * (wa.turns - 1))


@kernel
def polarity(wa: Waiting) -> bool:
    """Tell whether the turns show the wheel as reversed polarity does; a look hides the gap half the time."""
    return bool(wa.same == 0 and 3 * wa.turned >= wa.turns)


@kernel
def _alike(an: anchor.State, size: int) -> bool:
    """Tell whether the intervals that are known are all alike: there is no gap at all."""
    low, high = np.inf, 0.0
    for k in range(size):
        if an.intervals[k] > 0.0:
            low, high = min(low, an.intervals[k]), max(high, an.intervals[k])
    return bool(high < ALIKE * low)


@kernel
def _place(an: anchor.State, c: anchor.Const, pulses: int, repeats: int) -> int:
    """Return the place that the latest pulse has by the contrasts of the last turn, UNDECIDED or AGAINST."""
    known = anchor.contrasts(an, c.length)
    if known < anchor.least_known(pulses):
        return UNDECIDED
    largest = 0.0
    for k in range(1, c.length - 1):
        d = an.logs[k]
        if d < anchor.UNKNOWN:
            largest = max(largest, abs(d))
    beside = AGAINST if _even(an, c, known) else UNDECIDED
    if largest < LEVEL * c.largest:
        return beside
    first, second, found = anchor.likeliest(an, c, pulses, repeats, 0)
    variance = max(first / (known - 1), anchor.LEAST_VARIANCE)
    if (
        second - first < anchor.unique(first, known)
        or anchor.plain(an, c.length) - first < 2.0 * anchor.ODDS * variance
    ):
        return beside
    return found


@kernel
def _even(an: anchor.State, c: anchor.Const, known: int) -> bool:
    """Tell whether the turn is even but for some places: its ripple is too small to hide a gap.

    Of a sine that has this rms, half of the contrasts are below it.
    """
    small, rms = 0, _hidden_by(c)
    for k in range(1, c.length - 1):
        if abs(an.logs[k]) < rms:
            small += 1
    return bool(small > EVEN * known)


@kernel
def _hidden_by(c: anchor.Const) -> float:
    """Return the rms of the contrasts from which on ripple could hide the gap.

    A sine of the speed has the contrast A (n 2 pi / S)^2 at single pitches; over a gap of G pitches the neighbours are
    (1 + G) / 2 as far from its middle, and the contrast is the square of that larger.
    """
    reach = (1.0 + c.width) / 2.0
    return float((1.0 - LEVEL) * c.largest / (sqrt(2.0) * reach * reach))

"""Another place on the wheel that explains teeth which are missing in each turn as well as the present one does.

A tooth broken off a wheel of N - 1 leaves two equal gaps, half a wheel or any other angle apart: which of them is the
wheel's own, the pulses cannot say. Such a place is not proven, and the other one is told with it. A cam sensor can
decide: its edges fit one of the two.

The pulses that are left are those of the wheel without the teeth. They are laid onto the wheel at each other place: it
is a rival if they fit with as many teeth of the wheel missing there. A place that needs more, and a pulse too many for
each of them, is none.
"""

from __future__ import annotations

from typing import Annotated

from gateway_fdi.jit import Record, f8s, i4, kernel, means, u1s
from gateway_plants.crank.monitor import anchor
from gateway_plants.crank.pulse_tracking.profile import LearnedWheel
from gateway_plants.crank.wheel import MOST_TEETH

#: Two pitches are equal within this [pitch].
EQUAL = 0.15
#: Edges of the cam, more of one place than of the other, that decide.
EDGES = 3
#: The time of a pitch changes by no more than this factor from one interval to the next, and no interval is farther
#: from its pitches than by this one.
FASTER, WIDEST = 1.15, 1.3
#: There is no rival.
NONE = -1


class CompetingHypothesis(Record):
    """A rival."""

    tooth: i4 = means("first tooth that is missing by the present place")
    number: i4 = means("how many teeth are")
    other: i4 = means("first tooth that is missing by the rival place; :data:`NONE`: there is no rival")
    first: i4 = means("by the rival place, the first tooth left behind tooth")
    here: i4 = means("edges of the cam that fitted the present place alone")
    there: i4 = means("edges of the cam that fitted the rival place alone")
    gone: Annotated[u1s, MOST_TEETH] = means("1: the tooth is missing by the present place")


@kernel
def clear(rv: CompetingHypothesis) -> None:
    """There is no rival."""
    rv.other = NONE
    rv.here = 0
    rv.there = 0


@kernel
def _following(tooth: int, pulses: int) -> int:
    """Return the next tooth."""
    return tooth + 1 if tooth + 1 < pulses else 0


@kernel
def _left(rv: CompetingHypothesis, pulses: int, tooth: int) -> int:
    """Return the tooth, or the next one that is left."""
    while rv.gone[tooth] == 1:
        tooth = _following(tooth, pulses)
    return tooth


@kernel
def _step(rv: CompetingHypothesis, nominal: f8s, pulses: int, tooth: int, at: int) -> tuple[int, int, int]:
    """Go from one pulse that is left to the next, by both places.

    Args:
        rv: record of Rival.
        nominal: pitches of the wheel.
        pulses: of one turn.
        tooth: of the pulse by the present place.
        at: the same by the other one.

    Returns:
        the next tooth, by both (NONE: the pulses do not fit), and the first one missing by the other in between.
    """
    span = nominal[tooth]
    tooth = _following(tooth, pulses)
    while rv.gone[tooth] == 1:
        span += nominal[tooth]
        tooth = _following(tooth, pulses)
    there, missing = nominal[at], NONE
    at = _following(at, pulses)
    while span - there > EQUAL:
        missing = at if missing == NONE else missing
        there += nominal[at]
        at = _following(at, pulses)
    return tooth, at if there - span < EQUAL else NONE, missing


@kernel
def _walk(rv: CompetingHypothesis, nominal: f8s, pulses: int, first: int) -> int:
    """Lay the pulses that are left onto the wheel; returns the first tooth missing then, NONE: they do not fit.

    Args:
        rv: record of Rival.
        nominal: pitches of the wheel.
        pulses: of one turn.
        first: where the first tooth left behind ``tooth`` is laid.
    """
    begin = _left(rv, pulses, int(rv.tooth))
    tooth, at, skipped = begin, first, NONE
    for _ in range(pulses):
        tooth, at, missing = _step(rv, nominal, pulses, tooth, at)
        if at == NONE:
            return NONE
        skipped = missing if skipped == NONE else skipped
        if tooth == begin:
            return skipped if at == first else NONE
    return NONE


@kernel
def _lay(rv: CompetingHypothesis, an: anchor.State, size: int, nominal: f8s, pulses: int, index: int) -> int:
    """Lay the intervals of the last turn onto the wheel, the latest one first; notes the teeth that are gone.

    Each interval is of so many pitches that the time of one changes least.

    Args:
        rv: record of Rival.
        an: record of anchor.State.
        size: of its intervals.
        nominal: pitches of the wheel.
        pulses: of one turn.
        index: of the latest tooth, at least 1.

    Returns:
        how many are, :data:`NONE` where the intervals do not fit.
    """
    for k in range(pulses):
        rv.gone[k] = 0
    tooth, number, period, left = index, 0, 0.0, pulses
    at = int(an.at)
    while left > 0:
        at = at - 1 if at > 0 else size - 1
        y = an.intervals[at]
        if y <= 0.0:
            return NONE
        tooth = tooth - 1 if tooth > 0 else pulses - 1
        span = nominal[tooth]
        left -= 1
        while period > 0.0 and left > 0:
            before = tooth - 1 if tooth > 0 else pulses - 1
            if y * y < span * (span + nominal[before]) * period * period:
                break
            rv.gone[tooth] = 1
            number += 1
            left -= 1
            span += nominal[before]
            tooth = before
        period = y / span if period == 0.0 else period * min(max(y / (span * period), 1.0 / FASTER), FASTER)
        if y > WIDEST * span * period or WIDEST * y < span * period:
            return NONE
    return number


@kernel
def seek(rv: CompetingHypothesis, an: anchor.State, size: int, c: LearnedWheel, repeats: int, index: int) -> int:
    """Look for a rival of a place at which teeth are missing in each turn.

    Args:
        rv: record of Rival.
        an: record of anchor.State.
        size: of its intervals.
        c: record of LearnedWheel.
        repeats: pulses after which the wheel's pattern repeats.
        index: of the latest tooth.

    Returns:
        the teeth that are missing, :data:`NONE` where the last turn does not fit the place.
    """
    had, before = rv.other != NONE, rv.tooth + MOST_TEETH * rv.number
    number = _lay(rv, an, size, c.nominal, c.pulses, index)
    if number == NONE:
        return NONE
    tooth = 0
    while number > 0 and rv.gone[tooth] == 0:
        tooth += 1
    rv.tooth, rv.number = tooth, number
    if had and before == tooth + MOST_TEETH * number:
        return number
    clear(rv)
    begin = _left(rv, c.pulses, tooth)
    for shift in range(1, c.pulses):
        if number == 0 or shift % repeats == 0:
            continue
        first = (begin + shift) % c.pulses
        other = _walk(rv, c.nominal, c.pulses, first)
        if other != NONE:
            rv.other, rv.first = other, first
            break
    return number


@kernel
def place_of(rv: CompetingHypothesis, nominal: f8s, pulses: int, index: int) -> int:
    """Return the tooth that the rival place has for a pulse which is tooth ``index`` by the present one.

    :data:`NONE` for a tooth that is missing by the present one.
    """
    tooth, at = _left(rv, pulses, int(rv.tooth)), int(rv.first)
    for _ in range(pulses):
        if tooth == index:
            return at
        tooth, at, _missing = _step(rv, nominal, pulses, tooth, at)
    return NONE


@kernel
def take_edge(rv: CompetingHypothesis, here: bool, there: bool) -> int:
    """Take an edge of the cam; returns 1: it is the present place, 2: the rival, 0: not decided yet.

    Args:
        rv: record of Rival.
        here: whether the edge fits the present place.
        there: whether it fits the rival.
    """
    if here != there:
        rv.here += 1 if here else 0
        rv.there += 1 if there else 0
    if rv.here - rv.there >= EDGES:
        return 1
    return 2 if rv.there - rv.here >= EDGES else 0

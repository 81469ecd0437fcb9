"""Another place on the wheel that explains what the pulses show in each turn as well as the present one does.

A tooth broken off a wheel of N - 1 leaves two equal gaps, half a wheel or any other angle apart: which of them is the
wheel's own, the pulses cannot say. A pulse in the middle of its gap leaves none, and one in the middle of a gap of two
teeth may as well lie on the other side. Such a place is not proven. Where teeth are missing the other one is told with
it, and a cam sensor can decide: its edges fit one of the two.

The pulses of the last turn are laid onto the wheel at each place, the latest one first: each is a tooth, or one too
many, and teeth in between are missing. A place is a rival if it needs no more of both than the present one.
"""

from __future__ import annotations

from gateway_fdi.jit import Record, f8, i4, kernel, means
from gateway_plants.crank.monitor import anchor
from gateway_plants.crank.pulse_tracking.profile import LearnedWheel

#: A pulse is a tooth within so much of its place [pitch], and this share of the way to it.
NEAR, SHARE, MOST_OFF = 0.25, 0.05, 0.42
#: Edges of the cam, more of one place than of the other, that decide.
EDGES = 3
#: The time of a pitch changes by no more than this factor from one interval to the next.
FASTER = 1.12
#: Defects of a turn, at most.
MOST = 6
#: There is no rival; the pulses do not fit.
NONE = -1


class CompetingHypothesis(Record):
    """A rival."""

    tooth: i4 = means("first tooth that is missing by the present place")
    other: i4 = means("first tooth that is missing by the rival place, 0 for pulses too many; NONE: there is no rival")
    off: f8 = means("from the present place to the rival", "pitch")
    here: i4 = means("edges of the cam that fitted the present place alone")
    there: i4 = means("edges of the cam that fitted the rival place alone")


@kernel
def clear(rv: CompetingHypothesis) -> None:
    """There is no rival."""
    rv.other = NONE
    rv.here = 0
    rv.there = 0


@kernel
def _lay(an: anchor.State, size: int, wh: LearnedWheel, index: int, period: float, most: int) -> tuple[int, int, int]:
    """Lay the intervals of the last turn onto the wheel, the latest pulse at tooth ``index``.

    Args:
        an: record of anchor.State.
        size: of its intervals.
        wh: record of LearnedWheel.
        index: of the latest tooth.
        period: time of a pitch there [us].
        most: defects; with more it does not matter how many.

    Returns:
        teeth missing and pulses too many, of these the teeth, and the first one that is missing; NONE: none is.
    """
    tooth, total, missing, added, lost = index, 0.0, 0, 0, NONE
    at, way = int(an.at), 0.0
    for _ in range(size):
        at = at - 1 if at > 0 else size - 1
        y = an.intervals[at]
        if y <= 0.0 or missing + added > most:
            return MOST + 1, missing, NONE
        way += y / period
        following = way + an.intervals[at - 1 if at > 0 else size - 1] / period
        before, span, skipped = tooth, 0.0, -1
        while span < way - min(NEAR + SHARE * span, MOST_OFF) or skipped < 0:
            before = before - 1 if before > 0 else wh.pulses - 1
            span += wh.nominal[before]
            skipped += 1
        off = abs(way - span)
        if off > min(NEAR + SHARE * span, MOST_OFF) or abs(following - span) < off:
            added += 1
            continue
        for k in range(1, skipped + 1):
            gone = (tooth - k) % wh.pulses
            lost = gone if lost == NONE else min(lost, gone)
        missing += skipped
        period *= min(max(way / span, 1.0 / FASTER), FASTER)
        total += span
        tooth, way = before, 0.0
        if total > wh.whole - NEAR:
            break
    return missing + added, missing, lost


@kernel
def seek(
    rv: CompetingHypothesis, an: anchor.State, size: int, wh: LearnedWheel, repeats: int, index: int, us: float
) -> tuple[int, int]:
    """Look for a rival of a place; returns the defects of the last turn there, and how many are missing teeth.

    Args:
        rv: record of CompetingHypothesis.
        an: record of anchor.State.
        size: of its intervals.
        wh: record of LearnedWheel.
        repeats: pulses after which the wheel's pattern repeats.
        index: of the latest tooth.
        us: time of a pitch there [us].
    """
    defects, missing, tooth = _lay(an, size, wh, index, us, MOST)
    had, before, other = rv.other, rv.off, NONE
    if defects <= MOST:
        for shift in range(1, wh.pulses):
            there = (index + shift) % wh.pulses
            number, _missing, first = _lay(an, size, wh, there, us, defects)
            if shift % repeats != 0 and number <= defects:
                other, rv.off = max(first, 0), (wh.place[there] - wh.place[index]) % wh.whole
                break
    if had == NONE or other != had or rv.off != before:
        clear(rv)
    rv.tooth, rv.other = tooth, other
    return defects, missing


@kernel
def place_of(rv: CompetingHypothesis, wh: LearnedWheel, index: int) -> int:
    """Return the tooth that the rival place has for a pulse which is tooth ``index`` by the present one.

    :data:`NONE` for a tooth that is missing by the present one.
    """
    place = (wh.place[index] + rv.off) % wh.whole
    for k in range(wh.pulses):
        if abs(wh.place[k] - place) < NEAR or abs(wh.place[k] + wh.whole - place) < NEAR:
            return k
    return NONE


@kernel
def take_edge(rv: CompetingHypothesis, here: bool, there: bool) -> int:
    """Take an edge of the cam; returns 1: it is the present place, 2: the rival, 0: not decided yet.

    Args:
        rv: record of CompetingHypothesis.
        here: whether the edge fits the present place.
        there: whether it fits the rival.
    """
    if here != there:
        rv.here += 1 if here else 0
        rv.there += 1 if there else 0
    if rv.here - rv.there >= EDGES:
        return 1
    return 2 if rv.there - rv.here >= EDGES else 0

"""Another place on the wheel that explains what the pulses show in each turn as well as the present one does.

A tooth broken off a wheel of N - 1 leaves two equal gaps, half a wheel or any other angle apart: which of them is the
wheel's own, the pulses cannot say. A pulse in the middle of its gap leaves none, and one in the middle of a gap of two
teeth may as well lie on the other side. Such a place is not proven. Where teeth are missing the other one is told with
it, and a cam sensor can decide: its edges fit one of the two.

The pulses of the last turn are laid onto the wheel at each place, the latest one first: each is a tooth, or one too
many, and teeth in between are missing. As minus its log likelihood [nat] a turn costs, with v the variance of e,

    sum of min(e^2 / 2 v, DEFECT) over its teeth, e how far each is off, + DEFECT * (teeth missing + pulses too many)

The odds of a place are what the turn costs at the likeliest other one, less what it costs here. What is wrong in each
turn is the same in all, so that their odds do not add up: they are averaged, which takes the noise out. The other
place is a rival while the odds are below :data:`ODDS`.
"""

from __future__ import annotations

from gateway_fdi.jit import Record, f8, i4, i8, kernel, means
from gateway_plants.crank.monitor import anchor
from gateway_plants.crank.pulse_tracking.profile import LearnedWheel

#: A pulse is a tooth within this share of the pitch before its place, of so much of a gap; a place is the same within
#: so much [pitch].
MOST_OFF, WIDE, NEAR = 0.42, 1.2, 0.25
#: Edges of the cam, more of one place than of the other, that decide.
EDGES = 3
#: Cost [nat] of a tooth that is missing or a pulse too many, and the most of a tooth out of its place.
DEFECT = 12.0
#: What a turn costs at most [nat]; what each interval costs that is of no place, and by how much one place has to be
#: cheaper than all others, just below a defect.
MOST, LOST, ODDS = 6.0 * DEFECT, 1.5, 11.0
#: Variance of what a tooth is off, in units of the edge's (for these shares, of white noise), and at least [pitch^2].
INNOVATION, LEAST_VARIANCE = 2.4, 0.05**2
#: A tooth no further off [pitch] is followed: shares of that in the time of a pitch, and of what is left of it.
SMALL, FOLLOWS, LEFT = 0.2, 0.5, 0.5
#: Turns that the odds are averaged over, at most, and what one of them counts at most [nat].
TURNS, MOST_ODDS = 8, 2.0 * ODDS
#: There is no rival; the pulses do not fit.
NONE = -1


class CompetingHypothesis(Record):
    """A rival."""

    tooth: i4 = means("first tooth that is missing by the present place")
    other: i4 = means("first tooth that is missing by the rival place, 0 for pulses too many; NONE: there is no rival")
    turns: i4 = means("turns that were asked, at most TURNS")
    odds: f8 = means("of the present place against the likeliest other one, mean of these turns", "nat")
    asked: i8 = means("number of the pulse behind the latest of them")
    off: f8 = means("from the present place to the rival", "pitch")
    here: i4 = means("edges of the cam that fitted the present place alone")
    there: i4 = means("edges of the cam that fitted the rival place alone")
    both: i4 = means("edges in a row that fitted both")


@kernel
def clear(rv: CompetingHypothesis) -> None:
    """There is no rival, and no turn was asked."""
    rv.other = NONE
    rv.turns, rv.asked = 0, 0
    rv.here, rv.there, rv.both = 0, 0, 0


@kernel
def most(size: int) -> float:
    """Return what a turn of so many intervals costs at most where it is of the place, with four defects [nat]."""
    return float(min(max(LOST * size, 4.0 * DEFECT), MOST))


@kernel
def _lay(
    an: anchor.State, size: int, wh: LearnedWheel, index: int, period: float, variance: float, most: float
) -> tuple[float, int, int]:
    """Lay the intervals of the last turn onto the wheel, the latest pulse at tooth ``index``.

    Args:
        an: record of anchor.State.
        size: of its intervals.
        wh: record of LearnedWheel.
        index: of the latest tooth.
        period: time of a pitch there [us].
        variance: of an edge [pitch^2].
        most: cost [nat]; beyond it does not matter how much.

    Returns:
        what the turn costs [nat], the teeth missing in it, and the first of them; NONE: none is.
    """
    tooth, total, cost, missing, lost = index, 0.0, 0.0, 0, NONE
    at, way, late, scale = int(an.at), 0.0, 0.0, 0.5 / max(INNOVATION * variance, LEAST_VARIANCE)
    for _ in range(size):
        at = at - 1 if at > 0 else size - 1
        y = an.intervals[at]
        if y <= 0.0 or cost > most:
            return 2.0 * MOST, missing, NONE
        way += y / period
        following = way + an.intervals[at - 1 if at > 0 else size - 1] / period
        before, span, skipped, most_off = tooth, 0.0, -1, 0.0
        while skipped < 0 or span < way - most_off:
            before = before - 1 if before > 0 else wh.pulses - 1
            span += wh.nominal[before]
            most_off = MOST_OFF * min(wh.nominal[before], WIDE)
            skipped += 1
        off = abs(way - span)
        if off > most_off or abs(following - span) < off:
            cost += DEFECT
            continue
        for k in range(1, skipped + 1):
            gone = (tooth - k) % wh.pulses
            lost = gone if lost == NONE else min(lost, gone)
        missing += skipped
        cost += skipped * DEFECT + min(scale * off * off, DEFECT)
        way -= span
        late, again = way, late * way > 0.0
        if off < SMALL:
            period *= 1.0 + FOLLOWS * way / span
            late, way = 0.0, LEFT * way
        elif again:  # two teeth in a row are off: it is the place of both, and of those behind
            late, way = 0.0, 0.0
        elif wh.nominal[before] > 1.0:  # a gap's own error
            way *= LEFT
        total += span
        tooth = before
        if total > wh.whole - NEAR:
            break
    return cost, missing, lost


@kernel
def place(an: anchor.State, size: int, wh: LearnedWheel, repeats: int, us: float, variance: float) -> int:
    """Return the tooth of the latest pulse that explains the last turn better than any other does; NONE: there is none.

    The arguments are those of :func:`seek`.
    """
    first, second, found = LOST * size, LOST * size, NONE
    for index in range(repeats):
        cost, _missing, _first = _lay(an, size, wh, index, us, variance, second)
        if cost < first:
            second, first, found = first, cost, index
        elif cost < second:
            second = cost
    return found if second - first >= ODDS else NONE


@kernel
def seek(
    rv: CompetingHypothesis,
    an: anchor.State,
    size: int,
    wh: LearnedWheel,
    repeats: int,
    index: int,
    us: float,
    variance: float,
) -> tuple[float, int]:
    """Look for a rival of a place; returns what the last turn costs there [nat], and how many teeth it lacks.

    Args:
        rv: record of CompetingHypothesis.
        an: record of anchor.State.
        size: of its intervals.
        wh: record of LearnedWheel.
        repeats: pulses after which the wheel's pattern repeats.
        index: of the latest tooth.
        us: time of a pitch there [us].
        variance: of an edge [pitch^2].
    """
    cost, missing, tooth = _lay(an, size, wh, index, us, variance, MOST)
    had, before, least = rv.other, rv.off, cost + MOST_ODDS
    other = had  # it stays while the odds are too low, also where this turn fits no other place
    if cost > max(LOST * size, 2.0 * DEFECT):  # it is rather of no place: the cam begins anew
        rv.here, rv.there = 0, 0
    if cost > MOST:
        return cost, missing
    for shift in range(1, wh.pulses):
        there = (index + shift) % wh.pulses
        price, _missing, first = _lay(an, size, wh, there, us, variance, least)
        if shift % repeats != 0 and price < least:
            least, other, rv.off = price, max(first, 0), (wh.place[there] - wh.place[index]) % wh.whole
    rv.turns = min(rv.turns + 1, TURNS)
    rv.odds += (least - cost - rv.odds) / rv.turns
    rv.tooth, rv.other = tooth, other if rv.odds < ODDS else NONE
    if rv.other == NONE or other != had or rv.off != before:
        rv.here, rv.there = 0, 0
    return cost, missing


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

    None decides where as many fitted both before: then it is the cam that has moved.

    Args:
        rv: record of CompetingHypothesis.
        here: whether the edge fits the present place.
        there: whether it fits the rival.
    """
    if here and there:
        rv.both += 1
    elif here != there and rv.both < EDGES:
        rv.both = 0
        rv.here += 1 if here else 0
        rv.there += 1 if there else 0
    if rv.here - rv.there >= EDGES:
        return 1
    return 2 if rv.there - rv.here >= EDGES else 0

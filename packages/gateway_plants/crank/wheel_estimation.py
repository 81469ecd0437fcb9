"""Which wheel is it? The pulses of a turn and their pitches, estimated from the pulses alone.

An interval is *regular* when it is about as long as those just before it. Each other interval is a *mark*: a gap, or a
short pitch. Its width is taken against the regular intervals on both sides, in logarithms, on a straight line between
them, so that a constant acceleration does not enter::

    w_k = ln y_k - ln b_k,      ln b_k = ln b_left + (ln b_right - ln b_left) * place of k between them

A mark is the number of pulses since the last one, and its width. A turn is the smallest number of marks after which
both come again, :data:`TURNS` times in a row. Its widths are averaged over the turns, and rounded to whole pitches, or
to halves where no whole one fits. The wheel is claimed only when the rounding is sure: the widths lie near their class,
and further from the next one than three standard errors. How much regular intervals differ from each other (jitter,
ripple, acceleration) is measured all the time: what does not exceed four times that (:data:`CLEAR`) is neither a mark
nor regular, and the count begins anew.

So nothing is claimed of an engine that is cranked so unevenly, or accelerates so hard, that its ripple could be a gap;
and a pulse that is missed or added now and then makes a turn that does not repeat. A wheel that was claimed stays
until another one has repeated for as long (:data:`STUBBORN`).

What cannot be told from pulses: a wheel of equal parts (``9*1,3`` three times a turn) is seen as one of its parts, its
smallest repeat. A tooth that is missed in each turn is a gap. A pattern that repeats after 3 pulses is a wheel here
when an even engine shows it for long; one of 2 pulses is none, because none of its intervals is regular.
"""

from __future__ import annotations

from math import exp, log, sqrt
from typing import Annotated

import numpy as np

from gateway_fdi.jit import Record, f8, f8s, i4, i4s, i8, kernel
from gateway_fdi.jit import means as says  # a field is called means
from gateway_plants.crank.wheel import MOST_GAPPED

#: Turns in a row that have to be the same before a wheel is claimed.
TURNS = 3
#: Least pulses of a turn, and of one that takes so many turns, none uneven: in three pulses a ripple of that order
#: looks like a gap for a while.
LEAST_PULSES, FEWEST_PULSES, FEWEST_TURNS = 4, 3, 32
#: Marks that are kept: of three turns, each pulse a mark.
RING = TURNS * MOST_GAPPED
#: An interval that differs by less than this share from those before it is regular.
BAND = 0.22
#: A mark differs by so much from the regular intervals beside it, in logarithms, and by so many times their spread;
#: a regular one by less than the first, or by so many times the spread, up to LEAST_MARK.
LEAST_MARK, CLEAR = 0.28, 4.0
REGULAR, USUAL = 0.2, 4.0
#: What is not clear counts as ripple up to here, in logarithms; beyond, it may be a gap.
MOST_RIPPLE = 0.5
#: Two marks are the same when their logarithms differ by so many times the spread, in these bounds.
SAME, LEAST_SAME, MOST_SAME = 4.0, 0.12, 0.35
#: Marks in a row after which the engine's speed is looked for anew, and an interval that no gap has [pitch].
MOST_OPEN, LONGEST = 8, 8.5
#: Spread that is assumed at least, and while it is not known; pulses over which it is averaged, and that make it known.
LEAST_SPREAD, UNKNOWN_SPREAD, MEMORY, KNOWN = 0.01, 0.15, 48.0, 6.0
#: Turns that are averaged at most.
AVERAGED = 16
#: A width may be so far from a whole number of pitches, of 1 or 2 and of more; from 0.5; from another
#: half.
WHOLE, WIDE, SHORT, HALF = 0.25, 0.35, 0.22, 0.15
#: Halves are told only below this spread: 1.5, and more.
EVEN_SPREAD, WIDE_SPREAD = 0.06, 0.03
#: Standard errors, and spreads, between a width and the border of its class.
ERRORS, SPREADS = 3.0, 1.0
#: A wheel of fewer pulses can have its pitches from ripple: they have to add up to whole ones, within this share, and
#: to be so many spreads inside their class.
COARSE, ADDED, COARSE_SPREADS = 16, 0.1, 1.5
#: Turns in a row behind marks that did not repeat.
DOUBTED = 5
#: Turns that another wheel needs in a row to take the place of one that was claimed for as many and more.
STUBBORN = 8
#: Regular pulses in a row that no gap lies between: then there is none.
EVEN = 256


class Seen(Record):
    """What the pulses have shown.

    Claimed are ``pulses``, ``pitches``, ``turns`` and ``total``.
    """

    pitch: f8 = says("time of a pitch just before; 0: none", "us")
    square: f8 = says("sum of the squared changes in the run", "us^2")
    weight: f8 = says("weight of variance, in pulses")
    run: i8 = says("regular pulses since the last mark")
    open: i4 = says("intervals behind the last regular one")
    linked: i4 = says("1: the latest mark is the beginning of a step")
    variance: f8 = says("variance of the changes, a share of the pitch squared")
    even: i8 = says("most regular pulses in a row")
    marks: i8 = says("marks in a row")
    period: i4 = says("marks of a turn; 0: none that repeats")
    pulses: i4 = says("pulses of a turn; 0: no wheel")
    matched: i8 = says("marks in a row that were as those a turn before, with that turn")
    turns: i8 = says("turns in a row that showed the wheel; 0: the last turn did not")
    total: i8 = says("turns that showed the wheel in all")
    intervals: Annotated[f8s, MOST_OPEN] = says("open intervals, which the next regular one will measure", "us")
    pitches: Annotated[f8s, MOST_GAPPED] = says("pitches of the wheel, the last one the largest", "pitch")
    draft: Annotated[f8s, MOST_GAPPED] = says("scratch")
    means: Annotated[f8s, MOST_GAPPED] = says("scratch")
    widths: Annotated[f8s, RING] = says("logarithms of the marks' widths, the latest at ``(marks - 1) % RING``")
    steps: Annotated[i4s, RING] = says("pulses from mark to mark, likewise")


@kernel
def skip(se: Seen) -> None:
    """Pulses were lost, or the engine stood: what repeated does so no more; the wheel that was claimed is kept."""
    se.even = max(se.even, se.run)
    se.pitch = 0.0
    se.open = 0
    _begin(se)


@kernel
def restart(se: Seen) -> None:
    """Forget all."""
    skip(se)
    se.even = 0
    se.variance = 0.0
    se.weight = 0.0
    se.pulses = 0
    se.total = 0


@kernel
def note(se: Seen, y: float) -> None:
    """Take an interval [us]."""
    change = y - se.pitch
    if abs(change) < BAND * se.pitch and se.open == 0:
        se.pitch += 0.5 * change
        se.square += change * change
        se.run += 1
    else:
        _unusual(se, y)


@kernel
def sure(se: Seen) -> int:
    """Return the pulses of a turn, while the last :data:`TURNS` turns and more have shown the wheel; else 0.

    None of fewer than :data:`LEAST_PULSES`.
    """
    shown = se.turns >= TURNS and se.run <= MOST_GAPPED and se.pulses >= LEAST_PULSES
    return int(se.pulses) if shown else 0


@kernel
def fits(se: Seen, pitches: f8s, pulses: int) -> bool:
    """Tell whether a wheel is the one that was claimed, at any rotation and in any number of equal parts.

    Args:
        se: record of Seen.
        pitches: shape (pulses or more,), of the wheel.
        pulses: of the wheel.
    """
    if se.pulses == 0 or pulses % se.pulses != 0:
        return False
    for shift in range(se.pulses):
        same = True
        for k in range(pulses):
            if abs(pitches[k] - se.pitches[(k + shift) % se.pulses]) > WHOLE:
                same = False
                break
        if same:
            return True
    return False


@kernel
def _begin(se: Seen) -> None:
    """Begin to count marks anew."""
    se.run = 0
    se.square = 0.0
    se.marks = 0
    se.linked = 0
    se.period = 0
    se.matched = 0
    se.turns = 0


@kernel(inlined=False)
def _unusual(se: Seen, y: float) -> None:
    """Take an interval that is the first one, may be a mark, or is the regular one behind some."""
    if se.pitch == 0.0 or y <= 0.0 or y > LONGEST * se.pitch:
        skip(se)
        se.pitch = max(y, 0.0)
    elif abs(y - se.pitch) < BAND * se.pitch:
        _settle(se, y)
    elif se.open == MOST_OPEN:
        skip(se)
        se.pitch = y
    else:
        se.intervals[se.open] = y
        se.open += 1


@kernel
def _spread(se: Seen) -> float:
    """Return how much regular intervals differ from those before them, with the last run [share of a pitch]."""
    if se.run > 0:
        _vary(se, se.square / (se.run * se.pitch * se.pitch), float(se.run))
    return UNKNOWN_SPREAD if se.weight < KNOWN else max(sqrt(se.variance), LEAST_SPREAD)


@kernel
def _vary(se: Seen, square: float, pulses: float) -> None:
    """Take squared changes into the variance: their mean, and of how many pulses."""
    se.weight = min(se.weight + pulses, MEMORY)
    se.variance += min(pulses / se.weight, 1.0) * (square - se.variance)


@kernel
def _settle(se: Seen, y: float) -> None:
    """Measure the open intervals between the regular ones before them and behind them, ``y`` [us]."""
    spread = _spread(se)
    left, right = log(se.pitch), log(y)
    for k in range(se.open):
        width = log(se.intervals[k]) - left - (right - left) * (k + 1.0) / (se.open + 1.0)
        if abs(width) < min(max(REGULAR, USUAL * spread), LEAST_MARK):
            change = se.intervals[k] - se.pitch
            se.square += change * change
            se.run += 1
        elif abs(width) < max(LEAST_MARK, CLEAR * spread):
            if abs(width) < MOST_RIPPLE:
                _vary(se, width * width, 1.0)
            se.even = max(se.even, se.run)
            _begin(se)
        else:
            _mark(se, width, min(max(SAME * spread, LEAST_SAME), MOST_SAME), spread)
    change = y - se.pitch
    se.open = 0
    se.pitch += 0.5 * change
    se.square += change * change
    se.run += 1


@kernel
def _mark(se: Seen, width: float, same: float, spread: float) -> None:
    """Take a mark.

    Args:
        se: record of Seen.
        width: logarithm of its width [pitch].
        same: by how much it may differ from the one a turn before.
        spread: of regular intervals [share of a pitch].
    """
    step = min(se.run + 1, MOST_GAPPED + 1)
    se.even = max(se.even, se.run)
    se.run = 0
    se.square = 0.0
    if se.linked == 0:
        se.linked = 1
        return
    se.widths[se.marks % RING] = width
    se.steps[se.marks % RING] = step
    se.marks += 1
    if se.period > 0 and not _again(se, se.marks - 1, se.period, same):
        se.period = 0
        se.turns = 0
    if se.period == 0:
        _search(se, same)
        if se.period > 0:
            _turn(se, spread)
    else:
        se.matched += 1
        if se.matched % se.period == 0:
            _turn(se, spread)


@kernel
def _again(se: Seen, mark: int, period: int, same: float) -> bool:
    """Tell whether a mark is as the one ``period`` marks before."""
    now, before = mark % RING, (mark - period) % RING
    return bool(se.steps[now] == se.steps[before] and abs(se.widths[now] - se.widths[before]) < same)


@kernel
def _search(se: Seen, same: float) -> None:
    """Look for the smallest number of marks after which the last ones repeat, :data:`TURNS` turns of them."""
    pulses = 0
    for period in range(1, min(se.marks, RING) // TURNS + 1):
        pulses += se.steps[(se.marks - period) % RING]
        if pulses > MOST_GAPPED:
            return
        k = 1
        while k <= (TURNS - 1) * period and _again(se, se.marks - k, period, same):
            k += 1
        if k > (TURNS - 1) * period:
            se.period = period
            se.matched = TURNS * period
            return


@kernel
def _turn(se: Seen, spread: float) -> None:
    """A turn has ended that was as those before it: claim its wheel, if it is sure."""
    turns = se.matched // se.period
    if se.turns > 0:
        parts = max(_pulses(se) // se.pulses, 1)
        se.turns += parts
        se.total += parts
    if turns > AVERAGED and turns % AVERAGED != 0:
        return
    averaged = min(turns, AVERAGED, RING // se.period)
    _average(se, averaged)
    pulses = _drafted(se, spread, spread / sqrt(averaged))
    few = turns * _pulses(se) < FEWEST_TURNS * pulses or spread > EVEN_SPREAD
    if pulses < FEWEST_PULSES or (pulses < LEAST_PULSES and few):
        return
    parts = _pulses(se) // pulses
    if se.pulses != pulses or not fits(se, se.draft, pulses):
        least = TURNS if se.marks == se.matched else DOUBTED
        if turns * parts < max(least, min(se.total, STUBBORN)):
            return
        se.total = 0
        se.turns = 0
    if se.turns == 0:
        se.turns = turns * parts
        se.total += turns * parts
    se.pulses = pulses
    for k in range(pulses):
        se.pitches[k] = se.draft[k]


@kernel
def _pulses(se: Seen) -> int:
    """Return the pulses of a turn of ``period`` marks."""
    pulses = 0
    for k in range(se.period):
        pulses += se.steps[(se.marks - 1 - k) % RING]
    return int(pulses)


@kernel
def _average(se: Seen, turns: int) -> None:
    """Average the marks of the last turns into ``means``, the earliest of a turn first."""
    first = se.marks - turns * se.period
    for k in range(se.period):
        total = 0.0
        for turn in range(turns):
            total += se.widths[(first + turn * se.period + k) % RING]
        se.means[k] = total / turns


@kernel
def _unit(se: Seen, regular: int) -> float:
    """Return the logarithm of the width that most pulses have; of two as frequent, the longer one.

    Args:
        se: record of Seen, with its ``means``.
        regular: regular pulses of a turn; their logarithm is 0.
    """
    most, unit = regular, 0.0
    for k in range(se.period):
        count, total = 0, 0.0
        for other in range(se.period):
            if abs(se.means[other] - se.means[k]) < LEAST_MARK:
                count += 1
                total += se.means[other]
        if count > most or (count == most and se.means[k] > unit):
            most, unit = count, total / count
    return unit


@kernel
def _near_whole(width: float) -> float:
    """Return the whole number of pitches that a width is near, 0.0: none."""
    whole = max(float(np.rint(width)), 1.0)
    return whole if abs(width - whole) < (WHOLE if whole < 3.0 else WIDE) else 0.0


@kernel
def _rounded(width: float, spread: float, error: float) -> float:
    """Return a width as a wheel has it [pitch]; 0.0: not sure.

    Args:
        width: measured [pitch].
        spread: of regular intervals [share of a pitch].
        error: standard error of ln(width).
    """
    whole = _near_whole(width)
    if whole > 0.0:
        border = min(log((whole + 0.5) / width), log(width / (whole - 0.5)))
        return whole if border > max(ERRORS * error, SPREADS * spread) else 0.0
    half = np.floor(width) + 0.5
    if half < 1.0:
        return float(half) if abs(width - half) < SHORT else 0.0
    if abs(width - half) < HALF and spread < (EVEN_SPREAD if half < 2.0 else WIDE_SPREAD):
        return float(half)
    return 0.0


@kernel
def _measured(se: Seen) -> int:
    """Write the averaged turn into ``draft`` as it was measured [pitch]; returns its pulses."""
    count = _pulses(se)
    unit = _unit(se, count - se.period)
    regular = exp(-unit)
    first = se.marks - se.period
    at = 0
    for k in range(se.period):
        for _ in range(se.steps[(first + k) % RING] - 1):
            se.draft[at] = regular
            at += 1
        se.draft[at] = exp(se.means[k] - unit)
        at += 1
    return count


@kernel
def _adds_up(se: Seen, count: int) -> bool:
    """Tell whether neighbouring pitches of ``draft`` that are no whole ones are a whole number of them together."""
    first = 0
    while first < count and _near_whole(se.draft[first]) == 0.0:
        first += 1
    if first == count:
        return False
    group = 0.0
    for k in range(1, count + 1):
        width = se.draft[(first + k) % count]
        if _near_whole(width) == 0.0:
            group += width
        elif group > 0.0:
            whole = max(float(np.rint(group)), 1.0)
            if abs(group - whole) > ADDED * whole:
                return False
            group = 0.0
    return True


@kernel
def _drafted(se: Seen, spread: float, error: float) -> int:
    """Round the averaged turn into ``draft``, the last pitch the largest; returns the pulses, 0: not sure."""
    count = _measured(se)
    if count < COARSE:
        spread *= COARSE_SPREADS
        if not _adds_up(se, count):
            return 0
    largest = 0
    for k in range(count):
        se.draft[k] = _rounded(se.draft[k], spread, error)
        if se.draft[k] == 0.0:
            return 0
        if se.draft[k] > se.draft[largest]:
            largest = k
    _rotate(se, largest + 1, count)
    repeat = 1
    while repeat < count and not (count % repeat == 0 and _repeats(se, repeat, count)):
        repeat += 1
    return int(repeat)


@kernel
def _rotate(se: Seen, by: int, count: int) -> None:
    """Rotate the first pitches of ``draft``; ``means`` are used up."""
    for k in range(count):
        se.means[k] = se.draft[(k + by) % count]
    for k in range(count):
        se.draft[k] = se.means[k]


@kernel
def _repeats(se: Seen, repeat: int, count: int) -> bool:
    """Tell whether ``draft`` repeats after so many pulses."""
    for k in range(repeat, count):
        if se.draft[k] != se.draft[k - repeat]:
            return False
    return True


@kernel
def _keep(now: Seen, best: Seen) -> None:
    """Keep a claim that more turns have shown than the best one before."""
    if now.total > best.total:
        best.total = now.total
        best.pulses = now.pulses
        for k in range(now.pulses):
            best.pitches[k] = now.pitches[k]


@kernel
def watch(se: Seen, best: Seen, intervals_us: f8s) -> None:
    """Take intervals one after the other, and keep the claim that most turns have shown.

    Args:
        se: record of Seen.
        best: record of Seen, takes that claim (``pulses``, ``pitches``, ``total``).
        intervals_us: shape (n,) [us]; zero or less where pulses were lost or the engine stood.
    """
    total = se.total
    for y in intervals_us:
        note(se, y)
        if se.total != total:
            total = se.total
            _keep(se, best)

"""What a channel does by itself: repeats the same reading, or moves along a smooth line."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from gateway_fdi.jit import Record, f8s, i8s, kernel, means
from gateway_plants.pedal.voting.movement import MOST_LOST, bent
from gateway_plants.pedal.voting.simple import MOST_CHANNELS

#: Same readings in a row that are suspicious while another channel moves.
FEW = 4
#: Samples over which what is no line is averaged, and the share that is nothing: a single jump there and back, as a
#: reading of another time is, makes less.
ROUGH_OVER, SMOOTH = 128.0, 0.02
#: What is no line of noise: bends of this share of the largest; samples over which their share is averaged; from which
#: share on a channel is so noisy that its way is none. Impulses bend less often.
UNEVEN, UNEVEN_OVER, NOISY = 0.25, 20.0, 0.6
#: Samples that a coarse channel's way lies on one line, and how many times as far it has to go.
LONG, FARTHER = 16, 2.0
#: Samples without a bend that end a jump, and those after which one has to have ended.
CALM, LEAPS = 2, 30
#: Samples over which a channel's own pace is averaged.
TREND_OVER = 8.0
#: Standard deviations by which the quantity's way is off a line.
BENDS = 3.0
#: Share of what the other is expected to move by if something moves both: from there on that is what has happened.
BOTH = 0.5
#: Share of the largest bend of a line below which that of the quantity's way in a sample is a small one.
FINE = 0.1
#: Share of what it has jumped by that a channel keeps from one agreement to the next.
FORGETS = 0.95


class State(Record):
    """State, of each channel.

    Lengths are in the unit of the readings. A leap is what it does since it left its way. Arrays of pairs have channel
    j beside channel i at ``i * 3 + j``.
    """

    last: Annotated[f8s, MOST_CHANNELS] = means("this reading")
    older: Annotated[f8s, MOST_CHANNELS] = means("the reading before")
    oldest: Annotated[f8s, MOST_CHANNELS] = means("the reading before that")
    raw: Annotated[f8s, MOST_CHANNELS] = means("this reading as it was read")
    gap: Annotated[f8s, MOST_CHANNELS] = means("time from older to last", "periods")
    spacing: Annotated[f8s, MOST_CHANNELS] = means("time from oldest to older", "periods")
    wait: Annotated[f8s, MOST_CHANNELS] = means("time for which nothing has come since", "periods")
    held: Annotated[f8s, MOST_CHANNELS] = means("time since the first of the repeated readings", "periods")
    along: Annotated[f8s, MOST_CHANNELS] = means("time since begin", "periods")
    same: Annotated[i8s, MOST_CHANNELS] = means("how often the last reading was repeated")
    longest: Annotated[i8s, MOST_CHANNELS] = means("most repetitions while the channel was trusted")
    line: Annotated[i8s, MOST_CHANNELS] = means("samples, beyond the first two, that lie on one line")
    begin: Annotated[f8s, MOST_CHANNELS] = means("where that line began")
    before: Annotated[f8s, MOST_CHANNELS] = means("reading before raw")
    bend: Annotated[f8s, MOST_CHANNELS] = means("second difference of raw")
    uneven: Annotated[f8s, MOST_CHANNELS] = means("share of large second differences")
    rough: Annotated[f8s, MOST_CHANNELS] = means("share of the samples that jumped or were none")
    shaken: Annotated[f8s, MOST_CHANNELS] = means("share of the samples that jumped, lately")
    moved: Annotated[f8s, MOST_CHANNELS] = means("by how much it has jumped since it agreed with the others")
    torn: Annotated[f8s, MOST_CHANNELS] = means("that of moved which the quantity cannot move by in the time of lasted")
    lasted: Annotated[f8s, MOST_CHANNELS] = means("time that the last jump took", "periods")
    origin: Annotated[f8s, MOST_CHANNELS] = means("where it jumped from last")
    from_: Annotated[f8s, MOST_CHANNELS] = means("where the leap began")
    pace: Annotated[f8s, MOST_CHANNELS] = means("speed of the quantity then, in a period")
    trend: Annotated[f8s, MOST_CHANNELS] = means("trend of its own, in a period")
    since: Annotated[i8s, MOST_CHANNELS] = means("samples of the leap; 0: there is none", "samples")
    elapsed: Annotated[f8s, MOST_CHANNELS] = means("time of the leap", "periods")
    calm: Annotated[i8s, MOST_CHANNELS] = means("samples of the leap without a bend", "samples")
    leapt: Annotated[i8s, MOST_CHANNELS] = means("1: it bent to and fro")
    left: Annotated[f8s, MOST_CHANNELS * MOST_CHANNELS] = means("where channel j was when the leap began")
    along_with: Annotated[f8s, MOST_CHANNELS * MOST_CHANNELS] = means("what channel j left its way by while i jumped")
    anchor: Annotated[f8s, MOST_CHANNELS * MOST_CHANNELS] = means("reading of channel j when channel i began to repeat")
    away: Annotated[f8s, MOST_CHANNELS * MOST_CHANNELS] = means("for how long j has been off its anchor", "periods")
    strayed: Annotated[f8s, MOST_CHANNELS * MOST_CHANNELS] = means("how far channel j has been from its anchor")


@kernel
def start(h: State, n: int, y: f8s, raw: f8s) -> None:
    """Begin with the first readings."""
    for i in range(n):
        h.last[i] = y[i]
        h.older[i] = y[i]
        h.oldest[i] = y[i]
        h.raw[i] = raw[i]
        h.gap[i] = h.spacing[i] = 1.0
        h.wait[i] = h.held[i] = h.along[i] = 0.0
        h.same[i] = 0
        h.line[i] = 0
        h.begin[i] = y[i]
        h.before[i] = raw[i]
        h.bend[i] = h.uneven[i] = 0.0
        h.rough[i] = h.shaken[i] = 0.0
        h.moved[i] = h.torn[i] = h.trend[i] = 0.0
        h.since[i] = 0
        for j in range(n):
            h.along_with[i * MOST_CHANNELS + j] = 0.0
            h.anchor[i * MOST_CHANNELS + j] = y[j]
            h.strayed[i * MOST_CHANNELS + j] = h.away[i * MOST_CHANNELS + j] = 0.0


@kernel
def _land(h: State, n: int, i: int, read: f8s, straight: float, bends: float, slew: float) -> None:
    """Note where channel ``i`` is at the end of a leap."""
    moved = read[i] - h.from_[i] - h.pace[i] * h.elapsed[i]
    other = (h.trend[i] - h.pace[i]) * h.elapsed[i]
    if abs(other) > straight and abs(moved - other) < abs(moved):
        moved -= other  # it has gone a way of its own before
    # Less than what begins a jump makes none; nor does what a way that bends meanwhile leaves. Of samples far apart the
    # bends are the most of what begins a jump: there they count again only where there are many.
    least = straight
    if h.rough[i] > SMOOTH or BENDS * bends < FINE * straight:
        least += BENDS * bends * h.elapsed[i] ** 1.5
    if h.leapt[i] == 1 and abs(moved) > least:
        h.moved[i] += moved
        h.origin[i] = h.from_[i]
        if abs(moved) > slew * h.lasted[i]:
            h.torn[i] += moved
        for j in range(n):
            way = read[j] - h.left[i * MOST_CHANNELS + j] - h.pace[i] * h.elapsed[i]
            if not np.isnan(way):
                h.along_with[i * MOST_CHANNELS + j] += way


@kernel
def _leap(h: State, n: int, i: int, read: f8s, straight: float, bends: float, slew: float, speed: float) -> None:
    """Note whether channel ``i`` jumps, and where to; and by how much the others leave their way meanwhile.

    Who jumps bends twice, to and fro; a pedal that meets its stop bends once.
    """
    raw = read[i]
    bend = bent(raw, h.raw[i], h.before[i], h.gap[i], h.spacing[i]) if np.isfinite(raw - h.raw[i]) else np.nan
    if max(h.gap[i], h.spacing[i]) > MOST_LOST:
        # Nobody knows how it went, nor whether a turn of the counter passed at all.
        bend, h.since[i] = np.nan, 0
    large = abs(bend) > straight
    jump = large and abs(h.bend[i]) > straight and bend * h.bend[i] < 0.0
    h.shaken[i] += ((1.0 if jump else 0.0) - h.shaken[i]) / ROUGH_OVER
    h.rough[i] += ((1.0 if jump or np.isnan(raw) else 0.0) - h.rough[i]) / ROUGH_OVER
    h.bend[i] = bend
    if not np.isnan(bend):
        h.uneven[i] += ((1.0 if abs(bend) > UNEVEN * straight else 0.0) - h.uneven[i]) / UNEVEN_OVER
    if large and h.since[i] == 0:
        h.from_[i], h.pace[i], h.leapt[i], h.elapsed[i] = h.raw[i], speed, 0, 0.0
        for j in range(n):
            h.left[i * MOST_CHANNELS + j] = h.raw[j]
    if not large and h.since[i] == 0:
        if not np.isnan(bend):
            h.trend[i] += ((raw - h.raw[i]) / h.gap[i] - h.trend[i]) / TREND_OVER
        return
    h.since[i] += 1
    h.elapsed[i] += h.gap[i]
    h.calm[i] = 0 if large else h.calm[i] + 1
    if large:
        h.lasted[i] = max(h.elapsed[i] - h.gap[i], h.gap[i])
    if jump:
        h.leapt[i] = 1
    if h.calm[i] < CALM and h.since[i] < LEAPS:
        return
    _land(h, n, i, read, straight, bends, slew)
    h.since[i] = 0


@kernel
def watch(
    h: State,
    n: int,
    y: f8s,
    raw: f8s,
    trusted: int,
    absent: int,
    straight: float,
    bends: float,
    slew: float,
    speed: float,
    dt: float,
) -> None:
    """Take the readings of one sample.

    Args:
        n: channels.
        y: readings; NaN: none.
        raw: as they were read.
        trusted: bits of the channels that are not held for failed.
        absent: bits of the channels of which nothing has come.
        straight: largest second difference on a line, of samples one period apart.
        bends: standard deviation of the change of the quantity's slope in a period.
        slew: largest difference of neighbours on a line, in a period.
        speed: of the quantity, in a period.
        dt: time since the last sample, in periods.
    """
    for i in range(n):
        h.wait[i] += dt
        if absent & (1 << i) == 0:
            h.spacing[i], h.gap[i], h.wait[i] = h.gap[i], h.wait[i], 0.0
            _leap(h, n, i, raw, straight, bends, slew, speed)
    for i in range(n):
        if absent & (1 << i):
            continue
        gap = h.gap[i]
        if raw[i] == h.raw[i] and y[i] == y[i]:  # not NaN
            h.same[i] += 1
            h.held[i] += gap
            for j in range(n):
                far = abs(y[j] - h.anchor[i * MOST_CHANNELS + j])
                if not np.isnan(far):
                    h.strayed[i * MOST_CHANNELS + j] = max(h.strayed[i * MOST_CHANNELS + j], far)
                h.away[i * MOST_CHANNELS + j] += gap
                if far <= 0.5 * straight:
                    h.away[i * MOST_CHANNELS + j] = 0.0
        else:
            if trusted & (1 << i):
                h.longest[i] = max(h.longest[i], h.same[i])
            h.same[i] = 0
            h.held[i] = 0.0
            for j in range(n):
                h.anchor[i * MOST_CHANNELS + j] = y[j]
                h.strayed[i * MOST_CHANNELS + j] = h.away[i * MOST_CHANNELS + j] = 0.0
        bend = abs(bent(y[i], h.last[i], h.older[i], gap, h.spacing[i]))
        if bend <= straight and abs(y[i] - h.last[i]) <= slew * gap:
            h.line[i] += 1
            h.along[i] += gap
        else:
            h.line[i] = 0  # so do NaNs
            h.along[i] = gap
            h.begin[i] = h.last[i]
        h.oldest[i] = h.older[i]
        h.older[i] = h.last[i]
        h.last[i] = y[i]
        h.before[i], h.raw[i] = h.raw[i], raw[i]


@kernel
def slope(h: State, i: int) -> float:
    """Return by how much channel ``i`` moves in a period, by its last three readings."""
    return float((h.last[i] - h.oldest[i]) / (h.gap[i] + h.spacing[i]))


@kernel
def agreed(h: State, i: int) -> None:
    """Take note that channel ``i`` is where it should be: what it jumped by once is forgotten."""
    h.moved[i] *= FORGETS
    h.torn[i] *= FORGETS
    for j in range(MOST_CHANNELS):
        h.along_with[i * MOST_CHANNELS + j] *= FORGETS


@kernel
def jumped(h: State, i: int, j: int, least: float, common: float) -> bool:
    """Tell whether channel ``i`` left the way that it went, as no foot moves, and channel ``j`` did not, or less.

    Who has jumped and stayed there counts before who jumps to and fro. If both have, it is nobody's fault alone: a
    supply moves all, one more than the other.

    Args:
        i: a channel.
        j: another one.
        least: way that is one.
        common: way of channel j, for one of channel i, if something moves both; 0: nothing does.
    """
    if abs(h.moved[j]) > least:
        return False
    expected = common * h.moved[i]
    if abs(h.moved[i]) > least:
        both = h.along_with[i * MOST_CHANNELS + j]
        return bool(common == 0.0 or both * expected <= BOTH * expected * expected)
    return bool(h.rough[i] > SMOOTH and h.rough[i] > 2.0 * h.rough[j])


@kernel
def outrun(h: State, n: int, i: int, y: f8s, smooth: int, far: float, rate: float) -> tuple[int, float]:
    """Return the channel that moves, smoothly and fast, while channel ``i`` repeats itself, and by how much; -1: none.

    Args:
        n: channels.
        i: the channel.
        y: readings.
        smooth: samples beyond the first two that the other must move along a line.
        far: least movement of the other.
        rate: least movement of the other in a period; a drift is slower.
    """
    if h.same[i] < FEW:
        return -1, 0.0
    for j in range(n):
        if j == i or h.line[j] < smooth or h.uneven[j] > NOISY:
            continue
        anchor = h.anchor[i * MOST_CHANNELS + j]
        moved = y[j] - anchor
        length = h.away[i * MOST_CHANNELS + j]
        if h.line[j] < h.same[i]:
            # The anchor may have been an impulse: what counts is the line, too.
            length = h.along[j]
            if abs(y[j] - h.begin[j]) < abs(moved):
                anchor = h.begin[j]
                moved = y[j] - anchor
        way = -1.0 if moved < 0.0 else 1.0
        on_the_way = min((h.older[j] - anchor) * way * 2.0, (h.oldest[j] - anchor) * way * 4.0)
        # A channel that comes back from an impulse has moved, but does not go on.
        step, before = (h.last[j] - h.older[j]) * way, (h.older[j] - h.oldest[j]) * way
        # Of a coarse one it goes on if it does not go back, and has been on its line for long.
        slowly = min(step, before) >= 0.0 and step + before > 0.0 and h.line[j] >= LONG
        least = far if min(step, before) > 0.0 else FARTHER * far
        goes_on = slowly or min(step, before) > 0.0
        if goes_on and min(abs(moved), on_the_way) >= least and abs(moved) >= rate * length:
            return j, moved
    return -1, 0.0

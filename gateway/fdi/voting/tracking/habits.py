"""What a channel does by itself: repeats the same reading, or moves along a smooth line."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from gateway.fdi.voting.simple import MOST_CHANNELS
from gateway.jit import Record, f8s, i8s, kernel

#: Same readings in a row that are suspicious while another channel moves.
FEW = 4
#: Samples over which what is no line is averaged, and the share that is nothing: a single jump is one for two seconds
#: at 1 ms.
ROUGH_OVER, SMOOTH = 128.0, 1e-9


class State(Record):
    """State.

    ``last``, ``older``, ``oldest``: this reading and the two before; ``raw``: this one as it was read; ``same``: how
    often the last was repeated;
    ``longest``: most repetitions while the channel was trusted; ``line``: samples, beyond the first two, that lie
    on one line; ``begin``: where that began; ``before``, ``bend``: reading before ``raw``, and its second difference;
    ``rough``: share of the samples that jumped or were none; ``anchor[i * 3 + j]``: reading of channel j when channel i began to
    repeat, ``strayed[i * 3 + j]``: how far channel j has been from there since.
    """

    last: Annotated[f8s, MOST_CHANNELS]
    older: Annotated[f8s, MOST_CHANNELS]
    oldest: Annotated[f8s, MOST_CHANNELS]
    raw: Annotated[f8s, MOST_CHANNELS]
    same: Annotated[i8s, MOST_CHANNELS]
    longest: Annotated[i8s, MOST_CHANNELS]
    line: Annotated[i8s, MOST_CHANNELS]
    begin: Annotated[f8s, MOST_CHANNELS]
    before: Annotated[f8s, MOST_CHANNELS]
    bend: Annotated[f8s, MOST_CHANNELS]
    rough: Annotated[f8s, MOST_CHANNELS]
    anchor: Annotated[f8s, MOST_CHANNELS * MOST_CHANNELS]
    strayed: Annotated[f8s, MOST_CHANNELS * MOST_CHANNELS]


@kernel
def start(h: State, n: int, y: f8s, raw: f8s) -> None:
    """Begin with the first readings."""
    for i in range(n):
        h.last[i] = y[i]
        h.older[i] = y[i]
        h.oldest[i] = y[i]
        h.raw[i] = raw[i]
        h.same[i] = 0
        h.line[i] = 0
        h.begin[i] = y[i]
        h.before[i] = raw[i]
        h.bend[i] = 0.0
        h.rough[i] = 0.0
        for j in range(n):
            h.anchor[i * MOST_CHANNELS + j] = y[j]
            h.strayed[i * MOST_CHANNELS + j] = 0.0


@kernel
def watch(h: State, n: int, y: f8s, raw: f8s, trusted: int, straight: float, slew: float) -> None:
    """Take the readings of one sample.

    Args:
        h: record of State.
        n: channels.
        y: readings; NaN: none.
        raw: as they were read.
        trusted: bits of the channels that are not held for failed.
        straight: largest second difference on a line.
        slew: largest difference of neighbours on a line.
    """
    for i in range(n):
        if raw[i] == h.raw[i] and y[i] == y[i]:  # not NaN
            h.same[i] += 1
            for j in range(n):
                far = abs(y[j] - h.anchor[i * MOST_CHANNELS + j])
                if not np.isnan(far):
                    h.strayed[i * MOST_CHANNELS + j] = max(h.strayed[i * MOST_CHANNELS + j], far)
        else:
            if trusted & (1 << i):
                h.longest[i] = max(h.longest[i], h.same[i])
            h.same[i] = 0
            for j in range(n):
                h.anchor[i * MOST_CHANNELS + j] = y[j]
                h.strayed[i * MOST_CHANNELS + j] = 0.0
        # Who jumps bends twice, to and fro; a pedal that meets its stop bends once.
        bend = raw[i] - 2.0 * h.raw[i] + h.before[i]
        jump = abs(bend) > straight and abs(h.bend[i]) > straight and bend * h.bend[i] < 0.0
        h.rough[i] += ((1.0 if jump or np.isnan(raw[i]) else 0.0) - h.rough[i]) / ROUGH_OVER
        h.bend[i] = bend
        bend = abs(y[i] - 2.0 * h.last[i] + h.older[i])
        if bend <= straight and abs(y[i] - h.last[i]) <= slew:
            h.line[i] += 1
        else:
            h.line[i] = 0  # so do NaNs
            h.begin[i] = h.last[i]
        h.oldest[i] = h.older[i]
        h.older[i] = h.last[i]
        h.last[i] = y[i]
        h.before[i], h.raw[i] = h.raw[i], raw[i]


@kernel
def jumped(h: State, i: int, j: int) -> bool:
    """Tell whether channel ``i`` left the way that it went, as no foot moves, and channel ``j`` did not, or less."""
    return bool(h.rough[i] > SMOOTH and h.rough[i] > 2.0 * h.rough[j])


@kernel
def outrun(h: State, n: int, i: int, y: f8s, smooth: int, far: float, rate: float) -> int:
    """Return the channel that moves, smoothly and fast, while channel ``i`` repeats itself; -1: none.

    Args:
        h: record of State.
        n: channels.
        i: the channel.
        y: readings.
        smooth: samples beyond the first two that the other must move along a line.
        far: least movement of the other.
        rate: least movement of the other per sample; a drift is slower.
    """
    if h.same[i] < FEW:
        return -1
    for j in range(n):
        if j == i or h.line[j] < smooth:
            continue
        anchor = h.anchor[i * MOST_CHANNELS + j]
        moved = y[j] - anchor
        length = h.same[i]
        if h.line[j] < h.same[i]:
            # The anchor may have been an impulse: what counts is the line, too.
            length = h.line[j] + 1
            if abs(y[j] - h.begin[j]) < abs(moved):
                anchor = h.begin[j]
                moved = y[j] - anchor
        way = -1.0 if moved < 0.0 else 1.0
        on_the_way = min((h.older[j] - anchor) * way * 2.0, (h.oldest[j] - anchor) * way * 4.0)
        # A channel that comes back from an impulse has moved, but does not go on.
        goes_on = (h.last[j] - h.older[j]) * way > 0.0 and (h.older[j] - h.oldest[j]) * way > 0.0
        if goes_on and min(abs(moved), on_the_way) >= far and abs(moved) >= rate * length:
            return j
    return -1

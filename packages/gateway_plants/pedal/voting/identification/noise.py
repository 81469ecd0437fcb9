"""Noise and resolution of a channel, from the second differences of its readings.

A foot bends its way by less than noise does in three samples, so that the median of the differences is that of noise,
1.652 sigma; the median knows nothing of single wrong readings. It is learned from the first samples and stays: what
becomes noisy later is at fault. The resolution is the least step that readings have made; it is learned for as long as
it takes: an ADC that is coarser than was told shows when the quantity moves. A sample that was lost makes no difference
of three readings, and no step.
"""

from __future__ import annotations

from typing import Annotated

from gateway_fdi.jit import Record, f8, f8s, i8, i8s, kernel, means
from gateway_plants.pedal.voting.simple import MOST_CHANNELS

#: Classes of second differences, so many a unit.
CLASSES, PER_UNIT = 64, 4.0
#: Samples after which noise is known for the first time, and those after which it is not learned any more; in between
#: it is asked for whenever their number has doubled.
FIRST, LAST = 128, 4096
#: Median of the second difference of white noise over its standard deviation: 0.6745 sqrt(6).
MEDIAN = 1.6522
#: Steps after which the least one is the resolution, and those after which it is not looked at any more. Until then it
#: is the least one so far, once there are a few.
FEW, STEPS = 4, 256
#: More noise than so many units is not a sensor's: it is not learned.
MOST = 5.0


class Const(Record):
    """Constants, in the unit of the readings."""

    unit: f8 = means("width of PER_UNIT classes")
    noise: f8 = means("standard deviation of a reading, as told")
    step: f8 = means("resolution, as told")
    widest: f8 = means("largest resolution")


class State(Record):
    """State, of each channel, in the unit of the readings."""

    count: Annotated[i8s, MOST_CHANNELS, CLASSES] = means("second differences in each class")
    taken: Annotated[i8s, MOST_CHANNELS] = means("second differences in all")
    due: Annotated[i8s, MOST_CHANNELS] = means("with so many of them the noise is asked for next")
    run: Annotated[i8s, MOST_CHANNELS] = means("readings in a row")
    last: Annotated[f8s, MOST_CHANNELS] = means("last reading")
    older: Annotated[f8s, MOST_CHANNELS] = means("reading before that")
    steps: Annotated[i8s, MOST_CHANNELS] = means("how often a reading changed")
    least: Annotated[f8s, MOST_CHANNELS] = means("by how much at least")
    noise: Annotated[f8s, MOST_CHANNELS] = means("noise found; 0: nothing yet")
    resolution: Annotated[f8s, MOST_CHANNELS] = means("resolution found; 0: nothing yet")
    known: i8 = means("1: the noise of all channels that have readings")


def prepare(c: Const, *, noise: float, step: float, span: float) -> None:
    """Fill the constants.

    Args:
        noise: standard deviation of a reading, as told.
        step: resolution, as told.
        span: of the quantity.
    """
    c.noise, c.step = noise, step
    c.unit = max(noise, 0.6 * step, 5e-4 * span)
    c.widest = 0.01 * span


@kernel
def _median(s: State, c: Const, i: int) -> float:
    """Return the median of a channel's second differences."""
    half, below = 0.5 * s.taken[i], 0.0
    for k in range(CLASSES):
        here = float(s.count[i, k])
        if below + here >= half:
            return float((k + (half - below) / here) * c.unit / PER_UNIT)
        below += here
    return float(CLASSES * c.unit / PER_UNIT)


@kernel
def _step(s: State, c: Const, i: int, y: float) -> bool:
    """Look at the step from one reading of channel ``i`` to the next; tells whether its resolution is another now."""
    moved = abs(y - s.last[i])
    if moved == 0.0:
        return False
    s.least[i] = moved if s.steps[i] == 0 else min(s.least[i], moved)
    s.steps[i] += 1
    before = s.resolution[i]
    if s.steps[i] >= FEW:
        s.resolution[i] = min(s.least[i], c.widest)
    return bool(s.resolution[i] != before)


@kernel
def _take(s: State, c: Const, i: int, y: float) -> None:
    """Take a reading of channel ``i`` that follows the one before by one period."""
    if s.run[i] >= 2 and s.taken[i] < LAST:
        bend = abs(y - 2.0 * s.last[i] + s.older[i])
        s.count[i, min(int(bend * PER_UNIT / c.unit), CLASSES - 1)] += 1
        s.taken[i] += 1


@kernel
def learn(s: State, c: Const, n: int, y: f8s, fine: int, dt: float) -> bool:
    """Take the readings of one sample; tells whether more is known of the channels than before.

    Args:
        n: channels.
        y: readings.
        fine: bits of the channels whose reading is one.
        dt: time since the last sample, in periods.
    """
    news, known = False, True
    for i in range(n):
        if s.taken[i] >= LAST and s.steps[i] >= STEPS:
            continue
        if fine & (1 << i) == 0:
            s.run[i] = 0
            continue
        if dt > 1.0:
            s.run[i] = 0
        if s.run[i] > 0:
            if s.steps[i] < STEPS and _step(s, c, i, y[i]):
                news = True
            _take(s, c, i, y[i])
        s.run[i] += 1
        s.older[i], s.last[i] = s.last[i], y[i]
        if s.taken[i] < LAST and s.taken[i] >= max(s.due[i], FIRST):
            s.noise[i] = min(_median(s, c, i) / MEDIAN, MOST * c.unit)
            s.due[i] = 2 * s.taken[i]
            news = True
        known = known and s.taken[i] >= FIRST
    s.known = 1 if known else 0
    return news


@kernel
def largest_noise(s: State, c: Const, n: int) -> float:
    """Return the noise to reckon with: the largest of any channel, and not less than was told."""
    noise = c.noise
    for i in range(n):
        noise = max(noise, s.noise[i])
    return float(noise)


@kernel
def least_noise(s: State, c: Const, n: int) -> float:
    """Return the noise of the quietest channel; as told until it is known."""
    least = c.noise
    for i in range(n):
        if s.taken[i] >= FIRST:
            least = min(least, s.noise[i])
    return float(least)


@kernel
def widest_step(s: State, c: Const, n: int) -> float:
    """Return the resolution to reckon with: the coarsest of any channel, and not less than was told."""
    step = c.step
    for i in range(n):
        step = max(step, s.resolution[i])
    return float(step)

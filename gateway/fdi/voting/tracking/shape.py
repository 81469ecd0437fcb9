"""Constants, state and parameters of the tracking voter."""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np

from gateway.fdi.voting.simple import MOST_CHANNELS
from gateway.fdi.voting.tracking.habits import FEW
from gateway.fdi.voting.tracking.habits import State as Habits
from gateway.fdi.voting.tracking.mismatch import State as Mismatch
from gateway.fdi.voting.tracking.motion import State as Motion
from gateway.jit import Record, f8, f8s, i8, i8s

#: Standard deviations of a gate: 6e-7 of normal innovations lie outside.
GATE = 5.0
#: Rejections (an acceptance takes one back) that isolate a channel, and the consistent samples that restore it.
ISOLATE, RESTORE, RELAPSE = 30, 60, 4
#: Samples of coasting for which a channel that was rejected more often than another is not followed.
SUSPECT = 8
#: Samples for which a jump of all channels together is not believed; and where all lie at an end of the span.
COMMON, COMMON_AT_END = 5, 60
#: Samples after which coasting becomes holding: nothing is known any more.
LOST = 100
#: Agreements that a track must rest on, less what single readings have moved it since, to outweigh a new one.
SURE, SUREST = 3, 20
#: Samples for which a disagreement may have lasted that still counts as creeping.
CALM, LONG = 4.0, 1e9
#: Samples for which a track that was given up is remembered, and how many in a row bring it back.
REMEMBER, REGRET = 6, 2
#: Rejections from which on a channel's agreement with another does not move the track by itself.
DOUBT = 4
#: Steps of the resolution that the others must stray for a channel's silence to count: a sensor quieter than its data
#: sheet says repeats itself at rest, and in slow movement, while its neighbour goes on by a step or two.
LIVELY = 3.0
#: A count that is not reached.
NEVER = 1 << 62
#: Why a channel is isolated.
TRUSTED, IMPLAUSIBLE, FROZEN, DRIFTED = range(4)
#: Where the value comes from.
NONE, AGREED, SINGLE, MOVED, COMMON_MODE, COASTED, FOLLOWED = range(7)


class Const(Record):
    """Constants.

    ``floor``, ``ceiling``: where readings are clipped; ``variance``: of a reading; ``agree``: largest difference
    of readings that agree; ``straight``: largest second difference on a line; ``noise_gate``: largest change of a
    parity that is noise; ``silent``: repetitions that no live channel makes; ``lively``: movement of the others that
    a live channel shows, too; ``widest``: largest deviation of the level.
    """

    channels: i8
    low: f8
    high: f8
    floor: f8
    ceiling: f8
    variance: f8
    agree: f8
    straight: f8
    slew: f8
    bend: f8
    mismatch: f8
    tolerance: f8
    creep: f8
    noise_gate: f8
    silent: i8
    lively: f8
    widest: f8


class State(Record):
    """State.

    ``used``: bits of the channels in the value; ``isolated``: bits, reasons in ``why``; ``drift`` 1 while the
    channels' slow mismatch exceeds the tolerance and none of them is known to be the cause. ``y``: the readings,
    NaN for none; ``z``: without the mismatch; ``anchor``: the last level that was sure; ``parity``, ``lately``:
    what the two trusted channels of ``pair`` differed by when they last agreed, ``apart`` samples ago, and in the
    last sample; ``met``: they have agreed before.
    """

    value: f8
    used: i8
    source: i8
    isolated: i8
    why: Annotated[i8s, MOST_CHANNELS]
    drift: i8
    spread: f8
    rejected: Annotated[i8s, MOST_CHANNELS]
    back: Annotated[i8s, MOST_CHANNELS]
    innovation: Annotated[f8s, MOST_CHANNELS]
    gate: f8
    common: i8
    accord: i8
    sure: i8
    pair: i8
    met: i8
    parity: f8
    lately: f8
    apart: f8
    started: i8
    anchor: f8
    y: Annotated[f8s, MOST_CHANNELS]
    z: Annotated[f8s, MOST_CHANNELS]
    motion: Motion
    old: Motion
    old_age: i8
    old_hits: i8
    mismatch: Mismatch
    habits: Habits


def _silent(noise: float, step: float) -> int:
    """Return how often a live channel hardly ever repeats a reading: probability 1e-8 at the likeliest one."""
    if noise == 0.0:
        return NEVER
    likeliest = math.erf(step / (2.0 * math.sqrt(2.0) * noise))
    if likeliest == 0.0:
        return FEW
    return max(FEW, math.ceil(math.log(1e-8) / math.log(likeliest))) if likeliest < 0.9 else NEVER


def prepare(
    c: Const,
    channels: int,
    *,
    low: float,
    high: float,
    noise: float,
    step: float,
    slew: float = 0.02,
    bend: float = 1.6e-4,
    mismatch: float = 0.005,
    tolerance: float = 0.01,
    creep: float = 6e-4,
    rails: tuple[float, float] | None = None,
) -> None:
    """Fill the constants.

    Args:
        c: record of Const.
        channels: 2 or 3.
        low: least value of the quantity; the unit is that of the readings.
        high: largest value.
        noise: standard deviation of a reading, from the data sheet.
        step: resolution of a reading, from the data sheet.
        slew: largest true change in one sample, share of the span.
        bend: standard deviation of the change of slope in one sample, share of the span.
        mismatch: difference of the channels' gains that is usual.
        tolerance: slow mismatch that is usual, share of the span.
        creep: largest change of a drift in one sample, share of the span.
        rails: where readings are clipped, default at the ends of the span; there a live channel may repeat itself,
            and channels that jump there together have more likely failed than moved.
    """
    span = high - low
    least = 2e-5 * span  # arithmetic and what no data sheet says
    variance = noise**2 + step**2 / 12 + least**2
    c.channels, c.low, c.high = channels, low, high
    c.floor, c.ceiling = rails or (low, high)
    c.variance = variance
    c.agree = max(GATE * np.sqrt(2 * variance) + step / 2, 1.2e-3 * span)
    c.noise_gate = GATE * np.sqrt(2 * variance) + step
    c.slew = slew * span
    c.bend = bend * span
    c.straight = GATE * np.sqrt(6 * variance) + 6 * bend * span
    c.mismatch = 4 * mismatch
    c.tolerance = tolerance * span
    c.creep = creep * span
    c.silent = _silent(noise, step)
    c.lively = LIVELY * step
    c.widest = span / 4

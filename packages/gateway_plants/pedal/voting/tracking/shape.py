"""Constants, state and parameters of the tracking voter."""

from __future__ import annotations

from typing import Annotated

from gateway_fdi.jit import Record, f8, f8s, i8, i8s
from gateway_plants.pedal.voting.simple import MOST_CHANNELS
from gateway_plants.pedal.voting.tracking.habits import State as Habits
from gateway_plants.pedal.voting.tracking.mismatch import State as Mismatch
from gateway_plants.pedal.voting.tracking.motion import State as Motion
from gateway_plants.pedal.voting.tracking.scale import Scale

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
#: Why a channel is isolated.
TRUSTED, IMPLAUSIBLE, FROZEN, DRIFTED = range(4)
#: Where the value comes from.
NONE, AGREED, SINGLE, MOVED, COMMON_MODE, COASTED, FOLLOWED = range(7)


class Const(Record):
    """Constants.

    ``floor``, ``ceiling``: where readings are clipped; ``common`` 1: a supply may move all channels, each
    by ``lean``, its reading at rest over its slope, plus the level;
    ``noise``, ``step``: of a reading, as told; ``widest``: largest deviation of the level.
    """

    channels: i8
    low: f8
    high: f8
    floor: f8
    ceiling: f8
    noise: f8
    step: f8
    slew: f8
    bend: f8
    mismatch: f8
    tolerance: f8
    creep: f8
    amble: f8
    common: i8
    lean: Annotated[f8s, MOST_CHANNELS]
    widest: f8


class State(Record):
    """State.

    ``used``: bits of the channels in the value; ``isolated``: bits, reasons in ``why``; ``drift`` 1 while the
    channels' slow mismatch exceeds the tolerance and none of them is known to be the cause. ``y``: the readings,
    NaN for none; ``z``: without the mismatch; ``anchor``: the last level that was sure; ``parity``, ``lately``:
    what the two trusted channels of ``pair`` differed by when they last agreed, ``apart`` samples ago, and in the last
    sample; ``met``: they have agreed before; ``alone``: samples for which there has been one trusted channel.
    ``scale``: of the gates; ``slack``: what channels that lag behind each other may differ by at present, ``swing``:
    what one may still move when the other stands, both set by who brings the readings; ``raw``: as they were read,
    where ``y`` is filtered; ``absent``: bits of the channels of which nothing has come.
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
    alone: i8
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
    raw: Annotated[f8s, MOST_CHANNELS]
    absent: i8
    scale: Scale
    slack: f8
    swing: f8
    motion: Motion
    old: Motion
    old_age: i8
    old_hits: i8
    mismatch: Mismatch
    habits: Habits


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
    amble: float = 6e-4,
    rails: tuple[float, float] | None = None,
    lean: list[float] | None = None,
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
        amble: likewise of one that goes on for long while the other channel repeats itself.
        rails: where readings are clipped, default at the ends of the span; there a live channel may repeat itself,
            and channels that jump there together have more likely failed than moved.
        lean: of each channel, its reading at rest over the change of it by one unit of the quantity, if a supply moves
            all of them; None: nothing does.
    """
    span = high - low
    c.channels, c.low, c.high = channels, low, high
    c.floor, c.ceiling = rails or (low, high)
    c.noise, c.step = noise, step
    c.slew = slew * span
    c.bend = bend * span
    c.mismatch = 4 * mismatch
    c.tolerance = tolerance * span
    c.creep, c.amble = creep * span, amble * span
    c.common = lean is not None
    c.lean[:channels] = lean or [0.0] * channels
    c.widest = span / 4

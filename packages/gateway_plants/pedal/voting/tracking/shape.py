"""Constants, state and parameters of the tracking voter."""

from __future__ import annotations

from typing import Annotated

from gateway_fdi.jit import Record, f8, f8s, i8, i8s, means
from gateway_plants.pedal.voting.simple import MOST_CHANNELS
from gateway_plants.pedal.voting.tracking.channel_activity import State as Habits
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
    """Constants, in the unit of the readings."""

    channels: i8 = means("channels, 2 or 3")
    low: f8 = means("least value of the quantity")
    high: f8 = means("largest value of the quantity")
    floor: f8 = means("readings are clipped there from below")
    ceiling: f8 = means("readings are clipped there from above")
    noise: f8 = means("standard deviation of a reading, as told")
    step: f8 = means("resolution, as told")
    slew: f8 = means("largest true change in a sample")
    bend: f8 = means("standard deviation of the change of slope in a sample")
    mismatch: f8 = means("usual difference of the channels' gains, four times")
    tolerance: f8 = means("slow mismatch that is usual")
    creep: f8 = means("largest change of a drift in a sample")
    amble: f8 = means("slope of a channel that goes on for long while the other one repeats itself, a period")
    common: i8 = means("1: a supply may move all channels")
    lean: Annotated[f8s, MOST_CHANNELS] = means("reading at rest over slope; a supply moves it by this and the level")
    widest: f8 = means("largest standard deviation of the level")


class State(Record):
    """State, in the unit of the readings. Who brings the readings sets ``slack`` and ``swing``."""

    value: f8 = means("the value voted")
    used: i8 = means("bits of the channels in the value")
    source: i8 = means("what the value comes from")
    isolated: i8 = means("bits of the channels isolated")
    why: Annotated[i8s, MOST_CHANNELS] = means("reason of each channel")
    drift: i8 = means("1: the slow mismatch exceeds the tolerance, and no channel is known to be the cause")
    spread: f8 = means("mismatch of the channels")
    slow_limit: f8 = means("what the slow mismatch was judged by: less to end a drift than to begin one")
    rejected: Annotated[i8s, MOST_CHANNELS] = means("how often each channel was rejected, lately")
    back: Annotated[i8s, MOST_CHANNELS] = means("for how long an isolated channel has followed the track", "samples")
    innovation: Annotated[f8s, MOST_CHANNELS] = means("reading less the track")
    gate: f8 = means("largest innovation that is noise")
    common: i8 = means("samples in which channels agreed beside the track", "samples")
    accord: i8 = means("samples in which isolated channels agreed", "samples")
    alone: i8 = means("samples for which there has been one trusted channel", "samples")
    sure: i8 = means("samples in which channels agreed on the track", "samples")
    pair: i8 = means("bits of the two trusted channels")
    met: i8 = means("1: they have agreed before")
    parity: f8 = means("what they differed by when they last agreed")
    lately: f8 = means("what they differed by in the last sample")
    apart: f8 = means("time since they last agreed", "samples")
    started: i8 = means("1: there is a track")
    anchor: f8 = means("last level that was sure")
    y: Annotated[f8s, MOST_CHANNELS] = means("readings; NaN: none")
    z: Annotated[f8s, MOST_CHANNELS] = means("readings without the mismatch")
    raw: Annotated[f8s, MOST_CHANNELS] = means("readings as they were read, where y is filtered")
    absent: i8 = means("bits of the channels of which nothing has come")
    scale: Scale = means("the gates")
    slack: f8 = means("what channels that lag behind each other may differ by at present")
    swing: f8 = means("what one channel may still move when another stands")
    motion: Motion = means("the track")
    old: Motion = means("a track that was given up")
    old_age: i8 = means("samples since that; 0: there is none", "samples")
    old_hits: i8 = means("readings near the old track")
    mismatch: Mismatch = means("what channels differ by for long")
    habits: Habits = means("what each channel does by itself")


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

"""What the monitor of redundant sensors works on: constants, state, inputs, and what it sends."""

from __future__ import annotations

from typing import Annotated

from gateway.monitors import contract
from gateway_fdi.jit import Record, f8, f8s, i8, i8s, means
from gateway_plants.pedal.voting import simple, supply
from gateway_plants.pedal.voting.identification import lag
from gateway_plants.pedal.voting.identification import noise as own_noise
from gateway_plants.pedal.voting.simple import MOST_CHANNELS
from gateway_plants.pedal.voting.tracking import shape


class Diagnosis(Record):
    """State of the diagnosis."""

    erratic: Annotated[f8s, MOST_CHANNELS] = means("how often each channel goes wrong, per sample")
    wrong: Annotated[i8s, MOST_CHANNELS] = means("1: it did in the last sample")
    absent: Annotated[i8s, MOST_CHANNELS] = means("samples in a row without a reading of it")
    there: Annotated[i8s, MOST_CHANNELS] = means("samples in a row with a reading of it")
    split: f8 = means("share of the samples without agreement")


class Const(Record):
    """Constants."""

    channels: i8 = means("channels, 2 or 3")
    voter: i8 = means("voter whose value is sent, a place in VOTERS")
    rest: Annotated[f8s, MOST_CHANNELS] = means("reading at 0 %, in the unit of the signal")
    percent: Annotated[f8s, MOST_CHANNELS] = means("travel by reading, in % by the unit of the signal")
    low: Annotated[f8s, MOST_CHANNELS] = means("readings below are a short or open, in the unit of the signal")
    high: Annotated[f8s, MOST_CHANNELS] = means("readings above are a short or open, in the unit of the signal")
    over: f8 = means("what the travel may be beyond 0 and 100 %", "%")
    period_ns: i8 = means("period of the samples", "ns")
    lost: f8 = means("time without agreement after which the value is invalid", "periods")
    last_fault: i8 = means("number of the last fault, that of the supply")
    sensors: own_noise.Const = means("noise and resolution of the channels")
    lag: lag.Const = means("delay of one channel behind another")
    supply: supply.Const = means("a supply that is wrong for all channels")
    tracking: shape.Const = means("the tracking voter")
    simple: simple.Const = means("average and median voters")


class State(Record):
    """State."""

    value: f8 = means("voted position", "%")
    quality: i8 = means("how good the value is")
    speed: f8 = means("speed of the position", "%/s")
    samples: i8 = means("samples taken")
    used: i8 = means("bits of the channels voted")
    isolated: i8 = means("bits of the channels isolated")
    spread: f8 = means("mismatch of the channels", "%")
    noise: f8 = means("noise that is reckoned with", "%")
    resolution: f8 = means("resolution that is reckoned with", "%")
    lag_ms: f8 = means("lag that is reckoned with", "ms")
    known: i8 = means("what was learned, bits KNOWN_*")
    share: f8 = means("supply, a share of what it should be")
    reading: Annotated[f8s, MOST_CHANNELS] = means("reading in the unit of the signal; NaN: missing")
    position: Annotated[f8s, MOST_CHANNELS] = means("position by the reading", "%")
    place: Annotated[i8s, MOST_CHANNELS] = means("place of the reading to its range")
    trusted: Annotated[f8s, MOST_CHANNELS] = means("position; NaN: the reading is outside its range", "%")
    aligned: Annotated[f8s, MOST_CHANNELS] = means("trusted, as late as the slowest channel", "%")
    level: Annotated[f8s, MOST_CHANNELS] = means("position by the nominal supply, mismatch taken off", "%")
    sensors: own_noise.State = means("noise and resolution of the channels")
    lag: lag.State = means("delay of one channel behind another")
    supply: supply.State = means("a supply that is wrong for all channels")
    tracking: shape.State = means("the tracking voter")
    simple: simple.State = means("average and median voters")
    diagnosis: Diagnosis = means("from the voter's verdicts to tests")


class Inputs(contract.SampledInputs):
    """Inputs."""

    reading: Annotated[f8s, MOST_CHANNELS] = means("readings of the channels, in the unit of the signal")


class Outputs(Record):
    """What it sends."""

    value: f8 = means("voted position", "%")
    speed: f8 = means(unit="%/s")
    quality: f8 = means("how good the value is")
    used: f8 = means("bit mask of the channels voted")
    isolated: f8 = means("bit mask of the channels isolated")
    spread: f8 = means("mismatch of the channels", "%")

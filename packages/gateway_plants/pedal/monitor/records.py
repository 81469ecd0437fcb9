"""What the monitor of redundant sensors works on: constants, state, inputs, and what it sends."""

from __future__ import annotations

from typing import Annotated

from gateway.monitors import contract
from gateway_fdi.jit import Record, f8, f8s, i8, i8s, means
from gateway_plants.pedal.voting import simple, supply
from gateway_plants.pedal.voting.acquaintance import lag
from gateway_plants.pedal.voting.acquaintance import noise as own_noise
from gateway_plants.pedal.voting.simple import MOST_CHANNELS
from gateway_plants.pedal.voting.tracking import shape


class Diagnosis(Record):
    """State of the diagnosis.

    ``erratic``: how often each channel goes wrong, per sample, and whether it was ``wrong`` in the last one;
    ``absent``: samples in a row without a reading of it, ``there``: with one;
    ``split``: share of the samples without agreement.
    """

    erratic: Annotated[f8s, MOST_CHANNELS]
    wrong: Annotated[i8s, MOST_CHANNELS]
    absent: Annotated[i8s, MOST_CHANNELS]
    there: Annotated[i8s, MOST_CHANNELS]
    split: f8


class Const(Record):
    """Constants."""

    channels: i8
    voter: i8
    rest: Annotated[f8s, MOST_CHANNELS]
    percent: Annotated[f8s, MOST_CHANNELS]
    low: Annotated[f8s, MOST_CHANNELS]
    high: Annotated[f8s, MOST_CHANNELS]
    over: f8
    period_ns: i8
    lost: f8
    last_fault: i8
    sensors: own_noise.Const
    lag: lag.Const
    supply: supply.Const
    tracking: shape.Const
    simple: simple.Const


class State(Record):
    """State.

    ``reading`` in the unit of the signal, NaN: missing, ``position`` [%], ``place`` to its range, ``trusted`` [%], NaN
    outside it. ``noise``, ``resolution`` [%], ``lag_ms`` that is reckoned with, ``known``: of what was learned, bits
    KNOWN_*; ``share`` of the supply.
    """

    value: f8
    quality: i8
    speed: f8
    samples: i8
    used: i8
    isolated: i8
    spread: f8
    noise: f8
    resolution: f8
    lag_ms: f8
    known: i8
    share: f8
    reading: Annotated[f8s, MOST_CHANNELS]
    position: Annotated[f8s, MOST_CHANNELS]
    place: Annotated[i8s, MOST_CHANNELS]
    trusted: Annotated[f8s, MOST_CHANNELS]
    aligned: Annotated[f8s, MOST_CHANNELS]
    level: Annotated[f8s, MOST_CHANNELS]
    sensors: own_noise.State
    lag: lag.State
    supply: supply.State
    tracking: shape.State
    simple: simple.State
    diagnosis: Diagnosis


class Inputs(contract.SampledInputs):
    """Inputs."""

    reading: Annotated[f8s, MOST_CHANNELS]


class Outputs(Record):
    """What it sends."""

    value: f8 = means("voted position", "%")
    speed: f8 = means(unit="%/s")
    quality: f8
    used: f8 = means("bit mask of the channels voted")
    isolated: f8 = means("bit mask of the channels isolated")
    spread: f8 = means("mismatch of the channels", "%")

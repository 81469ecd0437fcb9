"""Redundant position sensors: faults of two or three channels, and one value out of them.

Source: Kim, Lee, Lee, "Development of Kalman Hybrid Redundancy for Sensor Fault-Tolerant of Safety Critical System"
(2008). Its scheme latches for good on ten microvolts of noise: it is a study, and the voter is
:mod:`gateway_plants.pedal.voting.tracking`. The value leaves each sample with its quality, in the batch of its input.
Samples are numbered by frame counters; channels in several messages make one when each has come once more, and one that
stays away is not waited for (:class:`gateway.monitors.contract.Sampled`).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from gateway.monitors.contract import (
    TIMER,
    Blames,
    Connection,
    Emission,
    Monitor,
    Out,
    Readout,
    Sampled,
    SensorCalibration,
    Signal,
)
from gateway_fdi.jit import kernel
from gateway_plants.pedal.monitor import channel_estimates, channel_identification, diagnosis
from gateway_plants.pedal.monitor.diagnosis import ABOVE, ABSENT, BELOW, FINE, OUTSIDE
from gateway_plants.pedal.monitor.faults import Evidence, blames, faults
from gateway_plants.pedal.monitor.params import BEND, PRESETS, VOTERS, PairParams, Params, TripleParams
from gateway_plants.pedal.monitor.records import Const, Inputs, Outputs, State
from gateway_plants.pedal.voting import simple, supply
from gateway_plants.pedal.voting.identification import lag, noise
from gateway_plants.pedal.voting.simple import MOST_CHANNELS
from gateway_plants.pedal.voting.tracking import shape
from gateway_plants.pedal.voting.tracking import vote as tracking

#: Quality of the value, as GW_BrakePedal carries it.
STARTING, AGREED, ONE_CHANNEL, DEGRADED, ESTIMATED, INVALID = range(6)
#: What people are shown of the state.
_SHOWN = (
    *("value", "quality", "speed", "samples", "used", "isolated", "spread"),
    *("noise", "resolution", "lag_ms", "known", "share"),
)
#: Without a sample for so many periods the value is invalid.
SILENCE = 20
#: A drift is slower; so is one that lasts while the other channel repeats itself [travels/s].
CREEP, AMBLE = 0.6, 0.25


def _connect(p: Params) -> Mapping[str, Connection]:
    readings = [Signal(c.signal, triggers=True, optional=True, may_be_nan=True) for c in p.channels]
    return {"reading": [*readings, *[None] * (MOST_CHANNELS - len(readings))]}


def _emits(p: Params) -> Emission:
    signals = {
        "value": "Position", "speed": "Speed", "quality": "Quality", "used": "Used",
        "isolated": "Isolated", "spread": "Mismatch",
    }  # fmt: skip
    return Emission(PRESETS[p.preset].message, signals)


def _prepare(p: Params, s: State, c: Const) -> None:
    n = len(p.channels)
    c.channels, c.voter = n, VOTERS.index(p.voter)
    for i, channel in enumerate(p.channels):
        c.rest[i], c.percent[i] = channel.at_rest, channel.percent
        c.low[i], c.high[i] = channel.low, channel.high
    c.over = p.overtravel
    c.period_ns = round(p.period_ms * 1e6)
    c.lost = shape.LOST
    c.last_fault = len(faults(p)) - 1
    told = max(abs(channel.noise * channel.percent) for channel in p.channels)
    step = max(abs(channel.resolution * channel.percent) for channel in p.channels)
    noise.prepare(c.sensors, noise=told, step=step, span=100.0)
    lag.prepare(c.lag, period_ms=p.period_ms, most_ms=p.lag_ms)
    supply.prepare(
        s.supply,
        c.supply,
        [channel.at_rest for channel in p.channels],
        [channel.at_full - channel.at_rest for channel in p.channels],
        possible=p.tells_supply,
        bend=100.0 * BEND * p.period_ms**1.5,
    )
    s.share = 1.0
    shape.prepare(
        c.tracking,
        n,
        low=0.0,
        high=100.0,
        noise=told,
        step=step,
        slew=p.fastest * p.period_ms * 1e-3,
        bend=BEND * p.period_ms**1.5,
        mismatch=p.gain_error / 100,
        tolerance=p.tolerance / 100,
        creep=CREEP * p.period_ms * 1e-3,
        amble=AMBLE * p.period_ms * 1e-3,
        lean=[channel.at_rest * channel.percent for channel in p.channels] if p.tells_supply else None,
        rails=(-np.inf, np.inf),  # a clipped reading is out of its range, and not voted
    )
    simple.prepare(c.simple, n)


@kernel
def _read(s: State, c: Const) -> None:
    """Bring the readings to per cent of the travel, and place them to their ranges."""
    s.tracking.absent = 0
    for i in range(c.channels):
        reading = s.reading[i]
        position = (reading / s.share - c.rest[i]) * c.percent[i]
        s.position[i] = position
        if np.isnan(reading):
            s.place[i] = ABSENT
            s.tracking.absent |= 1 << i
        elif reading < c.low[i] * s.share:
            s.place[i] = BELOW
        elif reading > c.high[i] * s.share:
            s.place[i] = ABOVE
        elif -c.over <= position <= 100.0 + c.over:
            s.place[i] = FINE
        else:
            s.place[i] = OUTSIDE
        s.trusted[i] = position if s.place[i] == FINE else np.nan


@kernel
def _vote(s: State, c: Const, dt: float) -> None:
    """Run the tracking voter, and the one whose value is asked for."""
    t = s.tracking
    tracking.vote_filtered(t, c.tracking, s.aligned, s.trusted, dt)
    s.value, s.used = t.value, t.used
    s.speed = t.motion.v / (c.period_ns * 1e-9)
    s.isolated, s.spread = t.isolated, t.spread
    if c.voter == 1:
        simple.average(s.simple, c.simple, s.position)
        s.value, s.used = s.simple.value, s.simple.used
    elif c.voter == 2:
        simple.median(s.simple, c.simple, s.position)
        s.value, s.used = s.simple.value, s.simple.used


@kernel
def _quality(s: State) -> int:
    """Return how good the value is."""
    t = s.tracking
    if t.source == shape.NONE:
        return STARTING if t.started == 0 else INVALID
    if t.used == 0:
        return ESTIMATED
    if t.drift == 1 or s.supply.active == 1:
        return DEGRADED
    return ONE_CHANNEL if t.used & (t.used - 1) == 0 else AGREED


@kernel
def _send(s: State, out: Out[Evidence, Outputs]) -> None:
    out.send = 1
    out.values.value = s.value
    out.values.speed = s.speed
    out.values.quality = s.quality
    out.values.used = s.used
    out.values.isolated = s.isolated
    out.values.spread = s.spread


@kernel
def step(s: State, c: Const, u: Inputs, out: Out[Evidence, Outputs]) -> None:
    """Take one sample of all channels, or the timer of a silent bus."""
    if u.trigger == TIMER:
        s.quality = INVALID
        s.used = 0
        _send(s, out)
        return
    s.samples += 1
    for i in range(c.channels):
        s.reading[i] = u.reading[i]
    dt = u.gap
    _read(s, c)
    if channel_identification.supplied(s, c, dt):
        _read(s, c)
    channel_identification.learn(s, c, dt)
    _vote(s, c, dt)
    s.quality = _quality(s)
    diagnosis.diagnose(s, c, out)
    _send(s, out)
    out.wake_ns = u.t_ns + SILENCE * c.period_ns


def _monitor(kind: str, params: type[Params]) -> Monitor[Params]:
    return Monitor(
        type=kind,
        api=2,
        params=params,
        state=State,
        const=Const,
        inputs=Inputs,
        evidence=Evidence,
        outputs=Outputs,
        step=step,
        connect=_connect,
        prepare=_prepare,
        faults=faults,
        emits=_emits,
        capabilities=(
            Blames(blames),
            Readout(_SHOWN),
            SensorCalibration(lambda p: len(p.channels), channel_estimates.found),
            Sampled(lambda p: p.sampling),
        ),
    )


PAIR = _monitor("redundant_pair", PairParams)
TRIPLE = _monitor("redundant_triple", TripleParams)

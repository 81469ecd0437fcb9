"""What the monitor learns of its channels before it judges them, and what it makes of it."""

from __future__ import annotations

import math

from gateway_fdi.jit import kernel
from gateway_plants.pedal.monitor.records import Const, State
from gateway_plants.pedal.voting import supply
from gateway_plants.pedal.voting.identification import lag, noise
from gateway_plants.pedal.voting.tracking import isolation, mismatch, motion, scale
from gateway_plants.pedal.voting.tracking.shape import IMPLAUSIBLE, SURE, SUSPECT

#: What is known of the channels: their noise, their lag.
KNOWN_NOISE, KNOWN_LAG = 1, 2
#: Noise beyond what was reckoned with by this factor puts what was judged before in doubt.
DOUBT = 1.1


@kernel
def supplied(s: State, c: Const, dt: float) -> bool:
    """Look at the common supply; tells whether the readings are to be taken once more, with another share of it."""
    v, y, t = s.tracking.mismatch, s.supply, s.tracking
    if c.supply.possible == 0 or t.started == 0:
        return False
    before = s.share
    middle = mismatch.centre(v, c.channels)
    for i in range(c.channels):
        s.level[i] = (s.reading[i] - c.rest[i]) * c.percent[i] - (v.level[i] - middle)
    m = t.motion
    sure = t.isolated == 0 and t.sure >= SURE and m.coasted < SUSPECT
    # Readings are as they came: one that lags is behind.
    behind, variance = max(t.slack, t.swing), t.scale.variance
    agree = t.scale.agree + behind
    if supply.look(y, c.supply, s.reading, s.level, agree, m.x, m.v, m.p00, variance, behind, sure, dt):
        # What the voter took for the pedal meanwhile was one channel or another.
        motion.restart(m, y.travel, 0.0, variance, c.tracking.slew * c.tracking.slew / 9.0)
        for i in range(c.channels):
            t.rejected[i] = 0
    s.share = y.share
    return bool(s.share != before)


@kernel
def _forgive(s: State, n: int) -> None:
    """Take back what was judged by too little noise."""
    t = s.tracking
    for i in range(n):
        if t.isolated & (1 << i) and t.why[i] == IMPLAUSIBLE:
            isolation.restore(t, i)
        t.rejected[i] = 0
        s.diagnosis.erratic[i] = 0.0
    s.diagnosis.split = 0.0


@kernel
def _measure(s: State, c: Const) -> None:
    """Make the voter's gates anew of what is known of the sensors."""
    n, t, before = c.channels, s.tracking, s.noise
    s.noise = noise.largest_noise(s.sensors, c.sensors, n)
    s.resolution = noise.widest_step(s.sensors, c.sensors, n)
    scale.measure(t.scale, s.noise, s.resolution, c.tracking.high - c.tracking.low, c.tracking.bend)
    quiet = scale.silent(noise.least_noise(s.sensors, c.sensors, n), s.resolution) == scale.NEVER
    if quiet or s.sensors.known == 0:
        t.scale.silent = scale.NEVER  # one of them always repeats itself at rest, or may: nobody knows yet
    if s.noise > DOUBT * max(before, c.sensors.noise):
        _forgive(s, n)


@kernel
def learn(s: State, c: Const, dt: float) -> None:
    """Take the positions of one sample; leaves them aligned.

    Args:
        dt: time since the last sample, in periods.
    """
    n, t = c.channels, s.tracking
    fine = 0
    for i in range(n):
        if not math.isnan(s.trusted[i]) and t.isolated & (1 << i) == 0:
            fine |= 1 << i
    if t.scale.variance == 0.0 or noise.learn(s.sensors, c.sensors, n, s.position, fine, dt):
        _measure(s, c)
    smooth = lag.smooth(s.lag, n, s.position, t.absent, t.scale.straight, dt)
    rate = t.motion.v if t.started == 1 else 0.0
    lag.align(s.lag, c.lag, n, s.trusted, smooth, rate, s.aligned)
    lag.learn(s.lag, c.lag, n, s.aligned, fine, smooth, dt, t.scale.variance)
    t.slack, t.swing = s.lag.slack, s.lag.swing
    s.known = KNOWN_NOISE if s.sensors.known == 1 else 0
    if s.lag.known == 1:
        s.known |= KNOWN_LAG
        slowest = 0.0
        for i in range(n):
            slowest = max(slowest, s.lag.tau[i])
        s.lag_ms = slowest * c.period_ns * 1e-6

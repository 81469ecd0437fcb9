"""What two or three sensors make of a travel: slope, supply, filter, noise, ADC; and how they fail."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Literal

import cantools
import numpy as np
from scipy.signal import lfilter

from gateway.bus.frames import Frames
from gateway.signals.frame_encoding import frames_of
from gateway_fdi.common.resources import shipped
from gateway_plants.pedal.study.outside.foot import DT, Array, Random

#: What makes a fault of volts, shape (n, sensors): they, the travel, and what is random.
Fault = Callable[[Array, Array, Random], Array]
Kind = Literal["first", "delay", "mean"]

DBC = shipped("dbc/pedal.dbc")
DATABASE = cantools.database.Database()
DATABASE.add_dbc_file(str(DBC))


@dataclass(frozen=True)
class Sensor:
    """A sensor of the supply's voltage: (volts at rest, at full) at 5 V; lag in ms of a filter of a kind."""

    rest: float = 0.5
    full: float = 4.5
    gain: float = 1.0
    offset: float = 0.0
    noise: float = 0.002
    lag_ms: float = 0.0
    filter: Kind = "first"  # first: of first order; delay; mean: a moving one
    bits: int = 12


@dataclass(frozen=True)
class Plant:
    """Sensors, and the message that carries them."""

    sensors: tuple[Sensor, ...] = field(default_factory=lambda: (Sensor(), Sensor(4.5, 0.5)))
    message: str = "PED_Brake"


def brake(
    noise: float = 0.002,
    lag: tuple[float, float] = (0.0, 0.0),
    kind: Kind = "first",
    rng: Random | None = None,
    bits: int = 12,
) -> Plant:
    """The brake's two sensors, each with its own small errors of gain and offset if there is a ``rng``."""
    ends = ((0.5, 4.5), (4.5, 0.5))
    gains = 1 + (rng.normal(0, 0.002, 2) if rng is not None else np.zeros(2))
    offsets = rng.normal(0, 0.004, 2) if rng is not None else np.zeros(2)
    return Plant(tuple(Sensor(*ends[k], gains[k], offsets[k], noise, lag[k], kind, bits) for k in range(2)))


def _filtered(x: Array, sensor: Sensor) -> Array:
    if sensor.lag_ms == 0.0:
        return x
    steps = sensor.lag_ms * 1e-3 / DT
    if sensor.filter == "delay":
        k = np.arange(len(x))
        return np.asarray(np.interp(k - steps, k, x), np.float64)
    if sensor.filter == "mean":
        return _mean(x, max(round(2 * steps), 1))
    pole = np.exp(-1 / steps)
    return np.asarray(lfilter([1 - pole], [1, -pole], x - x[0]) + x[0], np.float64)


def _mean(x: Array, n: int) -> Array:
    total = np.cumsum(np.concatenate([np.full(n, x[0]), x]))
    return np.asarray((total[n:] - total[:-n]) / n, np.float64)


def readings(
    plant: Plant,
    travel: Array,
    rng: Random,
    *,
    supply: Array | float | None = None,
    faults: Sequence[Fault] = (),
) -> Array:
    """Volts behind the ADC, shape (n, sensors).

    Args:
        plant: the sensors.
        travel: shape (n,).
        rng: of noise and of faults.
        supply: of 5 V, shape (n,) or one number; the ADC has a reference of its own.
        faults: functions of (volts (n, sensors), travel, rng), in their order, before the ADC.
    """
    share = np.ones(len(travel)) if supply is None else np.broadcast_to(supply, len(travel)) / 5.0
    volts = np.empty((len(travel), len(plant.sensors)))
    for k, s in enumerate(plant.sensors):
        position = _filtered(travel, s) * s.gain
        volts[:, k] = (s.rest + position * (s.full - s.rest) + s.offset) * share
        volts[:, k] += rng.normal(0, s.noise, len(travel)) if s.noise else 0.0
    for fault in faults:
        volts = fault(volts, travel, rng)
    for k, s in enumerate(plant.sensors):
        step = 5.0 / (1 << s.bits)
        volts[:, k] = np.clip(np.rint(volts[:, k] / step), 0, (1 << s.bits) - 1) * step
    return volts


def frames(plant: Plant, volts: Array, first: int = 0) -> Frames:
    """CAN frames of readings, one each millisecond; ``first``: number of the first one."""
    k = np.arange(first, first + len(volts))
    columns = {f"Ch{i + 1}": volts[:, i] for i in range(volts.shape[1])} | {"FrameCnt": k % 16}
    message = DATABASE.get_message_by_name(plant.message)
    return frames_of(message, columns, k * round(DT * 1e9) + 1_000_000, "Crc")


# --- faults: each returns a function for ``readings``; seconds from the begin, channels from 0


def _from(begin_s: float, end_s: float | None = None) -> slice:
    return slice(round(begin_s / DT), None if end_s is None else round(end_s / DT))


def _changed(
    channels: int | slice, begin_s: float, new: Callable[[Array, Random], Array | float], end_s: float | None = None
) -> Fault:
    """Return the fault that makes of a part of the readings what ``new`` does."""

    def put(y: Array, travel: Array, rng: Random) -> Array:
        part = y[_from(begin_s, end_s), channels]
        part[:] = new(part, rng)
        return y

    return put


def offset(channel: int, begin_s: float, volts: float, end_s: float | None = None) -> Fault:
    """Put it off by ``volts``."""
    return _changed(channel, begin_s, lambda y, _: y + volts, end_s)


def gain(channel: int, begin_s: float, share: float, rest: float) -> Fault:
    """Make its slope steeper by ``share``."""
    return _changed(channel, begin_s, lambda y, _: rest + (1 + share) * (y - rest))


def drift(channel: int, begin_s: float, volts_per_s: float) -> Fault:
    """Let it drift."""
    return _changed(channel, begin_s, lambda y, _: y + np.arange(len(y)) * DT * volts_per_s)


def level(channel: int, begin_s: float, volts: float, noise: float = 0.0, end_s: float | None = None) -> Fault:
    """Short to ground, to the battery, or an open wire that floats."""
    return _changed(channel, begin_s, lambda y, rng: volts + rng.normal(0, noise, len(y)) if noise else volts, end_s)


def stuck(channel: int, begin_s: float, noise: float = 0.0) -> Fault:
    """Hold its voltage; ``noise`` goes on behind that."""
    return _changed(channel, begin_s, lambda y, rng: y[0] + (rng.normal(0, noise, len(y)) if noise else 0.0))


def floating(channel: int, begin_s: float) -> Fault:
    """An open input: wanders slowly between the rails."""

    def wandering(y: Array, rng: Random) -> Array:
        walk = np.cumsum(rng.normal(0, 0.02, len(y)))
        return np.asarray(2.5 + 2.4 * np.sin(walk) + rng.normal(0, 0.05, len(y)))

    return _changed(channel, begin_s, wandering)


def breaks(channel: int, begin_s: float) -> Fault:
    """An intermittent contact, each half a second: to ground for 1 to 25 ms."""

    def put(y: Array, travel: Array, rng: Random) -> Array:
        at = begin_s
        while at < len(y) * DT:
            at += rng.exponential(0.5)
            y[_from(at, at + rng.uniform(1e-3, 25e-3)), channel] = 0.0
        return y

    return put


def chatter(channel: int, begin_s: float) -> Fault:
    """Put a fifth of its readings off, each by another value of up to 0.5 V."""

    def chattering(y: Array, rng: Random) -> Array:
        return y + np.where(rng.random(len(y)) < 0.2, rng.uniform(-0.5, 0.5, len(y)), 0.0)

    return _changed(channel, begin_s, chattering)


def noise(channel: int, begin_s: float) -> Fault:
    """Make it noisy, by 50 mV."""
    return _changed(channel, begin_s, lambda y, rng: y + rng.normal(0, 0.05, len(y)))


def lag(channel: int, begin_s: float, ms: float) -> Fault:
    """Put a filter of first order behind it."""
    pole = np.exp(-DT * 1e3 / ms)
    return _changed(channel, begin_s, lambda y, _: lfilter([1 - pole], [1, -pole], y - y[0]) + y[0])


def bridged(begin_s: float) -> Fault:
    """The first two channels touch: both carry the mean of their voltages."""
    return _changed(slice(2), begin_s, lambda y, _: y.mean(axis=1)[:, None])

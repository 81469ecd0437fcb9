"""What two or three sensors make of a travel: slope, supply, filter, noise, ADC; and how they fail."""

from dataclasses import dataclass, field

import cantools
import numpy as np
from scipy.signal import lfilter
from wire.encode import frames_of

from gateway.common.resources import shipped
from pedal.foot import DT

DBC = shipped("dbc/pedal.dbc")
DATABASE = cantools.database.load_file(DBC)


@dataclass(frozen=True)
class Sensor:
    """A sensor of the supply's voltage: (volts at rest, at full) at 5 V; lag in ms of a filter of a kind."""

    rest: float = 0.5
    full: float = 4.5
    gain: float = 1.0
    offset: float = 0.0
    noise: float = 0.002
    lag_ms: float = 0.0
    filter: str = "first"  # first: of first order; delay; mean: a moving one
    bits: int = 12


@dataclass(frozen=True)
class Plant:
    """Sensors, and the message that carries them."""

    sensors: tuple = field(default_factory=lambda: (Sensor(), Sensor(4.5, 0.5)))
    message: str = "PED_Brake"


def brake(noise=0.002, lag=(0.0, 0.0), kind="first", rng=None, bits=12):
    """The brake's two sensors, each with its own small errors of gain and offset if there is a ``rng``."""
    ends = ((0.5, 4.5), (4.5, 0.5))
    gains = 1 + (rng.normal(0, 0.002, 2) if rng is not None else np.zeros(2))
    offsets = rng.normal(0, 0.004, 2) if rng is not None else np.zeros(2)
    return Plant(tuple(Sensor(*ends[k], gains[k], offsets[k], noise, lag[k], kind, bits) for k in range(2)))


def _filtered(x, sensor):
    if sensor.lag_ms == 0.0:
        return x
    steps = sensor.lag_ms * 1e-3 / DT
    if sensor.filter == "delay":
        k = np.arange(len(x))
        return np.interp(k - steps, k, x)
    if sensor.filter == "mean":
        return _mean(x, max(round(2 * steps), 1))
    pole = np.exp(-1 / steps)
    return lfilter([1 - pole], [1, -pole], x - x[0]) + x[0]


def _mean(x, n):
    total = np.cumsum(np.concatenate([np.full(n, x[0]), x]))
    return (total[n:] - total[:-n]) / n


def readings(plant, travel, rng, *, supply=None, faults=()):
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


def frames(plant, volts, first=0):
    """CAN frames of readings, one each millisecond; ``first``: number of the first one."""
    k = np.arange(first, first + len(volts))
    columns = {f"Ch{i + 1}": volts[:, i] for i in range(volts.shape[1])} | {"FrameCnt": k % 16}
    message = DATABASE.get_message_by_name(plant.message)
    return frames_of(message, columns, k * round(DT * 1e9) + 1_000_000, "Crc")


# --- faults: each returns a function for ``readings``; seconds from the begin, channels from 0


def _from(begin_s, end_s=None):
    return slice(round(begin_s / DT), None if end_s is None else round(end_s / DT))


def offset(channel, begin_s, volts, end_s=None):
    def put(y, travel, rng):
        y[_from(begin_s, end_s), channel] += volts
        return y

    return put


def gain(channel, begin_s, share, rest):
    def put(y, travel, rng):
        part = y[_from(begin_s), channel]
        part[:] = rest + (1 + share) * (part - rest)
        return y

    return put


def drift(channel, begin_s, volts_per_s):
    def put(y, travel, rng):
        part = y[_from(begin_s), channel]
        part += np.arange(len(part)) * DT * volts_per_s
        return y

    return put


def level(channel, begin_s, volts, noise=0.0, end_s=None):
    """Short to ground, to the battery, or an open wire that floats."""

    def put(y, travel, rng):
        part = y[_from(begin_s, end_s), channel]
        part[:] = volts + rng.normal(0, noise, len(part)) if noise else volts
        return y

    return put


def stuck(channel, begin_s, noise=0.0, end_s=None):
    def put(y, travel, rng):
        part = y[_from(begin_s, end_s), channel]
        part[:] = part[0] + (rng.normal(0, noise, len(part)) if noise else 0.0)
        return y

    return put


def floating(channel, begin_s):
    """An open input: wanders slowly between the rails."""

    def put(y, travel, rng):
        part = y[_from(begin_s), channel]
        walk = np.cumsum(rng.normal(0, 0.02, len(part)))
        part[:] = 2.5 + 2.4 * np.sin(walk) + rng.normal(0, 0.05, len(part))
        return y

    return put


def breaks(channel, begin_s, longest_ms=25.0, each_s=0.5):
    """An intermittent contact: to ground for 1 to ``longest_ms``."""

    def put(y, travel, rng):
        at = begin_s
        while at < len(y) * DT:
            at += rng.exponential(each_s)
            y[_from(at, at + rng.uniform(1e-3, longest_ms * 1e-3)), channel] = 0.0
        return y

    return put


def chatter(channel, begin_s, share=0.2, size=0.5):
    def put(y, travel, rng):
        part = y[_from(begin_s), channel]
        part += np.where(rng.random(len(part)) < share, rng.uniform(-size, size, len(part)), 0.0)
        return y

    return put


def noise(channel, begin_s, volts=0.05):
    def put(y, travel, rng):
        part = y[_from(begin_s), channel]
        part += rng.normal(0, volts, len(part))
        return y

    return put


def lag(channel, begin_s, ms):
    def put(y, travel, rng):
        part = y[_from(begin_s), channel]
        pole = np.exp(-DT * 1e3 / ms)
        part[:] = lfilter([1 - pole], [1, -pole], part - part[0]) + part[0]
        return y

    return put


def bridged(begin_s):
    """The first two channels touch: both carry the mean of their voltages."""

    def put(y, travel, rng):
        part = y[_from(begin_s), :2]
        part[:] = part.mean(axis=1)[:, None]
        return y

    return put

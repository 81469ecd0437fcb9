"""How a pedal's sensors fail, what may be said of it, whether it can be seen at all; each drive as a log would be."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway.bus.frames import Frames
from gateway_bench.wire.channel_model import road
from gateway_bench.wire.replay import Said, config_of, through
from gateway_plants.pedal.study.outside import sensors
from gateway_plants.pedal.study.outside.foot import DT, Array, Random, driving

#: Seconds that are made and fed at once.
BATCH_S = 60.0
#: A fault can be seen when what the channels differ by because of it is more than what is usual [% of the travel] and
#: so many standard deviations, for so long in all [s]; or when both jump at once, farther than a pedal moves in a
#: sample.
USUAL, DEVIATIONS, FOR_S, FASTEST = 2.0, 5.0, 0.2, 2.0

Way = dict[str, Any]
Made = Callable[[Random], sensors.Plant]


@dataclass(frozen=True)
class Row:
    """A row of the fault table.

    Attributes:
        make: rng, begin [s] -> faults for :func:`sensors.readings`.
        names: by which of these, at first, it is right to call it.
        supply: of 5 V, after the begin.
    """

    make: Callable[[Random, float], tuple[sensors.Fault, ...]]
    names: tuple[str, ...]
    supply: float = 5.0


def _one(kind: Callable[..., sensors.Fault], *args: float) -> Callable[[Random, float], tuple[sensors.Fault, ...]]:
    return lambda rng, begin: (kind(0, begin, *args),)


_ONE = ("channel_1_implausible", "channel_1_erratic", "channel_1_high", "channel_1_low", "channel_1_stuck")
#: Of two channels that part as a foot could move nobody can tell which one is off.
_MAYBE = (*_ONE, "drift", "correlation")
#: How channel 1 fails, and what may be said of it; never a word on channel 2.
FAULTS = {
    "offset 3 %": Row(_one(sensors.offset, 0.12), _ONE),
    "offset 5 %": Row(_one(sensors.offset, 0.20), _ONE),
    "offset 20 %": Row(_one(sensors.offset, 0.80), (*_ONE, "channel_1_range")),
    "gain +10 %": Row(_one(sensors.gain, 0.10, 0.5), _MAYBE),
    "gain -30 %": Row(_one(sensors.gain, -0.30, 0.5), _MAYBE),
    "drift 1 %/s": Row(_one(sensors.drift, 0.04), ("drift",)),
    "drift 0.1 %/s": Row(_one(sensors.drift, 0.004), ("drift",)),
    "short to ground": Row(_one(sensors.level, 0.0), ("channel_1_low",)),
    "short to battery": Row(_one(sensors.level, 5.0), ("channel_1_high",)),
    "open, floating": Row(_one(sensors.floating), (*_MAYBE, "channel_1_range")),
    "stuck": Row(_one(sensors.stuck), ("channel_1_stuck",)),
    "stuck with noise": Row(
        _one(sensors.stuck, 0.002), ("channel_1_implausible", "channel_1_stuck", "drift", "correlation")
    ),
    "breaks of 1 to 25 ms": Row(_one(sensors.breaks), ("channel_1_low", "channel_1_erratic", "channel_1_implausible")),
    "chatter in 20 %": Row(_one(sensors.chatter), ("channel_1_erratic", "channel_1_implausible")),
    "noise 50 mV": Row(_one(sensors.noise), ("channel_1_erratic", "channel_1_implausible", "correlation", "drift")),
    "lag 50 ms": Row(_one(sensors.lag, 50.0), _MAYBE),
    "bridged": Row(lambda rng, begin: (sensors.bridged(begin),), ("jump",)),
    "supply -10 %": Row(lambda rng, begin: (), ("supply",), supply=4.5),
}


def monitor(**params: Any) -> dict[str, Any]:
    """Return the table of the brake's monitor."""
    return {"type": "redundant_pair", "preset": "brake", **params}


def _as_told(rng: Random) -> sensors.Plant:
    return sensors.brake(rng=rng)


def healthy(plant: Made, hours: float, seed: int, *, way: Way | None = None, **params: Any) -> Said:
    """Replay healthy driving; returns what was said.

    Args:
        plant: rng -> the sensors.
        hours: length.
        seed: of everything.
        way: what happens to the frames, of :func:`gateway_bench.wire.channel_model.road`.
        params: of the monitor.
    """
    rng = np.random.default_rng(seed)
    made, seconds = plant(rng), hours * 3600

    def batches() -> Iterator[Frames]:
        for begin in np.arange(0, seconds, BATCH_S):
            travel = driving(min(BATCH_S, seconds - begin), rng)
            # Each part rests at both ends, so that the whole is one drive.
            travel[-400:] *= np.linspace(1, 0, 400) ** 2
            frames = sensors.frames(made, sensors.readings(made, travel, rng), round(begin / DT))
            yield road(frames, rng, **way) if way else frames

    return through(config_of(monitor(**params), sensors.DBC), batches())


@dataclass(frozen=True)
class Drive:
    """A drive with a fault: its frames, when the fault began, and from when on it can be seen [s]; None: it cannot."""

    frames: Frames
    begin: float
    visible: float | None


def visible(plant: sensors.Plant, effect: Array, begin: float) -> float | None:
    """Return from when on the effect of a fault can be seen [s]; None: it cannot.

    Args:
        plant: the two sensors.
        effect: what the fault puts readings off by, shape (n, 2) [V].
        begin: of the fault [s].
    """
    percent = np.array([100.0 / (s.full - s.rest) for s in plant.sensors])
    volts = np.array([np.hypot(s.noise, 5.0 / (1 << s.bits) / np.sqrt(12)) for s in plant.sensors])
    off, sd = effect * percent, float(np.linalg.norm(volts * percent))
    first = round(begin / DT)
    if abs(off[first].mean()) > FASTEST + DEVIATIONS * sd:
        return begin
    beyond: NDArray[np.bool_] = np.abs(off[:, 0] - off[:, 1]) > USUAL + DEVIATIONS * sd
    found = np.flatnonzero(np.cumsum(beyond) * DT >= FOR_S)
    return float(found[0] * DT) if len(found) else None


def drive(
    name: str,
    seed: int,
    *,
    plant: Made = _as_told,
    seconds: float = 30.0,
    begin: float | None = None,
    way: Way | None = None,
) -> Drive:
    """Return a drive with a fault of the table.

    Args:
        name: of the fault.
        seed: of everything.
        plant: rng -> the sensors; default: the brake's as told, with small errors.
        seconds: length.
        begin: of the fault [s]; default: at random, after 5 s.
        way: what happens to the frames, of :func:`gateway_bench.wire.channel_model.road`.
    """
    rng = np.random.default_rng([seed, list(FAULTS).index(name)])
    made = plant(rng)
    begin = float(rng.uniform(5, 9)) if begin is None else begin
    travel = driving(seconds, rng)
    t = np.arange(len(travel)) * DT
    row = FAULTS[name]
    supply = np.where(t < begin, 5.0, row.supply)
    well = sensors.readings(made, travel, copy.deepcopy(rng))
    volts = sensors.readings(made, travel, rng, supply=supply, faults=row.make(rng, begin))
    frames = sensors.frames(made, volts)
    return Drive(road(frames, rng, **way) if way else frames, begin, visible(made, volts - well, begin))


def faulty(name: str, seed: int, **options: Any) -> tuple[Said, float]:
    """Replay a drive with a fault; returns what was said, and when the fault began [s]. Arguments: :func:`drive`."""
    made = drive(name, seed, **{key: options.pop(key) for key in _OF_DRIVES & set(options)})
    return through(config_of(monitor(**options), sensors.DBC), [made.frames]), made.begin


_OF_DRIVES = {"plant", "seconds", "begin", "way"}


def blamed(said: Said) -> list[str]:
    """Return the faults of channel 2 that were set: nothing was wrong with it."""
    return [name for name in said.set if name.startswith("channel_2")]

"""The mismatch matrix and the fault table of a brake pedal, each case replayed as a log would be."""

from dataclasses import dataclass

import numpy as np
from wire.replayed import config_of, through
from wire.road import road

from pedal import sensors
from pedal.foot import DT, driving

#: Seconds that are made and fed at once.
BATCH_S = 60.0


@dataclass(frozen=True)
class Row:
    """A row of the fault table.

    Attributes:
        make: rng, begin [s] -> faults for :func:`sensors.readings`.
        names: by which of these, at first, it is right to call it.
        supply: of 5 V, behind the begin.
    """

    make: object
    names: tuple
    supply: float = 5.0


def _one(kind, *args, **options):
    return lambda rng, begin: (kind(0, begin, *args, **options),)


_ONE = ("channel_1_implausible", "channel_1_erratic", "channel_1_high", "channel_1_low", "channel_1_stuck")
_MAYBE = (*_ONE, "drift", "correlation")
#: What the note's table has: how channel 1 fails, and what may be said of it; never a word on channel 2.
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


def monitor(**params):
    return {"type": "redundant_pair", "preset": "brake", **params}


def healthy(plant, hours, seed, *, way=None, **params):
    """Replay healthy driving; returns what was said.

    Args:
        plant: rng -> the sensors.
        hours: length.
        seed: of everything.
        way: what happens to the frames, of :func:`wire.road.road`.
        params: of the monitor.
    """
    rng = np.random.default_rng(seed)
    made, seconds = plant(rng), hours * 3600

    def batches():
        for begin in np.arange(0, seconds, BATCH_S):
            travel = driving(min(BATCH_S, seconds - begin), rng)
            # Each part rests at both ends, so that the whole is one drive.
            travel[-400:] *= np.linspace(1, 0, 400) ** 2
            frames = sensors.frames(made, sensors.readings(made, travel, rng), round(begin / DT))
            yield road(frames, rng, **way) if way else frames

    return through(config_of(monitor(**params), sensors.DBC), batches())


def faulty(name, seed, *, plant=None, seconds=30.0, begin=None, way=None, **params):
    """Replay a run with a fault of the table; returns what was said, and when the fault began [s].

    Args:
        name: of the fault.
        seed: of everything.
        plant: rng -> the sensors; default: the brake's as told, with small errors.
        seconds: length.
        begin: of the fault [s]; default: at random, behind 5 s.
        way: what happens to the frames, of :func:`wire.road.road`.
        params: of the monitor.
    """
    rng = np.random.default_rng([seed, list(FAULTS).index(name)])
    made = (plant or (lambda r: sensors.brake(rng=r)))(rng)
    begin = rng.uniform(5, 9) if begin is None else begin
    travel = driving(seconds, rng)
    t = np.arange(len(travel)) * DT
    row = FAULTS[name]
    supply = np.where(t < begin, 5.0, row.supply)
    volts = sensors.readings(made, travel, rng, supply=supply, faults=row.make(rng, begin))
    frames = sensors.frames(made, volts)
    frames = road(frames, rng, **way) if way else frames
    return through(config_of(monitor(**params), sensors.DBC), [frames]), begin


def blamed(said):
    """Faults of channel 2 that were set: nothing was wrong with it."""
    return [name for name in said.set if name.startswith("channel_2")]

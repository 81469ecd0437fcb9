"""A plant of other make: a model as a user writes it, and a drive that its own solver makes.

Its structure is not the model's. Plants of the study, which the arena has too, have that, with other parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Plant:
    """A plant.

    Attributes:
        name: of the plant and of its model.
        model: as a user writes it, in TOML.
        period_s: between two samples.
        knowns: known variables.
        options: lines of a configuration.
        faults: fault -> its sizes, in the unit that it has in the model.
        sensors: fault -> the known variable of the sensor that it is in; others are of parts.
        pace: by which all times of a drive are longer.
        drive: (seed, samples, faults) -> what the sensors show, shape (samples, knowns). The seed draws the plant, its
            drive and its noise; faults are fault -> size at each sample.
    """

    name: str
    model: str
    period_s: float
    knowns: tuple[str, ...]
    options: str
    faults: Mapping[str, tuple[float, ...]]
    sensors: Mapping[str, str]
    drive: Callable[[int, int, Mapping[str, Array]], Array]
    pace: float = 1.0

    def part(self, fault: str) -> str:
        """Return the component that a fault is of, as a diagnosis names it."""
        z = self.sensors.get(fault)
        return f"signal b.M{self.knowns.index(z)}.{z}" if z else f"plant own.{fault}"


def course(rng: np.random.Generator, count: int, period_s: float, low: float, high: float, every: Any) -> Array:
    """Return a course at random: lines between levels, ``every`` (least, most) seconds, over 1 s rounded off."""
    t = np.cumsum(rng.uniform(*every, int(count * period_s / every[0]) + 2))
    y = np.interp(np.arange(count) * period_s, t - t[0], rng.uniform(low, high, len(t)))
    width = max(int(1.0 / period_s) | 1, 3)
    return np.convolve(np.pad(y, width // 2, "edge"), np.ones(width) / width, "valid")


def shown(rng: np.random.Generator, car: np.random.Generator, values: Array, sensor: tuple[float, ...]) -> Array:
    """Return what a sensor shows: its own gain and bias, noise, and whole steps.

    Args:
        rng: of the noise.
        car: of gain and bias.
        values: shape (samples,).
        sensor: half width of 1 + gain, half width of the bias, standard deviation of the noise, step.
    """
    gain, bias, noise, step = sensor
    read = values * (1.0 + car.uniform(-gain, gain)) + car.uniform(-bias, bias) + rng.normal(size=len(values)) * noise
    return np.round(read / step) * step


def all_of(faults: Mapping[str, Array], names: tuple[str, ...], count: int) -> Array:
    """Return the sizes of faults at each sample, shape (samples, names)."""
    return np.stack([faults.get(name, np.zeros(count)) for name in names], 1)

"""What the estimators are given: demands, loads, parameter spread, faults (paper 001; nothing of it is published)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gateway.fdi.filters.motor import Motor
from gateway.vecu.steering_plant import CONTROL, Plant

#: Length of a run [s]; its first second is warm-up.
DURATION, WARM_UP = 24.0, 1.0

Array = NDArray[np.float64]


def times() -> Array:
    """Return the controller's samples of a run [s]."""
    return np.arange(0.0, DURATION + CONTROL / 2, CONTROL)


def demand(t: Array) -> Array:
    """Return the motor angle asked for [rad]: rests, 12 rad at 0.5 Hz, 20 rad at 0.7 Hz, creep, chirp to 2.4 Hz."""
    angle = np.zeros_like(t)

    def wave(begin: float, end: float, size: float, phase: Array, at: float = 0.0) -> None:
        s = t - begin
        soft = np.clip(np.minimum(s, end - begin - s) / 0.3, 0.0, 1.0)
        soft = soft * soft * (3.0 - 2.0 * soft)
        inside = (t >= begin) & (t < end)
        angle[inside] = at + (size * soft * np.sin(2.0 * np.pi * phase))[inside]

    wave(2.0, 6.0, 12.0, 0.5 * (t - 2.0))
    end = 8.0 + 3.0 / 0.7
    wave(8.0, end, 20.0, 0.7 * (t - 8.0))
    angle[t >= 14.3] = np.clip(t[t >= 14.3] - 14.3, 0.0, 3.0)
    s = t - 18.5
    wave(18.5, 22.5, 5.0, 0.3 * s + (2.4 - 0.3) / 8.0 * s * s, 3.0)
    return angle


def load(t: Array, scale: float = 1.0) -> Array:
    """Return the torque against the motor [N m]: 0.5 in the first rest between motions, -0.6 in the second."""
    torque = np.zeros_like(t)
    for begin, end, size in ((6.26, 8.0, 0.5), (12.3, 13.3, -0.6)):
        edge = np.clip(np.minimum(t - begin, end - t) / 0.02, 0.0, 1.0)
        torque += scale * size * edge
    return torque


@dataclass(frozen=True)
class Spread:
    """Ranges from which a run's motor is drawn, factors of its values; loads; dead time [V]; Coulomb [N m]."""

    resistance: tuple[float, float] = (0.9, 1.3)
    flux: tuple[float, float] = (0.95, 1.02)
    inertia: tuple[float, float] = (0.8, 1.3)
    dead: tuple[float, float] = (0.0, 0.05)
    coulomb: tuple[float, float] = (0.01, 0.04)
    load: tuple[float, float] = (-1.5, 1.5)

    def draw(self, rng: np.random.Generator) -> tuple[Plant, float]:
        """Return a plant and the scale of its load."""
        m = Motor()
        drawn = replace(
            m,
            resistance=m.resistance * rng.uniform(*self.resistance),
            flux=m.flux * rng.uniform(*self.flux),
            inertia=m.inertia * rng.uniform(*self.inertia),
        )
        plant = Plant(motor=drawn, dead=rng.uniform(*self.dead), coulomb=rng.uniform(*self.coulomb))
        return plant, float(rng.uniform(*self.load))


def wheel(t: Array) -> Array:
    """Return the steering wheel's angle [deg]: turns of 60 and 120 deg, and rests; its own rhythm, not the motor's."""
    angle = np.zeros_like(t)
    for begin, end, size, hertz in (
        (1.0, 5.0, 60.0, 0.25),
        (7.2, 10.2, 120.0, 1.0 / 3.0),
        (13.0, 19.0, 40.0, 0.5),
        (20.5, 23.0, 90.0, 0.4),
    ):
        inside = (t >= begin) & (t < end)
        s = t[inside] - begin
        soft = np.clip(np.minimum(s, end - begin - s) / 0.3, 0.0, 1.0)
        angle[inside] = size * soft * soft * (3.0 - 2.0 * soft) * np.sin(2.0 * np.pi * hertz * s)
    return angle

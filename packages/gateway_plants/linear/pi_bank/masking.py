"""Which faults hide each other from (16): for these sizes nobody can isolate them by stationary values.

A sensor's constant fault s_j moves the stationary fault of observer k, k != j, by G_kj s_j, whatever its gain:

    [[Phi - 1, Gamma], [C^k, 0]] [x; omega] = [0; s^k]

r_ai is lost for good where |a_i + (G_kj)_i s_j| < Th_ai in one observer.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gateway_plants.linear.mathematics.plant import LinearPlant
from gateway_plants.linear.pi_bank.design import steady

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Masked:
    """An actuator's fault that a sensor's hides.

    Attributes:
        actuator: by its place.
        sensor: likewise.
        observer: in which, by the sensor that it leaves out.
        low: of the sensor's fault, for the size of the actuator's that was asked for.
        high: likewise.
    """

    actuator: int
    sensor: int
    observer: int
    low: float
    high: float


def stationary(plant: LinearPlant) -> Array:
    """Return G, shape (p, p, m): stationary fault of observer k for 1 of sensor j's; 0 for k = j."""
    n, p = plant.states, plant.outputs
    moved = np.zeros((p, p, plant.inputs))
    for k in range(p):
        shown = np.eye(n + p - 1)[:, n:]
        moved[k, [j for j in range(p) if j != k]] = np.linalg.lstsq(steady(plant, k), shown, rcond=None)[0][n:].T
    return moved


def masked(plant: LinearPlant, size: Array, threshold: Array) -> list[Masked]:
    """Return the intervals of sensor faults that hide actuator faults of given sizes.

    Args:
        size: of each actuator's fault, shape (m,).
        threshold: Th_a, shape (m,).
    """
    moved = stationary(plant)
    found = []
    for i in range(plant.inputs):
        for j in range(plant.outputs):
            for k in range(plant.outputs):
                g = moved[k, j, i]
                if abs(g) > 1e-12:
                    ends = sorted(((threshold[i] - size[i]) / g, (-threshold[i] - size[i]) / g))
                    found.append(Masked(i, j, k, float(ends[0]), float(ends[1])))
    return found

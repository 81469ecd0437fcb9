"""What a bank needs of a plant (paper 003, section 3 and Theorem 1), and what is not exact of it.

Corrected against the paper: Theorem 1 also needs (C^k, A) observable for free poles (detectable, to exist at all), and
p - 1 >= m, not p >= m.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gateway_plants.linear.mathematics.plant import LinearPlant, unobservable

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Noise:
    """What is not exact.

    Attributes:
        outputs: standard deviation of each sensor, shape (p,).
        states: of each state's disturbance, per root of a second, shape (n,).
        faults: of each fault's random walk, per root of a second, shape (m,).
    """

    outputs: Array
    states: Array
    faults: Array


def steady(plant: LinearPlant, sensor: int) -> Array:
    """Return [[Phi - 1, Gamma], [C^i, 0]], which makes [0; what the sensors but i show] of a constant [x; a]."""
    block = np.zeros((plant.states + plant.outputs - 1, plant.states + plant.inputs))
    block[: plant.states] = np.hstack([plant.phi - np.eye(plant.states), plant.gamma])
    block[plant.states :, : plant.states] = plant.without(sensor)
    return block


def rank_without(plant: LinearPlant, sensor: int) -> int:
    """Return the rank of :func:`steady`: with n + m no constant fault looks like no fault at all."""
    block = steady(plant, sensor)
    block /= np.maximum(np.abs(block).max(axis=1, keepdims=True), 1e-300)
    return int(np.linalg.matrix_rank(block, tol=1e-9))


def check(plant: LinearPlant, sensors: tuple[str, ...] = (), states: tuple[str, ...] = ()) -> None:
    """Check Theorem 1 for every observer of the bank.

    rank [[A, B], [C^i, 0]] = n + m is, in discrete time, that of :func:`rank_without`.

    Raises:
        ValueError: it does not hold; says for which i, and what the rank is.
    """
    n, m, p = plant.states, plant.inputs, plant.outputs
    names = sensors or tuple(f"y{k + 1}" for k in range(p))
    if p - 1 < m:
        raise ValueError(f"{p} sensors for {m} actuators: a bank needs one sensor more than actuators, at least")
    for i in range(p):
        hidden = unobservable(plant.phi, plant.without(i), states)
        if hidden:
            raise ValueError(f"without sensor {i + 1} ({names[i]}) the plant does not show {hidden}")
        rank = rank_without(plant, i)
        if rank < n + m:
            raise ValueError(
                f"Theorem 1 does not hold for i = {i + 1} ({names[i]}): without that sensor the rank is {rank}, "
                f"not n + m = {n + m}; some constant faults of the actuators would not show in the others"
            )

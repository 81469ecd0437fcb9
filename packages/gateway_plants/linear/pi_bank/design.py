"""Gains of a bank of proportional-integral observers (paper 003, section 3 and Theorem 1).

Observer k takes all sensors but the k-th, (14). Its error with a step fault a of the actuators is, from (9) and (11)
with the estimate's error zeta = a - omega,

    e(k+1) = [[Phi, Gamma], [0, 1]] [x - x_k; zeta] - [K_k; H_k] C^k (x - x_k)

so that [K; H] is the gain of an observer of the plant with omega as further states. It is designed in discrete time:
the paper's continuous gains with outputs that are only held between samples find faults where there are none, because
the plant moves within a sample. Observer 0, which the paper does not have, takes all sensors: while none is at fault it
knows most.

Gains are Kalman's, from the noise. With the paper's poles, -1.1 to -10, and what is free beside them spent on little
noise, 82 % of its plant's random pairs of faults are named, with Kalman's 98 %.

Corrected against the paper: Theorem 1 also needs (C^k, A) observable for free poles (detectable, to exist at all), and
p - 1 >= m, not p >= m.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gateway_plants.linear.mathematics.gains import Gain, from_noise
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


@dataclass(frozen=True)
class Observer:
    """One observer of the bank.

    Attributes:
        rows: the sensors that it takes.
        shown: [C, 0] of these, shape (sensors, n + m).
        gain: [K; H] with covariances, of these.
    """

    rows: list[int]
    shown: Array
    gain: Gain


def augmented(plant: LinearPlant) -> Array:
    """Return [[Phi, Gamma], [0, 1]], shape (n + m, n + m)."""
    n, m = plant.states, plant.inputs
    whole = np.eye(n + m)
    whole[:n, :n], whole[:n, n:] = plant.phi, plant.gamma
    return whole


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


def covariances(plant: LinearPlant, noise: Noise) -> tuple[Array, Array]:
    """Return the covariances of a sample's noise on the augmented states, and on the outputs."""
    per_sample = np.concatenate([noise.states, noise.faults]) ** 2 * plant.period
    return np.diag(per_sample), np.diag(noise.outputs**2)


def design(plant: LinearPlant, noise: Noise) -> tuple[Observer, ...]:
    """Design the bank: observer 0 with all sensors, then one without each.

    Args:
        plant: that has passed :func:`check`.
        noise: of states, faults and sensors.

    Raises:
        ValueError: an observer cannot be designed; says which.
    """
    phi = augmented(plant)
    q, r = covariances(plant, noise)
    bank = []
    for left_out in (None, *range(plant.outputs)):
        rows = [k for k in range(plant.outputs) if k != left_out]
        shown = np.hstack([plant.c, np.zeros((plant.outputs, plant.inputs))])[rows]
        try:
            bank.append(Observer(rows, shown, from_noise(phi, shown, q, r[np.ix_(rows, rows)])))
        except ValueError as error:
            which = "with all sensors" if left_out is None else f"without sensor {left_out + 1}"
            raise ValueError(f"observer {which}: {error}") from error
    return tuple(bank)

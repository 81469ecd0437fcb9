"""Gains of a bank of proportional-integral observers (paper 003, section 3 and Theorem 1).

Observer k takes all sensors but the k-th, (14). Its error with a step fault a of the actuators is, from (9) and (11)
with the estimate's error zeta = a - omega,

    e(k+1) = [[Phi, Gamma], [0, 1]] [x - x_k; zeta] - [K_k; H_k] C^k (x - x_k)

so that [K; H] is the gain of an observer of the plant with omega as further states. It is designed in discrete time:
the paper's continuous gains with outputs that are only held between samples find faults where there are none, because
the plant moves within a sample. Observer 0, which the paper does not have, takes all sensors: while none is at fault it
knows most.

Corrected against the paper: Theorem 1 also needs (C^k, A) observable for free poles (detectable, to exist at all), and
p - 1 >= m, not p >= m.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gateway_plants.linear.mathematics.gains import Gain, from_noise, from_poles
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
        left_out: the sensor that it does not take, None: it takes all.
        gain: [K; H] with covariances, of the sensors that it takes.
    """

    left_out: int | None
    gain: Gain


def augmented(plant: LinearPlant) -> Array:
    """Return [[Phi, Gamma], [0, 1]], shape (n + m, n + m)."""
    n, m = plant.states, plant.inputs
    whole = np.eye(n + m)
    whole[:n, :n], whole[:n, n:] = plant.phi, plant.gamma
    return whole


def check(plant: LinearPlant, sensors: tuple[str, ...] = (), states: tuple[str, ...] = ()) -> None:
    """Check Theorem 1 for every observer of the bank.

    rank [[A, B], [C^i, 0]] = n + m is, in discrete time, rank [[Phi - 1, Gamma], [C^i, 0]] = n + m: a constant fault
    must not look like no fault at all.

    Raises:
        ValueError: it does not hold; says for which i, and what the rank is.
    """
    n, m, p = plant.states, plant.inputs, plant.outputs
    names = sensors or tuple(f"y{k + 1}" for k in range(p))
    if p - 1 < m:
        raise ValueError(f"{p} sensors for {m} actuators: a bank needs one sensor more than actuators, at least")
    for i in range(p):
        c = plant.without(i)
        hidden = unobservable(plant.phi, c, states)
        if hidden:
            raise ValueError(f"without sensor {i + 1} ({names[i]}) the plant does not show {hidden}")
        block = np.zeros((n + p - 1, n + m))
        block[:n, :n], block[:n, n:], block[n:, :n] = plant.phi - np.eye(n), plant.gamma, c
        block /= np.maximum(np.abs(block).max(axis=1, keepdims=True), 1e-300)
        rank = int(np.linalg.matrix_rank(block, tol=1e-9))
        if rank < n + m:
            raise ValueError(
                f"Theorem 1 does not hold for i = {i + 1} ({names[i]}): without that sensor the rank is {rank}, "
                f"not n + m = {n + m}; some constant faults of the actuators would not show in the others"
            )


def covariances(plant: LinearPlant, noise: Noise) -> tuple[Array, Array]:
    """Return the covariances of a sample's noise on the augmented states, and on the outputs."""
    per_sample = np.concatenate([noise.states, noise.faults]) ** 2 * plant.period
    return np.diag(per_sample), np.diag(noise.outputs**2)


def design(plant: LinearPlant, noise: Noise, poles: tuple[complex, ...] | None = None) -> tuple[Observer, ...]:
    """Design the bank: observer 0 with all sensors, then one without each.

    Args:
        plant: that has passed :func:`check`.
        noise: of states, faults and sensors.
        poles: n + m of discrete time; None: from the noise.

    Raises:
        ValueError: an observer cannot be designed; says which.
    """
    phi = augmented(plant)
    q, r = covariances(plant, noise)
    bank = []
    for left_out in (None, *range(plant.outputs)):
        rows = [k for k in range(plant.outputs) if k != left_out]
        c = np.hstack([plant.c[rows], np.zeros((len(rows), plant.inputs))])
        own = r[np.ix_(rows, rows)]
        try:
            if poles is None:
                gain = from_noise(phi, c, q, own)
            else:
                gain = from_poles(phi, c, poles, q, own, plant.inputs)
        except ValueError as error:
            which = "with all sensors" if left_out is None else f"without sensor {left_out + 1}"
            raise ValueError(f"observer {which}: {error}") from error
        bank.append(Observer(left_out, gain))
    return tuple(bank)

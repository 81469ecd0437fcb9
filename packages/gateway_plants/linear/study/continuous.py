"""The paper's simulation: continuous plant and continuous observers, exact, looked at each 0.1 s."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import expm

from gateway_plants.linear.study import example

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]


@dataclass(frozen=True)
class Told:
    """What the bank tells at each sample.

    Attributes:
        omega: estimated faults, shape (n, 3, 2): sample, observer, actuator.
        e: what each observer leaves of each sensor, shape (n, 3, 3).
        actuators: r_a by (16), shape (n, 2).
        printed: r_a by (16) as printed, shape (n, 2).
        sensors: r_s by (15), shape (n, 3).
    """

    omega: Array
    e: Array
    actuators: Flags
    printed: Flags
    sensors: Flags


def system(gains: ArrayLike, plant: tuple[ArrayLike, ArrayLike]) -> tuple[Array, Array]:
    """Return (A, B) of plant and three observers together: states x, then x_k, omega_k; inputs u, a, s.

    Args:
        gains: of the observers.
        plant: A and B as they are; the observers have the paper's.
    """
    a, b, c = (np.array(x) for x in (example.A, example.B, example.C))
    n, m, p = 4, 2, 3
    whole = np.zeros((n + p * (n + m), n + p * (n + m)))
    inputs = np.zeros((len(whole), 2 * m + p))
    whole[:n, :n] = plant[0]
    inputs[:n, :m] = inputs[:n, m : 2 * m] = plant[1]
    for k, gain in enumerate(np.array(gains)):
        at, rows = n + k * (n + m), [j for j in range(p) if j != k]
        left = c[rows]
        block = np.zeros((n + m, n + m))
        block[:n, :n], block[:n, n:] = a, b
        block[:, :n] -= gain @ left
        whole[at : at + n + m, at : at + n + m] = block
        whole[at : at + n + m, :n] = gain @ left
        inputs[at : at + n, :m] = b
        for place, j in enumerate(rows):
            inputs[at : at + n + m, 2 * m + j] = gain[:, place]
    return whole, inputs


def flags(omega: Array, e: Array) -> tuple[Flags, Flags, Flags]:
    """Return r_a, r_a as printed, r_s for estimates (n, 3, 2) and innovations (n, 3, 3): the paper's products.

        r_si = product over k != i of [|e_ki| >= Th_si]      (15)
        r_ai = product over all k of [|omega_ki| >= Th_ai]   (16), corrected

    (16) is printed with k != i, like (15). But there i counts actuators and k observers, and leaving out observer i
    leaves out the one that a fault of sensor i does not touch: flags of actuators for faults of sensors are the
    consequence. Both are levels. e_ki of a constant sensor fault returns to 0, since a stationary observer has H e = 0
    and H is regular where p - 1 = m: r_s is a pulse of some samples.
    """
    others = ~np.eye(3, dtype=np.bool_)
    small, still = np.abs(omega) < example.ACTUATOR_LIMIT, np.abs(e) < example.SENSOR_LIMIT
    denied = (small.any(axis=1), (small & others[:, :2]).any(axis=1), (still & others).any(axis=1))
    r_a, printed, r_s = map(np.logical_not, denied)
    return r_a, printed, r_s


def observe(
    a: Array,
    s: Array,
    gains: ArrayLike = example.GAINS,
    plant: tuple[ArrayLike, ArrayLike] = (example.A, example.B),
) -> Told:
    """Simulate from state 0 with faults that are held over a sample.

    Args:
        a: of the actuators, shape (n, 2).
        s: of the sensors, shape (n, 3).
        gains: of the observers.
        plant: A and B as they are; the observers have the paper's.
    """
    whole, inputs = system(gains, plant)
    size, width = len(whole), inputs.shape[1]
    block = np.zeros((size + width, size + width))
    block[:size, :size], block[:size, size:] = whole, inputs
    step = expm(block * example.PERIOD)
    x, count = np.zeros(size), len(a)
    omega, e = np.zeros((count, 3, 2)), np.zeros((count, 3, 3))
    for t in range(count):
        bank = x[4:].reshape(3, 6)
        omega[t], e[t] = bank[:, 4:], x[:3] + s[t] - bank[:, :3]
        np.fill_diagonal(e[t], 0.0)
        x = step[:size, :size] @ x + step[:size, size:] @ np.concatenate([[example.COMMAND] * 2, a[t], s[t]])
    return Told(omega, e, *flags(omega, e))


def spans(flag: Flags) -> list[tuple[float, float]]:
    """Return when a flag was set: [on, off) in s; off is infinite if it is set at the end."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flag, [False]]).astype(int)))
    found = []
    for on, off in zip(edges[::2], edges[1::2], strict=True):
        end = float("inf") if off == len(flag) else round(off * example.PERIOD, 6)
        found.append((round(on * example.PERIOD, 6), end))
    return found

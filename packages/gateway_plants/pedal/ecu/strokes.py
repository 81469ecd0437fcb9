"""What a driver does with a pedal: its travel over time, 0 at rest, 1 pressed to the floor."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Travel = NDArray[np.float64]

#: Paper 002, Fig. 6: the top of the stroke (4.5 V of 5 V), when the pedal is let go [s]; the time constants [s] are
#: found from the samples that the text quotes (1.80 V at 42 ms; 2.11, 2.10, 2.09 V from 746 ms on).
TOP, RELEASE_S, PRESS_S, EASE_S = 0.9, 0.6, 0.0822, 0.1928


def exponential(t: NDArray[np.float64], begin_s: float = 0.0) -> Travel:
    """Return the paper's stroke: pressed in an emergency, held, let go slowly.

    ``TOP (1 - exp(-t / 82.2 ms))`` until 600 ms, then a decay with 192.8 ms. Straight ramps, as the prose of the
    paper's Fig. 6 reads, contradict the samples it quotes.

    Args:
        t: times [s].
        begin_s: when the pedal is pressed [s].
    """
    t = np.asarray(t) - begin_s
    pressed = TOP * -np.expm1(-np.clip(t, 0, RELEASE_S) / PRESS_S)
    return np.asarray(pressed * np.exp(-np.maximum(t - RELEASE_S, 0) / EASE_S))


def ramp(t: NDArray[np.float64], begin_s: float = 0.0) -> Travel:
    """Return a stroke of straight lines: up in 0.4 s, held for 0.2 s, down to 0.1 in 0.4 s."""
    t = np.asarray(t) - begin_s
    return np.asarray(np.interp(t, [0, 0.4, 0.6, 1.0], [0, TOP, TOP, 0.1]))


def cosine(t: NDArray[np.float64], begin_s: float = 0.0) -> Travel:
    """Return a stroke like :func:`ramp`, of half waves of a cosine."""
    t = np.asarray(t) - begin_s
    up = (1 - np.cos(np.pi * np.clip(t / 0.4, 0, 1))) / 2
    down = (1 - np.cos(np.pi * np.clip((t - 0.6) / 0.4, 0, 1))) / 2
    return np.asarray(TOP * up - (TOP - 0.1) * down)


def along(t: NDArray[np.float64], points: Sequence[tuple[float, float]]) -> Travel:
    """Return straight lines through (time [s], travel) points."""
    return np.asarray(np.interp(t, [p[0] for p in points], [p[1] for p in points]))


def driving(t: NDArray[np.float64], rng: np.random.Generator) -> Travel:
    """Return random driving: the foot rests, presses, adjusts and lets go.

    Each movement goes to a random travel with the bell-shaped speed of a human limb (minimum jerk), in 0.15 s to
    1.2 s; between movements the foot holds, with a slow tremor of 0.2 %.

    Args:
        t: times [s], rising.
        rng: source of all randomness.
    """
    t = np.asarray(t)
    travel = np.zeros(len(t))
    now, at = float(t[0]) + rng.uniform(0.1, 0.5), 0.0
    while now < t[-1]:
        pressed = at > 0
        to = 0.0 if pressed and rng.random() < 0.4 else rng.beta(1.5, 3.0)
        length = rng.uniform(0.15, 1.2) * (0.5 + abs(to - at))
        s = np.clip((t - now) / length, 0, 1)
        travel += (to - at) * s**3 * (10 - 15 * s + 6 * s**2)
        now, at = now + length + rng.exponential(0.8), to
    tremor = np.zeros(len(t))
    for hertz in rng.uniform(2.0, 9.0, 3):
        tremor += np.sin(2 * np.pi * (hertz * t + rng.random()))
    return np.asarray(np.clip(travel + 0.0012 * tremor * np.minimum(travel / 0.05, 1), 0, 1))

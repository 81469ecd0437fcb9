"""How a pedal moves: a mass on a return spring, pushed by a leg that wants it elsewhere every now and then."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, cont2discrete, lfilter, sosfilt

Array = NDArray[np.float64]
Random = np.random.Generator

#: Sample time [s].
DT = 1e-3


def _response(wanted: Array, hertz: float, damping: float) -> Array:
    """Mass, spring and damper behind a muscle of first order, sampled exactly for steps of force."""
    w = 2 * np.pi * hertz
    numerator, denominator, _ = cont2discrete(
        ([w**3], np.polymul([1, 2 * damping * w, w * w], [1, w])), DT, method="zoh"
    )
    return np.asarray(lfilter(numerator.ravel(), denominator, wanted), np.float64)


def _steps(seconds: float, mean_s: float, draw: Callable[[int], Array], rng: Random) -> Array:
    """A level that is held for a while and then drawn anew."""
    n = round(seconds / DT)
    lengths = np.maximum(rng.exponential(mean_s, int(4 * seconds / mean_s) + 8), 0.08)
    ends = np.minimum(np.round(np.cumsum(lengths) / DT), n).astype(int)
    levels = draw(len(ends))
    return np.asarray(np.repeat(levels, np.diff(ends, prepend=0))[:n], np.float64)


def driving(seconds: float, rng: Random, *, abs_share: float = 0.15) -> Array:
    """Travel, 0 to 1, shape (n,): rests, slow and sudden pushes, creeping, brake-by-ABS pulsing, tremor.

    Args:
        seconds: length.
        rng: of all that is random.
        abs_share: share of the time in which the hydraulics push back, 8 to 16 times a second.
    """
    n = round(seconds / DT)
    t = np.arange(n) * DT

    def pushes(count: int) -> Array:
        return np.asarray(np.where(rng.random(count) < 0.45, 0.0, rng.uniform(0.02, 1.0, count)), np.float64)

    gentle = _response(_steps(seconds, 2.5, pushes, rng), 1.2, 1.0)
    sudden = _response(_steps(seconds, 1.6, lambda k: pushes(k) * (rng.random(k) < 0.5), rng), 6.0, 0.9)
    creep = np.cumsum(_steps(seconds, 3.0, lambda k: rng.normal(0, 0.02, k) * (rng.random(k) < 0.5), rng)) * DT
    travel = np.maximum(gentle, sudden) + 0.5 * np.abs(creep)
    pulsing = _steps(seconds, 1.5, lambda k: (rng.random(k) < abs_share) * rng.uniform(0.01, 0.05, k), rng)
    pulsing = _response(pulsing, 4.0, 1.0)
    rate = _steps(seconds, 1.0, lambda k: rng.uniform(8.0, 16.0, k), rng)
    pressed = np.clip(travel / 0.1, 0, 1)
    travel = travel + pressed * pulsing * np.sin(2 * np.pi * np.cumsum(rate) * DT)
    tremor = sosfilt(butter(2, [3.0, 9.0], "band", fs=1 / DT, output="sos"), rng.normal(0, 1, n))
    travel += 0.002 * np.clip(travel / 0.05, 0, 1) * tremor / max(np.std(tremor), 1e-9)
    rest = rng.uniform(0.2, 3.0)
    return np.asarray(np.clip(travel * np.clip((t - rest) / 0.3, 0, 1), 0.0, 1.0), np.float64)


def points(seconds: float, *pairs: tuple[float, float]) -> Array:
    """Travel along straight lines between (seconds, travel)."""
    t = np.arange(round(seconds / DT)) * DT
    return np.asarray(np.interp(t, [p[0] for p in pairs], [p[1] for p in pairs]), np.float64)

"""The paper's structure, filter - distance measure - stopping rule, in all its combinations (paper 001, Fig. 2)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway_fdi import stopping
from gateway_fdi.jit import kernel, zeros
from gateway_fdi.stopping import RULES
from gateway_plants.steering import distances
from gateway_plants.steering.study.estimators import (
    ANCHORED,
    EKF4_DQ,
    EKF5_AB,
    FF_HELD,
    LO,
    NAMES,
    NIS,
    REDUCED,
    estimate,
)
from gateway_plants.steering.study.follow import Followed, Run

Array = NDArray[np.float64]

SYMPTOMS = (
    "Luenberger, leaky",
    "reduced, leaky",
    "EKF4 dq, leaky",
    "feedforward, modulo pi",
    "EKF4 dq, NIS",
    "EKF5 ab, position",
    "EKF5 ab anchored, position",
    "EKF5 ab anchored, increment",
    "parity (1)",
)
#: Speed below which the feed-forward angle says nothing [rad/s].
SLOW = 15.0


@kernel
def _symptoms(x: Any, est: Any, parity: Any, n: int, period: float, out: Any, steps: Any, sums: Any) -> None:
    turn = 0.5 * np.pi
    share = period / 0.1
    for k in range(x.shape[0]):
        theta = x[k].sensor
        r = out[k]
        for j in range(3):
            column = (LO, REDUCED, EKF4_DQ)[j]
            odd = distances.increment(steps[j], theta, est[k, n + column], period, turn)
            r[j] = distances.leaky(sums[j], odd, share)
        r[3] = 0.0
        if abs(est[k, n + ANCHORED]) > SLOW:
            r[3] = distances.modulo_pi(theta, est[k, FF_HELD], 4.0)
        r[4] = est[k, NIS]
        r[5] = distances.position(theta, est[k, EKF5_AB], turn)
        r[6] = distances.position(theta, est[k, ANCHORED], turn)
        r[7] = distances.increment(steps[3], theta, est[k, n + ANCHORED], period, turn)
        r[8] = parity[k]


def symptoms(run: Run, followed: Followed, period: float = 1e-3) -> Array:
    """Return the symptoms of a run, shape (n, 9)."""
    x = zeros(len(run.samples), run.samples.dtype)
    x[:] = run.samples
    est = estimate(run.samples, period, mean_dq=True)
    out = np.empty((len(x), len(SYMPTOMS)))
    steps, sums = zeros(4, distances.Increment), zeros(3, distances.Leaky)
    _symptoms(x, est, followed.trace[:, 2], len(NAMES), period, out, steps, sums)
    return out


@kernel
def _levels(values: Any, c: Any, s: Any, out: Any) -> None:
    for k in range(values.shape[0]):
        stopping.update(s, c, values[k])
        out[k] = s.level


def levels(values: Array, scale: float) -> Array:
    """Return the level of each rule over a symptom's values, shape (n, rules).

    Args:
        values: shape (n,).
        scale: largest healthy value: CUSUM's drift, and half the SPRT's shift, are half of it.
    """
    out = np.empty((len(values), len(RULES)))
    column = np.empty(len(values))
    for j, rule in enumerate(RULES):
        c, s = zeros(1, stopping.Const), zeros(1, stopping.State)
        stopping.prepare(c[0], rule, np.inf, drift=0.5 * scale, shift=scale, sigma=max(scale / 3.0, 1e-12))
        _levels(values, c[0], s[0], column)
        out[:, j] = column
    return out


@dataclass
class Combination:
    """One symptom with one rule against one fault.

    The threshold is the largest level in the healthy runs (``mtfa_s``: not less than their length, in-sample).
    ``detected``: share within 2 s of those runs that had no alarm before; ``delay_ms``: their mean delay.
    """

    symptom: str
    rule: str
    fault: str
    runs: int
    detected: float
    delay_ms: float
    mtfa_s: float

"""The paper's structure, filter - distance measure - stopping rule, in all its combinations (paper 001, Fig. 2).

The normalised innovation squared is a distance, too; the filters give it (:mod:`gateway_fdi.filters.gaussian`).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

from gateway_fdi.detectors import StoppingRule
from gateway_fdi.stopping import RULES
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


def wrapped(angle: Array, turn: float) -> Array:
    """Return angles between -turn/2 and turn/2 that differ by whole turns [rad], shape (n,)."""
    return np.asarray(angle - turn * np.floor(angle / turn + 0.5))


def increments(measured: Array, speed: Array, period: float, turn: float) -> Array:
    """Return by how much a measured angle's steps differ from those that an estimated speed makes [rad], shape (n,).

    Args:
        measured: angle, known modulo ``turn`` [rad], shape (n,).
        speed: estimated mean speed since the sample before [rad/s], shape (n,).
        period: of the samples [s].
        turn: [rad].
    """
    found = np.zeros(len(measured))
    found[1:] = wrapped(np.diff(measured) - speed[1:] * period, turn)
    return found


def leaky(values: Array, share: float) -> Array:
    """Return sums that forget a share with each sample, shape (n,)."""
    return np.array(list(accumulate(values.tolist(), lambda total, x: total + (x - share * total))))


def symptoms(run: Run, followed: Followed, period: float = 1e-3) -> Array:
    """Return the symptoms of a run, shape (n, 9)."""
    n, turn, theta = len(NAMES), 0.5 * np.pi, run.samples["sensor"]
    est = estimate(run.samples, period, mean_dq=True)
    stepped = {k: increments(theta, est[:, n + k], period, turn) for k in (LO, REDUCED, EKF4_DQ, ANCHORED)}
    fast = np.abs(est[:, n + ANCHORED]) > SLOW
    found = [leaky(stepped[k], period / 0.1) for k in (LO, REDUCED, EKF4_DQ)]
    # The feed-forward angle is known modulo half an electrical turn.
    found += [np.where(fast, wrapped(theta - est[:, FF_HELD], 0.5 * turn), 0.0), est[:, NIS]]
    found += [wrapped(theta - est[:, k], turn) for k in (EKF5_AB, ANCHORED)]
    return np.column_stack([*found, stepped[ANCHORED], followed.trace[:, 2]])


def levels(values: Array, scale: float) -> Array:
    """Return the level of each rule over a symptom's values, shape (n, rules).

    Args:
        values: shape (n,).
        scale: largest healthy value: CUSUM's drift, and half the SPRT's shift, are half of it.
    """
    more = {"drift": 0.5 * scale, "shift": scale, "sigma": max(scale / 3.0, 1e-12)}
    return np.column_stack([StoppingRule(rule, np.inf, **more).levels(values) for rule in RULES])


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

"""Residual generators that do not forget by themselves are observers: their states are corrected by the residual.

A generator whose oscillation is hardly damped, or whose mode grows, carries what it is off by for ever: a start value,
a parameter, noise of a command. Where its equations are linear, and its residual is r = y - G x (no derivative is
checked), each sample ends with

    x := x + K r,      x' := x' + J K r                                                                          (1)

J the Jacobian of its states. The error then goes on as exp(J h) (1 - K G) from sample to sample. K is the gain of the
stationary Kalman filter of a plant without noise of its own whose states grow by exp(alpha h) a sample beside what they
do (a prescribed degree of stability: Anderson, Moore: Linear Optimal Control, 1971, section 4.3): a mode that forgets
faster than alpha by itself gets no correction at all, every other one forgets as fast as alpha at least, and of all
such gains this one brings the least noise of the sensor into the residual. alpha is :data:`FORGETS` / ``settle_s``.

A fault that is constant stays in the residual, but for the part that a state can take over.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gateway_fdi.structure.model import Model
from gateway_plants.structural.monitor import modes
from gateway_plants.structural.monitor.params import Params
from gateway_plants.structural.monitor.plan import Test

Array = NDArray[np.float64]

#: Time constants that ``settle_s`` has of what an observer forgets.
FORGETS = 3.0
#: Damping below which an oscillation is corrected.
LIGHT = 0.05
#: Noise of the states against that of the sensor, so that the Riccati equation has a solution.
_ROUNDING = 1e-9


@dataclass(frozen=True)
class Observer:
    """The correction of a generator's states.

    Attributes:
        states: their fields, n of them.
        gain: K, shape (n,).
        slope: J K, shape (n,).
        slowest: largest modulus of the error's modes from sample to sample.
    """

    states: tuple[str, ...]
    gain: Array
    slope: Array
    slowest: float


def wanted(found: modes.Modes | None) -> bool:
    """Tell whether a generator with these modes needs a correction: of a mode that forgets by itself, K is zero."""
    if found is None or not found.linear:
        return False
    return found.growing is not None or any(v.imag > 0.0 and -v.real < LIGHT * abs(v) for v in found.every)


def gain_of(jacobian: Array, shows: Array, h: float, alpha: float) -> Array | None:
    """Return K; None: the Riccati equation has no solution, or an error grows with it.

    Args:
        jacobian: J, shape (n, n) [1/s].
        shows: G, shape (n,).
        h: between two samples [s].
        alpha: rate at which everything is to be forgotten at least [1/s].
    """
    from scipy.linalg import expm, solve_discrete_are  # noqa: PLC0415 - slow to load

    size = np.abs(shows).max()
    if not size > 0.0:
        return None
    phi, g = expm(jacobian * h), shows / size
    try:
        ahead = solve_discrete_are((phi * math.exp(alpha * h)).T, g[:, None], _ROUNDING * np.eye(len(g)), np.eye(1))
    except (np.linalg.LinAlgError, ValueError):
        return None
    gain = np.asarray(ahead @ g / (g @ ahead @ g + 1.0) / size)
    return gain if slowest(jacobian, shows, h, gain) < 1.0 else None


def slowest(jacobian: Array, shows: Array, h: float, gain: Array) -> float:
    """Return what is left of an error after a sample: the largest modulus of exp(J h) (1 - K G)."""
    from scipy.linalg import expm  # noqa: PLC0415 - slow to load

    return float(np.abs(np.linalg.eigvals(expm(jacobian * h) @ (np.eye(len(gain)) - np.outer(gain, shows)))).max())


def observer_of(model: Model, test: Test, p: Params) -> Observer | None:
    """Return the correction of a generator at the configured parameters; None: there is none that helps."""
    point = modes.linearised(model, test, p)
    if point is None:
        return None
    h, shows = p.period_ms / 1e3, -point.residual
    gain = gain_of(point.jacobian, shows, h, FORGETS / p.settle_s if p.settle_s > 0.0 else 1.0 / h)
    if gain is None:
        return None
    return Observer(point.states, gain, point.jacobian @ gain, slowest(point.jacobian, shows, h, gain))

"""Gains of observers in predictor form, x(k+1) = Phi x + Gamma u + L (y - C x): of the stationary Kalman filter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Gain:
    """An observer's gain with the stationary covariances that noise makes of it.

    Attributes:
        gain: L, shape (n, p).
        error: covariance of the predicted state's error, shape (n, n).
        innovation: covariance of y - C x, shape (p, p).
    """

    gain: Array
    error: Array
    innovation: Array


def from_noise(phi: Array, c: Array, q: Array, r: Array) -> Gain:
    """Return the stationary Kalman filter.

    Raises:
        ValueError: there is none: something neither dies out nor is observed, or is not driven by any noise.
    """
    from scipy.linalg import solve_discrete_are  # noqa: PLC0415 - slow to load

    try:
        error = solve_discrete_are(phi.T, c.T, q, r)
    except np.linalg.LinAlgError as error_:
        raise ValueError(f"no stationary Kalman filter: {error_}") from error_
    innovation = c @ error @ c.T + r
    return Gain(phi @ error @ c.T @ np.linalg.inv(innovation), error, innovation)

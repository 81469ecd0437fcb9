"""Which entries of a plant's matrices are not known exactly, and by how much.

A plant is told as A, B (or Phi, Gamma). Entry k is off by theta_k, which nobody knows, but whose size is bounded:

    A = A_0 + sum of theta_k E_k,     B = B_0 + sum of theta_k F_k,     theta_k of the order of bound_k

A bound that is one number is relative to each entry; entries that are 0 or +-1 are then taken as exact: they
are kinematics (the derivative of an angle is a speed), which no tolerance changes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Entries:
    """Uncertain entries of [A, B].

    Attributes:
        row: of each, shape (q,).
        column: of each, in [A, B].
        bound: of each, absolute.
    """

    row: NDArray[np.int64]
    column: NDArray[np.int64]
    bound: Array

    def __len__(self) -> int:
        return len(self.row)


def _bounds(name: str, matrix: Array, error: float | Sequence[Sequence[float]]) -> Array:
    """Return the absolute bound of each entry of a matrix.

    Raises:
        ValueError: shapes do not fit, or a bound is negative.
    """
    if isinstance(error, (int, float)):
        exact = np.isin(matrix, (0.0, 1.0, -1.0))
        return np.where(exact, 0.0, float(error) * np.abs(matrix))
    given = np.array(error, dtype=np.float64)
    if given.shape != matrix.shape:
        raise ValueError(f"model_error.{name} is {' x '.join(map(str, given.shape))}, {name} is not")
    if not (given >= 0.0).all():
        raise ValueError(f"model_error.{name} has a negative bound")
    return given


def entries(
    a: ArrayLike,
    b: ArrayLike,
    a_error: float | Sequence[Sequence[float]],
    b_error: float | Sequence[Sequence[float]],
) -> Entries:
    """Return the uncertain entries.

    Args:
        a: shape (n, n).
        b: shape (n, m).
        a_error: relative bound of each entry, or absolute bounds, shape (n, n).
        b_error: likewise, shape (n, m).

    Raises:
        ValueError: shapes do not fit, or a bound is negative.
    """
    whole = np.hstack(
        [
            _bounds("a", np.array(a, dtype=np.float64), a_error),
            _bounds("b", np.array(b, dtype=np.float64), b_error),
        ]
    )
    row, column = np.nonzero(whole)
    return Entries(row, column, whole[row, column])

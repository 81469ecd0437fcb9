"""A linear plant in discrete time, and what can be observed of it.

    x(k+1) = Phi x(k) + Gamma (u(k) + a(k)),   y(k) = C x(k) + s(k)

with the additive actuator faults a and sensor faults s of paper 003, (4). A plant given in continuous time is
discretised exactly for commands that are held over a sample: exp([[A, B], [0, 0]] T) = [[Phi, Gamma], [0, 1]].
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

#: Largest plant that is watched.
MOST_STATES, MOST_INPUTS, MOST_OUTPUTS = 8, 4, 6


@dataclass(frozen=True)
class LinearPlant:
    """A plant in discrete time.

    Attributes:
        phi: shape (n, n).
        gamma: shape (n, m).
        c: shape (p, n).
        period: length of a sample [s].
    """

    phi: Array
    gamma: Array
    c: Array
    period: float

    @property
    def states(self) -> int:
        """Number of states, n."""
        return len(self.phi)

    @property
    def inputs(self) -> int:
        """Number of commands, m."""
        return int(self.gamma.shape[1])

    @property
    def outputs(self) -> int:
        """Number of sensors, p."""
        return len(self.c)

    def without(self, sensor: int | None) -> Array:
        """Return C without the row of a sensor (C^i of paper 003), all of it for None."""
        return self.c if sensor is None else np.delete(self.c, sensor, axis=0)


def _matrix(name: str, values: ArrayLike) -> Array:
    try:
        matrix = np.array(values, dtype=np.float64)
    except ValueError as error:
        raise ValueError(f"{name}: its rows are not of one length") from error
    if matrix.ndim != 2 or 0 in matrix.shape:
        raise ValueError(f"{name} is a matrix: a list of rows")
    if not np.isfinite(matrix).all():
        raise ValueError(f"{name} has entries that are no numbers")
    return matrix


def discretised(a: ArrayLike, b: ArrayLike, c: ArrayLike, period: float, *, discrete: bool = False) -> LinearPlant:
    """Return a plant in discrete time.

    Args:
        a: shape (n, n): A, or Phi if ``discrete``.
        b: shape (n, m): B, or Gamma.
        c: shape (p, n).
        period: length of a sample [s].
        discrete: the matrices are of discrete time already.

    Raises:
        ValueError: shapes do not fit; says which.
    """
    x, y, z = _matrix("a", a), _matrix("b", b), _matrix("c", c)
    n, m = len(x), y.shape[1]
    if x.shape != (n, n):
        raise ValueError(f"a is {n} x {x.shape[1]}, not square")
    if len(y) != n:
        raise ValueError(f"b has {len(y)} rows, a has {n}")
    if z.shape[1] != n:
        raise ValueError(f"c has {z.shape[1]} columns, a has {n}")
    if discrete:
        return LinearPlant(x, y, z, period)
    from scipy.linalg import expm  # noqa: PLC0415 - slow to load

    block = np.zeros((n + m, n + m))
    block[:n, :n], block[:n, n:] = x, y
    whole = expm(block * period)
    return LinearPlant(whole[:n, :n], whole[:n, n:], z, period)


def observability(phi: Array, c: Array) -> Array:
    """Return the observability matrix [C; C Phi; ..]: shape (n p, n), each block scaled to size 1."""
    rows, blocks = c / max(float(np.abs(c).max()), 1e-300), []
    for _ in range(len(phi)):
        blocks.append(rows)
        rows = rows @ phi
        rows = rows / max(float(np.abs(rows).max()), 1e-300)
    return np.vstack(blocks)


def unobservable(phi: Array, c: Array, names: tuple[str, ...] = ()) -> str:
    """Say which combination of states cannot be observed; empty if all can.

    Args:
        phi: shape (n, n).
        c: shape (p, n).
        names: of the states; default x1, x2, ...
    """
    from scipy.linalg import null_space  # noqa: PLC0415 - slow to load

    hidden = null_space(observability(phi, c), rcond=1e-10)
    if hidden.shape[1] == 0:
        return ""
    labels = names or tuple(f"x{k + 1}" for k in range(len(phi)))
    said = []
    for column in hidden.T * np.sign(hidden[np.abs(hidden).argmax(axis=0), range(hidden.shape[1])])[:, None]:
        parts = [f"{value:+.3g} {label}" for value, label in zip(column, labels, strict=True) if abs(value) > 1e-6]
        said.append(" ".join(parts).removeprefix("+"))
    return "; ".join(said)

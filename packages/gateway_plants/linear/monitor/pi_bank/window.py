"""Which parts may be at fault together: the last samples, without what these parts could have done to them.

A bank names one part at a time. For each part, and each two, the samples of a window are asked what is left of them
when sensors of these parts count for nothing and their actuators may have done anything, whatever the state was at the
beginning (parity space with unknown inputs; Chow, Willsky, "Analytical redundancy and the design of robust failure
detection systems" (1984)): in its own standard deviations, chi-square. Where it is too much, some other part is at
fault. It is
computed where a cause is looked for, not at each sample.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gateway_fdi.jit import Record, f8s, i8, kernel, means
from gateway_fdi.linear_algebra import copy
from gateway_fdi.quantiles import chi2_above
from gateway_plants.linear.mathematics.plant import MOST_INPUTS, MOST_OUTPUTS, Array, LinearPlant

#: Samples that are looked at.
LENGTH = 48
#: Probability that all is well and a test of a window fails.
FALSE_ALARM = 1e-6


class State(Record):
    """The last samples."""

    at: i8 = means("place of the next one")
    held: i8 = means("samples without one that is missing between them")
    y: Annotated[f8s, LENGTH, MOST_OUTPUTS] = means("outputs")
    u: Annotated[f8s, LENGTH, MOST_INPUTS] = means("commands")


@kernel
def keep(s: State, y: f8s, u: f8s, whole: bool) -> None:
    """Keep a sample and the commands that hold from it on; ``whole``: none is missing before it, nor a command."""
    s.held = min(s.held + 1, LENGTH) if whole else 0
    copy(s.y[s.at], y, MOST_OUTPUTS)
    copy(s.u[s.at], u, MOST_INPUTS)
    s.at = (s.at + 1) % LENGTH


class _Check(NamedTuple):
    """What is left of the rows of a window, shape (degrees, rows), and the most that chance makes of its square."""

    rows: NDArray[np.int64]
    left: Array
    limit: float


@dataclass(frozen=True)
class Windows:
    """The tests of a plant.

    Attributes:
        apart: the parts that each test leaves out, actuators from 0, sensors behind them: none, each one,
            each two.
        forced: what commands make of the outputs, shape (LENGTH outputs, LENGTH inputs).
        checks: of each test.
    """

    apart: tuple[tuple[int, ...], ...]
    forced: Array
    checks: tuple[_Check, ...]

    def levels(self, state: Any) -> list[float]:
        """Return of each test what is left over the most that chance makes; NaN where nothing is wrong, or not known.

        Args:
            state: record of State.
        """
        if state["held"] < LENGTH:
            return [math.nan] * len(self.checks)
        order = (int(state["at"]) + np.arange(LENGTH)) % LENGTH
        outputs, inputs = (size // LENGTH for size in self.forced.shape)
        y, u = state["y"][order, :outputs].ravel(), state["u"][order, :inputs].ravel()
        left = y - self.forced @ u
        found = [float(np.sum((one.left @ left[one.rows]) ** 2)) / one.limit for one in self.checks]
        return found if found[0] >= 1.0 else [math.nan] * len(found)


def windows_of(plant: LinearPlant, noise: Array, disturbance: Array) -> Windows:
    """Return the tests of a plant.

    Args:
        plant: in discrete time.
        noise: standard deviation of each sensor, shape (p,).
        disturbance: covariance of what disturbs the states in a sample, shape (n, n).
    """
    n, m, p = plant.states, plant.inputs, plant.outputs
    powers = [np.eye(n)]
    for _ in range(LENGTH - 1):
        powers.append(plant.phi @ powers[-1])
    free = np.vstack([plant.c @ power for power in powers])
    forced, noisy = np.zeros((LENGTH * p, LENGTH * m)), np.zeros((LENGTH * p, LENGTH * n))
    for k, j in itertools.combinations(range(LENGTH), 2):
        reach = plant.c @ powers[j - k - 1]
        forced[j * p : (j + 1) * p, k * m : (k + 1) * m] = reach @ plant.gamma
        noisy[j * p : (j + 1) * p, k * n : (k + 1) * n] = reach
    spread = noisy @ np.kron(np.eye(LENGTH), disturbance) @ noisy.T + np.diag(np.tile(noise**2, LENGTH))
    apart = tuple(itertools.chain.from_iterable(itertools.combinations(range(m + p), count) for count in range(3)))
    return Windows(apart, forced, tuple(_checks(apart, free, forced, spread, m, p)))


def _checks(
    apart: tuple[tuple[int, ...], ...], free: Array, forced: Array, spread: Array, m: int, p: int
) -> Iterator[_Check]:
    """Yield what is left of a window without the state at its beginning and what some parts do."""
    sensor, actuator = np.tile(np.arange(p), LENGTH), np.tile(np.arange(m), LENGTH)
    for parts in apart:
        rows = np.flatnonzero(~np.isin(sensor + m, parts))
        if not len(rows):  # no sensor is left that could contradict
            yield _Check(rows, np.zeros((0, 0)), math.inf)
            continue
        unknown = np.hstack([free, forced[:, np.isin(actuator, parts)]])[rows]
        root = np.linalg.cholesky(spread[np.ix_(rows, rows)])
        base, sizes, _ = np.linalg.svd(np.linalg.solve(root, unknown))
        rank = int(np.sum(sizes > sizes[0] * 1e-9))
        left = np.linalg.solve(root.T, base[:, rank:]).T
        yield _Check(rows, left, float(chi2_above(FALSE_ALARM, len(rows) - rank)) if rank < len(rows) else math.inf)

"""Constants of a set of models: from the plant, its noise, its errors and the faults that count."""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, log

import numpy as np
from numpy.typing import NDArray

from gateway_fdi.quantiles import chi2_above
from gateway_plants.linear.mathematics.plant import LinearPlant, observability
from gateway_plants.linear.mathematics.uncertainty import Entries
from gateway_plants.linear.model_set import alignment, matrices
from gateway_plants.linear.model_set.filters import (
    GAIN,
    HEALTHY,
    OFFSET,
    SENSOR,
    SILENT,
    VARYING,
    Const,
)
from gateway_plants.linear.model_set.matrices import MOST_ENTRIES
from gateway_plants.linear.pi_bank.design import Noise, rank_without

Array = NDArray[np.float64]

#: Time constant of a plant's own errors: they age, they do not jump [s].
AGEING_S = 36_000.0
#: Of offsets of healthy sensors and actuators, and their standard deviation in thresholds.
OFFSET_S, OFFSET_SIZE = 3600.0, 0.2
#: The latter where the matrices are exact.
EXACT_OFFSET = 0.02
#: Of a sensor's gain: it warms up.
WARMING_S = 600.0
#: Standard deviation of a fault that has begun, and of an unknown command, in thresholds; of a gain.
FAULT_SIZE, COMMAND_SIZE, GAIN_SIZE = 30.0, 100.0, 0.5
#: What a fault drifts within a root of a second, in thresholds; of a gain.
DRIFT_SIZE, GAIN_DRIFT = 0.1, 0.01
#: Range of a silent sensor's reading, in thresholds.
RANGE = 100.0
#: Share of healthy samples that look like a jump.
JUMPS = 1e-6
#: What an unknown state does to the outputs, in standard deviations of their noise.
UNKNOWN = 1e4


@dataclass(frozen=True)
class Told:
    """What a user tells of a plant.

    Attributes:
        plant: in discrete time.
        a, b: as given, continuous or discrete.
        discrete: which.
        noise: of states, sensors; of the faults of actuators.
        entries: of a and b that are uncertain.
        actuator: thresholds, shape (m,).
        sensor: thresholds, shape (p,).
        left_out: sensors without which the plant is still observable: they may be at fault in any way.
        gains: by how much each sensor's gain may be off, a share, shape (p,).
        biases: and each sensor's offset, shape (p,).
        offsets: of healthy actuators, shape (m,).
        lags: and by how many periods each sensor may be late or early, shape (p,).
        counted: commands have counters.
    """

    plant: LinearPlant
    a: Array
    b: Array
    discrete: bool
    noise: Noise
    entries: Entries
    actuator: Array
    sensor: Array
    left_out: tuple[int, ...]
    gains: Array
    biases: Array
    offsets: Array
    lags: Array
    counted: bool


def hypotheses(told: Told) -> list[tuple[int, int]]:
    """Return kind and place of each hypothesis."""
    m, p = told.plant.inputs, told.plant.outputs
    found = [(HEALTHY, 0)]
    found += [(OFFSET, i) for i in range(m)] + [(GAIN, i) for i in range(m)]
    found += [(SENSOR, j) for j in range(p)]
    found += [(SILENT, j) for j in told.left_out]
    return [*found, (VARYING, 0)] if len(told.entries) else found


def prepare(c: Const, told: Told) -> None:
    """Fill a record of Const.

    Raises:
        ValueError: too many entries are uncertain.
    """
    plant, q = told.plant, len(told.entries)
    n, m, p, period = plant.states, plant.inputs, plant.outputs, plant.period
    if q > MOST_ENTRIES:
        raise ValueError(f"{q} uncertain entries of a and b; at most {MOST_ENTRIES}: give model_error by entry")
    c.n, c.m, c.p, c.q = n, m, p, q
    c.gains = bool(told.gains.any())
    c.total = n + q + 2 * m + p + (p if c.gains else 0)
    alignment.prepare(c.alignment, told.plant, told.lags, counted=told.counted)
    if told.lags.any():
        c.lag, c.total = c.total, c.total + p
    _prepare_matrices(c.plant, told)
    given = np.hstack([told.a, told.b])[told.entries.row, told.entries.column]
    # Of an entry that is 0 the bound is all that is known.
    c.relative[:q] = 1.0 / np.maximum(np.abs(given), told.entries.bound) ** 2
    c.c[:p, :n] = plant.c
    c.noise[:n], c.r[:p] = told.noise.states**2 * period, told.noise.outputs**2
    c.unknown[:n] = _unknown(plant, told.noise.outputs) ** 2
    offsets = np.concatenate([told.actuator, told.sensor])
    nothing = np.zeros(m)
    fault = FAULT_SIZE * offsets
    more = [*([told.gains] if c.gains else []), *([told.lags] if c.lag else [])]
    prior = [told.entries.bound, told.offsets, nothing, told.biases, *more]
    c.prior[: c.total - n] = np.concatenate(prior) ** 2
    times = np.repeat(
        [AGEING_S, OFFSET_S, np.inf, OFFSET_S, *([WARMING_S] * len(more))], [q, m, m, p, *([p] * len(more))]
    )
    c.keep[: c.total - n] = np.exp(-period / times)[: c.total - n]
    drifts = [told.noise.faults, GAIN_DRIFT + nothing, DRIFT_SIZE * told.sensor]
    c.vary = exp(-period / slowest(plant))
    faults = slice(q, q + 2 * m + p)
    c.drive[faults] = np.concatenate(drifts) ** 2 * period
    c.free[faults] = np.concatenate([fault[:m], GAIN_SIZE + nothing, fault[m:]]) ** 2
    c.command[:m] = (COMMAND_SIZE * told.actuator) ** 2
    c.gate = chi2_above(JUMPS, p)
    c.range[:p] = [-log(RANGE * size) for size in told.sensor]
    found = hypotheses(told)
    c.hypotheses = len(found)
    for h, (kind, place) in enumerate(found):
        c.kind[h], c.place[h] = kind, place


def _prepare_matrices(c: matrices.Const, told: Told) -> None:
    """Fill a record of the matrices' Const."""
    q, n, m = len(told.entries), told.plant.states, told.plant.inputs
    c.n, c.m, c.q, c.discrete = n, m, q, told.discrete
    c.scale = 1.0 if told.discrete else told.plant.period
    c.matrix[:n, : n + m] = np.hstack([told.a, told.b]) * c.scale
    c.row[:q], c.column[:q] = told.entries.row, told.entries.column
    c.bound[:q] = told.entries.bound**2


def _unknown(plant: LinearPlant, noise: Array) -> Array:
    """Return how large each state may be before anything is known: its outputs are UNKNOWN of their noise."""
    rows, shown = plant.c / noise[:, None], np.zeros(plant.states)
    for _ in range(4 * plant.states):
        shown = np.maximum(shown, np.abs(rows).max(axis=0))
        rows = rows @ plant.phi
    return np.asarray(UNKNOWN / np.maximum(shown, 1e-9))


def slowest(plant: LinearPlant) -> float:
    """Return the time constant of the plant's slowest mode that forgets [s]; of one that has none, an hour."""
    left = np.abs(np.linalg.eigvals(plant.phi))
    left = left[(left > 0.0) & (left < np.exp(-plant.period / OFFSET_S))]
    return float(-plant.period / np.log(left.max())) if len(left) else OFFSET_S


def isolable(plant: LinearPlant) -> tuple[int, ...]:
    """Return the sensors without which the plant is still observable, and shows constant faults of its actuators."""
    n, m = plant.states, plant.inputs
    found = []
    for j in range(plant.outputs):
        c = plant.without(j)
        if len(c) < m or np.linalg.matrix_rank(observability(plant.phi, c), tol=1e-10) < n:
            continue
        if rank_without(plant, j) == n + m:
            found.append(j)
    return tuple(found)

"""Evidence over arrays: a whole record, block by block."""

from __future__ import annotations

from math import log
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gateway_fdi.errors import InputError
from gateway_fdi.evidence import blocks, healing, onsets, posterior
from gateway_fdi.evidence.model import Model
from gateway_fdi.evidence.quadratic import blur
from gateway_fdi.jit import f8s, kernel


class Told(NamedTuple):
    """Statement.

    Attributes:
        kind: NOTHING, CAUSE, ONE_OF or NOT_ISOLATED of :mod:`gateway_fdi.evidence.posterior`.
        faults: by their numbers, likeliest first; of NOTHING and NOT_ISOLATED none.
        probability: that it is one of them; of NOT_ISOLATED that there is any fault, of NOTHING that there is none.
        since: block in which the likeliest one began; 0: before the start.
    """

    kind: int
    faults: tuple[int, ...]
    probability: float
    since: int


class Course(NamedTuple):
    """Course of the evidence over a record of n blocks.

    Attributes:
        probability: of each fault, and of none, behind each block, shape (n, faults + 1).
        ratio: largest likelihood ratio of all, doubled logarithm, shape (n,).
        size: of each fault, if it has begun where that is likeliest, shape (n, faults).
        spread: standard deviations of the sizes, shape (n, faults).
        told: statements, one a block.
        evidence: logarithm of the likelihood without a fault, over that of noise alone.
    """

    probability: NDArray[np.float64]
    ratio: NDArray[np.float64]
    size: NDArray[np.float64]
    spread: NDArray[np.float64]
    told: list[Told]
    evidence: float


@kernel
def block_of(s: Any, c: Any, r: f8s, h: f8s, g: f8s) -> None:
    """Take the samples of a block.

    Args:
        s: record of State.
        c: record of Const.
        r: residuals, shape (samples, residuals).
        h: sensitivities, shape (samples, residuals, slow).
        g: gains, shape (samples, gains).
    """
    for t in range(len(r)):
        blocks.add(s, c, r[t], h[t], g[t])
    onsets.advance(s, c)


@kernel
def without(s: Any, c: Any) -> float:
    """Return what the slow errors, integrated out of all blocks, add to the likelihood without a fault."""
    p = c.slow
    gained = 0.0
    for i in range(p):
        s.work_b[i] = s.since_b[0, i]
        gained += 0.5 * log(c.prior[i])
        for j in range(p):
            s.work_a[i, j] = s.since_a[0, i, j]
    for i in range(p):
        gained += blur(s.work_a, s.work_b, p, i, 0.0)
    return gained


def over(model: Model, r: ArrayLike, h: ArrayLike, g: ArrayLike) -> Course:
    """Return the course of the evidence over a record; samples behind the last whole block are left out.

    Args:
        model: the plant.
        r: residuals, shape (n, m); NaN: one is missing.
        h: what each slow error adds to each residual, shape (n, m, slow errors).
        g: what each fault of size 1 adds to each residual that it moves, shape (n, gains), as :attr:`Model.gains`.

    Raises:
        InputError, InputErrors: it is no model, or an array has another shape, or is not finite.
    """
    s, c = model.records()
    rows, slow, gains = (np.ascontiguousarray(each, np.float64) for each in (r, h, g))
    n, m = len(rows), len(model.noise)
    wanted = {"r": (rows, (n, m)), "h": (slow, (n, m, len(model.slow))), "g": (gains, (n, len(model.gains)))}
    for key, (values, shape) in wanted.items():
        if values.shape != shape:
            raise InputError(f"an array of shape {shape}", key=key, value=str(values.shape))
    there = np.isfinite(rows)
    if not np.isfinite(slow[there]).all() or not np.isfinite(gains[there[:, c.row[: len(model.gains)]]]).all():
        raise InputError("a number wherever the residual is one", key="h, g")
    slow, gains = np.nan_to_num(slow), np.nan_to_num(gains)
    probability, ratio, size, spread, told = [], [], [], [], []
    each = np.arange(len(model.faults))
    for at in range(0, n - model.samples + 1, model.samples):
        block = slice(at, at + model.samples)
        block_of(s, c, rows[block], slow[block], gains[block])
        largest = posterior.weigh(s, c)
        place = s.chosen[: len(each)]
        probability.append(s.probability.copy())
        ratio.append(largest)
        size.append(s.found[place, each])
        spread.append(s.spread[place, each])
        posterior.tell(s, c, largest)
        healing.heal(s, c)
        faults = tuple(int(f) for f in s.named if f >= 0)
        told.append(Told(int(s.kind), faults, float(s.sure), int(s.since)))
    shape = (len(ratio), len(each))
    evidence = float(s.evidence + without(s, c))
    return Course(
        np.reshape(probability, (len(ratio), len(each) + 1)),
        np.array(ratio),
        np.reshape(size, shape),
        np.reshape(spread, shape),
        told,
        evidence,
    )

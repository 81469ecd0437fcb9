"""Linear plants with Gaussian noise, drawn as the evidence takes them; and their likelihoods by dense matrices."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from gateway_fdi.evidence import model as records_of
from gateway_fdi.evidence.hypotheses import FINER, SCALES
from gateway_fdi.jit import zeros

#: Standard deviation of a fault's size, and of each slow error, beforehand.
LARGEST, PRIOR = 3.0, 0.5


class Plant(NamedTuple):
    """Residuals that each fault moves, variances of noise; of slow errors their number; the rest as of a model."""

    moved: tuple[list[int], ...]
    noise: np.ndarray
    slow: int
    samples: int
    jitter: float
    error: float

    @property
    def gains(self):
        return [(f, row) for f, rows in enumerate(self.moved) for row in rows]


def plant(rng, *, faults=4, residuals=3, slow=2, jitter=0.0, error=0.3, samples=10):
    """Return a plant whose faults move some of the residuals, in other signs and sizes."""
    found = []
    for k in range(faults):
        moves = np.flatnonzero(rng.random(residuals) < 0.7)
        found.append(moves.tolist() if len(moves) else [k % residuals])
    return Plant(tuple(found), rng.uniform(0.3, 3.0, residuals), slow, samples, jitter, error)


def records(model):
    """Return records of State and Const for a plant, before the first block."""
    room = records_of.lengths(len(model.noise), model.slow, model.moved)

    class OwnState(records_of.State, lengths=room):
        pass

    class OwnConst(records_of.Const, lengths=room):
        pass

    s, c = zeros(1, OwnState)[0], zeros(1, OwnConst)[0]
    more = {"samples": model.samples, "jitter": model.jitter, "error": model.error}
    records_of.prepare(c, model.slow, model.moved, **more)
    c.weight[:] = 1.0 / model.noise
    return s, c


def drive(rng, model, n):
    """Return sensitivities and gains along a drive of n samples."""
    m, count = len(model.noise), len(model.gains)
    t = np.arange(n)[:, None] * 0.1
    h = 1.0 + np.sin(t * rng.uniform(0.2, 2.0, m * model.slow) + rng.uniform(0, 6, m * model.slow))
    g = rng.normal(size=count) * (1.0 + 0.5 * np.sin(t * rng.uniform(0.2, 2.0, count)))
    return h.reshape(n, m, model.slow), g


def columns(model, g, fault, since, n):
    """Return what each gain of a fault adds to the record, shape (n m, gains of the fault)."""
    m = len(model.noise)
    found = np.zeros((n, m, len(model.moved[fault])))
    mine = [k for k, (f, _) in enumerate(model.gains) if f == fault]
    for i, k in enumerate(mine):
        found[since:, model.gains[k][1], i] = g[since:, k]
    return found.reshape(n * m, -1)


def covariance(model, h):
    """Return the covariance of a record without a fault, shape (n m, n m): noise, x, and its jitter."""
    n, m, _ = h.shape
    of = np.arange(n) // model.samples
    total = np.kron(np.eye(n), np.diag(model.noise))
    for k in range(model.slow):
        moved = model.jitter**2 * (of[:, None] == of[None, :])
        flat = h[:, :, k].reshape(-1)
        total += np.kron(PRIOR**2 + moved, np.ones((m, m))) * np.outer(flat, flat)
    return total


def sizes(model, fault, scale):
    """Return the covariance of what a fault's gains are multiplied by."""
    m = len(model.moved[fault])
    return scale**2 * (np.ones((m, m)) + model.error**2 * np.eye(m))


def scales():
    """Return the scales of a fault's size."""
    return [LARGEST / FINER**n for n in range(SCALES)]


def gaussian(r, v):
    """Return the logarithm of the density of N(0, V)."""
    factor = np.linalg.cholesky(v)
    z = np.linalg.solve(factor, r)
    return -0.5 * z @ z - np.log(np.diag(factor)).sum() - 0.5 * len(r) * np.log(2 * np.pi)

"""Linear plants with Gaussian noise, drawn as the evidence takes them; and their likelihoods by dense matrices."""

from __future__ import annotations

import numpy as np

from gateway_fdi.evidence.model import FINER, SCALES, Const, Fault, Model, State
from gateway_fdi.jit import zeros


def plant(rng, *, faults=4, residuals=3, slow=2, jitter=0.0, error=0.3, samples=10):
    """Return a model whose faults move some of the residuals, in other signs and sizes."""
    a = rng.normal(size=(residuals, residuals))
    noise = a @ a.T + 0.3 * np.eye(residuals)
    found = []
    for k in range(faults):
        moves = np.flatnonzero(rng.random(residuals) < 0.7)
        moves = moves if len(moves) else np.array([k % residuals])
        found.append(Fault(f"f{k}", tuple(moves.tolist()), 3.0, error))
    return Model((0.5,) * slow, tuple(found), noise, samples, jitter)


def records(model):
    """Return records of State and Const for a model, before the first block."""

    class OwnState(State, lengths=model.lengths):
        pass

    class OwnConst(Const, lengths=model.lengths):
        pass

    s, c = zeros(1, OwnState)[0], zeros(1, OwnConst)[0]
    model.fill(c)
    return s, c


def drive(rng, model, n):
    """Return sensitivities and gains along a drive of n samples."""
    m, count = len(model.noise), len(model.gains)
    t = np.arange(n)[:, None] * 0.1
    h = 1.0 + np.sin(t * rng.uniform(0.2, 2.0, m * len(model.slow)) + rng.uniform(0, 6, m * len(model.slow)))
    g = rng.normal(size=count) * (1.0 + 0.5 * np.sin(t * rng.uniform(0.2, 2.0, count)))
    return h.reshape(n, m, len(model.slow)), g


def columns(model, g, fault, since, n):
    """Return what each gain of a fault adds to the record, shape (n m, gains of the fault)."""
    m = len(model.noise)
    found = np.zeros((n, m, len(model.faults[fault].residuals)))
    mine = [k for k, (f, _) in enumerate(model.gains) if f == fault]
    for i, k in enumerate(mine):
        found[since:, model.gains[k][1], i] = g[since:, k]
    return found.reshape(n * m, -1)


def covariance(model, h):
    """Return the covariance of a record without a fault, shape (n m, n m): noise, x, and its jitter."""
    n, m, _ = h.shape
    of = np.arange(n) // model.samples
    total = np.kron(np.eye(n), model.noise)
    for k, prior in enumerate(model.slow):
        moved = (model.jitter * prior) ** 2 * (of[:, None] == of[None, :])
        flat = h[:, :, k].reshape(-1)
        total += np.kron(prior**2 + moved, np.ones((m, m))) * np.outer(flat, flat)
    return total


def sizes(fault, scale):
    """Return the covariance of what a fault's gains are multiplied by."""
    m = len(fault.residuals)
    return scale**2 * (np.ones((m, m)) + fault.error**2 * np.eye(m))


def scales(fault):
    """Return the scales of a fault's size."""
    return [fault.size / FINER**n for n in range(SCALES)]


def gaussian(r, v):
    """Return the logarithm of the density of N(0, V)."""
    factor = np.linalg.cholesky(v)
    z = np.linalg.solve(factor, r)
    return -0.5 * z @ z - np.log(np.diag(factor)).sum() - 0.5 * len(r) * np.log(2 * np.pi)

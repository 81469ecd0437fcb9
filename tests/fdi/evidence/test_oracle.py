"""The evidence against dense matrices over the whole record."""

import numpy as np
import pytest

from gateway_fdi.evidence import blocks, hypotheses
from gateway_fdi.evidence.quadratic import blur
from tests.fdi.evidence import simulated

SEED = 6701


def dense(model, h, g, r, fault, scale):
    """Return the log likelihood ratio of a fault, there from the start, with one scale of its size."""
    there = np.isfinite(r).reshape(-1)
    v = simulated.covariance(model, h)[np.ix_(there, there)]
    z = simulated.columns(model, g, fault, 0, len(h))[there]
    more = z @ simulated.sizes(model, fault, scale) @ z.T
    flat = r.reshape(-1)[there]
    return simulated.gaussian(flat, v + more) - simulated.gaussian(flat, v)


@pytest.mark.parametrize("more", [{"jitter": 0.3, "error": 0.3}, {"jitter": 0.0, "error": 0.0}])
def test_likelihoods_are_those_of_dense_matrices(more):
    print("seed", SEED)
    rng = np.random.default_rng(SEED)
    model = simulated.plant(rng, samples=4, **more)
    n = 4 * 9
    h, g = simulated.drive(rng, model, n)
    r = rng.normal(size=(n, len(model.noise))) * np.sqrt(model.noise)
    r += (simulated.columns(model, g, 1, 16, n) @ np.full(len(model.moved[1]), 1.5)).reshape(r.shape)
    r[5, 0] = r[17, :2] = r[23] = np.nan
    s, c = simulated.records(model)
    whole = c.slow + len(model.gains)
    for at in range(n):
        if blocks.add(s, c, r[at], h[at], g[at]):
            blocks.close(s, c)
            s.work_a[:whole, :whole] += s.a[:whole, :whole]
            s.work_b[:whole] += s.b[:whole]
            blocks.drop(s)
    for k in range(model.slow):
        s.work_a[k, k] += simulated.PRIOR**-2
    for k in range(c.slow):
        blur(s.work_a, s.work_b, whole, k, 0.0)
    for f in range(len(model.moved)):
        hypotheses.of_fault(s, c, f, simulated.LARGEST)
        each = [dense(model, h, g, r, f, scale) for scale in simulated.scales()]
        wanted = np.logaddexp.reduce(each) - np.log(len(each))
        assert s.likelihood[f] == pytest.approx(wanted, rel=1e-9, abs=1e-9), f


def test_what_jitter_explains_lessens_the_sum_of_squares():
    """As much as against dense matrices: r' V^-1 r of each block, with its jitter and without."""
    print("seed", SEED)
    rng = np.random.default_rng(SEED)
    model = simulated.plant(rng, samples=6, jitter=0.4)
    h, g = simulated.drive(rng, model, 12)
    r = rng.normal(size=(12, len(model.noise)))
    s, c = simulated.records(model)
    for at in range(12):
        if blocks.add(s, c, r[at], h[at], g[at]):
            lessened, block = blocks.close(s, c), slice(at - 5, at + 1)
            flat, z = r[block].reshape(-1), h[block].reshape(-1, model.slow)
            noise = np.kron(np.eye(6), np.diag(model.noise))
            moved = noise + 0.4**2 * z @ z.T
            wanted = flat @ np.linalg.solve(noise, flat) - flat @ np.linalg.solve(moved, flat)
            assert lessened == pytest.approx(wanted, rel=1e-9)
            blocks.drop(s)

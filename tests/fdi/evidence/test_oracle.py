"""The evidence against dense matrices over the whole record."""

import numpy as np
import pytest

from gateway_fdi.evidence import hypotheses, record
from gateway_fdi.evidence.model import Fault, Model
from tests.fdi.evidence import simulated

SEED = 6701


def dense(model, h, g, r, fault, since, scale):
    """Return the log likelihood ratio of a fault with one scale of its size."""
    n = len(h)
    there = np.isfinite(r).reshape(-1)
    v = simulated.covariance(model, h)[np.ix_(there, there)]
    z = simulated.columns(model, g, fault, since * model.samples, n)[there]
    more = z @ simulated.sizes(model.faults[fault], scale) @ z.T
    flat = r.reshape(-1)[there]
    return simulated.gaussian(flat, v + more) - simulated.gaussian(flat, v)


def transient(model, h, g, r, since):
    """Return the log likelihood ratio of the block in which any fault begins."""
    rest = r[: (since + 1) * model.samples]
    unknown = len(model.faults) - 1
    each = [
        dense(model, h[: len(rest)], g[: len(rest)], rest, unknown, since, scale)
        for scale in simulated.scales(model.faults[-1])
    ]
    return np.logaddexp(0.0, np.logaddexp.reduce(each) - np.log(len(each))) + np.log(0.5)


def without(r, samples, since):
    """Return a record without a block."""
    left = r.copy()
    left[since * samples : (since + 1) * samples] = np.nan
    return left


@pytest.mark.parametrize(
    "more",
    [
        {"walk": 0.05, "jitter": 0.3, "error": 0.3, "unknown": True},
        {"walk": 0.0, "jitter": 0.0, "error": 0.0},
    ],
)
def test_likelihoods_are_those_of_dense_matrices(more):
    print("seed", SEED)
    rng = np.random.default_rng(SEED)
    model = simulated.plant(rng, samples=4, **more)
    n = 4 * 9
    h, g = simulated.drive(rng, model, n)
    r = rng.multivariate_normal(np.zeros(len(model.noise)), model.noise, n)
    r += (simulated.columns(model, g, 1, 16, n) @ np.full(len(model.faults[1].residuals), 1.5)).reshape(r.shape)
    r[5, 0] = r[17, :2] = r[23] = np.nan
    s, c = model.records()
    for at in range(0, n, 4):
        record.block_of(s, c, r[at : at + 4], h[at : at + 4], g[at : at + 4])
    hypotheses.judge(s, c)
    assert s.onset[: s.onsets].tolist() == list(range(9))
    for k in range(9):
        own = without(r, 4, k) if more.get("unknown") and k > 0 else r
        if own is not r:
            assert s.entry[k] == pytest.approx(transient(model, h, g, r, k), rel=1e-9, abs=1e-9)
        for f, fault in enumerate(model.faults):
            each = [dense(model, h, g, own, f, k, scale) for scale in simulated.scales(fault)]
            wanted = np.logaddexp.reduce(each) - np.log(len(each))
            assert s.likelihood[k, f] == pytest.approx(wanted, rel=1e-9, abs=1e-9), (k, fault.name)
    there = np.isfinite(r).reshape(-1)
    v, white = simulated.covariance(model, h), np.kron(np.eye(n), model.noise)
    wanted = simulated.gaussian(r.reshape(-1)[there], v[np.ix_(there, there)])
    wanted -= simulated.gaussian(r.reshape(-1)[there], white[np.ix_(there, there)])
    assert s.evidence + record.without(s, c) == pytest.approx(wanted, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("sign", [-1, 1])
def test_sizes_of_the_other_sign_are_cut_off(sign):
    model = Model((), (Fault("f", (0,), 2.0, error=0.0, sign=sign),), np.eye(1), 1.0, 5)
    r = 0.4 + np.sin(np.arange(5.0))[:, None]
    s, c = model.records()
    record.block_of(s, c, r, np.zeros((5, 1, 0)), np.ones((5, 1)))
    hypotheses.judge(s, c)
    grid = np.linspace(0.0, 20.0, 200_001) * sign
    each = []
    for scale in simulated.scales(model.faults[0]):
        prior = 2.0 * np.exp(-0.5 * (grid / scale) ** 2) / (scale * np.sqrt(2.0 * np.pi))
        each.append(prior * np.exp(r.sum() * grid - 0.5 * len(r) * grid**2) * 1e-4)
    density = np.mean(each, 0)
    mean = (density * grid).sum() / density.sum()
    assert s.likelihood[0, 0] == pytest.approx(np.log(density.sum()), abs=1e-3)
    assert s.found[0, 0] == pytest.approx(mean, abs=1e-3)
    assert s.spread[0, 0] == pytest.approx(np.sqrt((density * (grid - mean) ** 2).sum() / density.sum()), abs=1e-3)


def test_onsets_grow_apart_with_their_age_and_before_the_start_stays():
    model = Model((), (Fault("f", (0,), 2.0),), np.eye(1), 1.0, 1, onsets=8)
    s, c = model.records()
    rng = np.random.default_rng(SEED)
    for _ in range(200):
        record.block_of(s, c, rng.normal(size=(1, 1)), np.zeros((1, 1, 0)), np.ones((1, 1)))
    found = s.onset[: s.onsets].tolist()
    assert found[0] == 0
    assert found[-2:] == [198, 199]
    gaps = np.diff([*found[1:], 200])
    assert (np.diff(gaps) <= 0).all()
    assert gaps[0] > 10

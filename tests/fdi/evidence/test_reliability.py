"""Probabilities on simulated plants that are as the evidence takes them: what has p is right in the share p."""

import math

import numpy as np
import pytest

from gateway_fdi.evidence import posterior, record
from tests.fdi.evidence import simulated
from tests.support.amount import amount

SEED, BLOCKS, SAMPLES = 6702, 20, 6


def size(rng, fault):
    """Return what the gains of a fault are multiplied by."""
    scale, count = rng.choice(simulated.scales(fault)), len(fault.residuals)
    own = scale * rng.normal(size=count)
    return scale * rng.normal() + fault.error * own if fault.common else own


def drawn(rng, model):
    """Return a record of a plant with the fault that its priors draw, and that fault; -1: none."""
    n = BLOCKS * model.samples
    h, g = simulated.drive(rng, model, n)
    hours = model.samples * model.period_s / 3600.0
    weights = np.array([[fault.present] + [fault.per_h * hours] * (BLOCKS - 1) for fault in model.faults])
    each = np.append(weights.ravel(), 1.0) / (1.0 + weights.sum())
    fault, since = divmod(int(rng.choice(len(each), p=each)), BLOCKS)
    fault = -1 if fault == len(model.faults) else fault
    r = rng.multivariate_normal(np.zeros(len(model.noise)), model.noise, n)
    walked = [
        one.prior * rng.normal()
        + np.cumsum(np.append(0.0, one.walk * math.sqrt(hours * 3600.0) * rng.normal(size=BLOCKS - 1)))
        + model.jitter * one.prior * rng.normal(size=BLOCKS)
        for one in model.slow
    ]
    r += np.einsum("tij,tj->ti", h, np.repeat(np.transpose(walked), model.samples, 0))
    if fault >= 0:
        if since > 0:
            since += 1
            if rng.random() < 0.5:  # the block in which it begins: anything
                u = size(rng, model.faults[-1])
                first = slice((since - 1) * model.samples, since * model.samples)
                added = simulated.columns(model, g, len(model.faults) - 1, first.start, n) @ u
                r[first] += added.reshape(r.shape)[first]
        u = size(rng, model.faults[fault])
        r += (simulated.columns(model, g, fault, since * model.samples, n) @ u).reshape(r.shape)
    return (r, h, g), fault


@pytest.mark.long
def test_what_has_p_is_right_in_the_share_p():
    print("seed", SEED)
    rng, runs = np.random.default_rng(SEED), amount(6000, 600, 60)
    base = simulated.plant(rng, jitter=0.2, walk=0.02, unknown=True, samples=SAMPLES)
    told, right, hits = [], [], []
    s, c = base.records()
    fresh = s.copy()
    for _ in range(runs):
        data, fault = drawn(rng, base)
        for name in s.dtype.names:
            s[name] = fresh[name]
        for at in range(0, len(data[0]), SAMPLES):
            record.block_of(s, c, *(each[at : at + SAMPLES] for each in data))
        posterior.weigh(s, c)
        p = s.probability.copy()
        best = int(p.argmax())
        told.append(p[best])
        right.append(best == (fault if fault >= 0 else len(base.faults)))
        hits.append((p, fault))
    told, right = np.array(told), np.array(right)
    for low, high in ((0.0, 0.5), (0.5, 0.7), (0.7, 0.9), (0.9, 0.99), (0.99, 1.01)):
        mine = (told >= low) & (told < high)
        if mine.sum() > 20:
            wanted, found = told[mine].mean(), right[mine].mean()
            spread = math.sqrt((told[mine] * (1 - told[mine])).sum()) / mine.sum()
            print(f"{low} to {high}: {mine.sum()} runs, p {wanted:.4f}, right {found:.4f} +- {spread:.4f}")
            assert abs(found - wanted) < 4.0 * spread + 1.0 / mine.sum()
    every = np.array([p[fault] for p, fault in hits])
    entropy = np.array([-(p * np.log(np.maximum(p, 1e-300))).sum() for p, _ in hits])
    surplus = -np.log(every) - entropy
    print("log score", -np.log(every).mean(), "expected", entropy.mean(), "+-", surplus.std() / math.sqrt(runs))
    assert abs(surplus.mean()) < 4.0 * surplus.std() / math.sqrt(runs)

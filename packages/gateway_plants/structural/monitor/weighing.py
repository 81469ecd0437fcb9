"""Which faults fit sign and size of all residuals together, beside all that may be off.

When a test comes near its limit, generators of the model with a small fault begin beside each test, in the states that
the test has then. What they leave less, over the fault's size, is the test's gain by a fault that begins now.
Residuals, gains and sensitivities become one quadratic form (:mod:`gateway_fdi.evidence.blocks`) in which what may be
off is as the slow filter knew it before, and moves from block to block by a share of its bound: a plant has dynamics
that its model lacks, and most of them look like its parameters. Noise is taken as independent once in the time that
:mod:`.following` takes.

Of each fault the likelihood is that of :mod:`gateway_fdi.evidence.hypotheses`, with the scale of its size from what it
fits best, so that no prior of a size is asked for. As much as the best fault leaves beyond the noise, all are worth
less. A fault is **likely** if it fits as well as the best one; or a little less well, and it sees all tests that have
fired. If the best one does not see a test that has fired for sure, or leaves most of what was to be explained, none is:
it is several faults, or the model is wrong.
"""

from __future__ import annotations

from math import inf, isfinite
from typing import Annotated, Any

import numpy as np

from gateway_fdi.evidence import blocks, model
from gateway_fdi.evidence.hypotheses import of_fault
from gateway_fdi.evidence.model import FINER, SCALES
from gateway_fdi.evidence.quadratic import blur
from gateway_fdi.jit import f8, f8s, i8, kernel, means
from gateway_fdi.masks import clear, empty, has, include
from gateway_plants.structural.monitor.plan import Plan

#: Size of the fault that runs beside a test.
STEP = 1e-3
#: T over J of a test from which on faults run beside the tests.
NEAR = 0.2
#: Columns and gains up to which they do.
MOST_COLUMNS = 150
#: By which what may be off moves from block to block, a share of its bound; error of a gain, a share of it.
JITTER, ERROR = 0.3, 0.3
#: Logarithm of the likelihood, and share of the best one's, by which a fault that fits less well is unlikely; that it
#: takes to speak at all.
LESS, NEARLY, SPEAKS = 6.0, 0.1, 10.0
#: Share of what is beyond noise that the best fault has to explain; T over J of a test that is no chance.
FITS, SURE = 0.3, 3.0
#: Blocks in the time to confirm.
BLOCKS = 2


class Const(model.Const, lengths=model.LENGTHS):
    """Constants."""

    share: Annotated[f8s, "residuals"] = means("of a sample that is independent of those before")


class State(model.State, lengths=model.LENGTHS):
    """State."""

    awake: i8 = means("1: faults run beside the tests")
    r: Annotated[f8s, "residuals"] = means("residuals, without what was known to be off")
    h: Annotated[f8s, "residuals", "slow"] = means("their sensitivities")
    g: Annotated[f8s, "gains"] = means("gains")
    x: Annotated[f8s, "slow"] = means("what was known to be off when faults began beside the tests")
    since_a: Annotated[f8s, "columns", "columns"] = means("A of all blocks, and of what was known before")
    since_b: Annotated[f8s, "columns"] = means("b of all blocks")
    squares: f8 = means("sum of squares of the residuals over their noise")
    looks: f8 = means("number of independent residuals")
    excess: f8 = means("variance of what the best fault leaves, over that of the noise, 1 at least")


def faults_of(plan: Plan) -> tuple[model.Fault, ...]:
    """Return the faults that are weighed; none where their code is not known, or they would be too many."""
    found = tuple(model.Fault(f, tuple(plan.seen_by(f)), 1.0, ERROR) for f in plan.faults)
    known = all(test.faulty or not test.faults for test in plan.tests)
    return found if known and sum(len(f.residuals) for f in found) <= MOST_COLUMNS else ()


def model_of(plan: Plan, slow: int, period_s: float, confirm_s: float) -> model.Model:
    """Return what is said of a plant.

    Args:
        plan: its tests.
        slow: number of what may be off, each in shares of its bound.
        period_s: between two samples [s].
        confirm_s: before a name is told [s].
    """
    return model.Model(
        slow=tuple(model.Slow(str(k), 1.0) for k in range(slow)),
        faults=faults_of(plan),
        noise=np.eye(len(plan.tests)),
        period_s=period_s,
        samples=max(round(confirm_s / BLOCKS / period_s), 1),
        jitter=JITTER,
    )


@kernel
def begins(s: Any, c: Any, own: Any, own_const: Any) -> bool:
    """Return whether faults begin beside the tests behind this sample; without a test that is near they end."""
    near = not empty(own.fired)
    for k in range(own_const.tests):
        near = near or own.norm[k] > NEAR
    if near and s.awake == 1:
        return False
    s.awake = 1 if near else 0
    own.weighed = -1 if near else 0
    if not near:
        return False
    n = c.slow + c.first[c.faults]
    blocks.drop(s)
    for i in range(n):
        s.since_b[i] = 0.0
        for j in range(n):
            s.since_a[i, j] = 0.0
    s.squares = s.looks = 0.0
    return True


@kernel
def know(s: Any, c: Any, slow: Any) -> None:
    """Take over what the slow filter knows: its inverse covariance is the information (Gauss and Jordan)."""
    n = c.slow
    a, inverse = s.work_a, s.since_a
    for i in range(n):
        s.x[i] = slow.taken[i]
        for j in range(n):
            a[i, j] = slow.p[i, j] + (1e-9 if i == j else 0.0)
            inverse[i, j] = 1.0 if i == j else 0.0
    for i in range(n):
        pivot = a[i, i]
        for j in range(n):
            a[i, j] /= pivot
            inverse[i, j] /= pivot
        for k in range(n):
            factor = a[k, i]
            if k != i and factor != 0.0:
                for j in range(n):
                    a[k, j] -= factor * a[i, j]
                    inverse[k, j] -= factor * inverse[i, j]


@kernel
def take(s: Any, c: Any, own: Any, own_const: Any) -> None:
    """Take the residuals of a sample; where a block is whole, find the faults that are likely."""
    for k in range(c.residuals):
        settled = own.at_ns - max(own.since_ns, own.from_ns[k]) >= own_const.settle_ns
        if own.waits[k] == 1 or not settled or not c.share[k] > 0.0:
            s.r[k] = np.nan
        if isfinite(s.r[k]):
            s.squares += c.weight[k, k] * s.r[k] * s.r[k]
            s.looks += c.share[k]
    if not blocks.add(s, c, s.r, s.h, s.g):
        return
    n = c.slow + c.first[c.faults]
    s.squares -= 2.0 * blocks.close(s, c)
    for i in range(n):
        s.since_b[i] += s.b[i]
        for j in range(n):
            s.since_a[i, j] += s.a[i, j]
    blocks.drop(s)
    _judge(s, c, own, own_const, n)


@kernel
def _judge(s: Any, c: Any, own: Any, own_const: Any, n: int) -> None:
    """Find the faults that are likely by all blocks."""
    left = s.squares - s.looks
    for i in range(n):
        s.work_b[i] = s.since_b[i]
        for j in range(n):
            s.work_a[i, j] = s.since_a[i, j]
    for i in range(c.slow):
        left -= s.work_b[i] ** 2 / s.work_a[i, i]
        blur(s.work_a, s.work_b, n, i, 0.0)
    best = 0.0
    for f in range(c.faults):
        s.likelihood[f] = -inf
        product, information = 0.0, 0.0
        for i in range(c.slow + c.first[f], c.slow + c.first[f + 1]):
            product += s.work_b[i]
            for j in range(c.slow + c.first[f], c.slow + c.first[f + 1]):
                information += s.work_a[i, j]
        if information > 0.0 and product != 0.0:
            for m in range(SCALES):
                c.scale[f, m] = abs(product) / information / FINER**m
            of_fault(s, c, f)
        best = max(best, s.likelihood[f])
    s.excess = max((left + s.looks - 2.0 * best) / s.looks, 1.0)
    best /= s.excess
    fits = 2.0 * best * s.excess >= FITS * left
    own.weighed = 1 if best > SPEAKS else -1
    clear(own.likely)
    for f in range(c.faults):
        value = s.likelihood[f] / s.excess
        if not fits or value < (1.0 - NEARLY) * best - LESS:
            continue
        best_too, missed = value >= best - LESS, False
        for k in range(own_const.tests):
            missed = missed or (own.norm[k] > (SURE if best_too else 1.0) and not has(own_const.may[f], k))
        if missed and best_too:
            clear(own.likely)
            return
        if not missed:
            include(own.likely, f)

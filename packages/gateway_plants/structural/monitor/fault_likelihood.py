"""Which faults fit sign and size of all residuals together, beside all that may be off.

When a test comes near its limit, generators of the model with a small fault begin beside each test, in the states that
the test has then. What they leave less, over the fault's size, is the test's gain by a fault that begins now.
Residuals, gains and sensitivities become one quadratic form (:mod:`gateway_fdi.evidence.blocks`) in which what may be
off is as the slow filter knew it before, and moves from block to block by a share of its bound: a plant has dynamics
that its model lacks, and most of them look like its parameters. Noise is taken as independent once in the time that
:mod:`.parameter_tracking` takes.

Of each fault the likelihood is that of :mod:`gateway_fdi.evidence.hypotheses`, with the scale of its size from what it
fits best, so that no prior of a size is asked for. As much as the best fault leaves beyond the noise, all are worth
less. What a block says counts less with each block that follows: what a model lacks lasts as long as a manoeuvre, and
would add up for ever; what a fault leaves comes again.

It speaks above SPEAKS; where something may be off, also above what healthy logs show of it. What a model lacks looks
like one fault more than like others (tyres that are no line), and no theory says how much. Residuals of so many times
the amplitude have the likelihood ratio of its square, so limits are kept as roots, with the margin of the tests. In
calibration no test comes near; the largest T so far stands for J.

A fault is **likely** if it fits as well as the best one; or a little less well, and it sees all tests that have fired.
As long as a test fires and sizes are not sure, more is **awaited**: nothing is told that the tests leave open. They are
sure where the likelihood ratio of the best fault is large enough. Faults that are likely part as long as one of them
is on its way to be unlikely, more than half of it; that has then taken longer than the rest will. Others may stay
together: up to :data:`~.decision.MOST_TOGETHER` of them are told as one of several, when that has stood.

What was found may be no single fault of this model:

- **Two faults.** Sizes of each pair are of least squares, each gain u_i known to a share: with (A, b) the form
  of the gains, b := b - A u, u the sizes in their columns, and the deviation from it, N(0, (error s)^2), is integrated
  out. One of the two is among the faults that fit best alone. Two fit if the logarithm of their likelihood
  ratio over that of the best fault is above SPEAKS + LESS: a second fault is rare. A fault of all such pairs is sure.
- **No fault of the model.** Of what the residuals have beyond their noise the best one leaves more than a share, beside
  what a model leaves that is off; and enough to speak.
- **A test** has fired for sure that none of those that fit best sees.

Where nothing may be off, the tests decide alone then. Where something may, they name no fault that sizes do not: a
fault that was there while it was learned is in what is known, and the tests see what that leaves. For the same reason
faults that were likely before faults began beside the tests anew stay likely beside others.

**The fault has ended.** Of each block alone, with y and U its form by the size s, what may be off integrated out as it
was known before, y s - U s^2 / 2 is the logarithm of the likelihood that the fault has its size still, against that it
has gone. Their sum, 0 at most (Page, "Continuous inspection schemes", Biometrika 41, 1954), says when it has gone.
Nothing is weighed then until no test has been near its limit for the time to settle: what residuals have while they
decay is of no fault that begins. A name keeps the likely faults that it was given by, unless a test fires that none of
them explains.
"""

from __future__ import annotations

from math import inf, isfinite
from typing import Annotated, Any

import numpy as np

from gateway_fdi.cusum import FLOOR, MARGIN, NEVER
from gateway_fdi.evidence import blocks, model
from gateway_fdi.evidence.hypotheses import of_fault
from gateway_fdi.evidence.quadratic import blur
from gateway_fdi.jit import f8, f8s, i8, kernel, means
from gateway_fdi.linear_algebra import add
from gateway_fdi.linear_algebra import copy as copy_row
from gateway_fdi.masks import clear, copy, empty, has, include, within
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
#: takes to speak at all: of healthy cars that are 8 % off one reached it in 12 hours.
LESS, NEARLY, SPEAKS = 6.0, 0.1, 20.0
#: Share of the best one's from which on a fault is not out of the question while sizes are not sure.
LEANS = 0.5
#: Share of what is beyond noise that the best fault has to explain; variances of the noise that it may leave besides.
#: T over J of a test that is no chance.
FITS, BEYOND, SURE = 0.9, 1.0, 3.0
#: Blocks in the time to confirm; share of what they say that the next one leaves.
BLOCKS, KEPT = 2, 0.975


class Const(model.Const, lengths=model.LENGTHS):
    """Constants."""

    share: Annotated[f8s, "residuals"] = means("of a sample that is independent of those before")
    limit: Annotated[f8s, "edges"] = means("from which each fault speaks; the last: what no fault explains")
    opened: i8 = means("1: calibration, in which nothing reaches its threshold")


class State(model.State, lengths=model.LENGTHS):
    """State."""

    awake: i8 = means("1: faults run beside the tests")
    held: i8 = means("1: a fault has ended, and its residuals have not settled yet")
    near_ns: i8 = means("when a test was near its limit last", "ns")
    first: i8 = means("fault that fits best; -1: none")
    gone: f8 = means("logarithm of the likelihood that it is there still, against that it has gone; 0 at most")
    known_a: Annotated[f8s, "columns", "columns"] = means("A of what was known before")
    r: Annotated[f8s, "residuals"] = means("residuals, without what was known to be off")
    h: Annotated[f8s, "residuals", "slow"] = means("their sensitivities")
    g: Annotated[f8s, "gains"] = means("gains")
    x: Annotated[f8s, "slow"] = means("what was known to be off when faults began beside the tests")
    since_a: Annotated[f8s, "columns", "columns"] = means("A of all blocks, and of what was known before")
    since_b: Annotated[f8s, "columns"] = means("b of all blocks")
    squares: f8 = means("sum of squares of the residuals over their noise")
    looks: f8 = means("number of independent residuals")
    alone: Annotated[f8s, "faults"] = means("logarithm of the likelihood ratio of each fault alone")
    stands: i8 = means("blocks since it is sure")
    together: Annotated[f8s, "faults"] = means("logarithm of the likelihood ratio of each with the best one beside it")
    without: Annotated[f8s, "faults"] = means("likewise of the best two without it")
    excess: f8 = means("variance of what the best fault leaves, over that of the noise, 1 at least")
    peak: Annotated[f8s, "edges"] = means("largest of each while it fits best, over its limit")


def moved(plan: Plan) -> tuple[list[int], ...]:
    """Return the tests that see each fault that is weighed; none where their code is not known, or they are many."""
    found = tuple(plan.seen_by(f) for f in plan.faults)
    known = all(test.faulty or not test.faults for test in plan.tests)
    return found if known and sum(map(len, found)) <= MOST_COLUMNS else ()


def prepare(c: Const, plan: Plan, slow: int, period_s: float, confirm_s: float) -> None:
    """Fill a record of Const but for the weights of its residuals, and its limits.

    Args:
        plan: the tests.
        slow: number of what may be off, each in shares of its bound.
        period_s: between two samples [s].
        confirm_s: before a name is told [s].
    """
    samples = max(round(confirm_s / BLOCKS / period_s), 1)
    model.prepare(c, slow, moved(plan), samples=samples, jitter=JITTER, error=ERROR)


@kernel
def begins(s: Any, c: Any, own: Any, own_const: Any) -> bool:
    """Return whether faults begin beside the tests behind this sample; without a test that is near they end.

    Behind a fault that has ended they wait until no test has been near for the time to settle.
    """
    near = not empty(own.fired)
    own.by_size = 1 if c.slow > 0 else 0
    for k in range(own_const.tests):
        j = max(own.cusum[k].peak, FLOOR / NEVER) / MARGIN if c.opened == 1 else 1.0
        near = near or own.norm[k] > NEAR * j
    if near:
        s.near_ns = own.at_ns
    if s.held == 1:
        s.awake = own.awaits = 0
        if empty(own.fired) or _is_another(own, own_const):
            own.weighed = 0
        if not near and own.at_ns - s.near_ns >= own_const.settle_ns:
            s.held = 0
        return False
    if near and s.awake == 1:
        return False
    s.awake = own.awaits = 1 if near else 0
    own.weighed = 0
    for w in range(len(own.likely)):
        own.before[w] |= own.last[w]
        own.last[w] = 0
    if not near:
        return False
    blocks.drop(s)
    s.since_b[:] = 0.0
    s.since_a[:, :] = 0.0
    s.squares = s.looks = s.gone = 0.0
    s.first, s.stands = -1, 0
    return True


@kernel
def _is_another(own: Any, own_const: Any) -> bool:
    """Return whether a test has fired that none of the likely faults explains."""
    for f in range(own_const.faults):
        if has(own.likely, f) and within(own.fired, own_const.may[f]):
            return False
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
                add(a[k], -factor, a[i], n)
                add(inverse[k], -factor, inverse[i], n)
    for i in range(n):
        copy_row(s.known_a[i], inverse[i], n)


@kernel
def take(s: Any, c: Any, own: Any, own_const: Any) -> None:
    """Take the residuals of a sample; where a block is whole, find the faults that are likely."""
    for k in range(c.residuals):
        settled = own.at_ns - max(own.since_ns, own.from_ns[k]) >= own_const.settle_ns
        if own.waits[k] == 1 or not settled or not c.share[k] > 0.0:
            s.r[k] = np.nan
        if isfinite(s.r[k]):
            s.squares += c.weight[k] * s.r[k] * s.r[k]
            s.looks += c.share[k]
    if not blocks.add(s, c, s.r, s.h, s.g):
        return
    n = c.slow + c.first[c.faults]
    s.squares -= blocks.close(s, c)
    if s.first >= 0:
        s.gone = min(s.gone, 0.0) + _still(s, c, s.first, n)
        if s.gone < -LESS * s.excess:
            s.held = 1
            own.weighed = own.weighed if 0 <= own.found < own_const.groups else 0
            return
    s.squares *= KEPT
    s.looks *= KEPT
    for i in range(n):
        s.since_b[i] = KEPT * s.since_b[i] + s.b[i]
        for j in range(n):
            s.since_a[i, j] = KEPT * s.since_a[i, j] + (1.0 - KEPT) * s.known_a[i, j] + s.a[i, j]
    blocks.drop(s)
    _judge(s, c, own, own_const, n)


@kernel
def _left(s: Any, c: Any, a: Any, b: Any, n: int) -> float:
    """Copy a form into the scratch, and integrate out what may be off; returns what it explains."""
    explained = 0.0
    copy_row(s.work_b, b, n)
    for i in range(n):
        copy_row(s.work_a[i], a[i], n)
    for i in range(c.slow):
        explained += s.work_b[i] ** 2 / s.work_a[i, i]
        blur(s.work_a, s.work_b, n, i, 0.0)
    return explained


@kernel
def _still(s: Any, c: Any, f: int, n: int) -> float:
    """Return the logarithm of a block's likelihood that a fault has the size it had, against that it has gone."""
    for i in range(c.slow):
        for j in range(c.slow):
            s.a[i, j] += s.known_a[i, j]
    _left(s, c, s.a, s.b, n)
    for i in range(c.slow):
        for j in range(c.slow):
            s.a[i, j] -= s.known_a[i, j]
    (product, information), size = _moments(s, c, f), s.found[f]
    return float(product * size - 0.5 * information * size * size)


@kernel
def _moments(s: Any, c: Any, f: int) -> tuple[float, float]:
    """Return y and U of a fault's size, one for all of its gains, by the form in the scratch."""
    product, information = 0.0, 0.0
    for i in range(c.slow + c.first[f], c.slow + c.first[f + 1]):
        product += s.work_b[i]
        for j in range(c.slow + c.first[f], c.slow + c.first[f + 1]):
            information += s.work_a[i, j]
    return product, information


@kernel
def _ratio(s: Any, c: Any, f: int) -> float:
    """Return the logarithm of a fault's likelihood ratio by the form in the scratch, with its size to be found."""
    product, information = _moments(s, c, f)
    if not information > 0.0 or product == 0.0:
        return -inf
    of_fault(s, c, f, abs(product) / information)
    return float(s.likelihood[f])


@kernel
def _judge(s: Any, c: Any, own: Any, own_const: Any, n: int) -> None:
    """Find the faults that are likely by all blocks."""
    left = s.squares - s.looks - _left(s, c, s.since_a, s.since_b, n)
    best, s.first = 0.0, -1
    for f in range(c.faults):
        s.likelihood[f] = _ratio(s, c, f)
        s.alone[f] = s.likelihood[f]
        if s.likelihood[f] > best:
            best, s.first = s.likelihood[f], f
    s.excess = max((left + s.looks - 2.0 * best) / s.looks, 1.0)
    best /= s.excess
    clear(own.likely)
    own.weighed, own.awaits, known = 0, 1, False
    for k in range(own_const.tests):
        known = known or own.norm[k] > 1.0
    limit, rest = c.limit[max(s.first, 0)], left - 2.0 * best * s.excess
    if rest > (1.0 - FITS) * left + BEYOND * s.looks:
        rest /= 2.0 * s.excess * c.limit[c.faults]
        own.awaits = 0 if known and rest > 1.0 else 1
        s.peak[c.faults] = max(s.peak[c.faults], rest)
    if s.first >= 0:
        s.peak[s.first] = max(s.peak[s.first], best / limit)
    second = _second(s, c, own, left, best) if known and left > 2.0 * SPEAKS * s.excess else 0.0
    most = (best + second) * s.excess
    if c.slow > 0 and second > SPEAKS + LESS and left - 2.0 * most <= (1.0 - FITS) * left + BEYOND * s.looks:
        copy(own.last, own.likely)
        own.weighed, own.awaits, s.stands = 2, 0, 0
        return
    clear(own.likely)
    if own.awaits == 0 or not known or best <= limit:
        _lean(s, c, own, best)
        s.stands = 0
        return
    s.stands += 1
    own.awaits = 1 if s.stands <= BLOCKS else 0
    seen = False
    for f in range(c.faults):
        less = best - s.alone[f] / s.excess - NEARLY * best
        if less > LESS:
            continue
        best_too, missed = less <= LESS - NEARLY * best, False
        for k in range(own_const.tests):
            missed = missed or (own.norm[k] > (SURE if best_too else 1.0) and not has(own_const.may[f], k))
        seen = seen or (best_too and not missed)
        if best_too or not missed:
            include(own.likely, f)
            own.awaits = 1 if 2.0 * less > LESS else own.awaits
    own.weighed = 1 if seen and second <= SPEAKS else -1
    own.awaits = own.awaits if own.weighed == 1 else 0
    if own.weighed == 1 and c.slow > 0:
        _recall(own)


@kernel
def _lean(s: Any, c: Any, own: Any, best: float) -> None:
    """Find the faults that are not out of the question, where something may be off and sizes are not sure."""
    for f in range(c.faults):
        if c.slow > 0 and s.alone[f] >= LEANS * best * s.excess > 0.0:
            include(own.likely, f)


@kernel
def _recall(own: Any) -> None:
    """Let the faults that were likely before stay likely beside others."""
    copy(own.last, own.likely)
    same = False
    for w in range(len(own.likely)):
        same = same or own.likely[w] & own.before[w] != 0
    for w in range(len(own.likely)):
        own.likely[w] |= 0 if same else own.before[w]


@kernel
def _second(s: Any, c: Any, own: Any, left: float, best: float) -> float:
    """Return by how much two faults fit better than one, the logarithm of the likelihood ratio over what is left.

    Leaves the faults of all pairs that fit in ``own.likely``, and those that each of these pairs has in ``own.sure``.
    """
    most = -inf
    for f in range(c.faults):
        s.together[f] = s.without[f] = -inf
    for f in range(c.faults):
        for g in range(f):
            if max(s.alone[f], s.alone[g]) < LEANS * best * s.excess:
                continue
            value = _both(s, c, f, g)
            most = max(most, value)
            for k in range(c.faults):
                if k in (f, g):
                    s.together[k] = max(s.together[k], value)
                else:
                    s.without[k] = max(s.without[k], value)
    excess = max((left + s.looks - 2.0 * most) / s.looks, 1.0)
    clear(own.sure)
    for f in range(c.faults):
        if most - s.together[f] <= LESS * excess:
            include(own.likely, f)
            if most - s.without[f] > LESS * excess:
                include(own.sure, f)
    return float(most / s.excess - best)


@kernel
def _both(s: Any, c: Any, f: int, g: int) -> float:
    """Return the logarithm of the likelihood ratio of two faults by the form in the scratch.

    Sizes are of least squares; each gain is known to :data:`ERROR`, and what is not known of it is integrated out.
    """
    p, first, second = c.slow, c.first[f + 1] - c.first[f], c.first[g + 1] - c.first[g]
    y, z, a, b, d = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(first + second):
        row = p + (c.first[f] + i if i < first else c.first[g] + i - first)
        s.one_b[i] = s.work_b[row]
        y += s.one_b[i] if i < first else 0.0
        z += 0.0 if i < first else s.one_b[i]
        for j in range(first + second):
            s.one_a[i, j] = s.work_a[row, p + (c.first[f] + j if j < first else c.first[g] + j - first)]
            a += s.one_a[i, j] if i < first and j < first else 0.0
            b += s.one_a[i, j] if i < first <= j else 0.0
            d += s.one_a[i, j] if i >= first and j >= first else 0.0
    area = a * d - b * b
    if not area > 1e-9 * a * d:
        return -inf
    one, other = (d * y - b * z) / area, (a * z - b * y) / area
    if one == 0.0 or other == 0.0:
        return -inf  # one of no size is not there
    value = 0.5 * (one * y + other * z)
    for i in range(first + second):
        for j in range(first + second):
            s.one_b[i] -= s.one_a[i, j] * (one if j < first else other)
    for i in range(first + second):
        value += blur(s.one_a, s.one_b, first + second, i, (ERROR * (one if i < first else other)) ** -2)
    return float(value)

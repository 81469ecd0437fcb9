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
would add up for ever; what a fault leaves comes again. Where something may be off, a block that leaves more than its
noise, whatever is off and whatever each gain's size, counts as if its noise were larger: else it would be that of all
blocks, and end what stands.

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

- **Two faults** (:mod:`.fault_pairs`). Where they fit better by more than chance, the best fault keeps its name, but
  is not the cause: the two are as possible. From SPEAKS on, until it falls below LESS, it has no name, and pairs are
  listed beside it: what a model lacks may look like a second fault. From TWO on they are told, if they explain a share
  more; a fault of all pairs that fit is sure. Where nothing may be off, the tests name pairs.
- **No fault of the model.** Of what the residuals have beyond their noise the best one leaves more than a share, beside
  what a model leaves that is off; and enough to speak.
- **A test** has fired for sure that none of those that fit best sees; where nothing may be off, at any time since
  faults run beside the tests: what passes again may see only how a fault begins.

Where nothing may be off, the tests decide alone then. Where something may, they name no fault that sizes do not: a
fault that was there while it was learned is in what is known, and the tests see what that leaves. For the same reason
faults that were likely before faults began beside the tests anew stay likely beside others.

Where the tests begin anew, or their model moves to what has been learned, the faults beside them do, too; what the
blocks have said stays.

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
from gateway_fdi.linear_algebra import add, decompose, solve
from gateway_fdi.linear_algebra import copy as copy_row
from gateway_fdi.masks import clear, copy, disjoint, empty, has, include, unite, within
from gateway_plants.structural.monitor import fault_pairs
from gateway_plants.structural.monitor.fault_pairs import KEPT, LEANS, LENGTHS, LESS, NEARLY
from gateway_plants.structural.monitor.plan import Plan

#: Size of the fault that runs beside a test.
STEP = 1e-3
#: T over J of a test from which on faults run beside the tests.
NEAR = 0.2
#: Columns and gains up to which they do.
MOST_COLUMNS = 150
#: By which what may be off moves from block to block, a share of its bound; error of a gain, a share of it.
JITTER, ERROR = 0.3, 0.3
#: What it takes to speak at all: of healthy cars that are 8 % off one reached it in 12 hours.
SPEAKS = 20.0
#: Logarithm of the likelihood ratio of two faults to one, by which both are told: of 114 faults alone, of cars that are
#: 8 % off, two reached it.
TWO = 45.0
#: Share of what two explain that the best fault alone does not, by which both are told. Share of the best one's
#: likelihood by which two that fit better make it uncertain.
SHARE, DOUBT = 0.1, 0.05
#: Share of what is beyond noise that the best fault has to explain; variances of the noise that it may leave besides.
#: T over J of a test that is no chance.
FITS, BEYOND, SURE = 0.9, 1.0, 3.0
#: Blocks in the time to confirm.
BLOCKS = 2


class Const(model.Const, lengths=LENGTHS):
    """Constants."""

    share: Annotated[f8s, "residuals"] = means("of a sample that is independent of those before")
    limit: Annotated[f8s, "edges"] = means("from which each fault speaks; the last: what no fault explains")
    opened: i8 = means("1: calibration, in which nothing reaches its threshold")


class State(fault_pairs.State, lengths=LENGTHS):
    """State."""

    awake: i8 = means("1: faults run beside the tests")
    held: i8 = means("1: a fault has ended, and its residuals have not settled yet")
    near_ns: i8 = means("when a test was near its limit last", "ns")
    rests: i8 = means("1: the tests have begun anew, while faults ran beside them")
    first: i8 = means("fault that fits best; -1: none")
    second: f8 = means("logarithm of the likelihood ratio of two faults to one")
    doubt: i8 = means("1: the best fault is likely, and two may fit better")
    gone: f8 = means("logarithm of the likelihood that it is there still, against that it has gone; 0 at most")
    known_a: Annotated[f8s, "columns", "columns"] = means("A of what was known before")
    r: Annotated[f8s, "residuals"] = means("residuals, without what was known to be off")
    h: Annotated[f8s, "residuals", "slow"] = means("their sensitivities")
    g: Annotated[f8s, "gains"] = means("gains")
    x: Annotated[f8s, "slow"] = means("what was known to be off when faults began beside the tests")
    stands: i8 = means("blocks since it is sure")
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


def lengths_of(plan: Plan, slow: int) -> dict[str, int]:
    """Return the lengths of the records; arguments as of :func:`prepare`."""
    seen = moved(plan)
    return model.lengths(len(plan.tests), slow, seen) | {"joint": max(slow + 2 * sum(map(len, seen)), 1)}


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
    if near and s.rests == 1:
        s.awake = 1
        blocks.drop(s)
        s.own_squares = s.own_looks = 0.0
        return True
    s.awake = own.awaits = 1 if near else 0
    s.rests = 0
    own.weighed = 0
    clear(own.paired)
    unite(own.before, own.last)
    clear(own.last)
    if not near:
        return False
    blocks.drop(s)
    fault_pairs.begin(s)
    s.gone = s.second = 0.0
    s.first, s.stands = -1, 0
    clear(own.beyond)
    return True


@kernel
def interrupt(s: Any) -> None:
    """Let faults rest while the tests begin anew: what the blocks have said stays."""
    s.rests = max(s.rests, s.awake)
    s.awake = 0


@kernel
def _is_another(own: Any, own_const: Any) -> bool:
    """Return whether a test has fired that none of the likely faults explains."""
    for f in range(own_const.faults):
        if has(own.likely, f) and within(own.fired, own_const.may[f]):
            return False
    return True


@kernel
def know(s: Any, c: Any, slow: Any) -> None:
    """Take over what the slow filter knows: its inverse covariance is the information.

    Where faults have rested only, what was known before stays.
    """
    if s.rests == 1:
        return
    n, a = c.slow, s.work_a
    for i in range(n):
        s.x[i] = slow.taken[i]
        copy_row(a[i], slow.p[i], n)
        a[i, i] += 1e-9
    decompose(a, a, n)
    for i in range(n):
        s.work_b[:] = 0.0
        s.work_b[i] = 1.0
        solve(a, s.work_b, s.known_a[i], n)
        copy_row(s.since_a[i], s.known_a[i], n)


@kernel
def take(s: Any, c: Any, own: Any, own_const: Any) -> None:
    """Take the residuals of a sample; where a block is whole, find the faults that are likely."""
    s.rests = 0
    for k in range(c.residuals):
        if own.norm[k] > SURE:
            include(own.beyond, k)
        settled = own.at_ns - max(own.since_ns, own.from_ns[k]) >= own_const.settle_ns
        if own.waits[k] == 1 or not settled or not c.share[k] > 0.0:
            s.r[k] = np.nan
        if isfinite(s.r[k]):
            s.own_squares += c.weight[k] * s.r[k] * s.r[k]
            s.own_looks += c.share[k]
    if not blocks.add(s, c, s.r, s.h, s.g):
        return
    n = c.slow + c.first[c.faults]
    s.own_squares -= blocks.close(s, c)
    if c.slow > 0:
        _weigh(s, c, n)
    if s.first >= 0 and empty(own.paired):  # of two, either may have the other's size
        s.gone = min(s.gone, 0.0) + _still(s, c, s.first, n)
        if s.gone < -LESS * s.excess:
            s.held = 1
            own.weighed = own.weighed if 0 <= own.found < own_const.groups else 0
            return
    s.squares = KEPT * s.squares + s.own_squares
    s.looks = KEPT * s.looks + s.own_looks
    for i in range(n):
        s.since_b[i] = KEPT * s.since_b[i] + s.b[i]
        for j in range(n):
            s.since_a[i, j] = KEPT * s.since_a[i, j] + (1.0 - KEPT) * s.known_a[i, j] + s.a[i, j]
    fault_pairs.take(s, n)
    blocks.drop(s)
    s.own_squares = s.own_looks = 0.0
    _judge(s, c, own, own_const, n)


@kernel
def _weigh(s: Any, c: Any, n: int) -> None:
    """Let a block count less that leaves more than noise whatever is off, whatever the size of each gain."""
    most = (1.0 + BEYOND) * s.own_looks
    left = s.own_squares - _left(s, s.a, s.b, 0.0, n, n)
    if left > most:
        weight = most / left
        s.own_squares *= weight
        for i in range(n):
            s.b[i] *= weight
            for j in range(n):
                s.a[i, j] *= weight


@kernel
def _left(s: Any, a: Any, b: Any, known: float, n: int, most: int) -> float:
    """Copy a form and a share of what was known into the scratch, and integrate out the first columns.

    Returns what these explain.
    """
    explained = 0.0
    copy_row(s.work_b, b, n)
    for i in range(n):
        copy_row(s.work_a[i], a[i], n)
        add(s.work_a[i], known, s.known_a[i], n)
    for i in range(most):
        if s.work_a[i, i] > 1e-9 * a[i, i]:
            explained += s.work_b[i] ** 2 / s.work_a[i, i]
            blur(s.work_a, s.work_b, n, i, 0.0)
    return explained


@kernel
def _still(s: Any, c: Any, f: int, n: int) -> float:
    """Return the logarithm of a block's likelihood that a fault has the size it had, against that it has gone.

    Another fault may be there besides, and is less likely unless one has shown: of both the largest likelihood counts.
    """
    _left(s, s.a, s.b, 1.0, n, c.slow)
    (product, information), size = _moments(s, c, f), s.found[f]
    there, gone = 0.0, 0.0
    less = 0.0 if s.second > LESS else LESS * s.excess
    for g in range(c.faults):
        y, own = _moments(s, c, g)
        if g == f or not own > 0.0:
            continue
        shared = 0.0
        for i in range(c.slow + c.first[f], c.slow + c.first[f + 1]):
            for j in range(c.slow + c.first[g], c.slow + c.first[g + 1]):
                shared += s.work_a[i, j]
        gone = max(gone, 0.5 * y * y / own - less)
        there = max(there, 0.5 * (y - shared * size) ** 2 / own - less)
    return float(product * size - 0.5 * information * size * size + there - gone)


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
    left = s.squares - s.looks - _left(s, s.since_a, s.since_b, 0.0, n, c.slow)
    best, s.first = 0.0, -1
    for f in range(c.faults):
        s.likelihood[f] = _ratio(s, c, f)
        s.alone[f] = s.likelihood[f]
        if s.likelihood[f] > best:
            best, s.first = s.likelihood[f], f
    s.excess = max((left + s.looks - 2.0 * best) / s.looks, 1.0)
    best /= s.excess
    clear(own.likely)
    two, stood = own.weighed == 2, not empty(own.paired)
    own.weighed, own.awaits, known = 0, 1, not empty(own.up)
    limit, rest = c.limit[max(s.first, 0)], left - 2.0 * best * s.excess
    if rest > (1.0 - FITS) * left + BEYOND * s.looks:
        rest /= 2.0 * s.excess * c.limit[c.faults]
        own.awaits = 0 if known and rest > 1.0 else 1
        s.peak[c.faults] = max(s.peak[c.faults], rest)
    if s.first >= 0:
        s.peak[s.first] = max(s.peak[s.first], best / limit)
    s.second = besides = 0.0
    if known and left > 2.0 * SPEAKS * s.excess:
        s.second = fault_pairs.second(s, c, own, left, best)
        besides = 1.0 - best * s.excess / s.two
    s.doubt = 1 if s.second > max(0.5 * LESS, DOUBT * best) else 0
    fit = c.slow > 0 and left - 2.0 * s.two <= (1.0 - FITS) * left + BEYOND * s.looks
    if not (fit or stood) or s.second <= (LESS if stood else SPEAKS):
        clear(own.paired)
    elif s.second > (LESS if two else TWO) and besides > SHARE:
        copy(own.likely, own.paired)
        copy(own.last, own.paired)
        own.weighed, own.awaits, s.stands = 2, 0, 0
        return
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
            fires = own.norm[k] > (SURE if best_too else 1.0) or (c.slow == 0 and has(own.beyond, k))
            missed = missed or (fires and not has(own_const.may[f], k))
        seen = seen or (best_too and not missed)
        if best_too or not missed:
            include(own.likely, f)
            own.awaits = 1 if 2.0 * less > LESS else own.awaits
    own.weighed = 1 if seen and s.second <= SPEAKS and empty(own.paired) else -1
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
    if disjoint(own.likely, own.before):
        unite(own.likely, own.before)

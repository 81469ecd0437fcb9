"""A Kalman filter over slow errors, within bounds and rates.

An equation of a plant, with the configured parameters p and with sensors' readings y = (1 + g) x + b, leaves

    rest = h' e + noise

to first order: e, shape (n,), are the relative errors of the parameters, the sensors' relative gains g and their biases
b; h, shape (n,), is what each adds to the equation, in the equation's unit by the error's. e is a slow state:

    e(t + dt) = e(t) + w,    var w_k = dt rate_k WALK (high_k - low_k)

so that a walk spans the bound in the time that the rate allows for it. :func:`add` takes sets into a block,
:func:`update` a block into the filter: rest and h are linear in e, so the mean of a block holds the mean of its
equations, and a block of B sets costs a B-th. Noise is taken as independent only once in a number of sets: as often the
variance of a mean of B. h is made of readings, so noise is in h as well as in rest: of a set alone h v is not 0 in the
mean (a sensor's gain and its own noise), and an e that nothing else tells runs away by that; of a block it is a B-th.

The estimate is ``error``, without bounds; a monitor uses ``taken``. It is the most likely e within the bounds
(:func:`_within`): with e ~ N(m, P) and e_k held at its bound,

    E[e_j | e_k = bound] = m_j - P_jk / P_kk (m_k - bound)

so the part a little beyond the bounds is left, and tests see it. An error beyond its bound for sure is a fault: it is
not taken at all, nor are those of its group; others do not take it up, and tests see it whole.

``taken`` is the estimate while the filter LEARNS. While it is FOLLOWING, ``taken`` changes by its rate at most, and by
BETTER times the gain in certainty: a fault that comes at once is there long before it is followed. ``error`` does not
run away from ``taken`` meanwhile. While it is HELD, because the set may have a fault, ``error`` as well moves by its
rate at most, and nothing becomes surer. Several equations share one filter: a sensor's gain does the same in both, and
errors that no equation tells apart are left as P has them: in the residuals they cancel.

A test of an equation may doubt by :func:`doubt`, sqrt(h' P h): an unknown error is no fault, and a threshold adapts
itself.
"""

from __future__ import annotations

from math import sqrt
from typing import Annotated

from gateway_fdi.jit import Record, f8, f8s, i8, i8s, kernel, means
from gateway_fdi.linear_algebra import dot, minus, plus

#: Most errors of a filter.
MOST = 24
#: Sets of a block.
BLOCK = 10
#: Sets after which the noise of an equation is taken as independent, where nothing else is known.
COLOURED = 9.0
#: Share of a walk: the rate is the most that happens, not the usual.
WALK = 0.1
#: Uses of the estimate.
LEARNS, FOLLOWING, HELD = range(3)
#: Multiple of the standard deviation that a set takes away by which an error may move.
BETTER = 2.0
#: Standard deviations of the uncertainty by which a residual counts less.
GUARD = 2.0
#: Steps of its rate that ``error`` may be ahead of ``taken``, beside the uncertainty.
LEAD = 1000.0
#: Standard deviations, and share of the bounds' width, by which an error lies beyond its bound for sure.
SURE, BEYOND = 4.0, 0.03
#: Passes over the bounds.
PASSES = 3
#: Time after which waiting makes nothing more uncertain [s].
LONG = 300.0


class Const(Record):
    """Constants, of each error."""

    count: i8 = means("errors")
    group: Annotated[i8s, MOST] = means("errors of one group are refused together")
    low: Annotated[f8s, MOST] = means("lower bound")
    high: Annotated[f8s, MOST] = means("upper bound")
    rate: Annotated[f8s, MOST] = means("largest change", "1/s")
    prior: Annotated[f8s, MOST] = means("standard deviation beforehand")


class State(Record):
    """State, of each error."""

    error: Annotated[f8s, MOST] = means("what is found")
    taken: Annotated[f8s, MOST] = means("what is taken of it")
    p: Annotated[f8s, MOST, MOST] = means("covariance of error")
    now: f8 = means("time", "s")
    since: Annotated[f8s, MOST] = means("when it was followed last", "s")
    held: Annotated[f8s, MOST] = means("for how long it is held", "s")
    refused: Annotated[i8s, MOST] = means("1: beyond its bound for sure")
    wanted: Annotated[f8s, MOST] = means("scratch: the most likely one within the bounds")
    passed: Annotated[f8s, MOST] = means("scratch: time since it was followed", "s")
    before: Annotated[f8s, MOST] = means("scratch: standard deviation before this equation")
    gain: Annotated[f8s, MOST] = means("scratch")


class Block(Record):
    """Sums over the sets of an equation that wait."""

    h: Annotated[f8s, MOST] = means("sum of h")
    rest: f8 = means("sum of rest")
    variance: f8 = means("sum of the noise's variances")
    sets: i8 = means("number of sets")


def prepare(s: State, c: Const) -> None:
    """Let errors begin at 0 with their prior."""
    for k in range(c.count):
        s.p[k, k] = c.prior[k] ** 2


@kernel
def add(b: Block, h: f8s, rest: float, variance: float, size: int = BLOCK) -> bool:
    """Add a set to a block; returns whether it is whole.

    Args:
        h: sensitivities, shape (MOST,).
        rest: what the equation leaves.
        variance: of its noise.
        size: sets of a block.
    """
    b.h += h
    b.rest += rest
    b.variance += variance
    b.sets += 1
    return bool(b.sets >= size)


@kernel
def drop(b: Block) -> None:
    """Forget a block."""
    b.h[:] = 0.0
    b.rest, b.variance, b.sets = 0.0, 0.0, 0


@kernel
def _refused(s: State, c: Const, k: int) -> bool:
    """Return whether an error that is found lies beyond its bound for sure: then it is none of these errors."""
    over = max(s.error[k] - c.high[k], c.low[k] - s.error[k])
    return bool(over > max(SURE * sqrt(max(s.p[k, k], 0.0)), BEYOND * (c.high[k] - c.low[k])))


@kernel
def _within(s: State, c: Const, learning: bool) -> None:
    """Put the most likely errors within the bounds into ``wanted``; refused ones are left as they are taken."""
    for k in range(c.count):
        s.wanted[k] = s.error[k]
        s.refused[k] = 1 if _refused(s, c, k) else 0
    for k in range(c.count):
        for j in range(c.count):
            if s.refused[j] == 1 and c.group[j] == c.group[k]:
                s.refused[k] = 1
    for _ in range(PASSES):
        for k in range(c.count):
            over = s.wanted[k] - min(max(s.wanted[k], c.low[k]), c.high[k])
            if over == 0.0 or s.p[k, k] <= 0.0 or s.refused[k] == 1:
                continue
            share = over / s.p[k, k]
            for j in range(c.count):
                s.wanted[j] -= s.p[j, k] * share
    for k in range(c.count):
        s.wanted[k] = min(max(s.wanted[k], c.low[k]), c.high[k])
        if s.refused[k] == 1:
            s.wanted[k] = 0.0 if learning else s.taken[k]


@kernel
def wait(s: State, dt: float) -> None:
    """Let time pass [s]; an error is known less when it is followed again, or when :func:`age` says so."""
    s.now += dt


@kernel
def _walk(s: State, c: Const, k: int, held: bool) -> float:
    """Let an error walk for the time that it has waited; returns that [s].

    A walk spreads by the root of the time, at first far beyond the rate: while it is held, and nothing is learned, a
    test would doubt a fault away in seconds. So then it goes by its rate, GUARD standard deviations.
    """
    passed = min(s.now - s.since[k], LONG)
    s.since[k] = s.now
    slope, before = c.rate[k] / GUARD, s.held[k]
    s.held[k] = before + passed if held else 0.0
    if s.p[k, k] < c.prior[k] * c.prior[k]:
        walk = passed * c.rate[k] * WALK * (c.high[k] - c.low[k])
        s.p[k, k] += slope * slope * passed * (2.0 * before + passed) if held else walk
    return float(passed)


@kernel
def age(s: State, c: Const, dt: float) -> None:
    """Let all errors get older: nothing is followed for now, and each may go as far as its rate lets it in dt [s].

    The doubt of tests, GUARD standard deviations, grows by the rate and up to the bound: a test that fires because of
    ageing comes down again, one with a larger cause does not.
    """
    for k in range(c.count):
        spread = sqrt(max(s.p[k, k], 0.0)) + dt * c.rate[k] / GUARD
        if spread < c.prior[k]:
            s.p[k, k] = spread * spread


@kernel
def update(s: State, c: Const, b: Block, coloured: float, mode: int) -> None:
    """Take a block, and forget it.

    Args:
        coloured: sets after which its noise is independent.
        mode: LEARNS, FOLLOWING or HELD.
    """
    h, sets = b.h, float(b.sets)
    for k in range(c.count):
        h[k] /= sets
    _measure(s, c, h, b.rest / sets, coloured * b.variance / (sets * sets), mode)
    drop(b)


@kernel
def _measure(s: State, c: Const, h: f8s, rest: float, variance: float, mode: int) -> None:
    """Take an equation's rest, of sensitivities h, shape (MOST,)."""
    n = c.count
    for k in range(n):
        s.passed[k] = _walk(s, c, k, mode == HELD) if h[k] != 0.0 else 0.0
        s.before[k] = sqrt(max(s.p[k, k], 0.0))
    for j in range(n):
        s.gain[j] = dot(s.p[j], h, n)
    left, size = minus(rest, h, s.error, n), plus(variance, h, s.gain, n)
    if not size > 0.0:
        return
    for j in range(n):
        step = s.gain[j] * left / size
        if mode == HELD:
            most = c.rate[j] * s.passed[j]
            s.error[j] += min(max(step, -most), most)
            continue
        s.error[j] += step
        for k in range(j, n):
            s.p[j, k] -= s.gain[j] * s.gain[k] / size
            s.p[k, j] = s.p[j, k]
    _within(s, c, mode == LEARNS)
    for k in range(n):
        if mode == LEARNS:
            s.taken[k] = s.wanted[k]
            continue
        now = sqrt(max(s.p[k, k], 0.0))
        step = c.rate[k] * s.passed[k] + BETTER * max(s.before[k] - now, 0.0)
        s.taken[k] += min(max(s.wanted[k] - s.taken[k], -step), step)
        # A change that it may not follow is none of these errors: it does not run away from ``taken``.
        lead = LEAD * c.rate[k] * s.passed[k] + GUARD * now
        s.error[k] = s.taken[k] + min(max(s.error[k] - s.taken[k], -lead), lead)


@kernel
def doubt(s: State, c: Const, h: f8s) -> float:
    """Return the standard deviation of what the errors still add to an equation of sensitivities ``h``."""
    total = 0.0
    for j in range(c.count):
        if h[j] == 0.0:
            continue
        row = 0.5 * s.p[j, j] * h[j]
        for k in range(j + 1, c.count):
            row += s.p[j, k] * h[k]
        total += 2.0 * h[j] * row
    return sqrt(max(total, 0.0))


@kernel
def beyond(residual: float, doubt: float) -> float:
    """Return what is left of a residual beyond what is not known: a threshold that adapts itself."""
    least = GUARD * doubt
    if residual > least:
        return residual - least
    return residual + least if residual < -least else 0.0 * residual

"""What the tests of a monitor made from a model say together.

A fault **explains** the tests that have fired if it is in the signature of each of them (one fault at a time). That a
test has not fired says nothing: it may be slow, or its fault not excited. So there is never a single name while
another fault fits too. What has a name keeps it until its last test has come down, or another one fires.

Two ways to judge a residual: the CUSUM of what is beyond nu; or, for faults that begin at once, the likelihood ratio
that its mean has jumped at one of the last samples, against noise of a standard deviation that nu says.

That nothing explains what has fired is told only after :data:`PENDING` times as long as a name: tests of one fault
fire one after the other, and one that is yet to come may tell it. So one fault has one DTC.

A test that comes down for less than ``confirm_s`` has not come down: one that is up and down by turns, as of a fault
that is just large enough, does not keep all from being told.

A generator that gives no number (a root of what is negative, a division by zero) begins anew, and its test settles
again, alone.

The **size** of a fault is - residual / gain of the generator that checks its equation; of the samples since a test has
fired the least squares of it, forgetting. Where that generator is filtered, what its filter still has of the time
before is taken off both.
"""

from __future__ import annotations

from math import exp, isfinite, nan
from typing import Any

from gateway.fdi import cusum, likelihood
from gateway.fdi.structure.incidence import BITS, clear, exclude, include
from gateway.jit import kernel
from gateway.monitors.contract import EVIDENCE, MAX_RESULTS, report
from gateway.monitors.structural.records import (
    KINDS,
    LISTED,
    NORM,
    RANKED,
    RESIDUAL,
    WINDOW,
    Const,
    State,
)

#: Time between two reports of the same [ns].
REPEAT_NS = 1_000_000_000
#: Times of ``confirm_s`` for which nothing may join before what has fired is told as not isolated.
PENDING = 5
#: Tests up to which evidence has those that have fired as bits; faults up to which it ranks them with two digits.
AS_BITS, TWO_DIGITS = 48, 99
#: Faults that the evidence ranks, with two digits; with three, and tests that it lists.
MOST_RANKED, MOST_RANKED_LONG = 6, 5
#: Results that are reported at once; of more, some each time.
AT_ONCE = 60
#: nu of Gaussian noise in its standard deviations: mean and standard deviation of its modulus.
NU_OF_NOISE = 1.4007

assert AT_ONCE + 2 <= MAX_RESULTS


@kernel
def _has(mask: Any, k: int) -> bool:
    """Tell whether a number is in the set that a mask is."""
    return bool(mask[k // BITS] >> (k % BITS) & 1 == 1)


@kernel
def _empty(mask: Any) -> bool:
    """Tell whether nothing is in the set that a mask is."""
    for w in range(len(mask)):
        if mask[w] != 0:
            return False
    return True


@kernel
def _within(mask: Any, other: Any) -> bool:
    """Tell whether all of a set is in another one."""
    for w in range(len(mask)):
        if mask[w] & ~other[w] != 0:
            return False
    return True


@kernel
def _explain(s: State, c: Const) -> None:
    """Find the faults that explain what has fired; none if nothing has."""
    clear(s.explained)
    if _empty(s.fired):
        return
    for k in range(c.faults):
        if _within(s.fired, c.signature[k]):
            include(s.explained, k)


@kernel
def likelihood_of(s: State, c: Const, fault: int) -> float:
    """Return how near a fault's tests are to firing, 1 when all have: mean of T over J, each at most 1."""
    total, count = 0.0, 0
    for k in range(c.tests):
        if _has(c.signature[fault], k):
            total += min(s.norm[k], 1.0)
            count += 1
    return total / count if count > 0 else 0.0


@kernel
def ranked(s: State, c: Const) -> float:
    """Return the faults that explain, likeliest first, two digits each: 205 is the second, then the fifth; or three."""
    clear(s.now)
    digits = 0.0
    many = c.faults > TWO_DIGITS
    for _ in range(MOST_RANKED_LONG if many else MOST_RANKED):
        best, most = -1, -1.0
        for k in range(c.faults):
            if _has(s.explained, k) and not _has(s.now, k):
                value = likelihood_of(s, c, k)
                if value > most:
                    best, most = k, value
        if best < 0:
            break
        include(s.now, best)
        digits = digits * (1000.0 if many else 100.0) + best + 1
    return digits


@kernel
def listed(s: State, c: Const) -> float:
    """Return the tests that have fired: as bits; of many tests the first ones, three digits each."""
    if c.tests <= AS_BITS:
        return float(s.fired[0])
    digits, count = 0.0, 0
    for k in range(c.tests):
        if _has(s.fired, k) and count < MOST_RANKED_LONG:
            digits = digits * 1000.0 + k + 1
            count += 1
    return digits


@kernel
def _diagnosis(s: State, c: Const) -> int:
    """Return the place of what is to be told of the tests that have fired, -1 if none has; the last: not isolated."""
    if _empty(s.fired):
        return -1
    _explain(s, c)
    if not _empty(s.explained):
        for k in range(c.told - 1):
            if _within(s.explained, c.diagnosis[k]) and _within(c.diagnosis[k], s.explained):
                return k
    return int(c.told) - 1


@kernel
def _judge(s: State, c: Const, k: int) -> None:
    """Take a residual into its test."""
    residual = s.residual[k]
    if c.jumps == 0:
        cusum.update(s.cusum[k], c.cusum[k], residual)
        s.norm[k] = cusum.normalised(s.cusum[k], c.cusum[k])
        return
    cusum.observe(s.cusum[k], residual)
    s.newest[0] = residual / c.sigma[k]
    ratio = likelihood.largest(s.begun_jump[k], c.weighted, c.inverse, s.newest, s.ring, s.window, 1, 1)
    s.norm[k] = ratio / c.level[k]
    s.cusum[k].peak = max(s.cusum[k].peak, s.norm[k])


@kernel
def _weigh(s: State, c: Const) -> None:
    """Take the residuals, if the generators have settled; leaves the tests that are above J in ``s.now``."""
    settled = s.at_ns - s.since_ns >= c.settle_ns
    if settled and c.jumps == 1:
        s.ring = (s.ring + 1) & (WINDOW - 1)
        s.window = min(s.window + 1, WINDOW)
    clear(s.now)
    for k in range(c.tests):
        if s.anew[k] == 1:
            s.from_ns[k] = s.at_ns
            for d in range(WINDOW):
                s.begun_jump[k, d, 0] = 0.0
        elif settled and s.at_ns - s.from_ns[k] >= c.settle_ns:
            _judge(s, c, k)
        if s.norm[k] > 1.0:
            include(s.now, k)


@kernel
def _join(s: State, c: Const) -> None:
    """Let tests join those that have fired, and leave them once they have been down for long enough."""
    for k in range(c.tests):
        if _has(s.now, k):
            s.up_ns[k] = s.at_ns
            if not _has(s.fired, k):
                include(s.fired, k)
                s.fired_ns = s.at_ns
        elif _has(s.fired, k) and s.at_ns - s.up_ns[k] >= c.confirm_ns:
            exclude(s.fired, k)


@kernel
def _measure(s: State, c: Const) -> None:
    """Estimate the sizes of the faults that have a meter, as long as a test has fired; NaN where nothing says it."""
    if c.meters == 0:
        return
    keep = exp(-s.dt / c.memory_s)
    nothing = _empty(s.fired)
    settled = s.at_ns - s.since_ns >= c.settle_ns
    for k in range(c.meters):
        gain, residual = s.gain[k], s.measured[k]
        if nothing:
            s.information[k] = s.product[k] = 0.0
            s.sizes[k] = 0.0
        if nothing or not settled:
            if isfinite(gain) and isfinite(residual):
                s.measured_then[k], s.gain_then[k] = residual, gain
            continue
        decay = exp(-c.forgets[k] * s.dt)
        s.measured_then[k] *= decay
        s.gain_then[k] *= decay
        gain -= s.gain_then[k]
        residual -= s.measured_then[k]
        if isfinite(gain) and isfinite(residual):
            s.information[k] = keep * s.information[k] + gain * gain
            s.product[k] = keep * s.product[k] - gain * residual
        s.sizes[k] = s.product[k] / s.information[k] if s.information[k] > 0.0 else nan


@kernel
def _tell(s: State, c: Const, out: Any, k: int, largest: float) -> None:
    """Report one thing that can be told of; with its evidence, if it is what was found."""
    e = report(out, k, k == s.found, largest, 1.0)
    if k != s.found:
        return
    _explain(s, c)
    for j in range(EVIDENCE):
        what = c.shown[k, j]
        if what >= 0:
            kind, number = what % KINDS, what // KINDS
            e.value[j] = s.residual[number] if kind == RESIDUAL else s.norm[number] if kind == NORM else s.sizes[number]
        elif what == LISTED:
            e.value[j] = listed(s, c)
        elif what == RANKED:
            e.value[j] = ranked(s, c)


@kernel
def decide(s: State, c: Const, out: Any) -> None:
    """Report what the tests say together, once that has stood for long enough."""
    _weigh(s, c)
    _join(s, c)
    _measure(s, c)
    if s.at_ns - s.fired_ns < c.confirm_ns or s.at_ns - s.since_ns < c.settle_ns:
        return
    count = min(c.told, AT_ONCE)
    if out.n + count + 2 > MAX_RESULTS:
        return  # behind several samples of one step: with the next one
    found = _diagnosis(s, c)
    stays = not _empty(s.fired) and 0 <= s.found < c.told - 1 and _within(s.fired, s.basis)
    if stays:
        found = s.found  # a fault that goes away: its tests come down one after the other, and say no more than before
    else:
        for w in range(len(s.basis)):
            s.basis[w] = s.fired[w]
    before = s.found
    if found == c.told - 1 != before and s.at_ns - s.fired_ns < PENDING * c.confirm_ns:
        return  # tests of one fault fire one after the other: one that is yet to come may tell it
    if found not in (-1, before) and _empty(s.now):
        return  # all of them are down, at least for now
    if found == before and s.reported_ns != 0 and s.at_ns - s.reported_ns < REPEAT_NS:
        return
    s.found, s.reported_ns = found, s.at_ns
    largest = 0.0
    for k in range(c.tests):
        largest = max(largest, s.norm[k])
    if c.told <= AT_ONCE:
        for k in range(c.told):
            _tell(s, c, out, k, largest)
        return
    if before >= 0 and before != found:
        _tell(s, c, out, before, largest)
    if found >= 0:
        _tell(s, c, out, found, largest)
    for n in range(count):
        k = (s.turn + n) % c.told
        if k not in (before, found):
            _tell(s, c, out, k, largest)
    s.turn = (s.turn + count) % c.told


def prepare(c: Const, k: int, nu: float, threshold: float, most: float) -> None:
    """Fill the constants of a test's decision.

    Args:
        c: record of Const.
        k: number of the test.
        nu: of its residual.
        threshold: J.
        most: of its CUSUM in units of J.
    """
    cusum.prepare(c.cusum[k], nu, nu * threshold, most)
    c.sigma[k], c.level[k] = nu / NU_OF_NOISE, threshold


def prepare_window(c: Const) -> None:
    """Fill the constants of the likelihood ratio of a jump of the mean: S = 1, J = d."""
    c.weighted[:] = 1.0
    for d in range(1, WINDOW):
        c.inverse[d, 0, 0] = 1.0 / d

"""What the tests of a monitor made from a model say together: its isolation is :mod:`gateway_fdi.isolation`'s.

Two ways to judge a residual: the CUSUM of what is beyond nu; or, for faults that begin at once, the likelihood ratio
that its mean has jumped at one of the last samples, against noise of a standard deviation that nu says.

That nothing explains what has fired is told only after :data:`PENDING` times as long as a name: tests of one fault
fire one after the other, and one that is yet to come may tell it. So one fault has one DTC.

A generator that gives no number (a root of what is negative, a division by zero) begins anew, and its test settles
again, alone.

The **size** of a fault is - residual / gain of the generator that checks its equation; of the samples since a test has
fired the least squares of it, forgetting. Where that generator is filtered, what its filter still has of the time
before is taken off both.
"""

from __future__ import annotations

from math import exp, isfinite, nan
from typing import Any

from gateway.monitors.contract import EVIDENCE, MAX_RESULTS, report
from gateway_fdi import cusum, likelihood
from gateway_fdi.isolation import machine, table
from gateway_fdi.isolation.table import NOTHING, OPEN
from gateway_fdi.jit import i8s, kernel
from gateway_fdi.masks import clear, copy, empty, has, include, within
from gateway_plants.structural.monitor.plan import Plan
from gateway_plants.structural.monitor.records import (
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
#: Faults that are told as one of several, at most.
MOST_TOGETHER = 3
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
def listed(s: State, c: Const) -> float:
    """Return the tests that have fired: as bits; of many tests the first ones, three digits each."""
    if c.tests <= AS_BITS:
        return float(s.fired[0])
    digits, count = 0.0, 0
    for k in range(c.tests):
        if has(s.fired, k) and count < MOST_RANKED_LONG:
            digits = digits * 1000.0 + k + 1
            count += 1
    return digits


@kernel
def _judge(s: State, c: Const, k: int) -> None:
    """Take a residual into its test."""
    residual = s.residual[k]
    if c.jumps == 0:
        s.norm[k] = cusum.update(s.cusum[k], c.cusum[k], residual)
        return
    cusum.observe(s.cusum[k], residual)
    s.newest[0] = residual / c.sigma[k]
    ratio = likelihood.largest(s.begun_jump[k], c.weighted, c.inverse, s.newest, s.ring, s.window, 1, 1)
    s.norm[k] = ratio / c.level[k]
    s.cusum[k].peak = max(s.cusum[k].peak, s.norm[k])


@kernel
def _weigh(s: State, c: Const) -> None:
    """Take the residuals, if the generators have settled; leaves the tests that are above J in ``s.up``."""
    settled = s.at_ns - s.since_ns >= c.settle_ns
    if settled and c.jumps == 1:
        s.ring = (s.ring + 1) & (WINDOW - 1)
        s.window = min(s.window + 1, WINDOW)
    clear(s.up)
    s.without = 0
    for k in range(c.tests):
        if s.anew[k] == 1:
            s.without += 1
            s.from_ns[k] = s.at_ns
            for d in range(WINDOW):
                s.begun_jump[k, d, 0] = 0.0
        elif s.waits[k] == 1:
            s.without += 1
        elif settled and s.at_ns - s.from_ns[k] >= c.settle_ns:
            _judge(s, c, k)
        if s.norm[k] > 1.0:
            include(s.up, k)


@kernel
def _measure(s: State, c: Const) -> None:
    """Estimate the sizes of the faults that have a meter, as long as a test has fired; NaN where nothing says it."""
    if c.meters == 0:
        return
    nothing = empty(s.fired)
    keep = 0.0 if nothing else exp(-s.dt / c.memory_s)
    settled = s.at_ns - s.since_ns >= c.settle_ns
    for k in range(c.meters):
        gain, residual = s.gain[k], s.measured[k]
        if nothing and (s.sizes[k] != 0.0 or s.information[k] != 0.0):
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
def sees(c: Const, group: int, k: int) -> bool:
    """Tell whether a test sees a fault of a group."""
    for fault in range(c.faults):
        if has(c.group[group], fault) and has(c.may[fault], k):
            return True
    return False


@kernel
def _is_tested(s: State, c: Const, group: int) -> bool:
    """Tell whether a test of a group's faults is at work; of what is not isolated, any test."""
    for k in range(c.tests):
        if s.anew[k] == 1 or s.waits[k] == 1:
            continue
        if group == c.groups or sees(c, group, k):
            return True
    return False


@kernel
def _tell(s: State, c: Const, out: Any, k: int, largest: float) -> None:
    """Report one thing that can be told of; with its evidence, if it is what was found."""
    if k != s.found and s.without > 0 and not _is_tested(s, c, k):
        return
    e = report(out, k, k == s.found, largest, 1.0)
    if k != s.found:
        return
    table.explain(s, c)
    if s.weighed > 0:
        copy(s.explained, s.likely)
    elif s.by_size == 1:
        for w in range(len(s.likely)):
            s.explained[w] &= s.likely[w]
    for j in range(EVIDENCE):
        what = c.shown[k, j]
        if what >= 0:
            kind, number = what % KINDS, what // KINDS
            e.value[j] = s.residual[number] if kind == RESIDUAL else s.norm[number] if kind == NORM else s.sizes[number]
        elif what == LISTED:
            e.value[j] = listed(s, c)
        elif what == RANKED:
            many = c.faults > TWO_DIGITS
            most = MOST_RANKED_LONG if many else MOST_RANKED
            e.value[j] = table.ranked(s, c, s.norm, 1000.0 if many else 100.0, most)


@kernel
def _count(mask: i8s, size: int) -> int:
    """Return how many are in a mask."""
    count = 0
    for k in range(size):
        count += 1 if has(mask, k) else 0
    return count


@kernel
def _answer(s: State, c: Const) -> int:
    """Return what the tests say: a group, or OPEN.

    Where they leave it open, it is the smallest group of all faults that are likely by sign and size; a group without
    one of these is not told.
    """
    said = table.answer(s, c)
    if s.weighed == 0 and s.by_size == 0:
        return int(said)
    if said >= 0 and s.weighed < 2 and not empty(s.likely) and within(s.likely, c.group[said]):
        return int(said)
    if said >= 0:
        clear(s.explained)
    if s.weighed != 1:
        return OPEN
    said = OPEN
    least = c.faults + 1
    for k in range(c.groups):
        count = _count(c.group[k], c.faults)
        if count < least and within(s.likely, c.group[k]):
            said, least = k, count
    return int(said)


@kernel
def _contradicted(s: State, c: Const) -> bool:
    """Return whether a test has fired that speaks against the name that stands."""
    return machine.contradicted(s) and not (s.weighed == 1 and within(s.likely, c.group[s.found]))


@kernel
def decide(s: State, c: Const, out: Any) -> None:
    """Report what the tests say together, once that has stood for long enough."""
    _weigh(s, c)
    past_ns = s.at_ns - s.judged_ns
    s.judged_ns = s.at_ns
    machine.stand(s, c, past_ns, past_ns)
    _measure(s, c)
    if s.joined_ns < c.confirm_ns or s.at_ns - s.since_ns < c.settle_ns:
        return
    before = s.found
    if empty(s.fired):
        s.found = NOTHING
    else:
        said = _answer(s, c)
        if said == OPEN and s.found == NOTHING and s.awaits == 1:
            return
        if said == OPEN and s.found == NOTHING and s.weighed == 1 and _count(s.likely, c.faults) <= MOST_TOGETHER:
            s.found = c.groups
        else:
            machine.decide(s, c, s.norm, said, 0 <= s.found < c.groups and _contradicted(s, c))
        if before == s.found == NOTHING:
            return  # undecided: neither passed nor failed
    if s.found == before and s.reported_ns != 0 and s.at_ns - s.reported_ns < REPEAT_NS:
        return
    s.reported_ns = s.at_ns
    largest = 0.0
    for k in range(c.tests):
        largest = max(largest, s.norm[k])
    _tell_all(s, c, out, before, largest)


@kernel
def _tell_all(s: State, c: Const, out: Any, before: int, largest: float) -> None:
    """Report all that can be told of; of many what has changed, and some of the others each time."""
    told = c.groups + 1
    if told <= AT_ONCE:
        for k in range(told):
            _tell(s, c, out, k, largest)
        return
    if before >= 0 and before != s.found:
        _tell(s, c, out, before, largest)
    if s.found >= 0:
        _tell(s, c, out, s.found, largest)
    for n in range(AT_ONCE):
        k = (s.turn + n) % told
        if k not in (before, s.found):
            _tell(s, c, out, k, largest)
    s.turn = (s.turn + AT_ONCE) % told


def prepare(c: Const, k: int, nu: float, threshold: float, most: float) -> None:
    """Fill the constants of a test's decision.

    Args:
        k: number of the test.
        nu: of its residual.
        threshold: J.
        most: of its CUSUM in units of J.
    """
    cusum.prepare(c.cusum[k], nu, nu * threshold, most)
    c.sigma[k], c.level[k] = nu / NU_OF_NOISE, threshold


def prepare_table(s: Any, c: Any, plan: Plan, confirm_ns: int) -> None:
    """Fill the isolation's table and times.

    Args:
        s: record of State.
        c: record of Const.
        plan: the tests, what they see, and what they cannot tell apart.
        confirm_ns: before a name is told, and before a test that has come down leaves [ns].
    """
    place = {fault: k for k, fault in enumerate(plan.faults)}
    table.prepare(
        c,
        [plan.seen_by(fault) for fault in plan.faults],
        [[place[fault] for fault in faults] for faults in plan.diagnoses],
        tests=len(plan.tests),
        size=max(len(plan.tests), len(plan.faults)),
    )
    machine.prepare(s, c, confirm_ns=confirm_ns, hold_ns=confirm_ns, pending_ns=PENDING * confirm_ns)


def prepare_window(c: Const) -> None:
    """Fill the constants of the likelihood ratio of a jump of the mean: S = 1, J = d."""
    c.weighted[:] = 1.0
    for d in range(1, WINDOW):
        c.inverse[d, 0, 0] = 1.0 / d

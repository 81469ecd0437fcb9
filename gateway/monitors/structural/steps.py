"""What all monitors made from a model do alike: samples, whether the model holds, what the tests say together.

A **sample** takes the newest value of each signal: by the clock at each multiple of the period, by sets when each
signal has come once more. In both cases no value may be too old, else it is left out and the next one spans the gap.
Behind too many that are missing, or while the model did not hold, everything begins anew, and settles.

A fault **explains** the tests that have fired if it is in the signature of each of them (one fault at a time). That a
test has not fired says nothing: it may be slow, or its fault not excited. So there is never a single name while
another fault fits too. What has a name keeps it until its last test has come down, or another one fires.
"""

from __future__ import annotations

from typing import Annotated, Any

from gateway.fdi import cusum
from gateway.jit import Record, f8, f8s, i8, i8s, kernel, means
from gateway.monitors.contract import report
from gateway.monitors.rule.machine import Code, Machine, run
from gateway.monitors.structural.plan import MOST_FAULTS, MOST_TESTS

#: Known variables of a model, things that can be told of, tests in the evidence of each.
MOST_INPUTS, MOST_TOLD, SHOWN = 64, 2 * MOST_FAULTS + 1, 3
#: What :func:`arrived` says: no sample; go on; begin anew; the very first.
NOTHING, GO, BEGIN, FIRST = range(4)
#: Time between two reports of the same [ns].
REPEAT_NS = 1_000_000_000
#: Faults that the evidence ranks.
RANKED = 6


class Const(Record):
    """Constants."""

    inputs: i8
    message: Annotated[i8s, MOST_INPUTS] = means("of each input, as u.trigger has it; -1: not connected")
    wanted: Annotated[i8s, MOST_INPUTS] = means("1: a sample needs it")
    sets: i8 = means("1: a sample is a set")
    period_ns: i8 = means(unit="ns")
    oldest_ns: i8 = means("greatest age of a value", "ns")
    gap_ns: i8 = means("behind a longer one all begins anew", "ns")
    settle_ns: i8 = means(unit="ns")
    confirm_ns: i8 = means(unit="ns")
    active: Code
    tests: i8
    faults: i8
    told: i8
    signature: Annotated[i8s, MOST_FAULTS] = means("tests that see each fault, as bits")
    diagnosis: Annotated[i8s, MOST_TOLD] = means("faults that each result stands for, as bits; 0: not isolated")
    shown: Annotated[i8s, MOST_TOLD, SHOWN] = means("tests in the evidence of each; -1: none")
    cusum: Annotated[list[cusum.Const], MOST_TESTS]


class State(Record):
    """State."""

    came_ns: Annotated[i8s, MOST_INPUTS] = means("when each input came", "ns")
    fresh: Annotated[i8s, MOST_INPUTS] = means("bit 1: it came ever; bit 0: behind the last sample")
    tick_ns: i8 = means("next sample by the clock", "ns")
    last_ns: i8 = means("last sample", "ns")
    since_ns: i8 = means("when the generators began", "ns")
    running: i8
    begun: i8
    samples: i8
    missed: i8 = means("samples that were left out, for a value too old")
    dt: f8 = means("since the sample before", "s")
    active: Machine
    residual: Annotated[f8s, MOST_TESTS]
    norm: Annotated[f8s, MOST_TESTS] = means("T over J: above 1 a test has fired")
    cusum: Annotated[list[cusum.State], MOST_TESTS]
    fired: i8
    fired_ns: i8 = means("since when these have fired", "ns")
    found: i8 = means("what was reported, -1: nothing")
    basis: i8 = means("tests that had fired for that")
    reported_ns: i8 = means(unit="ns")


@kernel
def _take_arrivals(s: State, c: Const, u: Any) -> None:
    """Note what has come."""
    if u.trigger < 0:
        return
    for k in range(c.inputs):
        if c.message[k] == u.trigger:
            s.came_ns[k] = u.t_ns
            s.fresh[k] = 3


@kernel
def _due(s: State, c: Const, t_ns: int, out: Any) -> bool:
    """Tell whether it is time for a sample; by the clock it asks to be woken for the next."""
    if c.sets == 1:
        for k in range(c.inputs):
            if c.wanted[k] == 1 and s.fresh[k] & 1 == 0:
                return False
        return True
    if s.tick_ns == 0:
        for k in range(c.inputs):
            if c.wanted[k] == 1 and s.fresh[k] == 0:
                return False
        s.tick_ns = (t_ns + c.period_ns - 1) // c.period_ns * c.period_ns
    if t_ns < s.tick_ns:
        out.wake_ns = s.tick_ns
        return False
    s.tick_ns += ((t_ns - s.tick_ns) // c.period_ns + 1) * c.period_ns
    out.wake_ns = s.tick_ns
    return True


@kernel
def _young(s: State, c: Const, t_ns: int) -> bool:
    """Tell whether no value is too old."""
    for k in range(c.inputs):
        if c.wanted[k] == 1 and t_ns - s.came_ns[k] > c.oldest_ns:
            return False
    return True


@kernel
def arrived(s: State, c: Const, u: Any, out: Any) -> int:
    """Take a step's cause; returns what is to be done now, and leaves the time since the sample before in ``s.dt``."""
    _take_arrivals(s, c, u)
    if not _due(s, c, u.t_ns, out):
        return NOTHING
    if not _young(s, c, u.t_ns):
        if c.sets == 0:
            s.missed += 1
        return NOTHING
    for k in range(c.inputs):
        s.fresh[k] &= 2
    if c.active.length > 0:
        holds = run(s.active, c.active, u.t_ns, u.value, 0.0)
        if s.active.unknown == 1 or holds == 0.0:
            s.running = 0
            return NOTHING
    apart = u.t_ns - s.last_ns
    if c.sets == 1:  # frames come a little early and late; the sender's samples do not
        apart = max((2 * apart + c.period_ns) // (2 * c.period_ns), 1) * c.period_ns
    what = GO if s.running == 1 and apart <= c.gap_ns else BEGIN if s.begun == 1 else FIRST
    s.dt = apart * 1e-9 if what == GO else 0.0
    if what != GO:
        s.since_ns = u.t_ns
    s.running, s.begun = 1, 1
    s.last_ns = u.t_ns
    s.samples += 1
    return what


@kernel
def explaining(c: Const, fired: int) -> int:
    """Return the faults, as bits, that explain what has fired; none if nothing has."""
    found = 0
    for k in range(c.faults):
        if fired != 0 and fired & ~c.signature[k] == 0:
            found |= 1 << k
    return found


@kernel
def likelihood(s: State, c: Const, fault: int) -> float:
    """Return how near a fault's tests are to firing, 1 when all have: mean of T over J, each at most 1."""
    total, count = 0.0, 0
    for k in range(c.tests):
        if c.signature[fault] >> k & 1 == 1:
            total += min(s.norm[k], 1.0)
            count += 1
    return total / count if count > 0 else 0.0


@kernel
def ranked(s: State, c: Const, faults: int) -> float:
    """Return faults, likeliest first, two digits each: 205 is the second, then the fifth."""
    digits, left = 0.0, faults
    for _ in range(RANKED):
        best, most = -1, -1.0
        for k in range(c.faults):
            if left >> k & 1 == 1 and likelihood(s, c, k) > most:
                best, most = k, likelihood(s, c, k)
        if best < 0:
            break
        left &= ~(1 << best)
        digits = digits * 100.0 + best + 1
    return digits


@kernel
def diagnosis(c: Const, fired: int) -> int:
    """Return the place of what is to be told of the tests that have fired, -1 if none has; the last: not isolated."""
    if fired == 0:
        return -1
    faults = explaining(c, fired)
    for k in range(c.told - 1):
        if faults != 0 and c.diagnosis[k] == faults:
            return k
    return int(c.told) - 1


@kernel
def weigh(s: State, c: Const, t_ns: int) -> int:
    """Take the residuals, if the generators have settled; returns the tests that have fired, as bits."""
    settled = t_ns - s.since_ns >= c.settle_ns
    fired = 0
    for k in range(c.tests):
        residual = s.residual[k]
        if settled and residual == residual:  # noqa: PLR0124 - not NaN
            cusum.update(s.cusum[k], c.cusum[k], residual)
            s.norm[k] = cusum.normalised(s.cusum[k], c.cusum[k])
        if s.norm[k] > 1.0:
            fired |= 1 << k
    return fired


@kernel
def decide(s: State, c: Const, u: Any, out: Any) -> None:
    """Report what the tests say together, once that has stood for long enough."""
    fired = weigh(s, c, u.t_ns)
    if fired != s.fired:
        s.fired, s.fired_ns = fired, u.t_ns
    if u.t_ns - s.fired_ns < c.confirm_ns or u.t_ns - s.since_ns < c.settle_ns:
        return
    found = diagnosis(c, fired)
    if fired != 0 and 0 <= s.found < c.told - 1 and fired & ~s.basis == 0:
        found = s.found  # a fault that goes away: its tests come down one after the other, and say no more than before
    else:
        s.basis = fired
    if found == s.found and s.reported_ns != 0 and u.t_ns - s.reported_ns < REPEAT_NS:
        return
    s.found, s.reported_ns = found, u.t_ns
    largest = 0.0
    for k in range(c.tests):
        largest = max(largest, s.norm[k])
    for k in range(c.told):
        e = report(out, k, k == found, largest, 1.0)
        if k != found:
            continue
        for j in range(SHOWN):
            test = c.shown[k, j]
            if test >= 0:
                e.value[2 * j] = s.residual[test]
                e.value[2 * j + 1] = s.norm[test]
        e.value[2 * SHOWN] = fired
        e.value[2 * SHOWN + 1] = ranked(s, c, explaining(c, fired))

"""What the tests say together: the fault, the ambiguity group, the message."""

from __future__ import annotations

from typing import Annotated

from gateway.jit import Record, f8, f8s, kernel, means
from gateway.monitors.contract import Emission, Evidence, Out, report
from gateway.monitors.truck import isolation, observer
from gateway.monitors.truck.faults import UNISOLATED
from gateway.monitors.truck.params import Params
from gateway.monitors.truck.records import (
    MIXED,
    ROBUST,
    T1,
    T2,
    T3_ABSOLUTE,
    T3_MIXED,
    T3_SIGNED,
    T4_ABSOLUTE,
    T4_MIXED,
    T4_SIGNED,
    T5,
    T6,
    Const,
    State,
)

#: Use of the machine without a test that has fired, after which what had fired is forgotten [s].
QUIET = 20.0
#: Likewise, after which a fault that has its name is taken to be gone: its tests come down while little current flows.
HEALS = 60.0
#: T_norm of a test that may fire.
ON_ITS_WAY = 0.5
#: Sets in which the machine is used, and sets in all, for which a fault that may be named yet is not told as one that
#: is not isolated.
PENDING, LATEST = 6000, 18000
#: Sets between two reports of the same.
REPEAT = 100
#: Largest T_norm that the message can carry.
_SHOWN = 5.1


class Outputs(Record):
    """What it sends."""

    level: Annotated[f8s, isolation.MOST_TESTS] = means("T_norm of the tests")
    fired: f8 = means("tests that have fired, as bits")
    diagnosis: f8 = means("number of the fault, from 1; 0: none")
    valid: f8


def emits(_: Params) -> Emission:
    """Return the message."""
    tests = tuple(f"Tn_{k + 1}" for k in range(isolation.MOST_TESTS))
    return Emission("FDI_STATUS", {"level": tests, "fired": "Fired", "diagnosis": "Diagnosis", "valid": "Valid"})


@kernel
def _weigh(s: State, c: Const) -> int:
    """Put T_norm of the tests that decide in their places; returns those that have fired, as bits."""
    s.level[0], s.level[1] = s.norm[T1], s.norm[T2]
    if c.system == ROBUST:
        s.level[2], s.level[3], s.level[4] = s.norm[T5], s.norm[T6], s.observer.norm
    elif c.system == MIXED:
        s.level[2], s.level[3] = s.norm[T3_MIXED], s.norm[T4_MIXED]
    else:
        # Remark 4: two conditions, either of which suffices.
        s.level[2] = max(s.norm[T3_SIGNED], s.norm[T3_ABSOLUTE])
        s.level[3] = max(s.norm[T4_SIGNED], s.norm[T4_ABSOLUTE])
    fired = 0
    for place in range(len(s.level)):
        if s.level[place] > 1.0:
            fired |= 1 << place
    return fired


@kernel
def _settled(s: State, c: Const) -> bool:
    """Tell whether the machine has been used for long enough since a test fired last, and no other is on its way."""
    for place in range(len(s.level)):
        if c.isolation.signature[s.found] >> place & 1 == 0 and s.level[place] > ON_ITS_WAY:
            return False
    return bool(s.settled >= c.settle)


@kernel
def _waits(s: State, c: Const, settles: bool) -> bool:
    """Tell whether a fault may still be named: it settles, or tests of one that explains what has fired may come.

    A fault's tests fire one behind the other, as the machine is used. When that has been used for long enough, and none
    of these tests is on its way, or when much time has passed, the tests do not tell more.
    """
    s.pending += 1
    if s.used == 1:
        s.pending_used += 1
    if s.explained == 0 or s.pending >= LATEST:
        return False
    if s.pending_used < PENDING or settles:
        return True
    for k in range(len(c.isolation.signature)):
        if s.explained >> k & 1 == 0:
            continue
        for place in range(len(s.level)):
            awaited = c.isolation.signature[k] >> place & 1 == 1 and s.seen >> place & 1 == 0
            if awaited and s.level[place] > ON_ITS_WAY:
                return True
    return False


@kernel
def decide(s: State, c: Const, out: Out[Evidence, Outputs]) -> None:
    """Report which fault is isolated, or that one is not."""
    fired = _weigh(s, c)
    changed = fired != s.fired
    s.fired = fired
    if fired & ~s.seen != 0:
        s.settled = 0.0
    s.seen |= fired
    if fired != 0:
        s.quiet = 0.0
    elif s.quiet >= (QUIET if s.named < 0 else HEALS) or c.system != ROBUST:
        s.seen = 0
    # With the paper's systems what has fired decides; beyond it what has since all were quiet: a second fault's test
    # that comes down for want of use is not forgotten, nor a single one's.
    s.found = isolation.isolated(c.isolation, s.seen if c.system == ROBUST else fired)
    s.explained = isolation.candidates(c.isolation, s.seen if c.system == ROBUST else fired)
    settles = s.found >= 0 and s.settled < c.settle
    if s.found != s.named and (fired == 0 or (s.found >= 0 and not _settled(s, c))):
        s.found = -1  # a second fault's tests may be on their way
    unisolated = fired != 0 and s.found < 0 and not _waits(s, c, settles)
    if s.seen == 0 or s.found >= 0:
        s.pending = s.pending_used = 0
    changed = changed or s.found != s.named or unisolated != (s.unisolated == 1)
    s.unisolated = unisolated
    s.named = s.found
    s.reported += 1
    if not changed and s.reported < REPEAT:
        return
    s.reported = 0
    largest = 0.0
    for place in range(len(s.level)):
        largest = max(largest, s.level[place])
    for k in range(UNISOLATED + 1):
        failed = k == s.found if k < UNISOLATED else unisolated
        e = report(out, k, failed, largest, 1.0)
        if failed:
            for j in range(c.tests):
                e.value[j] = s.level[j]
            e.value[c.tests] = fired
            e.value[c.tests + 1] = isolation.ranked(c.isolation, s.explained, s.level)
            e.value[c.tests + 2] = s.observer.error[observer.MOTOR]


@kernel
def tell(s: State, out: Out[Evidence, Outputs]) -> None:
    """Send how far the tests are, and the diagnosis: the fault's place and 1, or 6 for one that is not isolated."""
    out.send = 1
    for place in range(len(s.level)):
        out.values.level[place] = min(s.level[place], _SHOWN)
    out.values.fired = s.fired
    out.values.diagnosis = s.found + 1 if s.found >= 0 else (UNISOLATED + 1 if s.unisolated else 0)
    out.values.valid = s.valid

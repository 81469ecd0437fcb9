"""What the tests say together: the fault, the ambiguity group, the message."""

from __future__ import annotations

from typing import Annotated

from gateway.monitors.contract import Emission, Evidence, Out, report
from gateway_fdi.isolation import machine, table
from gateway_fdi.jit import Record, f8, f8s, kernel, means
from gateway_fdi.linear_algebra import copy
from gateway_plants.truck.monitor import isolation, observer
from gateway_plants.truck.monitor.faults import UNISOLATED
from gateway_plants.truck.monitor.params import Params
from gateway_plants.truck.monitor.records import T1, T2, T5, T6, Const, State

#: Sets between two reports of the same.
REPEAT = 100
TESTS = len(isolation.TESTS)
#: Largest T_norm that the message can carry.
_SHOWN = 5.1


class Outputs(Record):
    """What it sends."""

    level: Annotated[f8s, TESTS] = means("T_norm of the tests")
    fired: f8 = means("tests that have fired, as bits")
    diagnosis: f8 = means("number of the fault, from 1; 0: none")
    valid: f8 = means("1: the model of T7 holds")


def emits(_: Params) -> Emission:
    """Return the message."""
    tests = tuple(f"Tn_{k + 1}" for k in range(TESTS))
    return Emission("FDI_STATUS", {"level": tests, "fired": "Fired", "diagnosis": "Diagnosis", "valid": "Valid"})


@kernel
def _weigh(s: State) -> int:
    """Put T_norm of the tests that decide in their places; returns those that have fired, as bits."""
    s.level[0], s.level[1], s.level[2], s.level[3] = s.norm[T1], s.norm[T2], s.norm[T5], s.norm[T6]
    s.level[4] = s.observer.norm
    fired = 0
    for place in range(len(s.level)):
        if s.level[place] > 1.0:
            fired |= 1 << place
    return fired


@kernel
def decide(s: State, c: Const, dt: float, out: Out[Evidence, Outputs]) -> None:
    """Report which fault is isolated, or that one is not.

    Args:
        dt: since the set before [s].
        out: results.
    """
    x, fired = s.isolation, _weigh(s)
    changed = fired != s.fired
    s.fired, x.up[0] = fired, fired
    machine.stand(x, c.isolation, int(dt * 1e9), int(s.use * 1e9))
    s.use = 0.0
    before = x.found
    machine.decide(x, c.isolation, s.level, table.answer(x, c.isolation), machine.contradicted(x))
    s.explained = x.explained[0]
    s.unisolated = 1 if x.found == UNISOLATED else 0
    s.named = x.found if s.unisolated == 0 else table.NOTHING
    s.reported += 1
    if not changed and x.found == before and s.reported < REPEAT:
        return
    s.reported = 0
    largest = 0.0
    for place in range(len(s.level)):
        largest = max(largest, s.level[place])
    for k in range(UNISOLATED + 1):
        failed = k == x.found
        e = report(out, k, failed, largest, 1.0)
        if failed:
            copy(e.value, s.level, TESTS)
            e.value[TESTS] = fired
            e.value[TESTS + 1] = table.ranked(x, c.isolation, s.level, 10.0, UNISOLATED)
            e.value[TESTS + 2] = s.observer.error[observer.MOTOR]


@kernel
def tell(s: State, out: Out[Evidence, Outputs]) -> None:
    """Send how far the tests are, and the diagnosis: the fault's place and 1, or 6 for one that is not isolated."""
    out.send = 1
    for place in range(len(s.level)):
        out.values.level[place] = min(s.level[place], _SHOWN)
    out.values.fired = s.fired
    out.values.diagnosis = s.isolation.found + 1
    out.values.valid = s.valid

"""What ``gateway check`` tells of the tests that will run."""

from __future__ import annotations

from collections.abc import Iterator

from gateway.fdi.structure.model import Model
from gateway.monitors.structural.faults import equations_in_words
from gateway.monitors.structural.params import Params
from gateway.monitors.structural.plan import Plan


def notes(model: Model, plan: Plan) -> tuple[str, ...]:
    """Return the tests, and the table of what they tell apart."""
    return (*_tests(model, plan), *_table(plan))


def _tests(model: Model, plan: Plan) -> Iterator[str]:
    for test in plan.tests:
        faults = ", ".join(test.faults) or "no fault"
        yield f"test {test.name} ({test.causality}) sees {faults}; it checks {equations_in_words(model, test)}"


def _table(plan: Plan) -> Iterator[str]:
    found = plan.isolability
    width = max(map(len, plan.faults), default=0)
    for k, fault in enumerate(plan.faults):
        others = [other for j, other in enumerate(plan.faults) if found.confused[k, j] and j != k]
        told = f"cannot be told from {', '.join(others)}" if others else "isolated"
        fired = " ".join(test.name for test in plan.tests if fault in test.faults)
        yield f"fault {fault:<{width}}  {told}; fires {fired}"


def warnings(plan: Plan, p: Params) -> tuple[str, ...]:
    """Return what is not wrong, but should be known."""
    silent = [test.name for test in plan.tests if test.name not in p.nu or test.name not in p.thresholds]
    lines = list(plan.told)
    if silent:
        lines.append(f"{', '.join(silent)} cannot fire without nu and thresholds: gateway calibrate finds them")
    return tuple(lines)

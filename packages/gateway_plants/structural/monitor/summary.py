"""What ``gateway check`` tells of the tests that will run."""

from __future__ import annotations

from collections.abc import Iterator

from gateway_fdi.structure.model import Model
from gateway_plants.structural.monitor import modes, observer, uncertain
from gateway_plants.structural.monitor.decision import AS_BITS, TWO_DIGITS
from gateway_plants.structural.monitor.faults import equations_in_words
from gateway_plants.structural.monitor.filters import bandwidths
from gateway_plants.structural.monitor.params import Params
from gateway_plants.structural.monitor.plan import Plan, Test


def notes(model: Model, plan: Plan, p: Params) -> tuple[str, ...]:
    """Return the tests, and the table of what they tell apart."""
    return (*_tests(model, plan, p), *_uncertain(model, plan, p), *_table(model, plan))


def _uncertain(model: Model, plan: Plan, p: Params) -> Iterator[str]:
    """Yield what may be off, and the tests that follow it."""
    for one in uncertain.slow_of(model, p):
        by = [test.name for test in plan.tests if uncertain.acts_on(one, test)]
        unit = "ms" if one.kind == "lag" else ""
        if one.kind == "bias" and one.name in model.quantities:
            unit = model.quantities[one.name].unit
        size = f"{100 * one.bound:g} %" if one.kind in ("parameter", "gain") else f"{one.bound:g} {unit}".strip()
        yield f"uncertain: {one.text} by up to {size}; followed by {' '.join(by) or 'no test: it changes none'}"


def _tests(model: Model, plan: Plan, p: Params) -> Iterator[str]:
    many = len(plan.tests) > AS_BITS
    for k, test in enumerate(plan.tests):
        faults = ", ".join(test.faults) or "no fault"
        number = f"{k + 1} " if many else ""
        fitted = bandwidths(test, p).said
        yield (
            f"test {number}{test.name} ({test.causality}) sees {faults}; it checks {equations_in_words(model, test)}"
            f"{f'; {fitted}' if fitted else ''}{_modes(model, test, p)}"
        )


def _modes(model: Model, test: Test, p: Params) -> str:
    found = modes.modes(model, test, p)
    told = "" if found is None else f"; {modes.in_words(found, p)}"
    seen = observer.observer_of(model, test, p) if test.observed else None
    if seen is None:
        return told
    return f"{told}; corrected by its residual, so that {seen.slowest:.4g} of an error is left a sample"


def _table(model: Model, plan: Plan) -> Iterator[str]:
    found = plan.isolability
    width = max(map(len, plan.faults), default=0)
    many = len(plan.faults) > TWO_DIGITS
    for k, fault in enumerate(plan.faults):
        others = [other for j, other in enumerate(plan.faults) if found.confused[k, j] and j != k]
        told = f"cannot be told from {', '.join(others)}" if others else "isolated"
        fired = " ".join(test.name for test in plan.tests if fault in test.faults)
        size = ""
        if fault in plan.measured:
            unit = model.quantities[fault].unit if fault in model.quantities else ""
            size = f"; size{f' [{unit}]' if unit not in ('', '1') else ''} by {_meter(plan, fault)}"
        number = f"{k + 1} " if many else ""
        yield f"fault {number}{fault:<{width}}  {told}; fires {fired}{_fleeting(plan, fault)}{size}"


def _fleeting(plan: Plan, fault: str) -> str:
    """Return which tests see a fault only while it changes."""
    some = [test.name for test in plan.tests if fault in test.fleeting]
    every = len(some) == len(plan.seen_by(fault))
    return f" (only while it changes{'' if every else ': ' + ' '.join(some)})" if some else ""


def _meter(plan: Plan, fault: str) -> str:
    """Return what measures a fault: a test, or the equation that is checked for it alone."""
    generator = plan.generators[plan.measured[fault]]
    return generator.name if generator in plan.tests else generator.consistency


def warnings(model: Model, plan: Plan, p: Params) -> tuple[str, ...]:
    """Return what is not wrong, but should be known."""
    silent = [test.name for test in plan.tests if test.name not in p.nu or test.name not in p.thresholds]
    unknown = [test.name for test in plan.tests if test.name not in silent and test.name not in p.digests]
    lines = [*plan.told, *modes.warnings(model, plan, p), *modes.runs_away(model, plan, p)]
    if unknown:
        lines.append(
            f"digests: nothing says for which tests nu and thresholds of {', '.join(unknown)} were found, so a change"
            " of the model or of tests is not noticed: gateway calibrate --write keeps that"
        )
    if silent:
        lines.append(f"{', '.join(silent)} cannot fire without nu and thresholds: gateway calibrate finds them")
    return tuple(lines)

"""What a monitor made from a model can report: its faults, the groups that cannot be told apart, and the rest."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from gateway.fdi.structure.model import Model
from gateway.monitors.contract import Debounce, Fault
from gateway.monitors.structural.plan import Plan, Test
from gateway.monitors.structural.steps import SHOWN

#: Name of what no fault alone, and no group, explains.
UNISOLATED = "unisolated"
#: Length of a name, beyond which groups have numbers.
_MOST_NAME = 60

_FOUND = Debounce(failed_after=1, passed_after=1)


def names_of(plan: Plan) -> tuple[str, ...]:
    """Return the names of the faults, in the order in which they are reported."""
    names: list[str] = []
    for faults in plan.diagnoses:
        name = "_or_".join(faults)
        names.append(name if len(name) <= _MOST_NAME else f"group_{len(names) + 1}")
    return (*names, UNISOLATED)


def shown_tests(plan: Plan) -> Iterator[list[int]]:
    """Yield, for each of them, the tests that its evidence shows."""
    for faults in plan.diagnoses:
        yield [k for k, test in enumerate(plan.tests) if set(faults) <= set(test.faults)][:SHOWN]
    yield list(range(min(SHOWN, len(plan.tests))))


def equations_in_words(model: Model, test: Test) -> str:
    """Return what a test checks, and what it computes that from."""
    check = model.by_name[test.consistency]
    said = f"{check.name} ({check.text})" if check.text else check.name
    relation = f"{said}: {check.relation.text}" if check.relation is not None else said
    if check.differential:
        relation = f"{said}: the slope of {check.differential}"
    used = [name for name in test.equations if name != test.consistency]
    return f"{relation}, by {', '.join(used)}" if used else relation


def _text(model: Model, fault: str) -> str:
    quantity = model.quantities.get(fault)
    return quantity.text if quantity is not None and quantity.text else fault


def _labels(model: Model, plan: Plan, tests: Iterable[int]) -> tuple[str, ...]:
    """Return the names of the evidence."""
    found = []
    for k in tests:
        test = plan.tests[k]
        unit = f" [{test.unit}]" if test.unit else ""
        found += [f"residual of {test.name}, {equations_in_words(model, test)}{unit}", f"T over J of {test.name}"]
    found += [f"(not used {k})" for k in range(len(found), 2 * SHOWN)]
    bits = ", ".join(f"{test.name} {1 << k}" for k, test in enumerate(plan.tests))
    places = ", ".join(f"{k + 1} {fault}" for k, fault in enumerate(plan.faults))
    ranked = f"faults that explain them, likeliest first, two digits each ({places})"
    return (*found, f"tests that have fired ({bits})", ranked)


def faults_of(model: Model, plan: Plan, codes: dict[str, str]) -> tuple[Fault, ...]:
    """Return what can be reported.

    Args:
        model: the model.
        plan: the tests.
        codes: base code of each.
    """
    found = []
    diagnoses: list[tuple[str, ...]] = [*plan.diagnoses, ()]
    for name, faults, tests in zip(names_of(plan), diagnoses, shown_tests(plan), strict=True):
        words = " or ".join(_text(model, fault) for fault in faults)
        if not faults:
            text, kind = f"{model.name}: a fault that is not isolated (yet), or several", "62"
        elif len(faults) > 1:
            text, kind = f"{words}: the tests cannot tell these apart", "62"
        else:
            text, kind = words, "64"
        checks = "; ".join(f"{plan.tests[k].name} checks {equations_in_words(model, plan.tests[k])}" for k in tests)
        remedy = f"{f'look at {words}' if faults else 'look at what the fired tests have in common'}; {checks}"
        labels = _labels(model, plan, tests)
        found.append(Fault(name, f"{codes[name]}-{kind}", text, labels, _FOUND, remedy=remedy))
    return tuple(found)

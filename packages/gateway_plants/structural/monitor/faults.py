"""What a monitor made from a model can report: its faults, the groups that cannot be told apart, and the rest."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from math import inf, nan
from typing import Any, NamedTuple

import numpy as np

from gateway.monitors.contract import TOGETHER, VAGUE, Blame, Debounce, Fault
from gateway.monitors.evidence import as_bits, as_digits, words_of
from gateway_fdi.masks import unpack
from gateway_fdi.structure.model import Model
from gateway_plants.structural.monitor import fault_likelihood
from gateway_plants.structural.monitor.decision import AS_BITS, TWO_DIGITS
from gateway_plants.structural.monitor.plan import Plan, Test
from gateway_plants.structural.monitor.records import SHOWN

#: Name of what no fault alone, and no group, explains.
UNISOLATED = "unisolated"
#: Sizes that the evidence of a group shows.
MOST_SIZES = 2
#: Length of a name, beyond which groups have numbers.
_MOST_NAME = 60

_FOUND = Debounce(failed_after=1, passed_after=1)
#: What a verdict rests on.
_LARGEST = "largest test against its limit [times]"


def names_of(plan: Plan) -> tuple[str, ...]:
    """Return the names of the faults, in the order in which they are reported."""
    names: list[str] = []
    for faults in plan.diagnoses:
        name = "_or_".join(faults)
        names.append(name if len(name) <= _MOST_NAME else f"group_{len(names) + 1}")
    return (*names, UNISOLATED)


class Shown(NamedTuple):
    """What the evidence of a result shows.

    Attributes:
        tests: by their numbers; of each residual and T over J.
        meters: sizes, by their place in :attr:`Plan.measured`.
    """

    tests: list[int]
    meters: list[int]


def shown(plan: Plan) -> Iterator[Shown]:
    """Yield what the evidence of each result shows: up to three tests, or two and the sizes of up to two faults."""
    place = {fault: k for k, fault in enumerate(plan.measured)}
    for faults in plan.diagnoses:
        meters = [place[fault] for fault in faults if fault in place][:MOST_SIZES]
        tests = [k for k, test in enumerate(plan.tests) if set(faults) <= set(test.faults)]
        yield Shown(tests[: SHOWN - 1 if meters else SHOWN], meters)
    yield Shown(list(range(min(SHOWN, len(plan.tests)))), [])


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


def _labels(model: Model, plan: Plan, what: Shown) -> tuple[str, ...]:
    """Return the names of the evidence."""
    found = []
    for k in what.tests:
        test = plan.tests[k]
        unit = f" [{test.unit}]" if test.unit else ""
        found += [
            f"residual of test {_short(test)}, {_checked(model, test)}{unit}",
            f"test {_short(test)} against its limit [times]",
        ]
    faults = list(plan.measured)
    found += [f"size of the fault: {_size_in_words(model, faults[k])}" for k in what.meters]
    bits, two = len(plan.tests) <= AS_BITS, len(plan.faults) <= TWO_DIGITS
    fired, ranked = "tests that have fired", "faults that explain them, likeliest first"
    names = [_text(model, fault) for fault in plan.faults]
    return (
        *found,
        as_bits(fired, [_short(test) for test in plan.tests]) if bits else as_digits(f"first {fired}", (), 3),
        as_digits(ranked, names, 2) if two else as_digits(ranked, (), 3),
    )


def _short(test: Test) -> str:
    """Return the name of a test for people."""
    return test.name.replace("_", "/")


def _checked(model: Model, test: Test) -> str:
    """Return what a test checks, for people; ``gateway check`` has the equations."""
    check = model.by_name[test.consistency]
    return check.text or words_of(check.name)


def _size_in_words(model: Model, fault: str) -> str:
    """Return what the size of a fault is: its text, or where it stands, and its unit."""
    (where,) = (e for e in model.equations if fault in e.faults)
    quantity = model.quantities.get(fault)
    unit = f" [{quantity.unit}]" if quantity is not None and quantity.unit not in ("", "1") else ""
    text = _text(model, fault)
    return f"{text if text != fault else words_of(where.name)}{unit}"


def faults_of(model: Model, plan: Plan, codes: dict[str, str]) -> tuple[Fault, ...]:
    """Return what can be reported."""
    found = []
    diagnoses: list[tuple[str, ...]] = [*plan.diagnoses, ()]
    for name, faults, what in zip(names_of(plan), diagnoses, shown(plan), strict=True):
        words = " or ".join(_text(model, fault) for fault in faults)
        if not faults:
            text, kind = f"{model.name}: a fault that is not isolated (yet), or several", "62"
        elif len(faults) > 1:
            text, kind = f"{words}: the tests cannot tell these apart", "62"
        else:
            text, kind = words, "64"
        checks = "; ".join(f"test {_short(plan.tests[k])} checks {_checked(model, plan.tests[k])}" for k in what.tests)
        remedy = f"{f'look at {words}' if faults else 'look at what the fired tests have in common'}; {checks}"
        labels = _labels(model, plan, what)
        found.append(Fault(name, f"{codes[name]}-{kind}", text, labels, _FOUND, remedy=remedy, tested=_LARGEST))
    return tuple(found)


def blames(model: Model, plan: Plan) -> dict[str, list[Blame]]:
    """Return what each fault blames: the faults of the model that it stands for, and of what is not isolated, all.

    A fault in the equation of a sensor blames the sensor's signal, any other one the part that it is named after.
    Each blames the rest, too: of two faults that fire together what a third one would, the third one has the name.
    """
    sensors = _sensors(model)
    parts = {f: Blame(sensors[f]) if f in sensors else Blame(f, "plant") for f in plan.faults}
    own = {
        fault: tuple(other for other, too in zip(plan.faults, row, strict=True) if too)
        for fault, row in zip(plan.faults, plan.isolability.confused, strict=True)
    }
    found = {
        name: [parts[f] if own[f] == faults else parts[f]._replace(share=VAGUE) for f in faults]
        for name, faults in zip(names_of(plan), plan.diagnoses, strict=False)
    }
    every = dict.fromkeys(parts.values())
    for blamed in found.values():
        there = {(one.part, one.kind) for one in blamed}
        blamed += [one._replace(share=TOGETHER) for one in every if (one.part, one.kind) not in there]
    return found | {UNISOLATED: [*(one._replace(share=VAGUE) for one in every), Blame("model", "model")]}


#: How likely a test fires if a fault is there that it sees: of a large one all do, of a small one few.
_FIRES = 0.8
#: Likewise of one that sees only how it begins: it fails at first, and passes then.
_FLEETS = 0.5
#: How likely one fault alone looks like two. By it one of them is not told as the cause, and two neither: what a model
#: lacks may look so.
_LOOKS_LIKE_TWO = 0.002
#: How likely a fault that is there alone is not found unlikely (0.99), as :class:`Blame` has it.
_FITS = 1.1


def behind(model: Model, plan: Plan) -> dict[str, list[Blame]]:
    """Return whom the failure of each test blames: the faults that it sees, and the model.

    Behind the tests there are, where faults are weighed, one that fails if a fault fits, and three of each fault: one
    passes if it does not fit, and fails if it is one of two for sure; one fails if another one is there beside it; one
    if it fits alone, and two fit better.
    """
    sensors = _sensors(model)
    parts = {f: Blame(sensors[f]) if f in sensors else Blame(f, "plant") for f in plan.faults}
    every = [one._replace(share=_FIRES) for one in dict.fromkeys(parts.values())]
    weighed = {"fit": [*every, Blame("model", "model")]}
    weighed |= {f"fit of {f}": [parts[f]._replace(share=_FITS)] for f in plan.faults}
    others = {f: [one for one in every if one.part != parts[f].part] for f in plan.faults}
    weighed |= {f"more than {f}": others[f] for f in plan.faults}
    weighed |= {_better(f): others[f] for f in plan.faults}
    return (weighed if fault_likelihood.moved(plan) else {}) | {
        test.name: [
            *(parts[f]._replace(share=_FLEETS if f in test.fleeting else _FIRES) for f in test.faults if f in parts),
            Blame("model", "model"),
        ]
        for test in plan.tests
    }


def _better(fault: str) -> str:
    """Return the name of the test that fails if a fault fits alone, and two fit better."""
    return f"better than {fault}"


def false_alarms(plan: Plan) -> dict[str, float]:
    """Return how likely tests fail without a fault, of those that do so more often than others."""
    return dict.fromkeys(map(_better, plan.faults), _LOOKS_LIKE_TWO)


def levels(plan: Plan, state: Any) -> list[float]:
    """Return the levels of the tests: T over J, 1 at least as long as a test counts as one that has fired.

    Where nothing may be off, one that has fired for sure counts as long as any test is near: it may see only how a
    fault begins, and its pass would clear nothing.

    Where something may be off, tests say nothing until sizes do. Where sizes say which faults are likely, a test that
    has not fired says nothing; nor does one that some of these do not see: its residual is in what they say. One that
    has just fired says nothing where sizes have spoken: it may be another fault's. Where two fit better than a fault
    that fits alone, that is one more test of it, and each other fault alone is out of the question. Where nothing may
    be off, the tests name pairs; what sizes say of them is that one fault alone is unlikely.
    """
    own = state["own"]
    weighed: list[float] = []
    said = int(own["weighed"])
    if fault_likelihood.moved(plan):
        likely, paired, sure = (
            unpack(np.asarray(own[name])[None, :], len(plan.faults))[0] for name in ("likely", "paired", "sure")
        )
        named = plan.diagnoses[own["found"]] if own["by_size"] and 0 <= own["found"] < len(plan.diagnoses) else ()
        fit = state["fit"]
        doubted = {plan.faults[k] for k in fit["pair"] if said == 1 and fit["doubt"]}
        fits = [
            2.0 if said == 2 and two and not (f in named and len(named) > 1)
            else nan if one or pair or f in named or f in doubted else 0.0
            for f, one, pair, two in zip(plan.faults, likely, paired, sure, strict=True)
        ]  # fmt: skip
        alone = likely if said != 2 else np.zeros_like(likely)
        told = 1 - alone if said != 2 else sure if sure.any() else paired
        more = [2.0 if one and paired.any() else -inf for one in told]
        better = [2.0 if one and paired.any() else -inf for one in alone]
        weighed = [2.0, *fits, *more, *better]
        if said == 0 or (said < 0 and not paired.any()):
            weighed = [-inf] * len(weighed)
            if not own["by_size"] and _needs_two(fit):
                weighed[-len(better) :] = [2.0] * len(better)
        if said == 2 or (said != 1 and own["by_size"] == 1):
            return weighed + [-inf] * len(plan.tests)
    fired, sure = (unpack(np.asarray(one)[None, :], len(plan.tests))[0] for one in (own["fired"], own["beyond"]))
    levels = [
        max(float(norm), fault_likelihood.SURE if was else 1.0) if up or was else min(float(norm), 0.0)
        for norm, up, was in zip(own["norm"], fired, sure & (own["by_size"] == 0), strict=False)
    ]
    if said != 0:
        names = doubted.union(f for f, one in zip(plan.faults, likely, strict=True) if one and said == 1)
        levels = [
            (nan if said == 1 else level) if level < 1.0
            else level if level >= fault_likelihood.SURE and names <= set(test.faults)
            else -inf
            for level, test in zip(levels, plan.tests, strict=True)
        ]  # fmt: skip
    return weighed + levels


def _needs_two(fit: Any) -> bool:
    """Return whether two faults fit better than the best one by a share of what that explains.

    A fault whose gains are off by a few percent leaves less than that share, however large it is.
    """
    more = fit["second"] * fit["excess"]
    return bool(fit["second"] > fault_likelihood.TWO and more > fault_likelihood.SHARE * fit["alone"].max())


def _sensors(model: Model) -> dict[str, str]:
    """Return the faults that add to what a sensor reads, whatever its factor: fault -> its known variable."""
    found: dict[str, str] = {}
    for equation in model.equations:
        if equation.relation is None or not equation.variables or len(equation.knowns) != 1:
            continue
        z, sides = equation.knowns[0], (equation.relation.left, equation.relation.right)
        for measured in (one.tree for one, other in zip(sides, sides[::-1], strict=True) if other.text == z):
            if (
                isinstance(measured, ast.BinOp)
                and isinstance(measured.op, ast.Add)
                and isinstance(measured.right, ast.Name)
            ):
                found |= {fault: z for fault in equation.faults if fault == measured.right.id}
    return found

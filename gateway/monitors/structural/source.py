"""The module of a monitor: its records, and the kernel that steps its residual generators."""

from __future__ import annotations

from gateway.fdi.structure.generator.records import GAIN, field_name
from gateway.fdi.structure.generator.sources import module_name
from gateway.monitors.structural.plan import Plan
from gateway.monitors.structural.records import lengths

#: Fields of the state that show how many samples there were, from those of its own.
COUNTS = {"samples_taken": "samples", "samples_missed": "missed"}


def fields_of(plan: Plan) -> list[str]:
    """Return the field of the constants of each generator."""
    return [f"generator_{k}" for k in range(len(plan.generators))]


def sizes_of(plan: Plan) -> list[str]:
    """Return the field of the state that shows each fault's size, in the order of :attr:`Plan.measured`."""
    return [f"size_{field_name(fault)}" for fault in plan.measured]


def _numbered(plan: Plan, form: str) -> list[str]:
    """Return a line for each generator: ``{k}`` its number, ``{g}`` its field."""
    return [form.format(k=k, g=g) for k, g in enumerate(fields_of(plan))]


#: A generator begins when all do, or alone when it gave no number.
_START = """\
        if what != sampling.GO or s.own.anew[{k}] == 1:
            m{k}.start(s.{g}, c.{g}, s.sample)"""


def _residuals(plan: Plan) -> list[str]:
    """Return the lines that step the tests and the meters."""
    place = {k: j for j, k in enumerate(plan.measured.values())}
    lines = []
    for k, field in enumerate(fields_of(plan)):
        call = f"m{k}.step(s.{field}, c.{field}, s.sample, dt)"
        lines += [f"r = {call}", f"s.own.anew[{k}] = 0 if isfinite(r) else 1"]
        if k < len(plan.tests):
            lines.append(f"s.own.residual[{k}] = r")
        if k in place:
            lines += [f"s.own.measured[{place[k]}] = r", f"s.own.gain[{place[k]}] = s.{field}.{GAIN}"]
    return lines


def _records(plan: Plan, knowns: tuple[str, ...]) -> list[str]:
    """Return the lines of the module's records."""
    return [
        f"ROOM = {lengths(plan, len(knowns))}",
        "",
        "",
        "class OwnState(records.State, lengths=ROOM):",
        "    pass",
        "",
        "",
        "class OwnConst(records.Const, lengths=ROOM):",
        "    pass",
        "",
        "",
        "class Inputs(contract.Inputs):",
        f"    value: Annotated[f8s, {len(knowns)}]",
        "",
        "",
        "class Sample(Record):",
        *(f"    {field_name(z)}: f8" for z in (*knowns, *plan.rates)),
        "",
        "",
        "class State(Record):",
        "    own: OwnState",
        "    sample: Sample",
        *_numbered(plan, "    {g}: m{k}.State"),
        *(f"    {name}: f8" for name in (*sizes_of(plan), *COUNTS)),
        "",
        "",
        "class Const(Record):",
        "    own: OwnConst",
        *_numbered(plan, "    {g}: m{k}.Const"),
        "",
        "",
    ]


def module_of(plan: Plan, knowns: tuple[str, ...]) -> str:
    """Return the source of a monitor's module.

    Args:
        plan: its tests; their modules are to be loaded before this one.
        knowns: known variables of the model, in the order of the inputs.
    """
    imports = [f"import {module_name(test.source)} as m{k}" for k, test in enumerate(plan.generators)]
    taken = [f"s.sample.{field_name(z)} = s.own.taken[{k}]" for k, z in enumerate(knowns)]
    return "\n".join(
        [
            '"""A monitor made from its model, not by hand."""',
            "",
            "from math import isfinite",
            "from typing import Annotated, Any",
            "",
            *imports,
            "",
            "from gateway.jit import Record, f8, f8s, kernel",
            "from gateway.monitors import contract",
            "from gateway.monitors.structural import decision, records, sampling",
            "",
            "",
            *_records(plan, knowns),
            "@kernel",
            "def step(s: State, c: Const, u: Inputs, out: Any) -> None:",
            '    """Take a frame or the clock; when a sample is due, step all tests."""',
            "    what = sampling.arrived(s.own, c.own, u, out)",
            "    while what != sampling.NOTHING:",
            *(f"        {line}" for line in taken),
            "        if what == sampling.FIRST:",
            *_numbered(plan, "            m{k}.reset(s.{g}, c.{g})"),
            *_numbered(plan, _START),
            "        dt = s.own.dt",
            *(f"        {line}" for line in _residuals(plan)),
            "        decision.decide(s.own, c.own, out)",
            *(f"        s.{name} = s.own.sizes[{j}]" for j, name in enumerate(sizes_of(plan))),
            "        what = sampling.again(s.own, c.own, u)",
            *(f"    s.{name} = s.own.{field}" for name, field in COUNTS.items()),
            "",
        ]
    )

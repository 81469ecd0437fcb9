"""The module of a monitor: its records, and the kernel that steps its residual generators."""

from __future__ import annotations

from gateway.fdi.structure.generator.records import field_name
from gateway.fdi.structure.generator.sources import module_name
from gateway.monitors.structural.plan import Plan


def fields_of(plan: Plan) -> list[str]:
    """Return the field of the constants of each test's generator."""
    return [f"generator_{k}" for k in range(len(plan.tests))]


def _numbered(plan: Plan, form: str) -> list[str]:
    """Return a line for each test: ``{k}`` its number, ``{g}`` its field."""
    return [form.format(k=k, g=g) for k, g in enumerate(fields_of(plan))]


def module_of(plan: Plan, knowns: tuple[str, ...]) -> str:
    """Return the source of a monitor's module.

    Args:
        plan: its tests; their modules are to be loaded before this one.
        knowns: known variables of the model, in the order of the inputs.
    """
    names = [f"{field_name(z)}: f8" for z in knowns] + [f"{field_name(z)}: f8" for z in plan.rates]
    imports = [f"import {module_name(test.source)} as m{k}" for k, test in enumerate(plan.tests)]
    taken = [f"    s.sample.{field_name(z)} = u.value[{k}]" for k, z in enumerate(knowns)]
    return "\n".join(
        [
            '"""A monitor made from its model, not by hand."""',
            "",
            "from typing import Annotated, Any",
            "",
            *imports,
            "",
            "from gateway.jit import Record, f8, f8s, kernel",
            "from gateway.monitors import contract",
            "from gateway.monitors.structural import steps",
            "",
            "",
            "class Inputs(contract.Inputs):",
            f"    value: Annotated[f8s, {len(knowns)}]",
            "",
            "",
            "class Sample(Record):",
            *(f"    {name}" for name in names),
            "",
            "",
            "class State(Record):",
            "    own: steps.State",
            "    sample: Sample",
            *_numbered(plan, "    {g}: m{k}.State"),
            "",
            "",
            "class Const(Record):",
            "    own: steps.Const",
            *_numbered(plan, "    {g}: m{k}.Const"),
            "",
            "",
            "@kernel",
            "def step(s: State, c: Const, u: Inputs, out: Any) -> None:",
            '    """Take a frame or the clock; when a sample is due, step all tests."""',
            "    what = steps.arrived(s.own, c.own, u, out)",
            "    if what == steps.NOTHING:",
            "        return",
            *taken,
            "    if what == steps.FIRST:",
            *_numbered(plan, "        m{k}.reset(s.{g}, c.{g})"),
            "    if what != steps.GO:",
            *_numbered(plan, "        m{k}.start(s.{g}, c.{g}, s.sample)"),
            "    dt = s.own.dt",
            *_numbered(plan, "    s.own.residual[{k}] = m{k}.step(s.{g}, c.{g}, s.sample, dt)"),
            "    steps.decide(s.own, c.own, u, out)",
            "",
        ]
    )

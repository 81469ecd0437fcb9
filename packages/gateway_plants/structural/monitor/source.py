"""The module of a monitor: its records, and the kernel that steps its residual generators."""

from __future__ import annotations

from collections.abc import Sequence

from gateway_fdi.structure.generator.records import DEAD, GAIN, HOLD, JACOBIAN, SLOPES, field_name
from gateway_fdi.structure.generator.sources import load_source, module_name
from gateway_plants.structural.monitor.fault_likelihood import STEP as SIZE
from gateway_plants.structural.monitor.fault_likelihood import lengths_of, moved
from gateway_plants.structural.monitor.plan import Plan, Test
from gateway_plants.structural.monitor.records import lengths
from gateway_plants.structural.monitor.uncertain import STEP, Slow, neighbours

#: Fields of the state that show how many samples there were, and tests without their inputs, from those of its own.
COUNTS = {"samples_taken": "samples", "samples_missed": "missed", "tests_without": "without"}


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
            m{k}.start(s.{g}, {model}, s.sample)"""
#: And its neighbours with it.
_START_NEAR = """
            for i in range({count}):
                m{k}.start(s.beside_{k}[i], s.near_{k}[i], s.read[c.acts_{k}[i]])"""


def _model(slow: Sequence[Slow], k: int, g: str) -> str:
    """Return where the constants of a generator are: those of the corrected model, where something may be off."""
    return f"s.model_{k}" if slow else f"c.{g}"


def _counts(plan: Plan, slow: Sequence[Slow]) -> list[int]:
    """Return how many neighbours each generator has; meters have none."""
    tests = [len(neighbours(slow, test)) for test in plan.tests]
    return [*tests, *[0 for _ in plan.meters]]


def _starts(plan: Plan, slow: Sequence[Slow]) -> list[str]:
    """Return the lines that begin the generators and their neighbours."""
    lines = []
    for k, (g, count) in enumerate(zip(fields_of(plan), _counts(plan, slow), strict=True)):
        text = _START + (_START_NEAR if count else "")
        lines.append(text.format(k=k, g=g, model=_model(slow, k, g), count=count))
    return lines


def _resets(plan: Plan, slow: Sequence[Slow]) -> list[str]:
    """Return the lines for the very first sample."""
    lines = []
    for k, (g, count) in enumerate(zip(fields_of(plan), _counts(plan, slow), strict=True)):
        lines.append(f"m{k}.reset(s.{g}, {_model(slow, k, g)})")
        if count:
            lines += [f"for i in range({count}):", f"    m{k}.reset(s.beside_{k}[i], s.near_{k}[i])"]
    return lines


def is_late(slow: Sequence[Slow]) -> bool:
    """Tell whether a sensor may be late or early."""
    return any(one.kind == "lag" for one in slow)


def _readings(slow: Sequence[Slow], knowns: Sequence[str], rates: Sequence[str]) -> list[str]:
    """Return the lines that take the values of a sample, as the model has them; and as the neighbours have them."""
    place = {z: k for k, z in enumerate(knowns)}
    off = {(one.kind, one.name): j for j, one in enumerate(slow)}

    def corrected(z: str, beside: int = -1) -> str:
        """Return a known variable's reading without its lag, bias, gain; ``beside``: that one is off by STEP more."""

        def amount(kind: str) -> str:
            j = off[kind, z]
            return f"c.follow.bound[{j}] * (s.follow.point[{j}]{f' + {STEP!r}' if j == beside else ''})"

        text = f"u.value[{place[z]}]"
        if is_late(slow):
            back = f"c.late.back - c.late.per_ms * {amount('lag')}" if ("lag", z) in off else "c.late.back"
            text = f"delay.read(s.late, {place[z]}, {back})"
        if ("bias", z) in off:
            text = f"({text} - {amount('bias')})"
        return f"{text} / (1.0 + {amount('gain')})" if ("gain", z) in off else text

    lines = []
    if is_late(slow):
        lines.append("delay.put(s.late, u.value, round(s.own.dt * 1e3 * c.late.per_ms) if what == sampling.GO else 0)")
    lines += [f"s.sample.{field_name(z)} = {corrected(z)}" for z in knowns]
    if slow:
        fields = [field_name(z) for z in (*knowns, *rates)]
        lines += [f"for j in range({len(slow)}):", *(f"    s.read[j].{field} = s.sample.{field}" for field in fields)]
    for j, one in enumerate(slow):
        if one.kind != "parameter":
            lines.append(f"s.read[{j}].{field_name(one.name)} = {corrected(one.name, j)}")
    return lines


def _carried(plan: Plan, slow: Sequence[Slow], k: int) -> list[str]:
    """Return the lines that carry a test's states to where the model is moved.

    The neighbours' states say how they depend on what may be off, so that a residual goes on as if the model had stood
    there all the time, to first order: states + sum of (neighbour's - states) / STEP * step.
    """
    test, g, count = plan.tests[k], fields_of(plan)[k], _counts(plan, slow)[k]
    dtype = load_source(test.name, test.source).State.dtype
    lines = []
    for name in dtype.names or ():
        shape = dtype[name].shape
        if name.startswith((JACOBIAN, SLOPES, HOLD, DEAD)) or len(shape) > 1 or dtype[name].base.kind != "f":
            continue
        at, pad = ("[n]", "    ") if shape else ("", "")
        lines += [f"for n in range({shape[0]}):"] if shape else []
        lines += [
            f"{pad}a = 0.0",
            f"{pad}for i in range({count}):",
            f"{pad}    b = s.beside_{k}[i].{name}{at} - s.{g}.{name}{at}",
            f"{pad}    a += {1.0 / STEP!r} * b * s.follow.step[c.acts_{k}[i]]",
            f"{pad}if isfinite(a):",
            f"{pad}    s.{g}.{name}{at} += a",
            f"{pad}    for i in range({count}):",
            f"{pad}        s.beside_{k}[i].{name}{at} += a",
        ]
    return lines if count else []


def _moved(plan: Plan, slow: Sequence[Slow]) -> list[str]:
    """Return the lines that move the model, and its neighbours, to where the shares are."""
    if not slow:
        return []
    lines = [line for k in range(len(plan.tests)) for line in _carried(plan, slow, k)]
    counts = _counts(plan, slow)
    for k, (g, generator) in enumerate(zip(fields_of(plan), plan.generators, strict=True)):
        for j in (j for j in neighbours(slow, generator) if slow[j].kind == "parameter"):
            name = field_name(slow[j].name)
            lines.append(f"b = c.{g}.{name} * c.follow.bound[{j}]")
            lines.append(f"s.model_{k}.{name} = c.{g}.{name} + b * s.follow.point[{j}]")
            if counts[k]:
                lines += [
                    f"for i in range({counts[k]}):",
                    f"    s.near_{k}[i].{name} = s.model_{k}.{name} + (b * {STEP!r} if c.acts_{k}[i] == {j} else 0.0)",
                ]
    begins = "what == sampling.FIRST"
    return [
        f"if parameter_tracking.moves(s.follow, c.follow, s.own, c.own, {begins}):",
        *(f"    {line}" for line in [*lines, "fault_likelihood.interrupt(s.fit)" if faulty(plan) else "pass"]),
    ]


def _corrected(plan: Plan, slow: Sequence[Slow], k: int) -> list[str]:
    """Return the lines that correct a test's residual ``r`` by what is known of what may be off."""
    count = _counts(plan, slow)[k]
    lines = [f"for j in range({len(slow)}):", "    s.follow.h[j] = 0.0"]
    if count:
        lines += [
            f"for i in range({count}):",
            f"    b = m{k}.step(s.beside_{k}[i], s.near_{k}[i], s.read[c.acts_{k}[i]], dt)",
            "    if not isfinite(b):",
            f"        m{k}.start(s.beside_{k}[i], s.near_{k}[i], s.read[c.acts_{k}[i]])",
            "    elif isfinite(r):",
            f"        s.follow.h[c.acts_{k}[i]] = (r - b) * {1.0 / STEP!r}",
        ]
    return [*lines, f"s.own.residual[{k}] = parameter_tracking.correct(s.follow, c.follow, s.own, c.own, {k}, r)"]


def _residuals(plan: Plan, slow: Sequence[Slow]) -> list[str]:
    """Return the lines that step the tests and the meters."""
    place = {k: j for j, k in enumerate(plan.measured.values())}
    lines = []
    for k, field in enumerate(fields_of(plan)):
        call = f"m{k}.step(s.{field}, {_model(slow, k, field)}, s.sample, dt)"
        lines += [f"raw = r = {call}", f"s.own.anew[{k}] = 0 if isfinite(r) else 1"]
        if k < len(plan.tests) and slow:
            lines += [*_corrected(plan, slow, k), "r = s.follow.corrected"]
        elif k < len(plan.tests):
            lines.append(f"s.own.residual[{k}] = r")
        if k < len(plan.tests) and faulty(plan):
            lines += _gained(plan, slow, k)
        if k in place:
            lines += [f"s.own.measured[{place[k]}] = r", f"s.own.gain[{place[k]}] = s.{field}.{GAIN}"]
    return lines


def _same(one: str, other: str, record: str) -> list[str]:
    """Return the fields that the records of two modules have both."""
    there, here = (getattr(load_source("", source), record).dtype.names or () for source in (one, other))
    return [name for name in here if name in there]


def faulty(plan: Plan) -> list[tuple[int, Test]]:
    """Return the tests, by their numbers, beside which faults run."""
    return [(k, test) for k, test in enumerate(plan.tests) if test.faults] if moved(plan) else []


def _gained(plan: Plan, slow: Sequence[Slow], k: int) -> list[str]:
    """Return the lines that find a test's gains; the residual is ``r``."""
    test = plan.tests[k]
    lines = [f"s.fit.r[{k}] = s.own.residual[{k}]" if not slow else f"s.fit.r[{k}] = raw"]
    if slow:
        lines += [
            f"for j in range({len(slow)}):",
            f"    s.fit.h[{k}, j] = s.follow.h[j]",
            f"    s.fit.r[{k}] += s.follow.h[j] * (s.follow.point[j] - s.fit.x[j])",
        ]
    if test.faults:
        lines += [
            f"for i in range({len(test.faults)}):",
            f"    b = sized{k}.step(s.fault_{k}[i], s.faulty_{k}[i], s.sample, dt)",
            f"    s.fit.g[c.column_{k}[i]] = (raw - b) * {1.0 / SIZE!r}",
            "    if not isfinite(b):",
            f"        s.fit.r[{k}] = nan",
            f"        s.fit.g[c.column_{k}[i]] = 0.0",
        ]
    return ["if s.fit.awake == 1:", *(f"    {line}" for line in lines)]


def _begun(plan: Plan, slow: Sequence[Slow]) -> list[str]:
    """Return the lines that let faults begin beside the tests, in their states."""
    lines = ["fault_likelihood.know(s.fit, c.fit, s.follow.slow)"] if slow else []
    for k, test in faulty(plan):
        g = fields_of(plan)[k]
        same = [f"s.fault_{k}[i].{name} = s.{g}.{name}" for name in _same(test.source, test.faulty, "State")]
        constants = _same(test.source, test.faulty, "Const")
        same += [f"s.faulty_{k}[i].{name} = {_model(slow, k, g)}.{name}" for name in constants]
        lines += [f"for i in range({len(test.faults)}):", *(f"    {line}" for line in same or ["pass"])]
        names = load_source("", test.faulty).Const.dtype.names
        for i, fault in enumerate(test.faults):
            if field_name(fault) in names:
                lines.append(f"s.faulty_{k}[{i}].{field_name(fault)} = {SIZE!r}")
    return ["if fault_likelihood.begins(s.fit, c.fit, s.own, c.own):", *(f"    {line}" for line in lines)]


def _records(plan: Plan, knowns: tuple[str, ...], slow: Sequence[Slow]) -> list[str]:
    """Return the lines of the module's records."""
    beside = [(k, count) for k, count in enumerate(_counts(plan, slow)) if count]
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
        "class Inputs(contract.SampledInputs):",
        f"    value: Annotated[f8s, {len(knowns)}]",
        "",
        "",
        "class Sample(Record):",
        *(f"    {field_name(z)}: f8" for z in (*knowns, *plan.rates)),
        "",
        "",
        *(
            [f"class Late(delay.State, lengths={{'signals': {len(knowns)}}}):", "    pass", "", ""]
            if is_late(slow)
            else []
        ),
        *(
            [f"class Followed(parameter_tracking.State, lengths={{'tests': {len(plan.tests)}}}):", "    pass", "", ""]
            if slow
            else []
        ),
        *_weighed(plan, slow),
        "class State(Record):",
        "    own: OwnState",
        "    sample: Sample",
        *_numbered(plan, "    {g}: m{k}.State"),
        *(f"    beside_{k}: Annotated[list[m{k}.State], {count}]" for k, count in beside),
        *(f"    near_{k}: Annotated[list[m{k}.Const], {count}]" for k, count in beside),
        *(_numbered(plan, "    model_{k}: m{k}.Const") if slow else []),
        *(f"    fault_{k}: Annotated[list[sized{k}.State], {len(test.faults)}]" for k, test in faulty(plan)),
        *(f"    faulty_{k}: Annotated[list[sized{k}.Const], {len(test.faults)}]" for k, test in faulty(plan)),
        *(["    fit: Fit"] if faulty(plan) else []),
        *(["    late: Late"] if is_late(slow) else []),
        *([f"    read: Annotated[list[Sample], {len(slow)}]", "    follow: Followed"] if slow else []),
        *(f"    {name}: f8" for name in (*sizes_of(plan), *(one.field for one in slow), *COUNTS)),
        "",
        "",
        "class Const(Record):",
        "    own: OwnConst",
        *_numbered(plan, "    {g}: m{k}.Const"),
        *(f"    acts_{k}: Annotated[i8s, {count}]" for k, count in beside),
        *(f"    column_{k}: Annotated[i8s, {len(test.faults)}]" for k, test in faulty(plan)),
        *(["    fit: FitConst"] if faulty(plan) else []),
        *(["    follow: parameter_tracking.Const"] if slow else []),
        *(["    late: delay.Const"] if is_late(slow) else []),
        "",
        "",
    ]


def _weighed(plan: Plan, slow: Sequence[Slow]) -> list[str]:
    """Return the lines of the records that weigh faults."""
    if not faulty(plan):
        return []
    room = lengths_of(plan, len(slow))
    return [
        f"class Fit(fault_likelihood.State, lengths={room}):", "    pass", "", "",
        f"class FitConst(fault_likelihood.Const, lengths={room}):", "    pass", "", "",
    ]  # fmt: skip


def module_of(plan: Plan, knowns: tuple[str, ...], slow: Sequence[Slow] = ()) -> str:
    """Return the source of a monitor's module.

    Args:
        plan: its tests; their modules are to be loaded before this one.
        knowns: known variables of the model, in the order of the inputs.
        slow: what may be off.
    """
    weighed = bool(faulty(plan))
    rooms = ", ".join(
        (
            "decision",
            *(("fault_likelihood",) if weighed else ()),
            *(("parameter_tracking",) if slow else ()),
            *("records", "sampling"),
        )
    )
    imports = [f"import {module_name(test.faulty)} as sized{k}" for k, test in faulty(plan)]
    imports += [f"import {module_name(test.source)} as m{k}" for k, test in enumerate(plan.generators)]
    return "\n".join(
        [
            '"""A monitor made from its model, not by hand."""',
            "",
            "from math import isfinite, nan",
            "from typing import Annotated, Any",
            "",
            *imports,
            "",
            "from gateway_fdi.jit import Record, f8, f8s, i8s, kernel",
            *(["from gateway_fdi.slow import delay"] if is_late(slow) else []),
            "from gateway.monitors import contract",
            f"from gateway_plants.structural.monitor import {rooms}",
            "",
            "",
            *_records(plan, knowns, slow),
            "@kernel",
            "def step(s: State, c: Const, u: Inputs, out: Any) -> None:",
            '    """Take a sample; step all tests."""',
            "    what = sampling.arrived(s.own, c.own, u)",
            "    if what != sampling.NOTHING:",
            *(f"        {line}" for line in _moved(plan, slow)),
            *(f"        {line}" for line in _readings(slow, knowns, plan.rates)),
            "        if what == sampling.FIRST:",
            *(f"            {line}" for line in _resets(plan, slow)),
            *_starts(plan, slow),
            "        dt = s.own.dt",
            *(["        if what != sampling.GO:", "            fault_likelihood.interrupt(s.fit)"] if weighed else []),
            *(f"        {line}" for line in _residuals(plan, slow)),
            *(
                ["        if s.fit.awake == 1:", "            fault_likelihood.take(s.fit, c.fit, s.own, c.own)"]
                if weighed
                else []
            ),
            "        decision.decide(s.own, c.own, out)",
            *(f"        {line}" for line in (_begun(plan, slow) if weighed else [])),
            *(f"        s.{name} = s.own.sizes[{j}]" for j, name in enumerate(sizes_of(plan))),
            *(f"        s.{one.field} = c.follow.bound[{j}] * s.follow.slow.taken[{j}]" for j, one in enumerate(slow)),
            *(f"    s.{name} = s.own.{field}" for name, field in COUNTS.items()),
            "",
        ]
    )

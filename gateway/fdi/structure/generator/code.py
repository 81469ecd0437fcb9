"""A residual generator as the source of a module with three kernels.

    reset(s, c)              the states that are carried begin at their given values
    start(s, c, u)           the other states begin so that the residual does at zero, (24) and (25); ``u`` may be
                             low-pass filtered, as in (37) and (38)
    step(s, c, u, dt)        one sample, ``dt`` [s] after the one before (0 for the first after a start); the residual

Records: ``s`` of STATE, ``c`` of CONST (parameters, tables, bandwidths), ``u`` with a float field for each known
variable. Where an equation gives no number (a division by zero, a root that is not real) the residual is NaN, and the
states that depend on it keep their values.
With several solutions (Remark 1) there is a branch, with states of its own, for each combination; the residual is the
one nearest to zero, NaN if no branch has a real solution.
"""

from __future__ import annotations

import keyword
from collections.abc import Iterable
from dataclasses import dataclass

import sympy
from sympy.printing.precedence import PRECEDENCE
from sympy.printing.pycode import PythonCodePrinter

from gateway.fdi.structure.generator.initial import Initial, find_initial
from gateway.fdi.structure.generator.realisation import Realisation, Statement
from gateway.fdi.structure.generator.records import DIFFERENTIATOR, FILTER, GAIN, field_name
from gateway.fdi.structure.generator.symbols import Algebra
from gateway.fdi.structure.model import der
from gateway.fdi.structure.relation import identifier
from gateway.fdi.structure.sequence import shown

#: Fields of STATE for (20): the residual, the first variable, and b, of the sample before.
FILTERED, LAST, DRIVE = "filtered_", "last_", "drive_"
#: Field of STATE for the gain of a fault at the sample before, where the residual is filtered.
GAIN_DRIVE = "gain_drive_"

#: Binding of names and calls, just below which nothing needs parentheses.
_ATOM = PRECEDENCE["Atom"] - 1

#: Names that generated code uses itself.
_LOCALS = {
    *("s", "c", "u", "dt", "j", "r", "b", "best", "keep", "abs", "float", "range", "min", "max"),
    *(
        "Any",
        "Annotated",
        "Record",
        "State",
        "Const",
        "f8",
        "f8s",
        "kernel",
        "interpolate",
        "root",
        "sign",
        "isfinite",
        "nan",
        "pi",
    ),
    *("sin", "cos", "tan", "asin", "acos", "atan", "tanh", "exp", "log", "reset", "start", "step"),
    *("STATE", "CONST", "KNOWNS"),
}


def _shown(variable: str) -> str:
    """Return the field of STATE that shows a computed variable."""
    return f"shown_{identifier(variable)}"


def _last(variable: str, first: str) -> str:
    """Return the field of STATE for a variable of (20) at the sample before."""
    return LAST if variable == first else f"{LAST}{field_name(variable)}"


class _Printer(PythonCodePrinter):  # type: ignore[misc]
    """Writes algebra as code of a kernel; ``names`` says how each symbol is written."""

    def __init__(self, names: dict[Algebra, str], tables: Iterable[str]) -> None:
        super().__init__({"fully_qualified_modules": False})
        self._names = names
        self._tables = frozenset(tables)

    def _print_Symbol(self, expr: Algebra) -> str:  # noqa: N802 - the names of SymPy's printer
        return self._names[expr]

    def _print_Float(self, expr: Algebra) -> str:  # noqa: N802
        return repr(float(expr))

    def _print_Integer(self, expr: Algebra) -> str:  # noqa: N802
        return f"{int(expr)}.0"

    def written(self, expr: Algebra) -> str:
        """Return an expression as code; fractions are numbers."""
        fractions = {x: sympy.Float(float(x)) for x in expr.atoms(sympy.Rational) if not x.is_Integer}
        return str(self.doprint(expr.xreplace(fractions)))

    def _print_Pow(self, expr: Algebra, rational: bool = False) -> str:  # noqa: N802
        base, power = expr.as_base_exp()
        if power == 0.5:
            return f"root({self._print(base)})"
        if power == -0.5:
            return f"1.0 / root({self._print(base)})"
        if power == -1:
            return f"1.0 / {self.parenthesize(base, _ATOM)}"
        shown_power = str(int(power)) if power.is_Integer else self.parenthesize(power, _ATOM)
        return f"{self.parenthesize(base, _ATOM)}**{shown_power}"

    def _print_sign(self, expr: Algebra) -> str:
        return f"sign({self._print(expr.args[0])})"

    def _print_Function(self, expr: Algebra) -> str:  # noqa: N802
        name = type(expr).__name__
        if name in self._tables:
            field = field_name(name)
            return f"interpolate(c.{field}_x, c.{field}_y, {self._print(expr.args[0])})"
        return str(super()._print_Function(expr))

    def _print_Min(self, expr: Algebra) -> str:  # noqa: N802
        return self._nested("min", expr.args)

    def _print_Max(self, expr: Algebra) -> str:  # noqa: N802
        return self._nested("max", expr.args)

    def _nested(self, name: str, arguments: Iterable[Algebra]) -> str:
        return f"{name}({', '.join(str(self._print(a)) for a in arguments)})"


@dataclass(frozen=True)
class Generated:
    """A residual generator as code.

    Attributes:
        name: of it.
        source: of the module.
        realisation: what it does.
        knowns: known variables that it reads, names of the fields of ``u``.
        rates: derivatives of known variables that ``start`` reads, as fields of ``u``: ``<known>_rate<order>``.
        states: names of the states that it integrates.
        fault: whose size is minus the residual over ``gain_`` of its state; empty: none.
    """

    name: str
    source: str
    realisation: Realisation
    knowns: tuple[str, ...]
    rates: tuple[str, ...]
    states: tuple[str, ...]
    fault: str = ""


class _Writer:
    def __init__(self, name: str, realisation: Realisation, *, sized: bool) -> None:
        self.name, self.r = name, realisation
        self.sized = sized and bool(realisation.fault) and realisation.branches == 1
        self.initial: Initial = find_initial(realisation)
        self.several = realisation.branches > 1
        self.model, self.of = realisation.model, realisation.symbols.of
        self.index = "[j]" if self.several else ""
        names: dict[Algebra, str] = {}
        for z in self.model.knowns:
            names[self.of[z]] = f"u.{field_name(z)}"
        for p in self.model.parameters:
            names[self.of[p]] = f"c.{field_name(p)}"
        for v in self.model.full_variables:
            names[self.of[v]] = self.state(v) if v in realisation.integrated else self.local(v)
        for (z, order), symbol in self.initial.rates.items():
            names[symbol] = f"u.{field_name(z)}_rate{order}"
        self.names = names
        self.print = _Printer(names, self.model.tables).written

    def state(self, name: str) -> str:
        return f"s.{field_name(name)}{self.index}"

    @staticmethod
    def local(variable: str) -> str:
        name = identifier(variable)
        return f"{name}_" if name in _LOCALS or keyword.iskeyword(name) else name

    # What is read -----------------------------------------------------------------------------------------------------

    def used(self) -> set[Algebra]:
        return {x for e in self.expressions() for x in e.free_symbols}

    def expressions(self) -> list[Algebra]:
        expressions = [self.r.residual, *self.r.transformed.values(), *self.initial.values.values()]
        expressions += [self.r.gain] * self.sized
        return expressions + [e for s in self.r.statements for one in s.solutions for e in one.values()]

    def tables(self) -> tuple[str, ...]:
        called = {type(f).__name__ for e in self.expressions() for f in e.atoms(sympy.Function)}
        return tuple(name for name in self.model.tables if name in called)

    # Lines ------------------------------------------------------------------------------------------------------------

    def assign(self, statement: Statement, stride: int) -> list[str]:
        if statement.differentiates:
            x = statement.differentiates
            low, now, derivative = (
                f"low_{field_name(x)}",
                self.names[self.of[x]],
                self.local(der(x)),
            )
            return [
                f"keep = (1.0 - exp(-c.{DIFFERENTIATOR} * dt)) * ({now} - s.{low}{self.index})",
                f"s.{low}{self.index} += keep if isfinite(keep) else 0.0",
                f"{derivative} = keep / dt if dt > 0.0 else 0.0  # {', '.join(statement.equations)}, filtered",
            ]
        note = f"  # {', '.join(statement.equations)}"
        if len(statement.solutions) == 1:
            return self.given(statement, 0, note)
        lines = []
        which = f"j // {stride} % {len(statement.solutions)}".replace("j // 1 ", "j ")
        for k in range(len(statement.solutions)):
            last = k == len(statement.solutions) - 1
            lines.append("else:" if last else f"{'elif' if k else 'if'} {which} == {k}:")
            lines += [f"    {line}" for line in self.given(statement, k, f"{note}, solution {k + 1}")]
        return lines

    def given(self, statement: Statement, k: int, note: str) -> list[str]:
        solution = statement.solutions[k]
        return [f"{self.names[self.of[v]]} = {self.print(e)}{note}" for v, e in solution.items()]

    def chain(self, wanted: set[Algebra] | None) -> list[str]:
        """Return the statements for some symbols, all of them for None."""
        needed: set[Algebra] = set() if wanted is None else set(wanted)
        chosen: list[Statement] = []
        for statement in reversed(self.r.statements):
            mine = {self.of[v] for v in statement.variables}
            if wanted is None or mine & needed:
                chosen.append(statement)
                needed |= statement.needs
                if statement.differentiates:
                    needed.add(self.of[statement.differentiates])
        kept = {id(statement) for statement in chosen}
        lines: list[str] = []
        stride = 1
        for statement in self.r.statements:
            if id(statement) in kept:
                lines += self.assign(statement, stride)
            stride *= max(len(statement.solutions), 1)
        return lines

    def branched(self, lines: list[str]) -> list[str]:
        if not self.several:
            return lines
        return [f"for j in range({self.r.branches}):", *(f"    {line}" for line in lines)]

    # Kernels ----------------------------------------------------------------------------------------------------------

    def reset(self) -> list[str]:
        lines = [f"{self.state(x)} = c.start_{field_name(x)}" for x in self.r.carried]
        return self.branched(lines) if lines else ["pass"]

    def start(self) -> list[str]:
        lines = [f"s.d_{field_name(x)}{self.index} = 0.0" for x in self.r.integrated]
        free = {self.of[x] for x in self.r.initialised}
        first = {x for e in self.initial.values.values() for x in e.free_symbols} - free
        computed = {self.of[v] for s in self.r.statements for v in s.variables}
        lines += self.chain(first & computed)
        lines += [f"{self.state(x)} = {self.print(e)}" for x, e in self.initial.values.items()]
        behind = {self.of[x] for x in self.r.differentiated}
        behind |= {self.of[x] for x in self.r.transformed}
        if behind:
            chain = self.chain(behind & computed)
            lines += ["dt = 0.0"] * any("dt" in line for line in chain)
            lines += chain
        for x in self.r.differentiated:
            lines.append(f"s.low_{field_name(x)}{self.index} = {self.names[self.of[x]]}")
        if self.r.transformed:
            lines.append(f"s.{FILTERED}{self.index} = 0.0  # (25)")
            lines += [f"{self.last(x)} = {self.names[self.of[x]]}" for x in self.r.transformed]
            lines.append(f"s.{DRIVE}{self.index} = 0.0")
            if self.sized:
                lines += [f"s.{GAIN} = 0.0", f"s.{GAIN_DRIVE} = 0.0"]
        return self.branched(lines) if lines else ["pass"]

    def step(self) -> list[str]:
        lines = [f"{self.state(x)} += dt * s.d_{field_name(x)}{self.index}" for x in self.r.integrated]
        lines += self.chain(None)
        for v in self.r.outputs:
            lines.append(f"s.{_shown(v)}{self.index} = {self.names[self.of[v]]}")
        for x in self.r.integrated:
            d = self.names[self.of[der(x)]]
            lines.append(f"s.d_{field_name(x)}{self.index} = {d} if isfinite({d}) else 0.0")
        residual = self.print(self.r.residual)
        if self.r.transformed:
            lines += self.filtered(residual)
        else:
            lines.append(f"r = {residual}  # {self.r.consistency}")
            if self.sized:
                lines.append(f"s.{GAIN} = {self.print(self.r.gain)}  # {self.r.fault}")
        if not self.several:
            return [*lines, "return float(r)"]
        best = ["if not abs(r) >= abs(best) and r == r:", "    best = r  # Remark 1"]
        return ["best = nan", *self.branched([*lines, *best]), "return float(best)"]

    def last(self, x: str) -> str:
        """Return the field with a variable of (20) at the sample before."""
        first = next(iter(self.r.transformed))
        return f"s.{_last(x, first)}{self.index}"

    def filtered(self, residual: str) -> list[str]:
        kept, drive = (f"s.{name}{self.index}" for name in (FILTERED, DRIVE))
        names = {x: self.names[self.of[x]] for x in self.r.transformed}
        moved = " + ".join(
            f"({self.print(factor)}) * ({names[x]} - {self.last(x)})".removeprefix("(1.0) * ")
            for x, factor in self.r.transformed.items()
        )
        moved = moved if len(names) == 1 else f"({moved})"
        return [
            f"keep = exp(-c.{FILTER} * dt)",
            f"b = {residual}  # {self.r.consistency}",
            f"r = (1.0 - keep) / dt * {moved} if dt > 0.0 else c.{FILTER} * {moved}",
            f"r += keep * {kept} + (1.0 - keep) * {drive}  # (20)",
            "if isfinite(r):",
            f"    {kept} = r",
            *(f"    {self.last(x)} = {name}" for x, name in names.items()),
            "if isfinite(b):",
            f"    {drive} = b",
            "else:",
            "    r = nan",
            *self.filtered_gain(),
        ]

    def filtered_gain(self) -> list[str]:
        """Return the lines for the gain of a fault, filtered as b is."""
        if not self.sized:
            return []
        return [
            f"s.{GAIN} = keep * s.{GAIN} + (1.0 - keep) * s.{GAIN_DRIVE}",
            f"b = {self.print(self.r.gain)}  # {self.r.fault}",
            "if isfinite(b):",
            f"    s.{GAIN_DRIVE} = b",
        ]

    # Module -----------------------------------------------------------------------------------------------------------

    def records(self) -> list[str]:
        form = f"Annotated[f8s, {self.r.branches}]" if self.several else "f8"
        states = [f"{name}: {form}" for x in self.r.integrated for name in (field_name(x), f"d_{field_name(x)}")]
        if self.r.transformed:
            first = next(iter(self.r.transformed))
            lasts = [_last(x, first) for x in self.r.transformed]
            states += [f"{name}: {form}" for name in (FILTERED, *lasts, DRIVE)]
        states += [f"{GAIN}: f8"] * self.sized + [f"{GAIN_DRIVE}: f8"] * (self.sized and bool(self.r.transformed))
        states += [f"low_{field_name(x)}: {form}" for x in self.r.differentiated]
        states += [f"{_shown(v)}: {form}" for v in self.r.outputs]
        used = self.used()
        const = [f"{field_name(p)}: f8" for p in self.model.parameters if self.of[p] in used]
        for name in self.tables():
            points, field = len(self.model.tables[name].x), field_name(name)
            const += [f"{field}_{axis}: Annotated[f8s, {points}]" for axis in "xy"]
        const += [f"start_{field_name(x)}: f8" for x in self.r.carried]
        const += [f"{FILTER}: f8"] * bool(self.r.transformed)
        const += [f"{DIFFERENTIATOR}: f8"] * bool(self.r.differentiated)
        # A record has a field at least: there are generators without states, and without parameters.
        lines = []
        for title, fields in (("State", states), ("Const", const)):
            lines += ["", f"class {title}(Record):"]
            lines += [f"    {one}" for one in fields or ["unused_: f8"]]
            lines.append("")
        return lines

    def knowns(self) -> tuple[str, ...]:
        used = self.used()
        return tuple(z for z in self.model.knowns if self.of[z] in used)

    def module(self) -> str:
        r = self.r
        body = [*self.reset(), *self.start(), *self.step()]
        text = "\n".join(body)
        records = self.records()
        arrays = any("f8s" in line for line in records)
        functions = [f for f in _MATH if f"{f}(" in text or (f in ("pi", "nan") and f in text)]
        runtime = [f for f in ("interpolate", "root", "sign") if f"{f}(" in text]
        imports = [f"from math import {', '.join(functions)}"] if functions else []
        ours = [f"from gateway.fdi.structure.generator.runtime import {', '.join(runtime)}"] if runtime else []
        lines = [
            f'"""Residual generator {self.name} of {self.model.name}: made from its model, not by hand.',
            "",
            f"Consistency relation {r.consistency}" + (f": {text}" if (text := self._relation()) else ""),
            f"Sequence {shown(self.model, r.steps) or 'empty'}",
            '"""',
            "",
            *imports,
            f"from typing import {', '.join(['Annotated'] * arrays + ['Any'])}",
            "",
            *ours,
            f"from gateway.jit import Record, f8, {'f8s, ' * arrays}kernel",
            "",
            *records,
            "",
            f"KNOWNS = {self.knowns()!r}",
        ]
        for name, body in (
            ("reset", self.reset()),
            ("start", self.start()),
            ("step", self.step()),
        ):
            arguments, returned, meaning = _KERNELS[name]
            lines += ["", "", "@kernel", f"def {name}({arguments}) -> {returned}:"]
            lines += [f'    """{meaning}"""', *(f"    {line}" for line in body)]
        return "\n".join(lines) + "\n"

    def _relation(self) -> str:
        relation = self.model.by_name[self.r.consistency].relation
        return "" if relation is None else relation.text


#: Arguments, result and meaning of the three kernels.
_KERNELS = {
    "reset": ("s: State, c: Const", "None", "Let carried states begin at their start values."),
    "start": (
        "s: State, c: Const, u: Any",
        "None",
        "Let the other states begin so that the residual does at zero.",
    ),
    "step": (
        "s: State, c: Const, u: Any, dt: float",
        "float",
        "Take a sample, dt [s] behind the one before; returns the residual.",
    ),
}
_MATH = ("sin", "cos", "tan", "asin", "acos", "atan", "tanh", "exp", "log", "isfinite", "pi", "nan")


def write(name: str, realisation: Realisation, *, sized: bool = False) -> Generated:
    """Write a residual generator as code.

    Args:
        name: of it.
        realisation: what it does.
        sized: its state shows the gain of the fault that the residual tells the size of, if there is one.

    Raises:
        NotSolvableError: its states cannot begin by (24).
    """
    writer = _Writer(name, realisation, sized=sized)
    rates = tuple(f"{z}_rate{order}" for z, order in writer.initial.rates)
    fault = realisation.fault if writer.sized else ""
    return Generated(name, writer.module(), realisation, writer.knowns(), rates, realisation.integrated, fault)

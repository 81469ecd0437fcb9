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
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial

import sympy
from sympy.printing.precedence import PRECEDENCE
from sympy.printing.pycode import PythonCodePrinter

from gateway_fdi.structure.generator.initial import Initial, find_initial
from gateway_fdi.structure.generator.propagation import SLOPE, Component, components, depends, sensors, tangents
from gateway_fdi.structure.generator.realisation import Realisation, Statement
from gateway_fdi.structure.generator.records import (
    DEAD,
    DIFFERENTIATOR,
    FEED,
    FEED_SLOPE,
    FILTER,
    GAIN,
    HOLD,
    JACOBIAN,
    SLOPES,
    field_name,
)
from gateway_fdi.structure.generator.symbols import Algebra
from gateway_fdi.structure.model import Quantity, der
from gateway_fdi.structure.relation import identifier
from gateway_fdi.structure.sequence import shown

#: Fields of STATE for (20): the residual, the first variable, and b, of the sample before.
FILTERED, LAST, DRIVE = "filtered_", "last_", "drive_"
#: Field of STATE for the gain of a fault at the sample before, where the residual is filtered.
GAIN_DRIVE = "gain_drive_"

#: Field of STATE for the step of the states: a command's last value.
HELD = "held_"

#: How an expression is written.
Written = Callable[[Algebra], str]

#: Binding of names and calls, just below which nothing needs parentheses.
_ATOM = PRECEDENCE["Atom"] - 1

#: Names that generated code imports from math, and from :mod:`.runtime`.
_MATH = ("sin", "cos", "tan", "asin", "acos", "atan", "tanh", "exp", "log", "isfinite", "pi", "nan")
_RUNTIME = ("advance", "incline", "interpolate", "root", "sign")
#: Names that generated code uses itself.
_LOCALS = {
    *("s", "c", "u", "dt", "j", "r", "b", "ahead", "best", "keep", "abs", "float", "range", "min", "max"),
    *("Any", "Annotated", "Record", "State", "Const", "f8", "f8s", "kernel", "means", "STATE", "CONST"),
    *("reset", "start", "step"),
    *_MATH,
    *_RUNTIME,
}


def _shown(variable: str) -> str:
    """Return the field of STATE that shows a computed variable."""
    return f"shown_{identifier(variable)}"


def _field(name: str, form: str, text: str, unit: str = "") -> str:
    """Return the line of a record's field."""
    return f"{name}: {form} = means({text!r}{f', {unit!r}' if unit else ''})"


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
        table = name.removeprefix(SLOPE)
        if table in self._tables:
            field, call = field_name(table), "interpolate" if table == name else "incline"
            return f"{call}(c.{field}_x, c.{field}_y, {self._print(expr.args[0])})"
        return str(super()._print_Function(expr))

    def _print_Min(self, expr: Algebra) -> str:  # noqa: N802
        return self._nested("min", expr.args)

    def _print_Max(self, expr: Algebra) -> str:  # noqa: N802
        return self._nested("max", expr.args)

    def _nested(self, name: str, arguments: Iterable[Algebra]) -> str:
        return f"{name}({', '.join(str(self._print(a)) for a in arguments)})"


def _finite(name: str, dead: str = "") -> str:
    """Return a value where it is a number, and the sample before had slopes, else 0, as code."""
    alive = f" and {dead} == 0.0" if dead else ""
    return f"{name} if isfinite({name}){alive} else 0.0"


@dataclass(frozen=True)
class Generated:
    """A residual generator as code.

    Attributes:
        name: of it.
        source: of the module.
        realisation: its statements.
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
    def __init__(self, name: str, realisation: Realisation, *, sized: bool, observed: bool) -> None:
        self.name, self.r = name, realisation
        self.observed = observed
        self.sized = sized and bool(realisation.fault) and realisation.branches == 1 and not observed
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
        self.components = components(realisation)
        self.depends = depends(realisation)
        self.of_sensors, self.line, self.held = self.between()
        earlier = {self.of[z]: f"s.{HELD}{field_name(z)}" for z in self.held}
        self.print_early = _Printer(names | earlier, self.model.tables).written

    def between(self) -> tuple[frozenset[str], bool, tuple[str, ...]]:
        """Return what moves with sensors between two samples, and the commands in it.

        Returns:
            the states whose derivatives do; whether b of (20) does; the commands that are held beside these sensors.
            Values from a filtered derivative do not: they have the filter's state of the sample.
        """
        shown_by = sensors(self.model)
        reads: dict[Algebra, set[str]] = {self.of[z]: {z} for z in self.model.knowns}
        reads |= {self.of[x]: {x} for x in self.r.integrated}
        for s in self.r.statements:
            mine = {z for symbol in s.needs for z in reads.get(symbol, ())}
            mine |= {der(s.differentiates)} if s.differentiates else set()
            reads |= {self.of[v]: mine for v in s.variables}
        filtered = {der(x) for x in self.r.differentiated}
        slopes = {x: reads.get(self.of[der(x)], set()) for x in self.r.integrated}
        moving = frozenset(x for x, mine in slopes.items() if mine & shown_by and not mine & filtered)
        checked = {z for symbol in self.r.residual.free_symbols for z in reads.get(symbol, ())}
        alone = not (checked - shown_by) & set(self.model.knowns)
        moves = checked & shown_by or (alone and checked & {*self.r.integrated})
        line = bool(self.r.transformed and moves and not checked & filtered)
        every = {z for x in moving for z in slopes[x]} | (checked if line else set())
        return moving, line, tuple(z for z in self.model.knowns if z in every - shown_by)

    def state(self, name: str) -> str:
        return f"s.{field_name(name)}{self.index}"

    @staticmethod
    def local(variable: str) -> str:
        name = identifier(variable)
        return f"{name}_" if name in _LOCALS or keyword.iskeyword(name) else name

    # Inputs -----------------------------------------------------------------------------------------------------------

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

    def assign(self, statement: Statement, stride: int, written: Written) -> list[str]:
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
        return self.by_solution(statement, stride, lambda k: self.given(statement, k, note, written))

    @staticmethod
    def by_solution(statement: Statement, stride: int, given: Callable[[int], list[str]]) -> list[str]:
        """Return the lines of a statement's only solution, or of each under its condition."""
        count = len(statement.solutions)
        if count == 1:
            return given(0)
        lines = []
        which = f"j // {stride} % {count}".replace("j // 1 ", "j ")
        for k in range(count):
            mine = given(k)
            lines.append("else:" if k == count - 1 else f"{'elif' if k else 'if'} {which} == {k}:")
            lines += [f"    {line}" for line in mine or ["pass"]]
        return lines

    def given(self, statement: Statement, k: int, note: str, written: Written) -> list[str]:
        solution = statement.solutions[k]
        note += f", solution {k + 1}" if len(statement.solutions) > 1 else ""
        return [f"{self.names[self.of[v]]} = {written(e)}{note}" for v, e in solution.items()]

    def strides(self) -> Iterator[tuple[Statement, int]]:
        """Yield the statements, each with the number of combinations of the solutions before it."""
        stride = 1
        for statement in self.r.statements:
            yield statement, stride
            stride *= max(len(statement.solutions), 1)

    def leading_to(self, wanted: set[Algebra] | None) -> tuple[set[Algebra], list[tuple[Statement, int]]]:
        """Return the symbols that some are computed from, and the statements of these; all of them for None."""
        needed: set[Algebra] = set() if wanted is None else set(wanted)
        chosen: list[tuple[Statement, int]] = []
        for statement, stride in reversed(list(self.strides())):
            mine = {self.of[v] for v in statement.variables}
            if wanted is None or mine & needed:
                chosen.insert(0, (statement, stride))
                needed |= statement.needs
                if statement.differentiates:
                    needed.add(self.of[statement.differentiates])
        return needed, chosen

    def chain(self, wanted: set[Algebra] | None, written: Written | None = None) -> list[str]:
        """Return the statements for some symbols, all of them for None; ``written`` prints their expressions."""
        _, chosen = self.leading_to(wanted)
        return [line for one, stride in chosen for line in self.assign(one, stride, written or self.print)]

    def branched(self, lines: list[str]) -> list[str]:
        if not self.several:
            return lines
        return [f"for j in range({self.r.branches}):", *(f"    {line}" for line in lines)]

    # The step of the states -------------------------------------------------------------------------------------------

    def array(self, name: str, number: int) -> str:
        """Return how an array of a component is written."""
        return f"s.{name}{number}{self.index}"

    def propagate(self) -> list[str]:
        """Return the lines that move the states to this sample (:mod:`.propagation`)."""
        lines = self.chain({self.of[der(x)] for x in self.of_sensors}, self.print_early) if self.of_sensors else []
        for number, one in enumerate(self.components):
            if one.coupled:
                lines += self.propagate_coupled(number, one)
                continue
            for x in one.states:
                rate = f"s.d_{field_name(x)}{self.index}"
                if x in self.of_sensors:
                    lines += [
                        self.changed(x),
                        f"{self.state(x)} += dt * ({rate} + 0.5 * ({_finite('keep', self.dead)}))",
                    ]
                else:
                    lines.append(f"{self.state(x)} += dt * {rate}")
        return lines

    @property
    def dead(self) -> str:
        return f"s.{DEAD}{self.index}"

    def changed(self, x: str) -> str:
        return f"keep = {self.names[self.of[der(x)]]} - s.d_{field_name(x)}{self.index}"

    def propagate_coupled(self, number: int, one: Component) -> list[str]:
        lines, n = [], len(one.states)
        jacobian, slopes, hold = (self.array(name, number) for name in (JACOBIAN, SLOPES, HOLD))
        for k, x in enumerate(one.states):
            lines.append(f"{slopes}[{k}] = s.d_{field_name(x)}{self.index}")
            if x in self.of_sensors:
                lines += [self.changed(x), f"{slopes}[{n + k}] = {_finite('keep', self.dead)}"]
        lines.append(f"advance({jacobian}, {slopes}, {hold}, dt)")
        return [*lines, *(f"{self.state(x)} += {slopes}[{2 * n + k}]" for k, x in enumerate(one.states))]

    def tangent(self, variable: str, state: str) -> str:
        """Return the local name of a variable's derivative by a state."""
        return f"{self.local(variable)}__{field_name(state)}"

    def tangent_lines(self, statement: Statement, wanted: set[str], k: int) -> list[str]:
        lines = []
        for one in tangents(self.r, statement, wanted):
            if one.solution == k:
                terms = []
                for factor, by in one.terms:
                    written, rest = self.print(factor), "" if by is None else self.tangent(by, one.state)
                    terms.append(f"({written}) * {rest}".removeprefix("(1.0) * ") if rest else written)
                lines.append(f"{self.tangent(one.variable, one.state)} = {' + '.join(terms) or '0.0'}")
        return lines

    def linearise(self) -> list[str]:
        """Return the lines for the Jacobians of what is coupled, at this sample."""
        coupled = [(k, one) for k, one in enumerate(self.components) if one.coupled]
        needed, chosen = self.leading_to({self.of[der(x)] for _, one in coupled for x in one.states})
        wanted = {v for statement, _ in chosen for v in statement.variables if self.of[v] in needed}
        lines = []
        for statement, stride in chosen:
            mine = wanted & {v for v in statement.variables if self.depends.get(self.of[v])}
            if mine and coupled:
                lines += self.by_solution(statement, stride, partial(self.tangent_lines, statement, mine))
        for number, one in coupled:
            for i, x in enumerate(one.states):
                for k, y in enumerate(one.states):
                    if y in self.depends[self.of[der(x)]]:
                        t = self.tangent(der(x), y)
                        place = f"{self.array(JACOBIAN, number)}[{i * len(one.states) + k}]"
                        lines.append(f"{place} = {_finite(t)}")
        return lines

    def slopes(self) -> list[str]:
        """Return the lines that keep the derivatives of this sample for the next step."""
        lines = [f"{self.dead} = 0.0"] if self.of_sensors else []
        for x in self.r.integrated:
            d = self.names[self.of[der(x)]]
            lines.append(f"s.d_{field_name(x)}{self.index} = {_finite(d)}")
            if x in self.of_sensors:
                lines += [f"if not isfinite({d}):", f"    {self.dead} = 1.0"]
        return lines + self.linearise()

    # Kernels ----------------------------------------------------------------------------------------------------------

    def reset(self) -> list[str]:
        lines = [f"{self.state(x)} = c.start_{field_name(x)}" for x in self.r.carried]
        return self.branched(lines) if lines else ["pass"]

    def start(self) -> list[str]:
        lines = [f"s.d_{field_name(x)}{self.index} = 0.0" for x in self.r.integrated]
        lines += [f"{self.dead} = 1.0"] * bool(self.of_sensors)
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
        lines = self.propagate()
        if self.line and self.held:
            lines += self.chain(set(self.r.residual.free_symbols), self.print_early)
            lines.append(f"b = {self.print_early(self.r.residual)}  # {self.r.consistency}, commands held")
        lines += self.chain(None)
        for v in self.r.outputs:
            lines.append(f"s.{_shown(v)}{self.index} = {self.names[self.of[v]]}")
        lines += self.slopes()
        residual = self.print(self.r.residual)
        if self.r.transformed:
            lines += self.filtered(residual)
        else:
            lines.append(f"r = {residual}  # {self.r.consistency}")
            if self.sized:
                lines.append(f"s.{GAIN} = {self.print(self.r.gain)}  # {self.r.fault}")
        held = [f"s.{HELD}{field_name(z)} = u.{field_name(z)}" for z in self.held]
        if not self.several:
            return [*lines, *self.corrected(), *held, "return float(r)"]
        best = ["if not abs(r) >= abs(best) and r == r:", "    best = r  # Remark 1"]
        return ["best = nan", *self.branched([*lines, *best]), *held, "return float(best)"]

    def corrected(self) -> list[str]:
        """Return the lines that correct the states, and their derivatives, by the residual of this sample."""
        if not self.observed:
            return []
        lines = ["if isfinite(r):"]
        for x in self.r.integrated:
            name = field_name(x)
            lines += [f"    s.{name} += c.{FEED}{name} * r", f"    s.d_{name} += c.{FEED_SLOPE}{name} * r"]
        return lines

    def last(self, x: str) -> str:
        """Return the field with a variable of (20) at the sample before."""
        first = next(iter(self.r.transformed))
        return f"s.{_last(x, first)}{self.index}"

    def filtered(self, residual: str) -> list[str]:
        kept, drive, ahead = f"s.{FILTERED}{self.index}", f"s.{DRIVE}{self.index}", "ahead"
        names = {x: self.names[self.of[x]] for x in self.r.transformed}
        moved = " + ".join(
            f"({self.print(factor)}) * ({names[x]} - {self.last(x)})".removeprefix("(1.0) * ")
            for x, factor in self.r.transformed.items()
        )
        moved = moved if len(names) == 1 else f"({moved})"
        return [
            *[f"{ahead} = b - {drive} if isfinite(b) and dt > 0.0 else 0.0"] * (self.line and bool(self.held)),
            f"keep = exp(-c.{FILTER} * dt)",
            f"b = {residual}  # {self.r.consistency}",
            *[f"{ahead} = b - {drive} if isfinite(b) and dt > 0.0 else 0.0"] * (self.line and not self.held),
            f"r = (1.0 - keep) / dt * {moved} if dt > 0.0 else c.{FILTER} * {moved}",
            f"r += keep * {kept} + (1.0 - keep) * {drive}  # (20)",
            *[f"r += (1.0 - (1.0 - keep) / (c.{FILTER} * dt)) * {ahead} if dt > 0.0 else 0.0"] * self.line,
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
        lines = []
        for title, fields in (("State", [*self.states()]), ("Const", [*self.constants()])):
            # A record has a field at least: there are generators without states, and without parameters.
            written = fields or [_field("unused_", "f8", "nothing")]
            lines += ["", f"class {title}(Record):", *(f"    {one}" for one in written), ""]
        return lines

    def states(self) -> Iterator[str]:
        r, form = self.r, f"Annotated[f8s, {self.r.branches}]" if self.several else "f8"
        for x in r.integrated:
            text, unit = self.meaning(x)
            yield _field(field_name(x), form, text, unit)
            yield _field(f"d_{field_name(x)}", form, f"derivative of {x}", f"{unit or 1}/s")
        if self.of_sensors:
            yield _field(DEAD, form, "1: the sample before had no derivatives")
        for z in self.held:
            yield _field(f"{HELD}{field_name(z)}", "f8", f"{z} at the sample before", self.meaning(z)[1])
        for number, one in enumerate(self.components):
            if one.coupled:
                n, group = len(one.states), ", ".join(one.states)
                rows = f"{r.branches}, " if self.several else ""
                yield _field(f"{JACOBIAN}{number}", f"Annotated[f8s, {rows}{n * n}]", f"Jacobian of {group}")
                yield _field(f"{SLOPES}{number}", f"Annotated[f8s, {rows}{3 * n}]", "slopes, changes, what is moved")
                yield _field(f"{HOLD}{number}", f"Annotated[f8s, {rows}{6 * n * n}]", "functions of the Jacobian")
        if r.transformed:
            yield _field(FILTERED, form, "residual by (20)")
            first = next(iter(r.transformed))
            for x in r.transformed:
                yield _field(_last(x, first), form, f"{x} at the sample before", self.meaning(x)[1])
            yield _field(DRIVE, form, "b of (20) at the sample before")
        if self.sized:
            yield _field(GAIN, "f8", f"gain of {r.fault}")
            if r.transformed:
                yield _field(GAIN_DRIVE, "f8", f"gain of {r.fault} at the sample before, not filtered")
        for x in r.differentiated:
            yield _field(f"low_{field_name(x)}", form, f"{x}, low-pass filtered", self.meaning(x)[1])
        for v in r.outputs:
            yield _field(_shown(v), form, *self.meaning(v))

    def constants(self) -> Iterator[str]:
        used = self.used()
        for p in self.model.parameters:
            if self.of[p] in used:
                yield _field(field_name(p), "f8", *self.meaning(p))
        for name in self.tables():
            table = self.model.tables[name]
            for axis, text in (("x", "points"), ("y", "values")):
                form = f"Annotated[f8s, {len(table.x)}]"
                yield _field(f"{field_name(name)}_{axis}", form, f"{table.text or name}: {text}")
        for x in self.r.carried:
            yield _field(f"start_{field_name(x)}", "f8", f"{x} at the start", self.meaning(x)[1])
        if self.observed:
            for x in self.r.integrated:
                yield _field(f"{FEED}{field_name(x)}", "f8", f"what the residual adds to {x}")
                yield _field(f"{FEED_SLOPE}{field_name(x)}", "f8", f"what the residual adds to the derivative of {x}")
        if self.r.transformed:
            yield _field(FILTER, "f8", "alpha of (20)", "rad/s")
        if self.r.differentiated:
            yield _field(DIFFERENTIATOR, "f8", "bandwidth of the filters that differentiate", "rad/s")

    def meaning(self, name: str) -> tuple[str, str]:
        told = self.model.quantities.get(name, Quantity())
        return told.text or name, "" if told.unit == "1" else told.unit

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
        runtime = [f for f in _RUNTIME if f"{f}(" in text]
        imports = [f"from math import {', '.join(functions)}"] if functions else []
        ours = [f"from gateway_fdi.structure.generator.runtime import {', '.join(runtime)}"] if runtime else []
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
            f"from gateway_fdi.jit import Record, f8, {'f8s, ' * arrays}kernel, means",
            "",
            *records[:-1],
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


def correctable(realisation: Realisation) -> bool:
    """Return whether a generator's states can be corrected by its residual: no filter, and one solution."""
    return not realisation.transformed and not realisation.differentiated and realisation.branches == 1


def write(name: str, realisation: Realisation, *, sized: bool = False, observed: bool = False) -> Generated:
    """Write a residual generator as code.

    Args:
        name: of it.
        realisation: its statements.
        sized: its state shows the gain of the fault that the residual tells the size of, if there is one.
        observed: its states are corrected by the residual, by gains in its constants; then it tells no size.

    Raises:
        NotSolvableError: its states cannot begin by (24).
    """
    writer = _Writer(name, realisation, sized=sized, observed=observed and correctable(realisation))
    rates = tuple(f"{z}_rate{order}" for z, order in writer.initial.rates)
    fault = realisation.fault if writer.sized else ""
    return Generated(name, writer.module(), realisation, writer.knowns(), rates, realisation.integrated, fault)

"""From the text of a relation to a program: parsed, never executed.

The grammar is that of Python's expressions, of which only numbers, signals, arithmetic, comparisons, and, or, not, and
the functions of :data:`gateway_checks.rule.program.FUNCTIONS` are taken.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Collection
from dataclasses import dataclass, field

from gateway_checks.rule import program as p
from gateway_checks.rule.program import FUNCTIONS, Program
from gateway_fdi.errors import InputError, nearest

_BINARY: dict[type[ast.operator], int] = {
    ast.Add: p.ADD, ast.Sub: p.SUBTRACT, ast.Mult: p.MULTIPLY, ast.Div: p.DIVIDE, ast.Pow: p.POWER, ast.Mod: p.MODULO,
}  # fmt: skip
_COMPARISONS: dict[type[ast.cmpop], int] = {
    ast.Lt: p.LESS, ast.LtE: p.AT_MOST, ast.Gt: p.MORE, ast.GtE: p.AT_LEAST, ast.Eq: p.EQUAL, ast.NotEq: p.UNEQUAL,
}  # fmt: skip

#: Function that takes the unit from a value, which then may be added to and compared with values of other units.
WITHOUT_UNIT = "number"

#: Unit of an expression: None where it is not known, or a number's, which fits any.
Unit = str | None


@dataclass
class _Writer:
    """Writes a program while it walks an expression.

    Attributes:
        text: the expression.
        unit_of: signal -> its unit in the database, None where it has none.
        named: signals that have a name without a message.
        made: the program.
        depth: of the stack now.
    """

    text: str
    unit_of: Callable[[str], Unit]
    named: Collection[str] = ()
    made: Program = field(default_factory=Program)
    depth: int = 0

    def refuse(self, node: ast.AST, why: str) -> InputError:
        part = ast.get_source_segment(self.text, node) or self.text
        return InputError(f"{why}: {part}", value=self.text)

    def emit(self, operation: int, argument: int = 0, *, pops: int = 0) -> None:
        self.depth += 1 - pops
        self.made.depth = max(self.made.depth, self.depth)
        self.made.ops.append((operation, argument))

    def walk(self, node: ast.expr) -> Unit:
        """Write an expression; returns its unit."""
        if isinstance(node, ast.Constant):
            return self._number(node)
        if isinstance(node, ast.Attribute | ast.Name):
            return self._signal(node)
        if isinstance(node, ast.BinOp):
            return self._binary(node)
        if isinstance(node, ast.UnaryOp):
            return self._unary(node)
        if isinstance(node, ast.Call):
            return self._call(node)
        if isinstance(node, ast.Compare):
            return self._compare(node)
        if isinstance(node, ast.BoolOp):
            for k, value in enumerate(node.values):
                self.walk(value)
                if k:
                    self.emit(p.AND if isinstance(node.op, ast.And) else p.OR, pops=2)
            return None
        raise self.refuse(node, "this is no part of a rule")

    def _number(self, node: ast.Constant) -> Unit:
        if isinstance(node.value, bool) or not isinstance(node.value, int | float):
            raise self.refuse(node, "a rule has numbers and signals only")
        self.emit(p.NUMBER, len(self.made.numbers))
        self.made.numbers.append(float(node.value))
        return None

    def _signal(self, node: ast.Attribute | ast.Name) -> Unit:
        name = ast.unparse(node)
        if self.named and name not in self.named:
            known = [*self.named, *FUNCTIONS]
            raise self.refuse(node, f"the names are {', '.join(self.named)}{nearest(name, known)}")
        if not self.named and "." not in name:
            raise self.refuse(node, f'a signal is named "Message.Signal"{nearest(name, list(FUNCTIONS))}')
        if name not in self.made.signals:
            self.made.signals.append(name)
        self.emit(p.SIGNAL, self.made.signals.index(name))
        return self.unit_of(name)

    def _same(self, node: ast.expr, one: Unit, other: Unit) -> Unit:
        if one is not None and other is not None and one != other:
            raise self.refuse(node, f'"{one}" and "{other}" do not go together')
        return other if one is None else one

    def _binary(self, node: ast.BinOp) -> Unit:
        if type(node.op) not in _BINARY:
            raise self.refuse(node, "a rule has + - * / ** %")
        one, other = self.walk(node.left), self.walk(node.right)
        self.emit(_BINARY[type(node.op)], pops=2)
        if isinstance(node.op, ast.Add | ast.Sub | ast.Mod):
            return self._same(node, one, other)
        if isinstance(node.op, ast.Mult) and (one is None or other is None):
            return other if one is None else one
        return one if isinstance(node.op, ast.Div) and other is None else None

    def _unary(self, node: ast.UnaryOp) -> Unit:
        unit = self.walk(node.operand)
        if isinstance(node.op, ast.USub):
            self.emit(p.NEGATE, pops=1)
        elif isinstance(node.op, ast.Not):
            self.emit(p.NOT, pops=1)
            return None
        elif not isinstance(node.op, ast.UAdd):
            raise self.refuse(node, "a rule has + - and not")
        return unit

    def _compare(self, node: ast.Compare) -> Unit:
        left = node.left
        for k, (comparison, right) in enumerate(zip(node.ops, node.comparators, strict=True)):
            if type(comparison) not in _COMPARISONS:
                raise self.refuse(node, "a rule compares by < <= > >= == !=")
            self._same(node, self.walk(left), self.walk(right))
            self.emit(_COMPARISONS[type(comparison)], pops=2)
            if k:
                self.emit(p.AND, pops=2)
            left = right
        return None

    def _call(self, node: ast.Call) -> Unit:
        name = node.func.id if isinstance(node.func, ast.Name) else ast.unparse(node.func)
        if name == WITHOUT_UNIT and len(node.args) == 1 and not node.keywords:
            self.walk(node.args[0])
            return None
        if name not in FUNCTIONS:
            known = [*FUNCTIONS, WITHOUT_UNIT]
            raise self.refuse(node, f"the functions are {', '.join(known)}{nearest(name, known)}")
        operation, count = FUNCTIONS[name]
        several = name in ("min", "max") and len(node.args) >= 2
        if node.keywords or (len(node.args) != count and not several):
            raise self.refuse(node, f"{name} has {count} argument{'s' * (count > 1)}")
        if operation in (p.DELAY, p.LOWPASS):
            return self._timed(node, name, operation)
        unit = self.walk(node.args[0])
        if operation == p.RATE:
            self._memory(p.RATE, 0.0)
            return None if unit is None else f"{unit}/s"
        for argument in node.args[1:]:
            unit = self._same(node, unit, self.walk(argument))
            self.emit(operation, pops=2)
        if count == 1:
            self.emit(operation, pops=1)
        return unit if operation in (p.ABS, p.MIN, p.MAX, p.FLOOR) else None

    def _timed(self, node: ast.Call, name: str, operation: int) -> Unit:
        unit, time = self.walk(node.args[0]), node.args[1]
        if not isinstance(time, ast.Constant) or not isinstance(time.value, int | float) or time.value <= 0:
            raise self.refuse(node, f"{name} wants a number of milliseconds above 0")
        self._memory(operation, float(time.value) * 1e-3)
        return unit

    def _memory(self, operation: int, seconds: float) -> None:
        self.emit(operation, len(self.made.times_s), pops=1)
        self.made.times_s.append(seconds)


def compile_text(text: str, unit_of: Callable[[str], Unit], *, named: Collection[str] = ()) -> Program:
    """Return the program of a relation.

    Args:
        text: e.g. ``"abs(A.x - B.y) < 3 + 0.1 * C.v"``.
        unit_of: signal -> its unit in the database, None where it has none; raises InputError where there is no such
            signal.
        named: the only names that may stand in it, where they are no ``"Message.Signal"``.

    Raises:
        InputError: text that is none, signals or functions that are not there, units that do not go together, too much
            of it.
    """
    try:
        tree = ast.parse(text, mode="eval")
    except (SyntaxError, ValueError) as error:
        place = f" at character {error.offset}" if isinstance(error, SyntaxError) and error.offset else ""
        raise InputError(f"this is no expression{place}", value=text) from error
    writer = _Writer(text, unit_of, named)
    writer.walk(tree.body)
    made = writer.made
    for what, count, most in (
        ("operations", len(made.ops), p.MOST_OPS),
        ("numbers", len(made.numbers), p.MOST_NUMBERS),
        ("signals", len(made.signals), p.MOST_SIGNALS),
        ("rate, delay and lowpass", len(made.times_s), p.MOST_MEMORIES),
        ("values at once", made.depth, p.MOST_STACK),
    ):
        if count > most:
            raise InputError(f"{count} {what}, a rule has room for {most}: make two of it", value=text)
    return made


def is_relation(text: str) -> bool:
    """Return whether a text says something that is true or false."""
    node = ast.parse(text, mode="eval").body
    if isinstance(node, ast.UnaryOp):
        return isinstance(node.op, ast.Not)
    return isinstance(node, ast.Compare | ast.BoolOp)

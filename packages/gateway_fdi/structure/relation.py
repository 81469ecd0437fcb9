"""Equations as text: ``U_b = U_oc - R_b * I_b``, with conditionals and tables, never evaluated as code.

The grammar is Python's for expressions, and of it only numbers, names, + - * / **, comparisons, and/or/not,
``a if condition else b``, and calls of :data:`FUNCTIONS`, of a table of the model, or of ``der(x)``.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass

#: Functions that an equation may use.
FUNCTIONS = (
    "sqrt sin cos tan asin acos atan tanh exp log abs sign min max".split()  # noqa: SIM905 - read as one line
)
#: Names that stand for a number.
CONSTANTS = ("pi",)

_EQUALS = re.compile(r"(?<![<>=!])=(?!=)")
_NODES = (
    ast.BinOp,
    ast.UnaryOp,
    ast.BoolOp,
    ast.Compare,
    ast.IfExp,
    ast.Call,
    ast.Name,
    ast.Constant,
    ast.operator,
    ast.unaryop,
    ast.boolop,
    ast.cmpop,
    ast.expr_context,
)
_OPERATORS = (
    ast.Add,
    ast.Sub,
    ast.Mult,
    ast.Div,
    ast.Pow,
    ast.UAdd,
    ast.USub,
    ast.Not,
    ast.And,
    ast.Or,
    ast.Lt,
    ast.LtE,
    ast.Gt,
    ast.GtE,
)


@dataclass(frozen=True)
class Expression:
    """A checked expression.

    Attributes:
        text: as written.
        tree: Python's syntax tree of it.
        names: variables, parameters and faults in it, ``der(x)`` for a derivative, in order of appearance.
        functions: tables that it calls.
    """

    text: str
    tree: ast.expr
    names: tuple[str, ...]
    functions: tuple[str, ...]

    @staticmethod
    def parse(text: str) -> Expression:
        """Read an expression.

        Raises:
            ValueError: it is not one, or uses what equations may not; says where.
        """
        try:
            tree = ast.parse(text.strip(), mode="eval").body
            parts = list(_parts(tree, text))
        except (SyntaxError, RecursionError, MemoryError) as error:
            reason = error.msg if isinstance(error, SyntaxError) else "nested too deeply"
            raise ValueError(f'"{_short(text)}" is no expression: {reason}') from error
        names: dict[str, None] = {}
        functions: dict[str, None] = {}
        for kind, name in parts:
            (names if kind == "name" else functions)[name] = None
        return Expression(text.strip(), tree, tuple(names), tuple(functions))


def _short(text: str) -> str:
    text = " ".join(text.split())
    return text if len(text) <= 120 else f"{text[:117]}..."


def _refuse(node: ast.AST, text: str, what: str) -> ValueError:
    shown = ast.unparse(node)
    return ValueError(f'"{text.strip()}": {what} ({shown})')


def _parts(node: ast.AST, text: str) -> Iterator[tuple[str, str]]:
    """Yield the names in a tree, and the tables that it calls."""
    if not isinstance(node, _NODES):
        raise _refuse(node, text, "an equation cannot contain this")
    if isinstance(node, ast.operator | ast.unaryop | ast.boolop | ast.cmpop):
        if not isinstance(node, _OPERATORS):
            raise ValueError(f'"{text.strip()}": an equation has + - * / ** < <= > >= and or not')
        return
    if isinstance(node, ast.Constant):
        if isinstance(node.value, bool) or not isinstance(node.value, int | float):
            raise _refuse(node, text, "not a number")
        return
    if isinstance(node, ast.Name):
        if node.id not in CONSTANTS:
            yield "name", node.id
        return
    if isinstance(node, ast.Call):
        yield from _call(node, text)
        return
    for child in ast.iter_child_nodes(node):
        yield from _parts(child, text)


def _call(node: ast.Call, text: str) -> Iterator[tuple[str, str]]:
    if not isinstance(node.func, ast.Name) or node.keywords:
        raise _refuse(node, text, "only a function by its name can be called")
    name = node.func.id
    wanted = 2 if name in ("min", "max") else 1
    if len(node.args) != wanted:
        raise _refuse(node, text, f"{name} takes {wanted} argument{'s' * (wanted > 1)}")
    if name == "der":
        if not isinstance(node.args[0], ast.Name):
            raise _refuse(node, text, "der takes the name of a state")
        yield "name", f"der({node.args[0].id})"
        return
    if name not in FUNCTIONS:
        yield "function", name
    for argument in node.args:
        yield from _parts(argument, text)


@dataclass(frozen=True)
class Relation:
    """An equation, ``left = right``.

    Attributes:
        text: as written.
        left: its left side.
        right: its right side.
    """

    text: str
    left: Expression
    right: Expression

    @staticmethod
    def parse(text: str) -> Relation:
        """Read an equation.

        Raises:
            ValueError: it is not one.
        """
        sides = _EQUALS.split(text)
        if len(sides) != 2:
            raise ValueError(f'"{text.strip()}": an equation is "left = right"')
        return Relation(
            text.strip(),
            Expression.parse(" ".join(sides[0].split())),
            Expression.parse(" ".join(sides[1].split())),
        )

    @property
    def names(self) -> tuple[str, ...]:
        """Names in it, in order of appearance."""
        return tuple(dict.fromkeys(self.left.names + self.right.names))

    @property
    def functions(self) -> tuple[str, ...]:
        """Tables that it calls."""
        return tuple(dict.fromkeys(self.left.functions + self.right.functions))


def identifier(name: str) -> str:
    """Return a name as one that can stand in generated code: ``der(x)`` is ``d_x``."""
    return f"d_{name[4:-1]}" if name.startswith("der(") else name

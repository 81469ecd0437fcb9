"""Equations as algebra: from the checked syntax tree of a relation to SymPy."""

from __future__ import annotations

import ast
import operator
from collections.abc import Mapping
from typing import Any

import sympy

from gateway_fdi.structure.model import Model
from gateway_fdi.structure.relation import FUNCTIONS, Expression, Relation

_BINARY = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
}
_COMPARE = {ast.Lt: sympy.Lt, ast.LtE: sympy.Le, ast.Gt: sympy.Gt, ast.GtE: sympy.Ge}
#: Functions that SymPy calls otherwise.
_RENAMED = {"abs": "Abs", "min": "Min", "max": "Max"}
_FUNCTIONS = {name: getattr(sympy, _RENAMED.get(name, name)) for name in FUNCTIONS}

Algebra = Any


class Symbols:
    """Symbols of a model: one for each name, all real.

    Args:
        faulty: leave faults in expressions, instead of taking them as zero.
    """

    def __init__(self, model: Model, *, faulty: bool = False) -> None:
        self.model = model
        names = (*model.full_variables, *model.knowns, *model.faults, *model.parameters)
        self.of: Mapping[str, Algebra] = {name: sympy.Symbol(name, real=True) for name in names}
        self.tables: Mapping[str, Algebra] = {name: sympy.Function(name) for name in model.tables}
        self.nominal = {} if faulty else {self.of[name]: sympy.Integer(0) for name in model.faults}

    def expression(self, expression: Expression) -> Algebra:
        """Return an expression, without faults unless they are left in."""
        return self._tree(expression.tree).xreplace(self.nominal)

    def residual(self, relation: Relation) -> Algebra:
        """Return left minus right of an equation, without faults unless they are left in."""
        return self.expression(relation.left) - self.expression(relation.right)

    def _tree(self, node: ast.expr) -> Algebra:
        if isinstance(node, ast.Constant):
            return sympy.Integer(node.value) if isinstance(node.value, int) else sympy.Float(node.value)
        if isinstance(node, ast.Name):
            return sympy.pi if node.id == "pi" else self.of[node.id]
        if isinstance(node, ast.BinOp):
            return _BINARY[type(node.op)](self._tree(node.left), self._tree(node.right))
        if isinstance(node, ast.UnaryOp):
            value = self._tree(node.operand)
            if isinstance(node.op, ast.Not):
                return sympy.Not(value)
            return -value if isinstance(node.op, ast.USub) else value
        if isinstance(node, ast.IfExp):
            return sympy.Piecewise((self._tree(node.body), self._tree(node.test)), (self._tree(node.orelse), True))
        if isinstance(node, ast.BoolOp):
            join = sympy.And if isinstance(node.op, ast.And) else sympy.Or
            return join(*(self._tree(value) for value in node.values))
        if isinstance(node, ast.Compare):
            sides = [node.left, *node.comparators]
            pairs = zip(node.ops, sides, sides[1:], strict=False)
            return sympy.And(*(_COMPARE[type(op)](self._tree(a), self._tree(b)) for op, a, b in pairs))
        return self._call(node)

    def _call(self, node: ast.expr) -> Algebra:
        assert isinstance(node, ast.Call)
        assert isinstance(node.func, ast.Name)
        name = node.func.id
        if name == "der":
            return self.of[ast.unparse(node)]
        function = _FUNCTIONS.get(name) or self.tables[name]
        return function(*(self._tree(argument) for argument in node.args))

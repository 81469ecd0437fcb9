"""One step of a computation sequence solved: an equation for its variable, or a loop for all of its.

The model's declarations decide: a loop, or a solve, that it does not declare is refused, and algebra must find as many
solutions as it declares. A solution that the model gives itself is taken as it stands.
"""

from __future__ import annotations

from collections.abc import Mapping

import sympy

from gateway_fdi.structure.generator.budget import TooLongError, bounded, cancelled
from gateway_fdi.structure.generator.symbols import Algebra, Symbols
from gateway_fdi.structure.model import Equation, Loop, Model, Solvable
from gateway_fdi.structure.sequence import Kind, Step

#: A solution: an expression for each variable of the step.
Solution = Mapping[str, Algebra]


class NotSolvableError(ValueError):
    """A step that cannot be solved, or not as the model declares."""


def solve(model: Model, symbols: Symbols, step: Step) -> tuple[Solution, ...]:
    """Return the solutions of a step; several are for Remark 1 of paper 004.

    Raises:
        NotSolvableError: the model says that it cannot be solved, or says nothing of a loop; an equation is known by
            its structure only; algebra does not solve it in time; or it finds another number of solutions than the
            model declares.
    """
    where = ", ".join(step.equations)
    what = ", ".join(step.variables)
    if step.kind is Kind.SINGULAR:
        raise NotSolvableError(
            f"{{{where}}} cannot be solved for {{{what}}} without differentiating equations (higher index)"
        )
    equations = [model.by_name[name] for name in step.equations]
    for equation in equations:
        if equation.relation is None:
            raise NotSolvableError(f"equation {equation.name} has no relation, only a structure")
    if len(equations) == 1:
        found, declared = _one(symbols, equations[0], step.variables[0])
    else:
        found, declared = _several(model, symbols, equations, step)
    if (declared is Solvable.UNIQUE) != (len(found) == 1):
        raise NotSolvableError(
            f"{{{where}}} for {{{what}}}: the model says {declared.name.lower()}, algebra finds {len(found)}"
            " solutions; declare what it is, or give the solution in the model"
        )
    return found


def linear(residual: Algebra, symbol: Algebra) -> Algebra | None:
    """Return the solution of an equation that is linear in a symbol, else None."""
    slope = sympy.diff(residual, symbol)
    if slope.has(symbol) or slope.has(sympy.Derivative) or slope == 0:
        return None
    found = -residual.subs(symbol, 0) / slope
    return cancelled(found) if found.is_rational_function() else found


def _one(symbols: Symbols, equation: Equation, variable: str) -> tuple[tuple[Solution, ...], Solvable]:
    declared = equation.solvable.get(variable, Solvable.NONE)
    if declared is Solvable.NONE:
        raise NotSolvableError(f"equation {equation.name} cannot be solved for {variable}: not declared")
    given = equation.solutions.get(variable)
    if given:
        return tuple({variable: symbols.expression(one)} for one in given), declared
    relation = equation.relation
    assert relation is not None
    symbol = symbols.of[variable]
    for side, other in ((relation.left, relation.right), (relation.right, relation.left)):
        if side.text == variable and variable not in other.names:
            return ({variable: symbols.expression(other)},), declared
    residual = symbols.residual(relation)
    straight = linear(residual, symbol)
    if straight is not None:
        return ({variable: straight},), declared
    return tuple({variable: one} for one in _solutions([residual], [symbol], equation.name)[0]), declared


def _several(
    model: Model, symbols: Symbols, equations: list[Equation], step: Step
) -> tuple[tuple[Solution, ...], Solvable]:
    where = ", ".join(step.equations)
    loop = find_loop(model, step)
    if loop is None or loop.solvable is Solvable.NONE:
        why = "not declared" if loop is None else "declared as not solvable"
        raise NotSolvableError(f"algebraic loop {{{where}}} for {{{', '.join(step.variables)}}}: {why}")
    if loop.solutions:
        found = [{v: symbols.expression(e) for v, e in one.items()} for one in loop.solutions]
        return tuple(found), loop.solvable
    residuals = [symbols.residual(e.relation) for e in equations if e.relation is not None]
    wanted = [symbols.of[v] for v in step.variables]
    columns = _solutions(residuals, wanted, where)
    return tuple(dict(zip(step.variables, row, strict=True)) for row in zip(*columns, strict=True)), loop.solvable


def find_loop(model: Model, step: Step) -> Loop | None:
    """Return what a model declares of a loop."""
    equations, variables = frozenset(step.equations), frozenset(step.variables)
    return next((x for x in model.loops if x.equations == equations and x.variables == variables), None)


def _numerator(residual: Algebra) -> Algebra:
    """Return a residual without denominators: only numerators vanish."""
    return sympy.fraction(sympy.together(residual))[0]


def _solutions(residuals: list[Algebra], wanted: list[Algebra], where: str) -> list[list[Algebra]]:
    """Return the values of each wanted symbol in all solutions that algebra finds."""
    try:
        found = bounded(lambda: sympy.solve([_numerator(residual) for residual in residuals], wanted, dict=True))
    except (NotImplementedError, TooLongError) as error:
        why = "takes too long to solve it" if isinstance(error, TooLongError) else "does not solve it"
        raise NotSolvableError(f"{where}: algebra {why}; give the solution in the model") from error
    complete = [one for one in found if all(symbol in one for symbol in wanted)]
    if len(complete) != len(found) or not found:
        raise NotSolvableError(f"{where}: algebra does not solve it; give the solution in the model")
    return [[one[symbol] for one in complete] for symbol in wanted]

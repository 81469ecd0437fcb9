"""How the states of a residual generator get from one sample to the next: exactly, where their equations are linear.

Between two samples at a distance h the states x of integral causality follow

    x' = f(x, u(t)),        u(t) between u(k) and u(k+1)

A command is held until the next one comes. A sensor of a state (an equation ``y = x``, the known variable alone on its
left) shows what cannot jump, so it lies on a line; one of anything else may jump with a command, and is held. With J =
df/dx at sample k, the change c = f(x(k), u') - f(x(k), u(k)), u' the sensors of states at sample k+1 and all else of
sample k, and f linearised around sample k,

    x' = f(k) + J (x - x(k)) + c (t - t(k)) / h

whose solution at h, by variation of constants, is

    x(k+1) = x(k) + h phi1(h J) f(k) + h phi2(h J) c
    phi0(z) = exp z,   phi1(z) = (phi0(z) - 1) / z,   phi2(z) = (phi1(z) - 1) / z

That is the exponential Rosenbrock-Euler method (Hochbruck, Ostermann: Exponential integrators, Acta Numerica 19, 2010,
section 2.4). Where f is linear in x, and in the sensors, it is the matrix exponential over the hold: exact for any h.
Elsewhere its error is of order h^3 a step, and a mode lambda of J becomes exp(h lambda): a mode that dies away in the
plant does so here, at any step length. Forward Euler's 1 + h lambda does not: a mode with damping D diverges for h > 2
D / abs(lambda).

States that do not see each other, by whatever way, are propagated apart (`components`). One that no state acts on, an
integral, has phi1 = 1 and phi2 = 1/2.

J is derived line by line with the statements, v = e(w, ...), in their order: dv/dx = sum of de/dw dw/dx. Where a
derivative is no number (of a root at zero) it is taken as zero in that sample: the step is an explicit one there.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache, lru_cache

import sympy
from sympy.core.function import AppliedUndef

from gateway_fdi.structure.generator.realisation import Realisation, Statement
from gateway_fdi.structure.generator.symbols import Algebra
from gateway_fdi.structure.model import Model, der

#: Prefix of the function that is the slope of a table, before the table's name.
SLOPE = "slope_of_"


@dataclass(frozen=True)
class Component:
    """States that are propagated together.

    Attributes:
        states: in the order of the realisation.
        coupled: some derivative depends on a state: the component has a Jacobian.
    """

    states: tuple[str, ...]
    coupled: bool


def sensors(model: Model) -> frozenset[str]:
    """Return the known variables that show a state: each alone on the left of an equation with it, ``y = x``."""
    found: set[str] = set()
    for e in model.equations:
        if e.relation is not None and len(e.knowns) == 1 and not e.differential and e.relation.left.text in e.knowns:
            found.update(e.knowns if len(e.variables) == 1 and e.variables[0] in model.states else ())
    return frozenset(found)


def depends(realisation: Realisation) -> dict[Algebra, set[str]]:
    """Return the integrated states that each symbol depends on: itself, or by the statements that compute it."""
    of = realisation.symbols.of
    found = {of[x]: {x} for x in realisation.integrated}
    for statement in realisation.statements:
        mine = {x for symbol in statement.needs for x in found.get(symbol, ())}
        found |= {of[v]: mine for v in statement.variables}
    return found


def components(realisation: Realisation) -> tuple[Component, ...]:
    """Return which states are propagated together: those that act on each other, directly or by others."""
    by, of = depends(realisation), realisation.symbols.of
    acting = {x: by.get(of[der(x)], set()) for x in realisation.integrated}
    left = list(realisation.integrated)
    found = []
    while left:
        group, size = {left[0]}, 0
        while len(group) > size:
            size = len(group)
            group |= {y for x in group for y in acting[x]}
            group |= {x for x in left if acting[x] & group}
        states = tuple(x for x in realisation.integrated if x in group)
        found.append(Component(states, any(acting[x] for x in states)))
        left = [x for x in left if x not in group]
    return tuple(found)


class _Modulus(sympy.Function):  # type: ignore[misc]
    """abs, with the derivative that code can compute."""

    def fdiff(self, _: int = 1) -> Algebra:
        return _Sign(self.args[0])


class _Sign(sympy.Function):  # type: ignore[misc]
    """sign, which is flat."""

    def fdiff(self, _: int = 1) -> Algebra:
        return sympy.Integer(0)


@cache
def _table(name: str) -> Algebra:
    """Return a table's function with its slope, which is flat between two points."""
    flat = type(f"{SLOPE}{name}", (sympy.Function,), {"fdiff": lambda *_: sympy.Integer(0)})
    return type(name, (sympy.Function,), {"fdiff": lambda self, _=1: flat(self.args[0])})


@lru_cache(maxsize=10_000)  # the generators of a model share most of their equations
def slope(expression: Algebra, symbol: Algebra) -> Algebra:
    """Return the derivative of an expression as code can compute it: of abs, sign, min, max and tables to a side.

    A derivative without a formula in algebra is zero.
    """
    if not expression.has(symbol):
        return sympy.Integer(0)
    tame = expression.replace(sympy.Abs, _Modulus).replace(sympy.sign, _Sign)
    tame = tame.replace(lambda e: isinstance(e, AppliedUndef), lambda e: _table(type(e).__name__)(*e.args))
    found = sympy.diff(tame, symbol)
    found = found.replace(sympy.Heaviside, lambda x, *_: sympy.Piecewise((1, x > 0), (0, True)))
    found = found.replace(sympy.DiracDelta, lambda *_: sympy.Integer(0))
    found = found.replace(_Modulus, sympy.Abs).replace(_Sign, sympy.sign)
    strange = found.has(sympy.Derivative, sympy.Subs, sympy.re, sympy.im, sympy.zoo, sympy.nan, sympy.I)
    return sympy.Integer(0) if strange else found


@dataclass(frozen=True)
class Tangent:
    """How one variable of a statement changes with one state.

    Attributes:
        variable: of the statement.
        state: by which.
        solution: number of the statement's solution.
        terms: a factor, and the variable whose derivative by the state it goes with; None: the state itself.
    """

    variable: str
    state: str
    solution: int
    terms: tuple[tuple[Algebra, str | None], ...]


def tangents(realisation: Realisation, statement: Statement, wanted: Iterable[str]) -> Iterator[Tangent]:
    """Yield the derivatives of a statement's variables by the states that they depend on.

    Args:
        realisation: that it is of.
        statement: one of its statements, not one that differentiates.
        wanted: variables whose derivatives are used.
    """
    by, of = depends(realisation), realisation.symbols.of
    names = {of[v]: v for s in realisation.statements for v in s.variables}
    mine = [v for v in statement.variables if v in set(wanted)]
    for k, solution in enumerate(statement.solutions):
        for v in mine:
            needs = sorted(solution[v].free_symbols, key=str)
            factors = {w: slope(solution[v], w) for w in needs if by.get(w)}
            for x in (x for x in realisation.integrated if x in by[of[v]]):
                terms = [(f, names.get(w)) for w, f in factors.items() if f != 0 and x in by[w]]
                yield Tangent(v, x, k, tuple(terms))

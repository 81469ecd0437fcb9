"""Where the states of a residual generator begin: so that the residual and its derivatives are zero, (24).

    r(t0) = r'(t0) = ... = r^(n-1)(t0) = 0 for n states

The derivatives of the residual contain those of the known variables when n > 1; the caller gives them at the start.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import sympy

from gateway_fdi.structure.generator.budget import TooLongError, bounded
from gateway_fdi.structure.generator.realisation import Realisation
from gateway_fdi.structure.generator.solver import NotSolvableError
from gateway_fdi.structure.generator.symbols import Algebra
from gateway_fdi.structure.model import der


@dataclass(frozen=True)
class Initial:
    """Initial values.

    Attributes:
        values: an expression for each state that begins by (24); in the states that are carried, the variables that do
            not depend on a state of (24), known variables, their derivatives and parameters.
        rates: derivatives of known variables in them: (name, order) and the symbol.
    """

    values: Mapping[str, Algebra]
    rates: Mapping[tuple[str, int], Algebra]


def find_initial(realisation: Realisation) -> Initial:
    """Return the initial values by (24).

    Raises:
        NotSolvableError: (24) does not determine them, or algebra does not find them in time; names the states.
    """
    free = realisation.initialised
    if not free:
        return Initial({}, {})
    names = ", ".join(free)
    hint = f"give {'it a start value' if len(free) == 1 else 'them start values'}"
    if realisation.transformed:
        raise NotSolvableError(
            f"{names}: the residual begins at zero by the state of (20) alone, for any {names}; {hint}"
        )
    if realisation.branches > 1:
        raise NotSolvableError(f"{names}: (24) is not solved for several solutions; {hint}")
    if realisation.differentiated:
        raise NotSolvableError(f"{names}: (24) is not solved with filtered derivatives; {hint}")
    of = realisation.symbols.of
    wanted = [of[x] for x in free]
    deep = _Substitution(realisation, everything=len(free) > 1)
    conditions, rates = [deep(realisation.residual)], dict[tuple[str, int], Algebra]()
    for _ in free[1:]:
        conditions.append(_rate(realisation, conditions[-1], deep, rates))
    for condition in conditions:
        for piece in condition.atoms(sympy.Piecewise, sympy.Min, sympy.Max, sympy.sign, sympy.Abs):
            if piece.has(*wanted):
                raise NotSolvableError(f"{names}: the residual depends on {names} by cases; {hint}")
        if condition.atoms(sympy.Derivative, sympy.Subs):
            raise NotSolvableError(f"{names}: (24) needs the derivative of a table; {hint}")
    try:
        found = bounded(lambda: sympy.solve(conditions, wanted, dict=True))
    except NotImplementedError:
        found = []
    except TooLongError as error:
        raise NotSolvableError(f"{names}: (24) takes too long to solve; {hint}") from error
    if len(found) != 1 or any(x not in found[0] for x in wanted):
        raise NotSolvableError(f"{names}: (24) has {len(found) or 'no'} solutions; {hint}")
    return Initial({x: found[0][of[x]] for x in free}, rates)


class _Substitution:
    """Puts the statements into an expression: all of them, or those that depend on a state of (24)."""

    def __init__(self, realisation: Realisation, *, everything: bool) -> None:
        of = realisation.symbols.of
        self._by: dict[Algebra, Algebra] = {}
        depends = {of[x] for x in realisation.initialised}
        for statement in realisation.statements:
            mine = bool(statement.needs & depends)
            for variable, expression in statement.solutions[0].items():
                if mine:
                    depends.add(of[variable])
                if mine or everything:
                    self._by[of[variable]] = expression

    def __call__(self, expression: Algebra) -> Algebra:
        while True:
            here = expression.free_symbols & self._by.keys()
            if not here:
                return expression
            expression = expression.subs({x: self._by[x] for x in here})


def _rate(
    realisation: Realisation,
    expression: Algebra,
    deep: _Substitution,
    rates: dict[tuple[str, int], Algebra],
) -> Algebra:
    """Return the derivative with respect to time of an expression of states, known variables and their derivatives."""
    of, total = realisation.symbols.of, sympy.Integer(0)
    for x in realisation.integrated:
        total += sympy.diff(expression, of[x]) * deep(of[der(x)])
    levels = {(z, 0): of[z] for z in realisation.model.knowns} | dict(rates)
    for (z, order), symbol in levels.items():
        slope = sympy.diff(expression, symbol)
        if slope != 0:
            up = rates.setdefault((z, order + 1), sympy.Symbol(f"{z}_rate{order + 1}", real=True))
            total += slope * up
    return total

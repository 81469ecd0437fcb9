"""Index reduction: a model's equations, and the derivatives of those that bind states to each other.

Which equations are to be differentiated the structure says (Pantelides 1988): those that cannot be matched to a highest
derivative. Which derivatives then belong to no state is chosen by the rank of the Jacobian at the start (dummy
derivatives, Mattsson and Soederlind 1993), once: a choice that holds everywhere in most plants.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import sympy
from numpy.typing import NDArray
from scipy.linalg import qr

from gateway_fdi.structure.generator.symbols import Algebra, Symbols
from gateway_fdi.structure.model import Model, der

#: Differentiations of one equation that are tried.
MOST_ORDER = 8
#: Share of the largest pivot, below which a Jacobian has lost rank.
_RANK = 1e-9


class NotSimulatedError(ValueError):
    """A model that cannot be simulated; says why."""


@dataclass
class Equations:
    """Equations with those that were differentiated.

    Attributes:
        names: of each, ``e1``, its derivative ``d/dt e1``.
        zero: of each, the expression that is zero.
        source: of a derivative the place of the equation that it is of, else -1.
        up: variable -> its derivative.
        rates: input -> its derivative.
    """

    names: list[str]
    zero: list[Algebra]
    source: list[int]
    up: dict[Algebra, Algebra]
    rates: dict[Algebra, Algebra]
    unknown: set[Algebra] = field(default_factory=set)

    def within(self, k: int) -> list[Algebra]:
        """Return the variables of an equation, in order of their names."""
        return sorted(self.zero[k].free_symbols & self.unknown, key=str)

    def differentiate(self, k: int) -> int:
        """Add the derivative of an equation; returns its place."""
        total = sympy.Integer(0)
        for x in sorted(self.zero[k].free_symbols, key=str):
            if x in self.unknown:
                total += sympy.diff(self.zero[k], x) * self.raised(x)
            elif x in self.rates:
                total += sympy.diff(self.zero[k], x) * self.rates[x]
        if total.atoms(sympy.Derivative, sympy.Subs):
            raise NotSimulatedError(f"{self.names[k]} must be differentiated, and has a table or a jump")
        self.names.append(f"d/dt {self.names[k]}")
        self.zero.append(total)
        self.source.append(k)
        return len(self.zero) - 1

    def raised(self, x: Algebra) -> Algebra:
        """Return the derivative of a variable."""
        if x not in self.up:
            self.up[x] = sympy.Symbol(der(str(x)), real=True)
            self.unknown.add(self.up[x])
        return self.up[x]


@dataclass(frozen=True)
class Reduced:
    """A system without hidden constraints.

    Attributes:
        names: of its equations.
        zero: of each, the expression that is zero.
        states: integrated variables.
        slopes: of each state, its derivative.
        computed: variables that the equations give at each time; as many as they are.
        bound: states of the model that follow from others.
    """

    names: tuple[str, ...]
    zero: tuple[Algebra, ...]
    states: tuple[Algebra, ...]
    slopes: tuple[Algebra, ...]
    computed: tuple[Algebra, ...]
    bound: tuple[str, ...]


def equations_of(model: Model, symbols: Symbols, inputs: Sequence[str]) -> Equations:
    """Return a model's equations; a measured quantity is a variable, too, unless it is an input.

    An unknown that no equation determines (a load, a slope) may be an input.

    Raises:
        NotSimulatedError: an equation is known by its structure only.
    """
    for e in model.equations:
        if e.relation is None and not e.differential:
            raise NotSimulatedError(f"equation {e.name} has no relation, only a structure")
    own = [e for e in model.equations if e.relation is not None]
    of = symbols.of
    outputs = [z for z in model.knowns if z not in inputs]
    return Equations(
        [e.name for e in own],
        [symbols.residual(e.relation) for e in own if e.relation is not None],
        [-1] * len(own),
        {of[x]: of[der(x)] for x in model.states},
        {of[z]: sympy.Symbol(f"{z}_rate1", real=True) for z in inputs},
        {of[x] for x in (*model.full_variables, *outputs) if x not in inputs},
    )


def _determined(model: Model, found: Equations) -> None:
    """Refuse what has another number of equations than variables, or binds one part of them twice.

    Raises:
        NotSimulatedError: names the equations, or the variables, that are left over.
    """
    whole: dict[Algebra, Algebra] = {x: x for x in found.unknown}
    for low, high in found.up.items():
        whole[high] = low
    owner: dict[Algebra, int] = {}

    def take(k: int, seen: set[Algebra]) -> bool:
        for x in {whole[v] for v in found.within(k)} - seen:
            seen.add(x)
            if x not in owner or take(owner[x], seen):
                owner[x] = k
                return True
        return False

    left = [found.names[k] for k in range(len(found.zero)) if not take(k, set())]
    free = sorted(str(x) for x in set(whole.values()) - owner.keys())
    if free:
        could = [str(x) for x in sorted(found.unknown, key=str) if str(x) in model.knowns]
        hint = f"; of {', '.join(could)} those that the plant is given are inputs, and so is a load" if could else ""
        raise NotSimulatedError(f"{len(free)} equations too few ({', '.join(free)} left over){hint}")
    if left:
        raise NotSimulatedError(f"{', '.join(left)}: more equations than variables; fewer inputs would help")


def _pantelides(found: Equations) -> None:
    """Differentiate until each equation has a highest derivative of its own."""
    owner: dict[Algebra, int] = {}
    after: dict[int, int] = {}

    def take(k: int, variables: set[Algebra], equations: set[int]) -> bool:
        equations.add(k)
        highest = [x for x in found.within(k) if x not in found.up]
        for x in highest:
            if x not in owner:
                variables.add(x)
                owner[x] = k
                return True
        for x in highest:
            if x not in variables:
                variables.add(x)
                if take(owner[x], variables, equations):
                    owner[x] = k
                    return True
        return False

    for first in range(len(found.zero)):
        k = first
        for _ in range(MOST_ORDER):
            variables: set[Algebra] = set()
            equations: set[int] = set()
            if take(k, variables, equations):
                break
            for x in sorted(variables, key=str):
                found.raised(x)
            for e in sorted(equations):
                after[e] = found.differentiate(e)
            for x in variables:
                owner[found.up[x]] = after[owner[x]]
            k = after[k]
        else:
            raise NotSimulatedError(f"{found.names[first]} would be differentiated more than {MOST_ORDER} times")


def _numbers(
    found: Equations, values: Mapping[Algebra, float], rows: Sequence[int], columns: Sequence[Algebra]
) -> NDArray[np.float64]:
    """Return the Jacobian of some equations by some variables, at values; those without one are drawn around 1."""
    rng = np.random.default_rng(1)
    symbols = {x for k in rows for x in found.zero[k].free_symbols}
    point = {x: values.get(x, float(rng.uniform(0.5, 1.5))) for x in sorted(symbols, key=str)}
    entries = [[sympy.diff(found.zero[k], x).subs(point) for x in columns] for k in rows]
    matrix = np.array([[float(e) if e.is_number else 1.0 for e in row] for row in entries], np.float64)
    return np.where(np.isfinite(matrix), matrix, 1.0).reshape(len(rows), len(columns))


def _dummies(found: Equations, values: Mapping[Algebra, float], kept: Iterable[Algebra]) -> set[Algebra]:
    """Return the derivatives that belong to no state."""
    behind = {high: low for low, high in found.up.items()}
    wanted = set(kept)
    last = set(range(len(found.zero))) - set(found.source)
    rows = sorted(k for k in last if found.source[k] >= 0)
    variables = sorted((x for x in behind if x not in found.up), key=str)
    gone: set[Algebra] = set()
    while rows:
        columns = [x for x in variables if x in behind]
        matrix = _numbers(found, values, rows, columns)
        scale = np.array([1e-3 if behind[x] in wanted else 1.0 for x in columns])
        r, places = qr(matrix * scale, mode="r", pivoting=True)
        pivots = np.abs(np.diag(r))
        if len(columns) < len(rows) or pivots[len(rows) - 1] <= _RANK * pivots[0]:
            names = ", ".join(found.names[k].replace("d/dt ", "") for k in rows)
            raise NotSimulatedError(f"{names} bind the states in a way that changes their number (singular)")
        chosen = [columns[int(k)] for k in places[: len(rows)]]
        gone |= set(chosen)
        variables = [behind[x] for x in chosen]
        rows = sorted(found.source[k] for k in rows if found.source[found.source[k]] >= 0)
    return gone


def reduce(
    model: Model, symbols: Symbols, inputs: Sequence[str], values: Mapping[str, float], kept: Iterable[str] = ()
) -> Reduced:
    """Return a model as equations that give all derivatives from the states.

    Args:
        symbols: with its faults.
        inputs: given variables.
        values: of parameters, inputs and states, where the choice of states is made.
        kept: states that are to be such, if there is a choice.

    Raises:
        NotSimulatedError: it cannot be simulated.
    """
    found = equations_of(model, symbols, inputs)
    _determined(model, found)
    _pantelides(found)
    of = symbols.of
    point = {of[name]: value for name, value in values.items()}
    point |= {of[f]: 0.0 for f in model.faults} | dict.fromkeys(found.rates.values(), 0.0)
    gone = _dummies(found, point, (of[x] for x in kept))
    states = tuple(x for x in sorted(found.up, key=str) if found.up[x] not in gone)
    # A variable that is derivative and state at once (x'' of x) is integrated, and is the slope of another.
    computed = tuple(sorted(found.unknown - set(states), key=str))
    if len(computed) != len(found.zero):
        raise NotSimulatedError(f"{len(found.zero)} equations for {len(computed)} unknowns after index reduction")
    names = {str(x) for x in states}
    return Reduced(
        tuple(found.names), tuple(found.zero), states, tuple(found.up[x] for x in states), computed,
        tuple(x for x in model.states if x not in names),
    )  # fmt: skip

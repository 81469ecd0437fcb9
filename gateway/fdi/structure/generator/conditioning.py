"""Numbers put into a residual generator: does it forget where its states began, and do they have a beginning at all?

What is asked is where poles lie, and whether an expression is finite, at the model's parameters; known variables and
states get values drawn around 1 with a fixed seed. How noise of the known variables reaches the residual is asked where
states begin, and known variables are 1.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import sympy

from gateway.fdi.structure.generator.initial import Initial
from gateway.fdi.structure.generator.realisation import Realisation
from gateway.fdi.structure.generator.symbols import Algebra
from gateway.fdi.structure.model import Quantity, Table, der

#: Points that are tried; step of differences; a pole so near the axis, of the farthest one, lies on it.
_POINTS, _STEP, _SLOW = 3, 1e-6, 1e-6


class _Numbers:
    """Evaluates expressions of a realisation."""

    def __init__(self, realisation: Realisation) -> None:
        self.realisation, self.of = realisation, realisation.symbols.of
        model = realisation.model
        self._modules = [{name: _function(table) for name, table in model.tables.items()}, "numpy"]
        values = {p: model.quantities[p].value for p in model.parameters}
        self._parameters = {self.of[p]: value for p, value in values.items() if value is not None}

    def drawn(self, rng: np.random.Generator, symbols: Iterable[Algebra]) -> dict[Algebra, float]:
        """Return a value for each symbol."""
        return {x: float(rng.uniform(0.5, 1.5)) for x in sorted(symbols, key=str)} | self._parameters

    def function(self, expression: Algebra) -> Callable[[Mapping[Algebra, float]], float]:
        """Return an expression as a function of the values of its symbols."""
        symbols = sorted(expression.free_symbols, key=str)
        run = sympy.lambdify(symbols, expression, modules=self._modules)
        return lambda values: float(run(*(values[x] for x in symbols)))


def _function(table: Table) -> Callable[[float], float]:
    return lambda at: float(np.interp(at, table.x, table.y))


def forgets(realisation: Realisation, states: Sequence[str]) -> bool:
    """Tell whether what some integrated states are off by dies away, whatever combination of them it is.

    That is so where all poles of the linearised generator lie left of the axis, at one of the points at least; where
    there are no numbers, it is taken so.
    """
    if not states:
        return True
    n = _Numbers(realisation)
    chain = [(n.of[v], n.function(e)) for s in realisation.statements if s.solutions for v, e in s.solutions[0].items()]
    flat = [n.of[der(s.differentiates)] for s in realisation.statements if s.differentiates]
    free = [n.of[x] for x in (*realisation.model.knowns, *realisation.integrated)]
    rng = np.random.default_rng(1)

    def slopes(values: dict[Algebra, float]) -> Any:
        values = values | dict.fromkeys(flat, 0.0)
        for symbol, function in chain:
            values[symbol] = function(values)
        return np.array([values[n.of[der(x)]] for x in states])

    known = False
    for _ in range(_POINTS):
        point = n.drawn(rng, free)
        try:
            with np.errstate(all="ignore"):
                columns = [_difference(slopes, point, n.of[x]) for x in states]
        except (ArithmeticError, ValueError, KeyError):
            continue
        matrix = np.array(columns).T
        if not np.isfinite(matrix).all():
            continue
        known = True
        poles = np.linalg.eigvals(matrix)
        if poles.real.max() < -_SLOW * np.abs(poles).max():
            return True
    return not known


def _difference(slopes: Callable[[dict[Algebra, float]], Any], point: dict[Algebra, float], symbol: Algebra) -> Any:
    """Return the derivative by a symbol, from a central difference."""
    up, down = (slopes(point | {symbol: point[symbol] + step}) for step in (_STEP, -_STEP))
    return (up - down) / (2.0 * _STEP)


def begins(realisation: Realisation, initial: Initial) -> bool:
    """Tell whether (24) gives numbers at the model's parameters: it may divide by what is zero there.

    Derivatives of known variables are zero, as where a monitor begins: it has one sample, and knows none.
    """
    n = _Numbers(realisation)
    rng = np.random.default_rng(1)
    chain = [(n.of[v], n.function(e)) for s in realisation.statements if s.solutions for v, e in s.solutions[0].items()]
    wanted = [n.function(e) for e in initial.values.values()]
    free = {n.of[x] for x in (*realisation.model.knowns, *realisation.integrated)}
    for _ in range(_POINTS):
        values = n.drawn(rng, free) | dict.fromkeys(initial.rates.values(), 0.0)
        try:
            with np.errstate(all="ignore"):
                for symbol, function in chain:
                    values[symbol] = function(values)
                if all(math.isfinite(function(values)) for function in wanted):
                    return True
        except ZeroDivisionError:
            continue
        except (ArithmeticError, ValueError, KeyError):
            return True  # not to be told here
    return False


def noise_gains(realisation: Realisation) -> tuple[tuple[str, float, float], ...]:
    """Return how noise of known variables reaches a residual: each with the residual by it, and by its derivative [s].

    States that are integrated are held: an integral passes little of what is new with every sample. Nothing is returned
    where there are no numbers, or nothing is differentiated.
    """
    slopes = (*realisation.transformed, *realisation.differentiated)
    if not slopes:
        return ()
    n, model = _Numbers(realisation), realisation.model
    chain = [(n.of[v], n.function(e)) for s in realisation.statements if s.solutions for v, e in s.solutions[0].items()]
    residual = n.function(realisation.residual)
    factors = {x: n.function(factor) for x, factor in realisation.transformed.items()}
    starts = {x: model.quantities.get(x, Quantity()).value for x in realisation.integrated}
    point = {n.of[z]: 1.0 for z in model.knowns} | n.drawn(np.random.default_rng(1), ())
    point |= {n.of[x]: 1.0 if value is None else value for x, value in starts.items()}
    point |= {n.of[der(x)]: 0.0 for x in realisation.differentiated}

    def values(at: dict[Algebra, float]) -> dict[Algebra, float]:
        found = dict(at)
        for symbol, function in chain:
            found[symbol] = function(found)
        return found

    def by(function: Callable[[Mapping[Algebra, float]], float], symbol: Algebra) -> float:
        up, down = (function(values(point | {symbol: point[symbol] + step})) for step in (_STEP, -_STEP))
        return (up - down) / (2.0 * _STEP)

    try:
        with np.errstate(all="ignore"):
            here = values(point)
            weight = {x: factor(here) for x, factor in factors.items()}
            weight |= {x: by(residual, n.of[der(x)]) for x in realisation.differentiated}
            found = []
            for z in model.knowns:
                slope = sum(weight[x] * by(n.function(n.of[x]), n.of[z]) for x in slopes)
                found.append((z, by(residual, n.of[z]), float(slope)))
    except (ArithmeticError, ValueError, KeyError):
        return ()
    return tuple(one for one in found if one[1:] != (0.0, 0.0) and all(map(math.isfinite, one[1:])))

"""Numbers put into a residual generator: does it forget where its states began, and do they have a beginning at all?

The questions are where poles lie, and whether an expression is finite, at the model's parameters; known variables and
states get values drawn around 1 with a fixed seed. How noise of the known variables reaches the residual is asked where
states begin, and known variables are 1.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
import sympy
from numpy.typing import NDArray

from gateway_fdi.structure.generator.initial import Initial
from gateway_fdi.structure.generator.propagation import SLOPE, slope
from gateway_fdi.structure.generator.realisation import Realisation
from gateway_fdi.structure.generator.runtime import incline
from gateway_fdi.structure.generator.symbols import Algebra, Symbols
from gateway_fdi.structure.model import Quantity, Table, der

#: Points that are tried; step of differences; a pole so near the axis, of the farthest one, lies on it.
_POINTS, _STEP, _SLOW = 3, 1e-6, 1e-6
#: Share of the terms of a gain that is rounding of differences.
_NOTHING = 1e-6


class _Numbers:
    """Evaluates expressions of a realisation."""

    def __init__(self, realisation: Realisation) -> None:
        self.realisation, self.of = realisation, realisation.symbols.of
        model = realisation.model
        self._tables = tuple(model.tables.items())
        values = {p: model.quantities[p].value for p in model.parameters}
        self._parameters = {self.of[p]: value for p, value in values.items() if value is not None}

    def drawn(self, rng: np.random.Generator, symbols: Iterable[Algebra]) -> dict[Algebra, float]:
        """Return a value for each symbol."""
        return {x: float(rng.uniform(0.5, 1.5)) for x in sorted(symbols, key=str)} | self._parameters

    def function(self, expression: Algebra) -> Callable[[Mapping[Algebra, float]], float]:
        """Return an expression as a function of the values of its symbols."""
        return _compiled(expression, self._tables)


@lru_cache(maxsize=10_000)  # the generators of a model share most of their equations
def _compiled(expression: Algebra, tables: tuple[tuple[str, Table], ...]) -> Callable[[Mapping[Algebra, float]], float]:
    known = {name: _function(table) for name, table in tables}
    known |= {f"{SLOPE}{name}": _slope(table) for name, table in tables}
    symbols = sorted(expression.free_symbols, key=str)
    run = sympy.lambdify(symbols, expression, modules=[known, "numpy"])
    return lambda values: float(run(*(values[x] for x in symbols)))


def _function(table: Table) -> Callable[[float], float]:
    return lambda at: float(np.interp(at, table.x, table.y))


def _slope(table: Table) -> Callable[[float], float]:
    x, y = np.asarray(table.x), np.asarray(table.y)
    return lambda at: incline(x, y, at)


def forgets(realisation: Realisation, states: Sequence[str]) -> bool:
    """Return whether the errors of some integrated states die away, in any combination.

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
    """Return whether (24) gives numbers at the model's parameters: it may divide by what is zero there.

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
    where there are no numbers.
    """
    slopes = (*realisation.transformed, *realisation.differentiated)
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


def gains_at_rest(realisation: Realisation) -> dict[str, float]:
    """Return by how much each fault of size 1 moves the residual once it, and all derivatives, are constant.

    With the derivatives zero, the equations that compute the unknowns v are A dv + B df = 0, and the check is off by
    (e_f - e_v A^-1 B) df: that is the residual's gain at zero frequency. Where A has no inverse a state integrates, and
    its error grows: infinite, as where there are no numbers. It is the largest modulus at the points that are tried. A
    fault that is nearly zero at all of them is fleeting, here 0 (weakly detectable: Chen, Patton: Robust Model-Based
    Fault Diagnosis, 1999, section 2.5).
    """
    model, numbers = realisation.model, _Numbers(realisation)
    symbols = Symbols(model, faulty=True)
    own = [model.by_name[name] for name in realisation.equations]
    relations = [(e.name, e.relation) for e in own if e.relation is not None]
    flat = {symbols.of[der(x)]: 0 for x in model.states}
    zero = {name: symbols.residual(relation).xreplace(flat) for name, relation in relations}
    check = zero.pop(realisation.consistency, None)
    faults = [f for f in model.faults if any(f in e.faults for e in own)]
    unknown = dict.fromkeys(faults, math.inf)
    unknowns = [v for v in model.unknowns if any(zero[name].has(symbols.of[v]) for name in zero)]
    whole = len(relations) == len([e for e in own if not e.differential])
    if not whole or check is None or len(unknowns) != len(zero):
        return unknown
    rng = np.random.default_rng(1)
    free = [symbols.of[x] for x in (*model.unknowns, *model.knowns)]
    rows = [*zero.values(), check]
    try:
        slopes = [
            [numbers.function(slope(row, symbols.of[x])) if row.has(symbols.of[x]) else None for x in names]
            for row in rows
            for names in [(*unknowns, *faults)]
        ]
    except (ArithmeticError, ValueError, KeyError, TypeError):
        return unknown
    points = [numbers.drawn(rng, free) | {symbols.of[f]: 0.0 for f in model.faults} for _ in range(_POINTS)]
    largest = np.max([_at_rest(slopes, len(faults), point) for point in points], axis=0)
    return {f: float(gain) for f, gain in zip(faults, largest, strict=True)}


def _at_rest(
    slopes: Sequence[Sequence[Callable[[Mapping[Algebra, float]], float] | None]],
    faults: int,
    point: dict[Algebra, float],
) -> NDArray[np.float64]:
    """Return what each fault leaves at rest, at one point, shape (faults,); infinite where there are no numbers.

    Args:
        slopes: of each relation, the last one is checked, its derivative by each unknown and each fault; None: zero.
        faults: how many.
        point: values of all symbols.
    """
    try:
        with np.errstate(all="ignore"):
            rows = np.array([[0.0 if one is None else one(point) for one in row] for row in slopes])
            count = rows.shape[1] - faults
            size = np.maximum(np.abs(rows[:-1, :count]).max(axis=1, keepdims=True), 1e-300)
            unit = np.maximum(np.abs(rows[:-1, :count] / size).max(axis=0), 1e-300)
            moved = np.linalg.solve(rows[:-1, :count] / size / unit, rows[:-1, count:] / size)
            moved[np.abs(moved) <= _NOTHING**2 * np.abs(moved).max(axis=0)] = 0.0  # rounding
    except (ArithmeticError, ValueError, KeyError, TypeError, np.linalg.LinAlgError):
        return np.full(faults, math.inf)
    direct, by = rows[-1, count:], rows[-1, :count, None] * moved / unit[:, None]
    gain, most = np.abs(direct - by.sum(0)), np.abs(direct) + np.abs(by).sum(0)
    return np.asarray(np.where(gain <= _NOTHING * most, 0.0, np.where(np.isfinite(gain), gain, math.inf)))

"""A system without hidden constraints as functions of time: its equations in blocks, each solved in turn.

A block of one equation that is linear in its variable, or whose solution the model gives, is a formula. A larger one
that is linear is solved as a system; every other by Newton's method, from where it was solved last.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import sympy
from numpy.typing import NDArray
from sympy.printing.numpy import NumPyPrinter
from sympy.printing.pycode import PythonCodePrinter

from gateway_fdi.masks import pack, words
from gateway_fdi.structure.blocks import block_search, find_blocks
from gateway_fdi.structure.generator.solver import linear
from gateway_fdi.structure.generator.symbols import Algebra, Symbols
from gateway_fdi.structure.matching import match_set, new_matching
from gateway_fdi.structure.model import Model, Solvable
from gateway_fdi.structure.simulation.reduction import NotSimulatedError, Reduced

#: Newton's method: steps, and the remainder relative to the values.
_STEPS, _LEFT = 50, 1e-10
#: Halvings of a step that does not come nearer.
_HALVINGS = 8

Values = NDArray[np.float64]


@dataclass(frozen=True)
class _Block:
    """Equations that are solved together.

    Attributes:
        names: of the equations.
        variables: that they give.
        formula: of one variable, None: they are solved by numbers.
        zero: of each equation, the expression that is zero.
        flat: the Jacobian does not depend on the variables.
    """

    names: tuple[str, ...]
    variables: tuple[Algebra, ...]
    formula: Algebra | None
    zero: tuple[Algebra, ...]
    flat: bool


def _blocks(reduced: Reduced) -> list[list[tuple[int, Algebra]]]:
    """Return the blocks in order of computation: equations, and the variable that each is matched to."""
    place = {x: k for k, x in enumerate(reduced.computed)}
    m, n = len(reduced.zero), len(reduced.computed)
    rows = pack([[place[x] for x in zero.free_symbols if x in place] for zero in reduced.zero], n)
    matching = new_matching(m, n)
    members = np.arange(m, dtype=np.int64)
    everything = pack([range(n)], n)[0]
    if match_set(rows, members, m, matching, everything):
        raise NotSimulatedError("index reduction leaves equations that have no variable of their own")
    block = np.zeros(m, np.int64)
    count = find_blocks(rows, members, m, matching.owner, everything, 0, block, block_search(m, words(n)))
    found: list[list[tuple[int, Algebra]]] = [[] for _ in range(count)]
    for k in range(m):
        found[block[k]].append((k, reduced.computed[int(matching.mate[k])]))
    return found


def _given(model: Model, symbols: Symbols, name: str, variable: Algebra) -> Algebra | None:
    """Return the only solution that a model gives for an equation, None without."""
    equation = model.by_name.get(name)
    if equation is None or equation.solvable.get(str(variable)) is not Solvable.UNIQUE:
        return None
    given = equation.solutions.get(str(variable))
    if given and set(equation.faults) <= set(given[0].names):  # else its faults are left out of it
        return symbols.expression(given[0])
    relation = equation.relation
    if relation is not None:
        for side, other in ((relation.left, relation.right), (relation.right, relation.left)):
            if side.text == str(variable) and str(variable) not in other.names:
                return symbols.expression(other)
    return None


def _block(model: Model, symbols: Symbols, reduced: Reduced, pairs: Sequence[tuple[int, Algebra]]) -> _Block:
    names = tuple(reduced.names[k] for k, _ in pairs)
    variables = tuple(x for _, x in pairs)
    zero = tuple(reduced.zero[k] for k, _ in pairs)
    slopes = [sympy.diff(z, x) for z in zero for x in variables]
    flat = not any(slope.has(*variables) or slope.has(sympy.Derivative) for slope in slopes)
    formula = None
    if len(pairs) == 1:
        formula = _given(model, symbols, names[0], variables[0])
        if formula is None:
            formula = linear(zero[0], variables[0])
    return _Block(names, variables, formula, zero, flat)


@dataclass
class System:
    """Functions of a system.

    Attributes:
        names: of all variables, states first, in the order of the columns that :meth:`all_of` gives.
        states: how many of them are integrated.
        scalar: (t, states, inputs, rates, faults, guesses) -> all variables at one time.
        vector: the same for many times, arrays of shape (times,).
        slopes: places of the states' derivatives among the variables.
        guesses: of each block that is solved by Newton's method, where it begins.
        source: of the functions.
    """

    names: tuple[str, ...]
    states: int
    scalar: Callable[..., list[Any]]
    vector: Callable[..., list[Any]]
    slopes: tuple[int, ...]
    guesses: list[Values] = field(default_factory=list)
    source: str = ""

    def rate(self, states: Values, inputs: Values, rates: Values, faults: Values) -> Values:
        """Return the derivatives of the states; NaN where an equation gives no number."""
        try:
            found = self.scalar(states, inputs, rates, faults, self.guesses)
        except (ArithmeticError, ValueError):
            return np.full(self.states, math.nan)
        return np.array([found[k] for k in self.slopes], np.float64)

    def all_of(self, states: Values, inputs: Values, rates: Values, faults: Values) -> Values:
        """Return all variables, shape (variables, times), from arrays of shape (each, times)."""
        with np.errstate(all="ignore"):
            found = self.vector(states, inputs, rates, faults, self.guesses)
        return np.array([np.broadcast_to(x, states.shape[1:] or inputs.shape[1:]) for x in found], np.float64)


def newton(
    residual: Callable[..., Any], jacobian: Callable[..., Any], guess: Values, flat: bool, *given: Any
) -> Values:
    """Solve a block.

    Args:
        residual: (variables, *given) -> values that are to be zero, a list.
        jacobian: (variables, *given) -> rows of its derivatives.
        guess: shape (variables,), where to begin; the solution is written into it.
        flat: the Jacobian does not depend on the variables: one step is enough.
        given: further arguments of the functions.

    Returns:
        shape (variables,); NaN where there is no solution to be found.
    """
    x = guess.copy()
    f = np.asarray(residual(x, *given), np.float64)
    for _ in range(1 if flat else _STEPS):
        try:
            step = np.linalg.solve(np.asarray(jacobian(x, *given), np.float64), f)
        except np.linalg.LinAlgError:
            return np.full(len(x), math.nan)
        for halving in range(_HALVINGS):
            tried = x - step * 0.5**halving
            there = np.asarray(residual(tried, *given), np.float64)
            if flat or np.abs(there).max() < np.abs(f).max() or np.abs(f).max() == 0.0:
                break
        done = np.abs(tried - x).max() <= _LEFT * (1.0 + np.abs(tried).max())
        x, f = tried, there
        if done:
            break
    else:
        if not flat:
            return np.full(len(x), math.nan)
    if np.isfinite(x).all():
        guess[:] = x
    return x


def newtons(
    residual: Callable[..., Any], jacobian: Callable[..., Any], guess: Values, flat: bool, *given: Any
) -> Values:
    """The same for many times: ``given`` and the result have a further axis."""
    times = next((len(x) for x in given if np.ndim(x)), 1)
    found = np.empty((len(guess), times))
    columns = np.array([np.broadcast_to(x, times) for x in given], np.float64).reshape(len(given), times)
    for k in range(times):
        found[:, k] = newton(residual, jacobian, guess, flat, *columns[:, k].tolist())
    return found


class _Writer:
    """Writes the functions of a system."""

    def __init__(self, model: Model, symbols: Symbols, reduced: Reduced, inputs: Sequence[str]) -> None:
        self.model, self.symbols, self.reduced = model, symbols, reduced
        self.blocks = [_block(model, symbols, reduced, pairs) for pairs in _blocks(reduced)]
        names: dict[Algebra, str] = {x: f"v{k}" for k, x in enumerate((*reduced.states, *reduced.computed))}
        names |= {symbols.of[z]: f"u[{k}]" for k, z in enumerate(inputs)}
        names |= {sympy.Symbol(f"{z}_rate1", real=True): f"du[{k}]" for k, z in enumerate(inputs)}
        names |= {symbols.of[f]: f"f[{k}]" for k, f in enumerate(model.faults)}
        names |= {symbols.of[p]: f"p[{k}]" for k, p in enumerate(model.parameters)}
        self.names = names
        self.numeric = [b for b in self.blocks if b.formula is None]

    def function(self, name: str, printer: type[Any]) -> list[str]:
        """Return the lines of the function of all variables."""
        written = printer(self.names, self.model.tables).written
        lines = [f"def {name}(s, u, du, f, guesses):"]
        lines += [f"    v{k} = s[{k}]" for k in range(len(self.reduced.states))]
        for block in self.blocks:
            left = [self.names[x] for x in block.variables]
            if block.formula is not None:
                lines.append(f"    {left[0]} = {written(block.formula)}  # {block.names[0]}")
                continue
            k = self.numeric.index(block)
            given = ", ".join(self.names[x] for x in self.given(block))
            solve = "newton" if printer is _Scalar else "newtons"
            call = f"{solve}(zero_{k}, slopes_{k}, guesses[{k}], {block.flat}{', ' if given else ''}{given})"
            lines.append(f"    {', '.join(left)}{',' if len(left) == 1 else ''} = {call}  # {', '.join(block.names)}")
        everything = [f"v{k}" for k in range(len(self.reduced.states) + len(self.reduced.computed))]
        return [*lines, f"    return [{', '.join(everything)}]", ""]

    def given(self, block: _Block) -> list[Algebra]:
        """Return what a block's equations need beside its own variables and parameters."""
        parameters = {self.symbols.of[p] for p in self.model.parameters}
        found = {x for z in block.zero for x in z.free_symbols} - set(block.variables) - parameters
        return sorted(found, key=str)

    def solved(self, k: int, block: _Block) -> list[str]:
        """Return the lines of a block's residual and Jacobian."""
        given = self.given(block)
        names = dict(self.names) | {x: f"x[{i}]" for i, x in enumerate(block.variables)}
        names |= {x: f"a{i}" for i, x in enumerate(given)}
        written = _Scalar(names, self.model.tables).written
        arguments = ", ".join(["x", *(f"a{i}" for i in range(len(given)))])
        zero = ", ".join(written(z) for z in block.zero)
        rows = ", ".join("[" + ", ".join(written(sympy.diff(z, x)) for x in block.variables) + "]" for z in block.zero)
        return [
            f"def zero_{k}({arguments}):", f"    return [{zero}]", "",
            f"def slopes_{k}({arguments}):", f"    return [{rows}]", "",
        ]  # fmt: skip

    def source(self) -> str:
        """Return the module."""
        lines = [
            f'"""Simulation of {self.model.name}: made from its model, not by hand."""',
            "",
            "import functools",
            "import math",
            "import numpy",
            "",
        ]
        for k, block in enumerate(self.numeric):
            lines += self.solved(k, block)
        lines += self.function("scalar", _Scalar) + self.function("vector", _Vector)
        return "\n".join(lines)


class _Naming:
    """Common part of both printers."""

    def __init__(self, names: Mapping[Algebra, str], tables: Mapping[str, Any]) -> None:
        super().__init__({"user_functions": {name: f"table_{name}" for name in tables}})  # type: ignore[call-arg]
        self._names = names

    def written(self, expression: Algebra) -> str:
        """Return an expression as code."""
        return str(self.doprint(expression))  # type: ignore[attr-defined]

    def _print_Symbol(self, expr: Algebra) -> str:  # noqa: N802 - the names of SymPy's printers
        return self._names[expr]


class _Scalar(_Naming, PythonCodePrinter):  # type: ignore[misc]
    """For numbers, with the module ``math``."""

    def _print_sign(self, expr: Algebra) -> str:
        return f"sign({self._print(expr.args[0])})"


class _Vector(_Naming, NumPyPrinter):  # type: ignore[misc]
    """For arrays."""

    _module = "numpy"


def _table(x: Sequence[float], y: Sequence[float]) -> Callable[[Any], Any]:
    xs, ys = np.array(x), np.array(y)
    return lambda at: np.interp(at, xs, ys)


def system_of(
    model: Model, symbols: Symbols, reduced: Reduced, inputs: Sequence[str], values: Mapping[str, float]
) -> System:
    """Return the functions of a system.

    Raises:
        NotSimulatedError: its equations have no order of computation.
    """
    writer = _Writer(model, symbols, reduced, inputs)
    source = writer.source()
    scope: dict[str, Any] = {
        "newton": newton,
        "newtons": newtons,
        "sign": lambda x: float(np.sign(x)),
        "p": [float(values[p]) for p in model.parameters],
        **{f"table_{name}": _table(table.x, table.y) for name, table in model.tables.items()},
    }
    # Expressions were parsed by a grammar of their own, and are written here: nothing of the file is run.
    exec(compile(source, f"<simulation of {model.name}>", "exec", dont_inherit=True), scope)
    everything = (*reduced.states, *reduced.computed)
    place = {x: k for k, x in enumerate(everything)}
    return System(
        tuple(map(str, everything)),
        len(reduced.states),
        scope["scalar"],
        scope["vector"],
        tuple(place[x] for x in reduced.slopes),
        [np.full(len(block.variables), 0.5) for block in writer.numeric],
        source,
    )

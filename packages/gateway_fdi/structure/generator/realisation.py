"""A residual generator as statements: the variables in order of computation, their states, and the residual.

Three kinds of state:

- of **integral causality**: :mod:`.propagation` has the step from sample to sample;
- of the **state transformation** (20), where the consistency relation contains the derivative of a variable x that is
  computed: r~ = der(x) + b, filtered by alpha / (p + alpha), needs no derivative. With x straight between two samples
  at a distance h, and b on a line from b(k) to b(k) + c (of states and their sensors; all else is held, as in
  :mod:`.propagation`), the filter is

      r(k+1) = d r(k) + (1 - d) ((x(k+1) - x(k)) / h + b(k)) + (1 - (1 - d) / (alpha h)) c,   d = exp(-alpha h)

  its gain on x is alpha at most, for any h. (With x held as in (20d), Gamma = r - alpha x, a healthy ramp leaves alpha
  h / 2 of its slope.) It begins with r = 0, (25). Several such variables are one r~ = der(x) + a der(y) + b;
- of a **derivative** anywhere else in the sequence: no transformation avoids it (22), so x is low-pass filtered, and
  the filter's slope is taken for der(x).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import sympy

from gateway_fdi.structure.generator.budget import cancelled
from gateway_fdi.structure.generator.solver import NotSolvableError, Solution, solve
from gateway_fdi.structure.generator.symbols import Algebra, Symbols
from gateway_fdi.structure.model import Model, der, state_of
from gateway_fdi.structure.sequence import Kind, Step, Structure


@dataclass(frozen=True)
class Statement:
    """Variables computed at once.

    Attributes:
        equations: by which; for a derivative that is filtered, the state's relation.
        solutions: an expression for each variable; several solutions are branches.
        differentiates: the variable whose derivative this is; then there are no solutions.
    """

    equations: tuple[str, ...]
    solutions: tuple[Solution, ...] = ()
    differentiates: str = ""

    @property
    def variables(self) -> tuple[str, ...]:
        """Computed variables."""
        return (der(self.differentiates),) if self.differentiates else tuple(self.solutions[0])

    @property
    def needs(self) -> set[Algebra]:
        """Symbols of what it is computed from."""
        return {x for one in self.solutions for e in one.values() for x in e.free_symbols}


@dataclass(frozen=True)
class Realisation:
    """A residual generator before it is code.

    Attributes:
        model: of which.
        symbols: its symbols.
        equations: the overdetermined set, in the order of the model.
        consistency: the consistency relation.
        steps: the computation sequence.
        statements: in the order of computation.
        integrated: states in integral causality.
        residual: the residual, or b of (20) if ``transformed`` is not empty.
        transformed: each variable x of (20) with the factor of its derivative, that of the first is one; else empty.
        carried: states that begin at a given value, and keep theirs when the generator is started again; of each, the
            value.
        outputs: computed variables that its state shows, beside the residual.
        fault: the one fault of the consistency relation, if that is linear in it; empty: there is none.
        gain: the residual (or b) differentiated by that fault, whose size is - r / gain.
    """

    model: Model
    symbols: Symbols
    equations: tuple[str, ...]
    consistency: str
    steps: tuple[Step, ...]
    statements: tuple[Statement, ...]
    integrated: tuple[str, ...]
    residual: Algebra
    transformed: Mapping[str, Algebra] = field(default_factory=dict)
    carried: Mapping[str, float] = field(default_factory=dict)
    outputs: tuple[str, ...] = ()
    fault: str = ""
    gain: Algebra = None

    @property
    def branches(self) -> int:
        """Number of combinations of solutions (Remark 1)."""
        count = 1
        for statement in self.statements:
            count *= max(len(statement.solutions), 1)
        return count

    @property
    def differentiated(self) -> tuple[str, ...]:
        """Variables that are differentiated by a filter."""
        return tuple(s.differentiates for s in self.statements if s.differentiates)

    @property
    def initialised(self) -> tuple[str, ...]:
        """States in integral causality that begin so that the residual does at zero (24)."""
        return tuple(x for x in self.integrated if x not in self.carried)


def realise(
    model: Model,
    equations: frozenset[str],
    consistency: str,
    *,
    differentiate: bool = False,
    start: Mapping[str, float] | None = None,
    outputs: Sequence[str] = (),
) -> Realisation:
    """Turn an overdetermined set and its consistency relation into statements.

    Args:
        model: the model, with relations.
        equations: the set, one equation more than unknowns.
        consistency: which of them is checked.
        differentiate: allow variables within the sequence to be differentiated (by a filter).
        start: values at which states begin, beside those of the model; all others begin by (24).
        outputs: variables that are computed on the way, to be shown in the state.

    Raises:
        NotSolvableError: a step cannot be solved, or must differentiate and may not.
        ValueError: the set is not of that kind, or does not compute an output.
    """
    symbols = Symbols(model)
    steps = Structure(model).sequence(equations, consistency)
    avoided = _transformed(model, equations, consistency, steps)
    statements: list[Statement] = []
    integrated: list[str] = []
    for step in steps:
        state = state_of(step.variables[0])
        if step.kind is Kind.INTEGRATE:
            integrated.append(state)
        elif step.kind is not Kind.DIFFERENTIATE:
            statements.append(Statement(step.equations, solve(model, symbols, step)))
        elif state not in avoided:
            if not differentiate:
                raise NotSolvableError(
                    f"the sequence differentiates {state}, and a transformation (20) avoids that in the consistency"
                    " relation only: check another equation of the set, or take another set"
                )
            statements.append(Statement(step.equations, (), state))
    residual, transformed = _residual(symbols, model, consistency, avoided)
    carried = {x: value for x in integrated if (value := _start(model, x, start)) is not None}
    computed = {v for statement in statements for v in statement.variables}
    for name in outputs:
        if name not in computed:
            raise ValueError(f'"{name}" is not computed on the way to {consistency}')
    ordered = tuple(e.name for e in model.equations if e.name in equations)
    fault, gain = _measured(model, equations, consistency, avoided)
    return Realisation(
        model, symbols, ordered, consistency, steps, tuple(statements), tuple(integrated),
        residual, transformed, carried, tuple(outputs), fault, gain,
    )  # fmt: skip


def _measured(model: Model, equations: frozenset[str], consistency: str, avoided: Sequence[str]) -> tuple[str, Algebra]:
    """Return the fault whose size the residual tells, and the residual's derivative by it; none if there is none."""
    check = model.by_name[consistency]
    if check.relation is None or len(check.faults) != 1:
        return "", None
    (fault,) = check.faults
    if any(fault in e.faults for e in model.equations if e.name in equations and e.name != consistency):
        return "", None
    symbols = Symbols(model, faulty=True)
    residual = symbols.residual(check.relation)
    gain = sympy.diff(residual, symbols.of[fault])
    if avoided:
        gain = cancelled(gain / sympy.diff(residual, symbols.of[der(avoided[0])]))
    free = gain.free_symbols
    if gain == 0 or symbols.of[fault] in free or any(symbols.of[der(x)] in free for x in avoided):
        return "", None
    return fault, gain


def _start(model: Model, state: str, start: Mapping[str, float] | None) -> float | None:
    if start and state in start:
        return start[state]
    quantity = model.quantities.get(state)
    return None if quantity is None else quantity.value


def _residual(
    symbols: Symbols, model: Model, consistency: str, avoided: Sequence[str]
) -> tuple[Algebra, dict[str, Algebra]]:
    """Return the residual of a consistency relation; or b of (20), and the factors of the derivatives there."""
    check = model.by_name[consistency]
    if check.differential:
        return -symbols.of[der(check.differential)], {check.differential: sympy.Integer(1)}
    if check.relation is None:
        raise NotSolvableError(f"equation {consistency} has no relation, only a structure")
    residual = symbols.residual(check.relation)
    return _transformation(symbols, residual, avoided, consistency) if avoided else (residual, {})


def _transformed(model: Model, equations: frozenset[str], consistency: str, steps: tuple[Step, ...]) -> tuple[str, ...]:
    """Return the variables that are differentiated for the consistency relation, and stand so nowhere else."""
    check = model.by_name[consistency]
    if check.differential:
        return (check.differential,)
    differentiated = {state_of(s.variables[0]) for s in steps if s.kind is Kind.DIFFERENTIATE}
    others = [e for e in model.equations if e.name in equations and not e.differential and e.name != consistency]
    return tuple(x for x in check.derivatives if x in differentiated and not any(der(x) in e.variables for e in others))


def _transformation(
    symbols: Symbols, residual: Algebra, avoided: Sequence[str], consistency: str
) -> tuple[Algebra, dict[str, Algebra]]:
    """Return b of r~ = der(x) + a der(y) + ... + b, (20a), and the factors."""
    derivatives = {x: symbols.of[der(x)] for x in avoided}
    slopes = {x: sympy.diff(residual, d) for x, d in derivatives.items()}
    for x, slope in slopes.items():
        if slope == 0 or slope.has(*derivatives.values()):
            raise NotSolvableError(f"equation {consistency} is not linear in der({x}): (20a) does not hold")
    first = slopes[avoided[0]]
    b = residual.subs(dict.fromkeys(derivatives.values(), 0)) / first
    return b, {x: cancelled(slope / first) for x, slope in slopes.items()}

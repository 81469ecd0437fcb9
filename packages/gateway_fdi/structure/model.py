"""A structural model: equations, the variables of each, and those that each can be solved for.

A dynamic variable, a **state** x, occurs differentiated as ``der(x)`` (semi-explicit form, paper 004, (1); here an
equation may contain the derivatives of several states). Two ways of writing it:

- **lumped**, the paper's counts: x and der(x) are one variable, and the relation between them is tacit;
- **explicit**, (3): an equation of the model says "der(x) is the derivative of x", and both are variables.

A state is explicit when the model has such an equation (:attr:`Equation.differential`), and lumped otherwise.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum
from functools import cached_property

from gateway_fdi.structure.relation import Expression, Relation


class Solvable(IntEnum):
    """How an equation, or a loop of them, can be solved for its unknowns."""

    NONE = 0
    MULTIPLE = 1
    UNIQUE = 2

    @classmethod
    def of(cls, word: str) -> Solvable:
        """Return the one of a name.

        Raises:
            ValueError: it is none of them.
        """
        try:
            return cls[word.upper()]
        except KeyError as error:
            raise ValueError(f'"{word}" is not unique, multiple or none') from error


def der(state: str) -> str:
    """Return the name of a state's derivative."""
    return f"der({state})"


def state_of(variable: str) -> str:
    """Return the state that a variable is, or is the derivative of."""
    return variable[4:-1] if variable.startswith("der(") else variable


@dataclass(frozen=True)
class Equation:
    """An equation.

    Attributes:
        name: of the equation, ``e1``.
        variables: unknowns that it contains; the derivative of a state as ``der(x)``.
        knowns: known variables that it contains.
        faults: faults that it contains.
        solvable: variables it can be solved for, and whether that has one solution; others: not at all.
        differential: the state x, if this is the relation between x and der(x), (3); else empty.
        relation: the equation itself, for residual generators that run; None: only its structure is known.
        solutions: given solutions for a variable, where algebra does not find them.
        text: what it describes.
        note: where it differs from its source, and why.
    """

    name: str
    variables: tuple[str, ...]
    knowns: tuple[str, ...] = ()
    faults: tuple[str, ...] = ()
    solvable: Mapping[str, Solvable] = field(default_factory=dict)
    differential: str = ""
    relation: Relation | None = None
    solutions: Mapping[str, tuple[Expression, ...]] = field(default_factory=dict)
    text: str = ""
    note: str = ""

    @property
    def derivatives(self) -> tuple[str, ...]:
        """The states whose derivatives it contains (none for a differential relation)."""
        if self.differential:
            return ()
        return tuple(state_of(v) for v in self.variables if v.startswith("der("))


@dataclass(frozen=True)
class Loop:
    """An algebraic loop: equations that must be solved together; a loop that is not declared has no solution.

    Attributes:
        equations: of the loop.
        variables: solved for.
        solvable: unique, multiple or none.
        text: why.
        solutions: given solutions, one mapping for each; empty: algebra finds them.
    """

    equations: frozenset[str]
    variables: frozenset[str]
    solvable: Solvable
    text: str = ""
    solutions: tuple[Mapping[str, Expression], ...] = ()


@dataclass(frozen=True)
class Quantity:
    """Unit and meaning of a variable, a fault or a parameter.

    Attributes:
        unit: of its values.
        text: its meaning.
        value: of a parameter; a start value of a state.
    """

    unit: str = ""
    text: str = ""
    value: float | None = None


@dataclass(frozen=True)
class Table:
    """A function of one variable by points, linear between them, constant beyond."""

    x: tuple[float, ...]
    y: tuple[float, ...]
    text: str = ""


@dataclass(frozen=True)
class ResidualChoice:
    """A residual generator that a model names: an overdetermined set and its consistency relation.

    Attributes:
        equations: the set, with the consistency relation.
        consistency: the equation that is not used to compute unknowns.
        text: its purpose.
    """

    equations: frozenset[str]
    consistency: str
    text: str = ""


@dataclass(frozen=True)
class Model:
    """A structural model.

    Attributes:
        name: of the model.
        equations: in the order of the model.
        unknowns: names of the unknown variables, states among them, without derivatives.
        knowns: names of the known variables.
        faults: names of the faults.
        loops: algebraic loops that can be solved.
        quantities: unit and meaning of all names, parameters with their values.
        parameters: names of the parameters.
        tables: functions given by points.
        residuals: residual generators that the model names.
        text: the model's plant, and its source.

    Raises:
        ValueError: a name is used twice, or is not declared, or a state is used in a way that has no meaning; names
            the equation.
    """

    name: str
    equations: tuple[Equation, ...]
    unknowns: tuple[str, ...]
    knowns: tuple[str, ...] = ()
    faults: tuple[str, ...] = ()
    loops: tuple[Loop, ...] = ()
    quantities: Mapping[str, Quantity] = field(default_factory=dict)
    parameters: tuple[str, ...] = ()
    tables: Mapping[str, Table] = field(default_factory=dict)
    residuals: Mapping[str, ResidualChoice] = field(default_factory=dict)
    text: str = ""

    def __post_init__(self) -> None:
        _check(self)

    def __repr__(self) -> str:
        counted = (
            (self.equations, "equations"),
            (self.unknowns, "unknowns"),
            (self.knowns, "knowns"),
            (self.faults, "faults"),
        )
        return f"Model({self.name}: {', '.join(f'{len(some)} {what}' for some, what in counted)})"

    @cached_property
    def by_name(self) -> Mapping[str, Equation]:
        """Equations by their names."""
        return {equation.name: equation for equation in self.equations}

    @cached_property
    def states(self) -> tuple[str, ...]:
        """Variables that occur differentiated, in the order of the unknowns."""
        found = {x for equation in self.equations for x in (*equation.derivatives, equation.differential)}
        return tuple(name for name in self.unknowns if name in found)

    @cached_property
    def explicit_states(self) -> frozenset[str]:
        """States whose derivative is a variable of its own."""
        return frozenset(e.differential for e in self.equations if e.differential)

    @cached_property
    def lumped_states(self) -> tuple[str, ...]:
        """States that are one variable with their derivative."""
        return tuple(name for name in self.states if name not in self.explicit_states)

    @cached_property
    def variables(self) -> tuple[str, ...]:
        """Unknowns as they are counted: states, and the derivatives of explicit ones."""
        derivatives = [der(name) for name in self.states if name in self.explicit_states]
        return (*self.unknowns, *derivatives)

    @cached_property
    def full_variables(self) -> tuple[str, ...]:
        """Unknowns of the explicit form: with the derivatives of all states."""
        return (*self.unknowns, *(der(name) for name in self.states))

    @cached_property
    def full_equations(self) -> tuple[Equation, ...]:
        """Equations of the explicit form: with the tacit relations of lumped states after the model's own."""
        return (*self.equations, *(differential(name) for name in self.lumped_states))

    def explicit(self) -> Model:
        """Return the same model with every state explicit, (3)."""
        relation = {x: f"d/dt {x}" for x in self.lumped_states}
        residuals = {
            k: replace(
                r,
                equations=r.equations | {relation[x] for x in self._states_of(r) if x in relation},
            )
            for k, r in self.residuals.items()
        }
        return replace(self, equations=self.full_equations, residuals=residuals)

    def _states_of(self, residual: ResidualChoice) -> set[str]:
        return {x for name in residual.equations for x in self.by_name[name].derivatives}

    def lumped(self) -> Model:
        """Return the same model with every state lumped; without residuals that check a relation of a state.

        Raises:
            ValueError: a derivative occurs in several equations, so that it is not its state in disguise.
        """
        relations = frozenset(e.name for e in self.equations if e.differential)
        residuals = {
            k: replace(r, equations=r.equations - relations)
            for k, r in self.residuals.items()
            if r.consistency not in relations
        }
        equations = tuple(e for e in self.equations if not e.differential)
        return replace(self, equations=equations, residuals=residuals)

    def with_sensors(self, sensors: Mapping[str, str] | Iterable[str]) -> Model:
        """Return the model with sensors added, each an equation ``<known> = <unknown>``.

        Args:
            sensors: unknown variables, or the equation's name for each; the signal is ``<unknown>_sens``.

        Raises:
            ValueError: there is no such unknown, or the equation or the signal exists.
        """
        named = dict(sensors) if isinstance(sensors, Mapping) else {x: f"{x}_sens" for x in sensors}
        added = tuple(
            Equation(
                name,
                (x,),
                (f"{x}_sens",),
                (),
                {x: Solvable.UNIQUE},
                relation=Relation.parse(f"{x}_sens = {x}"),
                text=f"sensor of {x}",
            )
            for x, name in named.items()
        )
        return replace(
            self,
            equations=self.equations + added,
            knowns=self.knowns + tuple(f"{x}_sens" for x in named),
        )

    def without(self, equations: Iterable[str]) -> Model:
        """Return the model without some equations, and without the loops, knowns and faults of theirs alone."""
        gone = frozenset(equations)
        left = tuple(e for e in self.equations if e.name not in gone)
        lost = [e for e in self.equations if e.name in gone]
        alone = {x for e in lost for x in (*e.knowns, *e.faults)}
        alone -= {x for e in left for x in (*e.knowns, *e.faults)}
        return replace(
            self,
            equations=left,
            knowns=tuple(x for x in self.knowns if x not in alone),
            faults=tuple(x for x in self.faults if x not in alone),
            loops=tuple(loop for loop in self.loops if not loop.equations & gone),
            residuals={k: r for k, r in self.residuals.items() if not r.equations & gone},
        )


def differential(state: str, name: str = "") -> Equation:
    """Return the relation between a state and its derivative, paper 004, (3)."""
    both = {state: Solvable.UNIQUE, der(state): Solvable.UNIQUE}
    return Equation(name or f"d/dt {state}", (state, der(state)), solvable=both, differential=state)


def _once(kind: str, names: Sequence[str]) -> None:
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise ValueError(f'{kind} "{name}" is there twice')
        seen.add(name)


def _check(model: Model) -> None:
    _once("equation", [equation.name for equation in model.equations])
    _once("name", [*model.unknowns, *model.knowns, *model.faults, *model.parameters, *model.tables])
    known, faults, unknown = set(model.knowns), set(model.faults), set(model.unknowns)
    owners: dict[str, list[str]] = {}
    for e in model.equations:
        for kind, names, all_of_them in (
            ("unknown", [state_of(v) for v in e.variables], unknown),
            ("known variable", e.knowns, known),
            ("fault", e.faults, faults),
        ):
            for name in names:
                if name not in all_of_them:
                    raise ValueError(f'equation {e.name}: "{name}" is no {kind} of the model')
        _once(f"equation {e.name}: variable", e.variables)
        for v in (*e.solvable, *e.solutions):
            if v not in e.variables:
                raise ValueError(f'equation {e.name} does not contain "{v}", and cannot be solved for it')
        for state in e.derivatives:
            owners.setdefault(state, []).append(e.name)
    _check_states(model, owners)
    _check_sets(model)


def _check_states(model: Model, owners: Mapping[str, list[str]]) -> None:
    relations = [e.differential for e in model.equations if e.differential]
    _once("the relation between a state and its derivative,", relations)
    for e in model.equations:
        if e.differential and set(e.variables) != {e.differential, der(e.differential)}:
            raise ValueError(f"equation {e.name} relates {e.differential} to its derivative only")
    for state, names in owners.items():
        if len(names) > 1 and state not in relations:
            raise ValueError(
                f"der({state}) stands in {', '.join(names)}: with more than one, give the relation between"
                f' {state} and der({state}) as an equation of its own (differential = "{state}")'
            )


def _check_sets(model: Model) -> None:
    names = {e.name: e for e in model.full_equations}
    everything = set(model.full_variables)
    for loop in model.loops:
        where = f"loop {', '.join(sorted(loop.equations))}"
        for name in loop.equations:
            if name not in names:
                raise ValueError(f'{where}: there is no equation "{name}"')
        for v in loop.variables:
            if v not in everything:
                raise ValueError(f'{where}: "{v}" is no unknown of the model')
            if not any(v in names[name].variables for name in loop.equations):
                raise ValueError(f'{where}: none of its equations contains "{v}"')
        if len(loop.equations) != len(loop.variables):
            raise ValueError(f"{where}: {len(loop.equations)} equations for {len(loop.variables)} unknowns")
        for solution in loop.solutions:
            if set(solution) != loop.variables:
                raise ValueError(f"{where}: a solution gives {', '.join(sorted(loop.variables))}")
    for key, residual in model.residuals.items():
        for name in (*residual.equations, residual.consistency):
            if name not in model.by_name:
                raise ValueError(f'residual {key}: there is no equation "{name}"')
        if residual.consistency not in residual.equations:
            raise ValueError(f"residual {key}: {residual.consistency} is not in its set")


def with_sizes(model: Model) -> Model:
    """Return a model in which the size of each fault is a parameter, 0; solutions without faults are left out."""
    sizes = {fault: replace(model.quantities.get(fault, Quantity()), value=0.0) for fault in model.faults}
    equations = (replace(e, faults=(), solutions={} if e.faults else e.solutions) for e in model.equations)
    return replace(
        model, equations=tuple(equations), faults=(), parameters=(*model.parameters, *model.faults),
        quantities={**model.quantities, **sizes},
    )  # fmt: skip

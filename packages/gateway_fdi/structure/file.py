"""Structural models as TOML files.

    text = "what the model is"
    [unknown]                         # states too
    x = { unit = "V", text = "...", start = 0.0 }
    [known]                           # sensors, commands
    [fault]
    [parameter]
    R = { value = 0.05, unit = "ohm" }
    [table.f]                         # f(x), linear between points
    x = [0, 1]
    y = [2.0, 3.0]
    [equation.e1]
    relation = "der(x) = f(x) / R"    # or, structure alone: unknowns = ["x", "der(x)"], knowns = [], faults = []
    unique = ["der(x)"]               # what it can be solved for; also `multiple`
    solution = { x = "..." }          # where algebra does not find it
    [equation.e2]
    differential = "x"                # der(x) is the derivative of x; without it x is lumped
    [[loop]]                          # an algebraic loop that can be solved
    equations = ["e3", "e4"]
    unknowns = ["a", "b"]
    solvable = "multiple"
    [residual.T1]                     # a residual generator by name
    equations = ["e1", "e2", "e3"]
    consistency = "e3"

Equations stand in the order of the file.
"""

from __future__ import annotations

import keyword
from collections.abc import Iterable, Mapping
from os import PathLike
from pathlib import Path
from typing import Any

from pydantic import Field

from gateway_fdi.common.tomlfile import StrictModel, load, read_toml, validate
from gateway_fdi.errors import InputError, InputErrors, nearest
from gateway_fdi.structure.model import (
    Equation,
    Loop,
    Model,
    Quantity,
    ResidualChoice,
    Solvable,
    Table,
    der,
    differential,
)
from gateway_fdi.structure.relation import CONSTANTS, FUNCTIONS, Expression, Relation


class _Quantity(StrictModel):
    unit: str = ""
    text: str = ""


class _Unknown(_Quantity):
    start: float | None = Field(None, description="start value of a state that keeps its value")


class _Parameter(_Quantity):
    value: float


class _Table(StrictModel):
    text: str = ""
    x: tuple[float, ...] = Field(min_length=2)
    y: tuple[float, ...] = Field(min_length=2)


class _Equation(StrictModel):
    text: str = ""
    note: str = ""
    relation: str | None = None
    differential: str | None = Field(None, description="state whose derivative this relates to it")
    unknowns: tuple[str, ...] | None = None
    knowns: tuple[str, ...] = ()
    faults: tuple[str, ...] = ()
    unique: tuple[str, ...] = ()
    multiple: tuple[str, ...] = ()
    solution: dict[str, str | tuple[str, ...]] = Field(default_factory=dict)


class _Loop(StrictModel):
    text: str = ""
    equations: tuple[str, ...] = Field(min_length=1)
    unknowns: tuple[str, ...] = Field(min_length=1)
    solvable: str
    solution: tuple[dict[str, str], ...] = ()


class _Residual(StrictModel):
    text: str = ""
    equations: tuple[str, ...] = Field(min_length=1)
    consistency: str


class ModelFile(StrictModel):
    """Contents of the file of a structural model."""

    text: str = ""
    unknown: dict[str, _Unknown]
    known: dict[str, _Quantity] = Field(default_factory=dict)
    fault: dict[str, _Quantity] = Field(default_factory=dict)
    parameter: dict[str, _Parameter] = Field(default_factory=dict)
    table: dict[str, _Table] = Field(default_factory=dict)
    equation: dict[str, _Equation]
    loop: tuple[_Loop, ...] = ()
    residual: dict[str, _Residual] = Field(default_factory=dict)


class _Reader:
    """Turns a file into a model, and gathers what is wrong with it."""

    def __init__(self, data: ModelFile, file: Path | None) -> None:
        self.data, self.file = data, file
        self.errors: list[InputError] = []

    def wrong(self, message: str, key: str, value: object = None) -> None:
        self.errors.append(InputError(message, file=self.file, key=key, value=value))

    def names(self) -> None:
        kinds: dict[str, Mapping[str, Any]] = {
            "unknown": self.data.unknown,
            "known": self.data.known,
            "fault": self.data.fault,
            "parameter": self.data.parameter,
            "table": self.data.table,
        }
        seen: dict[str, str] = {}
        for kind, entries in kinds.items():
            for name in entries:
                key = f"{kind}.{name}"
                if not name.isidentifier() or keyword.iskeyword(name):
                    self.wrong("a name is letters, digits and _, and no word of Python", key)
                elif name in FUNCTIONS or name in CONSTANTS or name == "der":
                    self.wrong("this name has a meaning in equations", key)
                elif name in seen:
                    self.wrong(f"{seen[name]}.{name} has the same name", key)
                seen.setdefault(name, kind)
        for name, table in self.data.table.items():
            if len(table.x) != len(table.y):
                self.wrong(f"{len(table.x)} x for {len(table.y)} y", f"table.{name}.y")
            if any(b <= a for a, b in zip(table.x, table.x[1:], strict=False)):
                self.wrong("x must rise", f"table.{name}.x", table.x)

    def expression(self, text: str, key: str) -> Expression | None:
        try:
            found = Expression.parse(text)
        except ValueError as error:
            self.wrong(str(error), key)
            return None
        return found if self.known_names(found.names, found.functions, key) else None

    def known_names(self, names: Iterable[str], functions: Iterable[str], key: str) -> bool:
        data, before = self.data, len(self.errors)
        for name in names:
            state = name.removeprefix("der(").removesuffix(")")
            if state != name and state not in data.unknown:
                self.wrong(f'"{state}" is no unknown{nearest(state, data.unknown)}', key)
            elif state == name and name not in (all_ := [*data.unknown, *data.known, *data.fault, *data.parameter]):
                self.wrong(f'"{name}" is no unknown, known, fault or parameter{nearest(name, all_)}', key)
        for name in functions:
            if name not in data.table:
                near = nearest(name, [*FUNCTIONS, *data.table])
                self.wrong(f'there is no function or table "{name}"{near}', key)
        return len(self.errors) == before

    def equation(self, name: str, given: _Equation) -> Equation | None:
        key = f"equation.{name}"
        if given.differential is not None:
            return self.differential(name, given)
        relation = None
        if given.relation is not None:
            try:
                relation = Relation.parse(given.relation)
            except ValueError as error:
                self.wrong(str(error), f"{key}.relation")
                return None
            if not self.known_names(relation.names, relation.functions, f"{key}.relation"):
                return None
        elif given.unknowns is None:
            self.wrong('give "relation", or "unknowns" (the structure alone)', key)
            return None
        variables, knowns, faults = self.parts(relation, given, key)
        solvable = dict.fromkeys(given.multiple, Solvable.MULTIPLE)
        solvable.update(dict.fromkeys(given.unique, Solvable.UNIQUE))
        for word in ("unique", "multiple", "solution"):
            for v in getattr(given, word):
                if v not in variables:
                    self.wrong(f'equation {name} does not contain the unknown "{v}"', f"{key}.{word}")
        for v in set(given.unique) & set(given.multiple):
            self.wrong(f'"{v}" is unique already', f"{key}.multiple")
        return Equation(
            name,
            variables,
            knowns,
            faults,
            solvable,
            relation=relation,
            solutions=self.solutions(given, key, solvable),
            text=given.text,
            note=given.note,
        )

    def differential(self, name: str, given: _Equation) -> Equation | None:
        state, key = given.differential or "", f"equation.{name}"
        if given.relation is not None or given.unknowns is not None:
            self.wrong("a differential equation has no relation or unknowns", f"{key}.differential")
        if state not in self.data.unknown:
            self.wrong("this is no unknown", f"{key}.differential", state)
            return None
        return differential(state, name)

    def parts(
        self, relation: Relation | None, given: _Equation, key: str
    ) -> tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...]]:
        if relation is None:
            return given.unknowns or (), given.knowns, given.faults
        found = relation.names
        variables = tuple(n for n in found if n in self.data.unknown or n.startswith("der("))
        knowns = tuple(n for n in found if n in self.data.known)
        faults = tuple(n for n in found if n in self.data.fault)
        for word, wanted, there in (
            ("unknowns", given.unknowns, variables),
            ("knowns", given.knowns or None, knowns),
        ):
            if wanted is not None and set(wanted) != set(there):
                self.wrong(f"the relation contains {', '.join(there) or 'none'}", f"{key}.{word}", wanted)
        return variables, knowns, tuple(dict.fromkeys(faults + given.faults))

    def solutions(
        self, given: _Equation, key: str, solvable: Mapping[str, Solvable]
    ) -> dict[str, tuple[Expression, ...]]:
        found = {}
        for v, texts in given.solution.items():
            several = (texts,) if isinstance(texts, str) else texts
            parsed = [self.expression(text, f"{key}.solution.{v}") for text in several]
            found[v] = tuple(one for one in parsed if one is not None)
            wanted = solvable.get(v, Solvable.NONE)
            if (wanted is Solvable.UNIQUE) != (len(several) == 1) or wanted is Solvable.NONE:
                self.wrong(
                    f"{len(several)} solutions, but {wanted.name.lower()} is declared",
                    f"{key}.solution.{v}",
                )
        return found

    def loop(self, place: int, given: _Loop) -> Loop | None:
        key = f"loop[{place}]"
        try:
            solvable = Solvable.of(given.solvable)
        except ValueError as error:
            self.wrong(str(error), f"{key}.solvable")
            return None
        solutions = []
        for k, solution in enumerate(given.solution):
            parsed = {v: self.expression(t, f"{key}.solution[{k}].{v}") for v, t in solution.items()}
            solutions.append({v: e for v, e in parsed.items() if e is not None})
        return Loop(
            frozenset(given.equations),
            frozenset(given.unknowns),
            solvable,
            given.text,
            tuple(solutions),
        )

    def quantities(self) -> dict[str, Quantity]:
        data = self.data
        found = {k: Quantity(q.unit, q.text) for k, q in (data.known | data.fault).items()}
        found.update({k: Quantity(q.unit, q.text, q.start) for k, q in data.unknown.items()})
        found.update({k: Quantity(q.unit, q.text, q.value) for k, q in data.parameter.items()})
        for name in data.unknown:
            found[der(name)] = Quantity(text=f"derivative of {name}")
        return found

    def model(self, name: str) -> Model:
        data = self.data
        self.names()
        equations = [self.equation(k, e) for k, e in data.equation.items()]
        loops = [self.loop(k, one) for k, one in enumerate(data.loop)]
        if self.errors:
            raise InputErrors(self.errors)
        try:
            return Model(
                name,
                tuple(e for e in equations if e is not None),
                tuple(data.unknown),
                tuple(data.known),
                tuple(data.fault),
                tuple(one for one in loops if one is not None),
                self.quantities(),
                tuple(data.parameter),
                {k: Table(t.x, t.y, t.text) for k, t in data.table.items()},
                {k: ResidualChoice(frozenset(r.equations), r.consistency, r.text) for k, r in data.residual.items()},
                data.text,
            )
        except ValueError as error:
            raise InputError(str(error), file=self.file) from error


def load_model(source: str | PathLike[str] | Mapping[str, Any]) -> Model:
    """Read a structural model; its name is the file's.

    Args:
        source: the file, or its tables.

    Raises:
        InputError: the file is not readable, or the model makes no sense; names what.
        InputErrors: every key that is wrong.
    """
    if isinstance(source, Mapping):
        return _Reader(validate(dict(source), ModelFile, None), None).model("model")
    path = Path(source)
    return _Reader(load(path, ModelFile), path).model(path.stem)


def load_own_model(path: Path, *, key: str) -> Model:
    """Read a model that a configuration or a scenario names.

    Raises:
        InputError, InputErrors: the errors in it.
    """
    try:
        return load_model(path)
    except InputErrors as errors:
        there = read_toml(path)
        if not {"bus", "ecu"} & there.keys():
            raise
        kind = "configuration" if "bus" in there else "scenario"
        text = f"this file is a {kind}, not a model: one of the two needs another name, or folder"
        raise InputError(text, key=key, value=path.name) from errors

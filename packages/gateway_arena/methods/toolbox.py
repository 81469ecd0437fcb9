"""Rival: residuals that Fault Diagnosis Toolbox chooses and writes (Frisk, Krysander, Jung, IFAC World Congress 2017).

It is MIT-licensed, and its own package: pip install faultdiagnosistoolbox. Its minimal sets of equations, its choice of
tests, its matching and its Python are used as they are. Its sets know no equation that cannot be solved: those are left
out, by the model's word.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import chdir, redirect_stdout
from importlib.util import find_spec
from io import StringIO
from pathlib import Path
from tempfile import TemporaryDirectory
from textwrap import dedent
from typing import Any

import numpy as np

from gateway_arena.contract import Array, NotForThisPlantError, Plant, Record
from gateway_arena.methods.extended_kalman import Equations
from gateway_arena.methods.structural import Structural
from gateway_fdi import analyse
from gateway_fdi.structure.generator.sources import load_source
from gateway_fdi.structure.model import Model, Solvable

#: Steps of Euler's rule in a sample, if a residual integrates: with one the valve's runs away.
STEPS = 400
#: Kinds of residuals, in the order in which they are tried.
KINDS = ("algebraic", "int", "mixed", "der")
_MODULE = """
from math import acos, asin, atan, cos, exp, log, pi, sin, sqrt, tan, tanh

from gateway_fdi.jit import kernel
from gateway_fdi.structure.generator.runtime import interpolate

Max, Min, Abs = (kernel(f) for f in (lambda a, b: max(a, b), lambda a, b: min(a, b), lambda a: abs(a)))
sign = kernel(lambda a: (a > 0.0) - (a < 0.0))
Piecewise = kernel(lambda first, other: first[0] if first[1] else other[0])

"""
_OVER = """
@kernel
def over(rows, state, Ts, steps, found):
    for k in range(len(rows)):
        for _ in range(steps):
            found[k], state = checked_core(rows[k], state, 0, Ts)
"""


class Written:
    """A residual generator of the toolbox, its Python compiled.

    Attributes:
        faults: that it sees.
    """

    def __init__(self, text: str, model: Model, faults: Sequence[str], equations: Equations) -> None:
        self.faults, self._model, self._equations = faults, model, equations
        self._states = list(dict.fromkeys(re.findall(r"state\['(\w+)'\] = ", text)))
        text = dedent(text[text.index('"""\n', text.index('"""') + 3) + 4 : text.rindex("    return checked_core")])
        text = re.sub(r"params\['(\w+)'\]", lambda found: repr(model.quantities[found[1]].value), text)
        text = re.sub(r"state\['(\w+)'\]", lambda found: f"state[{self._states.index(found[1])}]", text)
        told = ((name, tuple(t.x), tuple(t.y)) for name, t in model.tables.items())
        tables = "".join(f"{name} = kernel(lambda at: interpolate({x}, {y}, at))\n" for name, x, y in told)
        text = re.sub(r"^def ", "@kernel\ndef ", text, flags=re.M)
        self._over = load_source("toolbox", _MODULE + tables + text + _OVER).over

    def run(self, t_s: Array, values: Mapping[str, Array]) -> Array:
        """Return the residual of a record, shape (n,); its states begin with the first sample."""
        rows = np.ascontiguousarray(np.stack([values[z] for z in self._model.knowns], 1))
        begun = dict(zip(self._equations.names, self._equations.begun(rows[0]).tolist(), strict=True))
        state, found = np.array([begun[name] for name in self._states] or [0.0]), np.zeros(len(rows))
        steps = STEPS if self._states else 1
        self._over(rows, state, float(t_s[1] - t_s[0]) / steps, steps, found)
        return found


def chosen(model: Model) -> Iterator[Written]:
    """Yield the residuals that the toolbox chooses among those that it can write."""
    import faultdiagnosistoolbox as fdt  # noqa: PLC0415 - an extra package, slow to load
    import sympy  # noqa: PLC0415 - likewise

    from gateway_fdi.structure.generator.symbols import Symbols  # noqa: PLC0415

    symbols, equations = Symbols(model, faulty=True), Equations(model, model.knowns)
    plain = {symbols.of[name]: sympy.Symbol(_plain(name)) for name in symbols.of}

    def relation(e: Any) -> Any:
        if e.differential:
            return fdt.DiffConstraint(f"d_{e.differential}", e.differential)
        return symbols.residual(e.relation).xreplace(plain)

    theirs = fdt.DiagnosisModel({
        "type": "Symbolic", "x": [_plain(x) for x in model.full_variables], "f": [*model.faults], "z": [*model.knowns],
        "parameters": [*model.parameters], "rels": [relation(e) for e in model.equations],
    }, name=model.name)  # fmt: skip
    analysis = analyse(model)
    rows = analysis.msos[analysis.candidates.sets(analysis.candidates.chosen("SDI", "unique"))]
    usable = {frozenset(np.flatnonzero(row).tolist()) for row in rows}
    sets = [np.array(each) for each in theirs.MSO() if frozenset(int(k) for k in each) in usable]
    while sets:
        texts = {int(k): _written(theirs, model, sets[k]) for k in theirs.TestSelection(sets)}
        if all(texts.values()):
            break
        sets = [each for k, each in enumerate(sets) if texts.get(k, "x")]
    for k, text in texts.items() if sets else ():
        sees = theirs.FSM([sets[k]])[0]
        yield Written(text, model, [f for f, there in zip(model.faults, sees, strict=True) if there], equations)


def _plain(name: str) -> str:
    return f"d_{name[4:-1]}" if name.startswith("der(") else name


def _written(theirs: Any, model: Model, rows: Array) -> str:
    """Return the toolbox's code of a set, "" if it writes none: first without a derivative, then with integrals."""
    can = [{_plain(x) for x, how in e.solvable.items() if how is Solvable.UNIQUE} for e in model.equations]
    found = []
    for checked in rows:
        matching = theirs.Matching(np.sort(rows[rows != checked]))
        pairs = [(r, theirs.x[c]) for part in matching.matching for r, c in zip(part.row, part.col, strict=True)]
        loops = any(part.matchType == "algebraic" and len(part.row) > 1 for part in matching.matching)
        if not loops and all(model.equations[r].differential or x in can[r] for r, x in pairs):
            differential = bool(model.equations[checked].differential)
            found.append((KINDS.index(matching.matchType), differential, int(checked), matching))
    for *_, checked, matching in sorted(found, key=lambda one: one[:3]):
        with TemporaryDirectory() as folder, chdir(folder), redirect_stdout(StringIO()):
            try:
                theirs.SeqResGen(matching, checked, "checked")
            except (NotImplementedError, IndexError):  # algebra does not solve an equation
                continue
            text = Path("checked.py").read_text()
        called = {*re.findall(r"(\w+)\(", text.rpartition("# Residual generator body")[2])} - {"checked_core"}
        if called <= {*re.findall(r"\w+", _MODULE), *model.tables, "ApproxInt", "ApproxDiff"}:
            return text
    return ""


class Toolbox(Structural):
    """The toolbox's residuals, a CUSUM each; faults that all tests that fire see share the probability."""

    def _derived(self, plant: Plant) -> Sequence[Any]:
        if find_spec("faultdiagnosistoolbox") is None:
            raise NotForThisPlantError("it is absent: pip install faultdiagnosistoolbox")
        found = list(chosen(plant.model.explicit()))
        if not found:
            raise NotForThisPlantError("the toolbox can write no residual")
        return found

    def _weighed(self, record: Record, computed: Sequence[Array], norms: Array) -> Array:
        blind = np.array([[fault not in residual.faults for fault in self._faults] for residual in self._residuals])
        fired = norms > 1.0
        fits = fired.any(1, keepdims=True) & ~(fired @ blind)
        return np.asarray(fits / np.maximum(fits.sum(1, keepdims=True), 1))

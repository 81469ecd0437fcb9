"""All that structural analysis tells of a model, computed once, and as data for programs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway_fdi.errors import InputError
from gateway_fdi.masks import Sets
from gateway_fdi.structure.candidates import ALGEBRAIC, CAUSALITIES, Candidates, classify
from gateway_fdi.structure.decomposition import Block, Decomposition, decompose
from gateway_fdi.structure.incidence import Incidence, counted
from gateway_fdi.structure.isolability import (
    Isolability,
    isolability_of_model,
    isolability_of_tests,
    signatures,
)
from gateway_fdi.structure.model import Model, ResidualChoice, Solvable
from gateway_fdi.structure.mso import MOST_SETS, TooManySetsError, find_msos
from gateway_fdi.structure.mtes import find_mtes
from gateway_fdi.structure.selection import fewest_tests
from gateway_fdi.structure.sequence import Structure, shown
from gateway_fdi.structure.sufficient import sufficient_msos


@dataclass(frozen=True)
class Test:
    """A residual generator of the model, classified.

    Attributes:
        equations: its set, in the order of the model.
        consistency: the consistency relation.
        causality: S, SI, SD or SDI.
        status: unique, multiple or none.
        faults: that it is sensitive to.
        sequence: how its unknowns are computed, as the paper writes it.
        minimal: whether its set is an MSO set.
    """

    equations: tuple[str, ...]
    consistency: str
    causality: str
    status: str
    faults: tuple[str, ...]
    sequence: str
    minimal: bool


@dataclass(frozen=True)
class Analysis:
    """Results of a model's structural analysis.

    Attributes:
        model: the model.
        structure: its structure as it is counted.
        parts: its Dulmage-Mendelsohn decomposition.
        msos: its MSO sets, shape (sets, equations).
        candidates: all candidates of these, classified.
        beyond: 0: these are all; else there are more than this number, and these are enough for all that the model can
            tell.
    """

    model: Model
    structure: Incidence
    parts: Decomposition
    msos: Sets
    candidates: Candidates
    beyond: int = 0

    def __repr__(self) -> str:
        more = f", more than {self.beyond} exist" if self.beyond else ""
        return f"Analysis({self.model.name}: {len(self.msos)} MSO sets{more}, {len(self.candidates)} candidates)"

    @property
    def left_out(self) -> str:
        """Parts that were not looked at, in words; empty: none."""
        if not self.beyond:
            return ""
        return (
            f"there are more than {self.beyond} MSO sets, not all of them were looked for: these {len(self.msos)},"
            " found for each fault and each pair of faults, tell what the structure can; there may be others that are"
            " smaller, need fewer tests, or tell more by one class of causality alone"
        )

    @cached_property
    def sizes(self) -> dict[int, int]:
        """How many sets there are of each number of equations."""
        return dict(sorted(Counter(map(int, self.msos.sum(1))).items()))

    @cached_property
    def signature(self) -> Sets:
        """Fault signature matrix of the sets, shape (sets, faults)."""
        return signatures(self.model, self.msos)

    @cached_property
    def best(self) -> Isolability:
        """Best isolation that the structure allows."""
        return isolability_of_model(self.model)

    def isolability(self, causality: str, algebraic: str = "unique") -> Isolability:
        """Return what the sets tell that have a candidate of a class."""
        chosen = self.candidates.sets(self.candidates.chosen(causality, algebraic))
        return isolability_of_tests(self.model.faults, self.signature[chosen])

    @cached_property
    def fewest(self) -> NDArray[np.int64]:
        """The fewest sets with unique residual generators that tell as much as all of those, by their numbers."""
        usable = np.flatnonzero(_unique(self.candidates))
        sizes = self.msos[usable].sum(1).astype(np.float64)
        return usable[fewest_tests(self.signature[usable], sizes)]

    @cached_property
    def tests(self) -> dict[str, Test]:
        """The residual generators that the model names."""
        return {name: self.test(choice) for name, choice in self.model.residuals.items()}

    def test(self, choice: ResidualChoice) -> Test:
        """Classify a residual generator.

        Raises:
            ValueError: its set does not determine its unknowns.
        """
        row = self.structure.subset(choice.equations)
        steps = Structure(self.model).sequence(choice.equations, choice.consistency)
        alone = classify(self.model, row[None, :])
        k = [self.structure.equations[e] for e in alone.equation].index(choice.consistency)
        faults = signatures(self.model, row[None, :])[0]
        return Test(
            self.structure.names(row),
            choice.consistency,
            alone.causality(k),
            Solvable(int(alone.status[k])).name.lower(),
            tuple(f for f, there in zip(self.model.faults, faults, strict=True) if there),
            shown(self.model, steps),
            bool((self.msos == row).all(1).any()),
        )

    def choice(self, name: str) -> ResidualChoice:
        """Return a residual generator by its name in the model, or as ``<number of a set>:<equation>``.

        Raises:
            InputError: neither.
        """
        if name in self.model.residuals:
            return self.model.residuals[name]
        number, _, equation = name.partition(":")
        if number.isdigit() and 1 <= int(number) <= len(self.msos):
            names = self.structure.names(self.msos[int(number) - 1])
            if equation in names:
                return ResidualChoice(frozenset(names), equation)
            raise InputError(f"set {number} has {', '.join(names)}", key="--residual", value=name)
        known = ", ".join(self.model.residuals) or "no residuals"
        raise InputError(
            f"the model names {known}; or give SET:EQUATION, of the sets 1 to {len(self.msos)}",
            key="--residual",
            value=name,
        )

    def counts(self, causality: str, algebraic: str) -> NDArray[np.int64]:
        """Return the number of candidates of a class in each set, shape (sets,): a bar chart of the paper's Fig. 2."""
        chosen = self.candidates.chosen(causality, algebraic)
        return np.bincount(self.candidates.mso[chosen], minlength=len(self.msos))


def analyse(
    model: Model,
    *,
    limit: int = MOST_SETS,
    progress: Callable[[str, float], None] | None = None,
) -> Analysis:
    """Analyse a model.

    Args:
        limit: greatest number of MSO sets that are all looked at; where there are more, as many as are enough.
        progress: called with what is done and the share of it, 0 to 1.
    """

    def searching(count: int, share: float) -> None:
        if progress is not None:
            progress(f"{count} MSO sets", share)

    def classifying(done: int) -> None:
        if progress is not None:
            progress(f"{done} of {len(msos)} sets classified", done / max(len(msos), 1))

    structure = counted(model)
    beyond = 0
    try:
        msos = find_msos(structure, limit=limit, progress=searching)
    except TooManySetsError as error:
        beyond = error.limit
        msos = sufficient_msos(
            model, lambda sets: _unique(classify(model, sets)), structure=structure, progress=searching
        )
    candidates = classify(model, msos, progress=classifying)
    return Analysis(model, structure, decompose(structure), msos, candidates, beyond)


def _unique(candidates: Candidates) -> NDArray[np.bool_]:
    """Return which sets have a residual generator with one solution, shape (sets,)."""
    return candidates.sets(candidates.chosen("SDI", "unique"))


def as_dict(analysis: Analysis) -> dict[str, Any]:
    """Return an analysis as data."""
    model, parts = analysis.model, analysis.parts
    return {
        "model": model.name,
        "equations": len(model.equations),
        "unknowns": len(model.variables),
        "knowns": len(model.knowns),
        "faults": list(model.faults),
        "redundancy": parts.redundancy,
        "msos": len(analysis.msos),
        "all": not analysis.beyond,
        "candidates": len(analysis.candidates),
        "sizes": {str(size): count for size, count in analysis.sizes.items()},
        "table": _table(analysis.candidates),
        **_isolability(analysis.best),
        "isolability_of": {causality: _isolability(analysis.isolability(causality)) for causality in CAUSALITIES},
        "mtes": None if analysis.beyond else [list(analysis.structure.names(row)) for row in find_mtes(model)],
        "fewest_tests": [int(k) + 1 for k in analysis.fewest],
        "parts": {
            "under": _block(parts.under),
            "just": [_block(block) for block in parts.just],
            "over": _block(parts.over),
            "classes": [_block(block) for block in parts.classes],
        },
        "tests": {name: asdict(test) for name, test in analysis.tests.items()},
        "sets": _sets(analysis),
    }


def _table(candidates: Candidates) -> dict[str, Any]:
    """Return Table IV; pairs as lists."""
    return {
        algorithm: {
            algebraic: {causality: list(pair) for causality, pair in row.items()} for algebraic, row in rows.items()
        }
        for algorithm, rows in candidates.table.items()
    }


def _isolability(found: Isolability) -> dict[str, Any]:
    return {
        "detectable": found.detectable.astype(int).tolist(),
        "isolability": found.confused.astype(int).tolist(),
    }


def _sets(analysis: Analysis) -> list[dict[str, Any]]:
    """Return every MSO set with its faults and its candidates of each class."""
    counts = {
        f"{algebraic} {causality}": analysis.counts(causality, algebraic)
        for algebraic in ALGEBRAIC
        for causality in CAUSALITIES
    }
    faults = analysis.model.faults
    return [
        {
            "equations": list(analysis.structure.names(row)),
            "faults": [f for f, there in zip(faults, signs, strict=True) if there],
            **{name: int(count[k]) for name, count in counts.items()},
        }
        for k, (row, signs) in enumerate(zip(analysis.msos, analysis.signature, strict=True))
    ]


def _block(block: Block) -> dict[str, list[str]]:
    return {"equations": list(block.equations), "unknowns": list(block.variables)}

"""What a structural model becomes: the tests that were chosen, and what they tell. It is data, and kept as such."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from gateway_fdi.structure.isolability import Isolability, isolability_of_tests

#: Tests and faults that a monitor has room for, and generators that only measure a fault's size.
MOST_TESTS, MOST_FAULTS, MOST_METERS = 320, 160, 160


class Noise(NamedTuple):
    """How a known variable's noise reaches a residual, at the model's parameters.

    Attributes:
        known: which.
        direct: residual by known variable, where nothing is differentiated.
        slope: residual by the derivative of the known variable [s].
    """

    known: str
    direct: float
    slope: float


@dataclass(frozen=True)
class Test:
    """A residual generator that runs.

    Attributes:
        name: of the test.
        equations: its set, in the order of the model.
        consistency: the equation that is checked.
        causality: S, SI, SD or SDI.
        faults: that it is sensitive to.
        sequence: how its unknowns are computed, as the paper writes it.
        knowns: known variables that it reads.
        rates: fields for derivatives of known variables that its start reads.
        unit: of its residual, empty if that is not known.
        guessed: states that begin at 0, because neither the model nor (24) says where.
        drifting: states that are integrated and never forget: what a sensor is off by adds up.
        differentiated: variables whose derivative is the slope of a low-pass.
        filtered: the residual is filtered by (20), and the gain of what it measures with it.
        noise: how the noise of its known variables reaches the residual.
        at_rest: by how much each fault of size 1 moves the residual for good; infinite: ever more, or not known.
        observed: its states are corrected by the residual (:mod:`.observer`).
        measures: the fault whose size is minus the residual over the gain that its state shows; empty: none.
        source: its code.
        faulty: the same with the size of each fault in its constants; empty: algebra does not find it.
    """

    name: str
    equations: tuple[str, ...]
    consistency: str
    causality: str
    faults: tuple[str, ...]
    sequence: str
    knowns: tuple[str, ...]
    rates: tuple[str, ...]
    unit: str
    guessed: tuple[str, ...]
    drifting: tuple[str, ...]
    differentiated: tuple[str, ...]
    filtered: bool
    noise: tuple[Noise, ...]
    at_rest: tuple[float, ...]
    measures: str
    source: str
    observed: bool = False
    faulty: str = ""

    @property
    def fleeting(self) -> tuple[str, ...]:
        """Faults that it sees only while they change: at rest they leave nothing."""
        return tuple(f for f, gain in zip(self.faults, self.at_rest, strict=True) if gain == 0.0)


@dataclass(frozen=True)
class Plan:
    """The tests of a monitor.

    Attributes:
        tests: in the order in which they run.
        faults: of the model that some test sees, in the model's order.
        told: what people should know of the choice, a line each.
        meters: generators that are no tests, but tell the size of a fault that no test measures.
    """

    tests: tuple[Test, ...]
    faults: tuple[str, ...]
    told: tuple[str, ...] = field(default=())
    meters: tuple[Test, ...] = field(default=())

    @property
    def generators(self) -> tuple[Test, ...]:
        """All that runs: the tests, and behind them the meters."""
        return (*self.tests, *self.meters)

    @cached_property
    def measured(self) -> dict[str, int]:
        """Which of the generators tells a fault's size, by fault, in the order of the faults.

        A test comes before a meter, but for one with the slope of a low-pass, which lags behind.
        """
        tests = [k for k, test in enumerate(self.tests) if not test.differentiated]
        rest = list(range(len(self.tests), len(self.generators)))
        rest += [k for k, test in enumerate(self.tests) if test.differentiated]
        by = {g.measures: k for k in reversed([*tests, *rest]) if (g := self.generators[k]).measures}
        return {fault: by[fault] for fault in self.faults if fault in by}

    @property
    def knowns(self) -> tuple[str, ...]:
        """Known variables that the tests read."""
        return tuple(dict.fromkeys(z for test in self.generators for z in test.knowns))

    @property
    def rates(self) -> tuple[str, ...]:
        """Fields for derivatives that their starts read."""
        return tuple(dict.fromkeys(z for test in self.generators for z in test.rates))

    @cached_property
    def isolability(self) -> Isolability:
        """What the tests tell."""
        rows = np.array([[fault in test.faults for fault in self.faults] for test in self.tests], np.bool_)
        return isolability_of_tests(self.faults, rows)

    @cached_property
    def diagnoses(self) -> tuple[tuple[str, ...], ...]:
        """What can come out: for each fault, when all its tests have fired, the faults that explain that."""
        found = self.isolability.confused
        each = (tuple(g for g, too in zip(self.faults, row, strict=True) if too) for row in found)
        return tuple(dict.fromkeys(each))

    def seen_by(self, fault: str) -> list[int]:
        """Return the tests that see a fault, by their numbers."""
        return [k for k, test in enumerate(self.tests) if fault in test.faults]


def from_dict(data: dict[str, Any]) -> Plan:
    """Return the plan that ``asdict`` gave, also by way of JSON."""

    def tuples(values: dict[str, Any]) -> dict[str, Any]:
        return {key: tuple(value) if isinstance(value, list) else value for key, value in values.items()}

    def test(values: dict[str, Any]) -> Test:
        return Test(**tuples(values) | {"noise": tuple(Noise(*one) for one in values["noise"])})

    tests, meters = (tuple(test(one) for one in data[key]) for key in ("tests", "meters"))
    return Plan(tests, tuple(data["faults"]), tuple(data["told"]), meters)

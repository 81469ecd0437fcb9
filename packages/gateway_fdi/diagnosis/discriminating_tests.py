"""What would tell diagnoses apart: tests that have not spoken, and that one of them would have fail, the other not."""

from __future__ import annotations

from typing import NamedTuple

from gateway_fdi.diagnosis.answer import Diagnosis, Group
from gateway_fdi.diagnosis.state import NOT_TESTED, State
from gateway_fdi.diagnosis.system import System

#: A test tells two diagnoses apart if by one of them it fails so much more often than by the other.
ENOUGH = 0.5


class Telling(NamedTuple):
    """A test that would tell two diagnoses apart.

    Attributes:
        test: its place.
        for_first, for_other: probability that it fails by the first diagnosis, and by the other.
        waits: whether it is tested, but not for long enough; else it is not tested.
    """

    test: int
    for_first: float
    for_other: float
    waits: bool


def telling(system: System, state: State, group: Group) -> tuple[Telling, ...]:
    """Return tests that would tell the two likeliest diagnoses of a group apart, the sharpest first."""
    if len(group.diagnoses) < 2:
        return ()
    first, other = group.diagnoses[:2]
    waiting = {one.test for one in group.waiting}
    tests = {
        int(system.link_test[link])
        for component in {*first.components, *other.components}
        for link in system.of_component[component]
    }
    found = [
        Telling(t, _fails(system, t, first), _fails(system, t, other), t in waiting)
        for t in sorted(tests)
        if t in waiting or state.verdict[t] == NOT_TESTED
    ]
    enough = [one for one in found if abs(one.for_first - one.for_other) >= ENOUGH]
    return tuple(sorted(enough, key=lambda one: (-abs(one.for_first - one.for_other), one.test)))


def _fails(system: System, test: int, diagnosis: Diagnosis) -> float:
    passes = 1.0 - float(system.false_alarm[test])
    for link in system.of_test[test]:
        if int(system.link_component[link]) in diagnosis.components:
            passes *= 1.0 - float(system.power[link])
    return 1.0 - passes

"""What would tell diagnoses apart: tests that have not spoken, and that one of them would have fail, the other not."""

from __future__ import annotations

from gateway_fdi.diagnosis.answer import Diagnosis, Group
from gateway_fdi.diagnosis.state import NOT_TESTED, State
from gateway_fdi.diagnosis.system import System

#: A test tells two diagnoses apart if by one of them it fails so much more often than by the other.
ENOUGH = 0.5


def telling(system: System, state: State, group: Group) -> tuple[int, ...]:
    """Return places of tests that would tell the two likeliest diagnoses of a group apart, the sharpest first."""
    if len(group.diagnoses) < 2:
        return ()
    first, other = group.diagnoses[:2]
    waiting = {one.test for one in group.waiting}
    tests = {
        int(system.link_test[link])
        for component in {*first.components, *other.components}
        for link in system.of_component[component]
    }
    open_ = [t for t in sorted(tests) if t in waiting or state.verdict[t] == NOT_TESTED]
    apart = {t: abs(_fails(system, t, first) - _fails(system, t, other)) for t in open_}
    return tuple(sorted((t for t in open_ if apart[t] >= ENOUGH), key=lambda t: -apart[t]))


def _fails(system: System, test: int, diagnosis: Diagnosis) -> float:
    passes = 1.0 - float(system.false_alarm[test])
    for link in system.of_test[test]:
        if int(system.link_component[link]) in diagnosis.components:
            passes *= 1.0 - float(system.power[link])
    return 1.0 - passes

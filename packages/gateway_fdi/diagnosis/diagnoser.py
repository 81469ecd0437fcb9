"""Keeps the diagnoses up to date while verdicts change; what a change does not touch is not looked at again.

Failed tests that share no component, not even by way of others, are independent: each group has diagnoses of its own,
and what is wrong as a whole is one of each. A verdict touches the group of its components only.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from gateway_fdi.diagnosis.answer import Group
from gateway_fdi.diagnosis.cluster import Cluster
from gateway_fdi.diagnosis.search import Bounds, solve
from gateway_fdi.diagnosis.state import FAILED, Sized, State
from gateway_fdi.diagnosis.system import Component, System, Test
from gateway_fdi.errors import MissingError, named


class Diagnoser:
    """Finds the causes of what tests say.

    Attributes:
        system: components and tests.
        state: the verdicts.
        solved: groups that have been looked at so far: the work that was done.

    Raises:
        InputError: a name that is there twice or not at all, a probability that is none.
    """

    def __init__(self, components: Sequence[Component], tests: Sequence[Test], bounds: Bounds | None = None) -> None:
        self.system = System(components, tests)
        self.state = State(self.system)
        self.solved = 0
        self._bounds = bounds or Bounds()
        self._groups: dict[tuple[int, ...], Group] = {}
        self._of: dict[int, tuple[int, ...]] = {}  # failed test -> its group
        self._touched: set[int] = set()  # tests with another verdict than before
        self._answer: tuple[Group, ...] = ()

    def update(self, test: str, verdict: int, t_ns: int, residual: float = math.nan) -> bool:
        """Take the verdict of a test; the same one again says until when it held. Returns whether anything changed.

        Args:
            test: its name.
            verdict: NOT_TESTED, PASSED or FAILED.
            t_ns: when, not before the last one of the same test [ns].
            residual: of the test, signed, in the unit of its noise; NaN: not known.

        Raises:
            MissingError: there is no such test.
        """
        place = self._place(test)
        changed = self.state.update(place, verdict, t_ns, residual)
        if changed:
            self._touched.add(place)
        return changed

    def _place(self, test: str) -> int:
        place = self.system.test_place.get(test)
        if place is None:
            raise MissingError(named("the tests are", test, self.system.test_place), key="test", value=test)
        return place

    def pass_first(self, places: NDArray[np.int64], t_ns: NDArray[np.int64]) -> bool:
        """Take first passes of tests, in order of time; returns False, and takes none, if any was tested before.

        Args:
            places: of the tests, shape (n,), each once.
            t_ns: when, shape (n,) [ns].
        """
        passed = set(places.tolist())
        if self.state.verdict[places].any() or len(passed) < len(places):
            return False
        self.state.pass_first(places, t_ns)
        self._touched |= passed
        return True

    def size(self, test: str, sized: Sized | None) -> None:
        """Take what a test says of sizes at its operating point, None: nothing.

        Raises:
            MissingError: there is no such test.
        """
        place = self._place(test)
        if self.state.size(place, sized):
            self._touched.add(place)

    def succeed(self, old: Diagnoser) -> None:
        """Take over what an earlier one knows of the tests that both have, by their names."""
        for name, place in self.system.test_place.items():
            before = old.system.test_place.get(name)
            if before is not None:
                self.state.take_over(place, old.state, before)
                self._touched.add(place)

    def diagnose(self) -> tuple[Group, ...]:
        """Return what explains the tests that fail, a group each, in the order of their first tests."""
        if not self._touched:
            return self._answer
        stale = self._stale()
        self._touched.clear()
        if stale is None:
            return self._answer
        failed = {t for t in stale if self.state.verdict[t] == FAILED}
        for key in {self._of[t] for t in stale if t in self._of}:
            self._groups.pop(key, None)
        for t in stale:
            self._of.pop(t, None)
        for group in self._parted(sorted(failed)):
            self._groups[group] = solve(Cluster(self.system, self.state, group), self._bounds)
            self._of.update(dict.fromkeys(group, group))
            self.solved += 1
        self._answer = tuple(self._groups[key] for key in sorted(self._groups))
        return self._answer

    def causes(self) -> list[tuple[tuple[str, ...], float]]:
        """Return what explains the tests that fail, by names, with its probability; of each group the likeliest first.

        No component: they are false alarms.
        """
        names = [component.told for component in self.system.components]
        return [
            (tuple(names[place] for place in one.components), one.probability)
            for group in self.diagnose()
            for one in group.diagnoses
        ]

    def _stale(self) -> set[int] | None:
        """Return tests whose groups are to be looked at again; None: no group is touched."""
        stale: set[int] = set()
        for test in self._touched:
            if self.state.verdict[test] == FAILED or test in self._of:
                stale.add(test)
            stale.update(self._failed_beside(test))
        for key in {self._of[t] for t in stale if t in self._of}:
            stale.update(key)
        return stale or None

    def _failed_beside(self, test: int) -> Iterable[int]:
        """Yield tests of groups that share a component with a test, or whose diagnoses have one of its components."""
        system = self.system
        if not self._of:
            return
        own = set(system.link_component[system.of_test[test]].tolist())
        yield from (
            key[0] for key, of in self._groups.items() if any(own.intersection(d.components) for d in of.diagnoses)
        )
        for component in system.link_component[system.of_test[test]].tolist():
            for other in system.link_test[system.of_component[component]].tolist():
                if other in self._of:
                    yield other

    def _parted(self, failed: Sequence[int]) -> list[tuple[int, ...]]:
        """Return failed tests in groups that share no component, each ascending."""
        system = self.system
        alone: list[tuple[int, ...]] = [(t,) for t in failed if not len(system.of_test[t])]  # they blame nothing
        failed = [t for t in failed if len(system.of_test[t])]
        if not failed:
            return alone
        links = np.concatenate([system.of_test[t] for t in failed])
        starts = np.cumsum([0, *(len(system.of_test[t]) for t in failed[:-1])])
        components, column = np.unique(system.link_component[links], return_inverse=True)
        row = np.repeat(np.arange(len(failed)), np.diff([*starts, len(links)]))
        head = np.arange(len(failed))
        while True:  # each test takes the least number among those that it shares a component with
            least = np.full(len(components), len(failed))
            np.minimum.at(least, column, head[row])
            now = np.minimum.reduceat(least[column], starts)
            if (now == head).all():
                break
            head = now[now]
        groups: dict[int, list[int]] = {}
        for t, of in zip(failed, head.tolist(), strict=True):
            groups.setdefault(of, []).append(t)
        return [*alone, *(tuple(group) for group in groups.values())]

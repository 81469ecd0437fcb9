"""What the tests say now, and since when."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gateway_fdi.diagnosis.system import System

NOT_TESTED = 0
PASSED = 1
"""The verdict of a test that passed."""
FAILED = 2
"""The verdict of a test that failed."""
#: A time that never came.
NEVER = np.iinfo(np.int64).max


class Sized(NamedTuple):
    """A residual, and how it depends on the errors of components at its operating point.

    Attributes:
        residual: signed, its unit.
        noise: its standard deviation without a fault, above 0.
        gains: component -> residual for an error of the component of size 1; one that is not named: not known.
        gain_error: by what share gains are wrong, 0 to 1.
        beyond: how far the residual is beyond its limit, as a factor; NaN: not known. Models that do not hold are
            mostly a little off: beyond a factor x with probability 1 / x^2.
    """

    residual: float
    noise: float
    gains: Mapping[str, float]
    gain_error: float = 0.05
    beyond: float = math.nan


class State:
    """The verdicts of some tests.

    Attributes:
        verdict: NOT_TESTED, PASSED or FAILED, shape (tests,).
        since: when it became that, shape (tests,) [ns].
        until: when a test that passes did last, shape (tests,) [ns].
        passed_from: of a test that fails: since when it had passed until then; NEVER: it had not, shape (tests,) [ns].
        healed: of a test that passes: since when, if it had failed before; -NEVER: it had not, shape (tests,) [ns].
        residual: of the last test; NaN: not known, shape (tests,).
        noise, gain_error: of the residual, as the system has them, or as it was told last, shape (tests,).
        gain: of each link, likewise, shape (links,).
        weaker: factor of the power of each link, if the test fails, shape (links,).
    """

    def __init__(self, system: System) -> None:
        tests = len(system.tests)
        self.verdict = np.zeros(tests, np.int8)
        self.since, self.until = np.zeros((2, tests), np.int64)
        self.passed_from: NDArray[np.int64] = np.full(tests, NEVER, np.int64)
        self.healed: NDArray[np.int64] = np.full(tests, -NEVER, np.int64)
        self.residual = np.full(tests, math.nan)
        self.noise, self.gain_error, self.gain = system.noise.copy(), system.gain_error.copy(), system.gain.copy()
        self.weaker = np.ones_like(system.gain)
        self._system = system
        self._is_model = np.array([one.kind == "model" for one in system.components], bool)

    def take_over(self, test: int, other: State, place: int) -> None:
        """Take over what another state has of a test, at its place there."""
        for name in ("verdict", "since", "until", "passed_from", "healed", "residual"):
            getattr(self, name)[test] = getattr(other, name)[place]

    @property
    def fails(self) -> bool:
        """Whether any test fails."""
        return bool((self.verdict == FAILED).any())

    def size(self, test: int, sized: Sized | None) -> bool:
        """Take what a test says of sizes; None: nothing. Returns whether anything is another than before."""
        system = self._system
        links = system.of_test[test]
        names = [system.components[c].name for c in system.link_component[links]]
        gains = np.array([math.nan if sized is None else sized.gains.get(name, math.nan) for name in names])
        now = (math.nan, math.nan, 0.0) if sized is None else (sized.residual, sized.noise, sized.gain_error)
        before = (self.residual[test], self.noise[test], self.gain_error[test])
        self.residual[test], self.noise[test], self.gain_error[test] = now
        off = 1.0 if sized is None or not sized.beyond > 1.0 else sized.beyond**-2
        weaker = np.where(self._is_model[system.link_component[links]], off, 1.0)
        same = np.array_equal(before, now, equal_nan=True) and np.array_equal(self.gain[links], gains, equal_nan=True)
        same = same and np.array_equal(self.weaker[links], weaker)
        self.gain[links], self.weaker[links] = gains, weaker
        return not same

    def pass_first(self, tests: NDArray[np.int64], t_ns: NDArray[np.int64]) -> None:
        """Take first passes of tests that have no verdict, by their places, as :meth:`update` does one by one."""
        self.residual[tests], self.passed_from[tests], self.healed[tests] = math.nan, NEVER, -NEVER
        self.verdict[tests], self.since[tests], self.until[tests] = PASSED, t_ns, t_ns

    def update(self, test: int, verdict: int, t_ns: int, residual: float) -> bool:
        """Take a verdict; returns whether anything is another than before.

        Args:
            test: its place.
            verdict: NOT_TESTED, PASSED or FAILED.
            t_ns: when; not before that of the last one [ns].
            residual: signed, in the unit of its noise; NaN: not known.
        """
        before = int(self.verdict[test])
        same = residual == self.residual[test] or (math.isnan(residual) and math.isnan(self.residual[test]))
        self.residual[test] = residual
        if verdict == before:
            renewed = verdict == PASSED and t_ns > self.until[test]
            self.until[test] = max(t_ns, int(self.until[test]))
            return renewed or not same
        self.passed_from[test] = self.since[test] if before == PASSED and verdict == FAILED else NEVER
        self.healed[test] = t_ns if before == FAILED and verdict == PASSED else -NEVER
        self.verdict[test], self.since[test], self.until[test] = verdict, t_ns, t_ns
        return True

"""What the tests say now, and since when."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

NOT_TESTED, PASSED, FAILED = 0, 1, 2
#: A time that never came.
NEVER = np.iinfo(np.int64).max


class State:
    """The verdicts of some tests.

    Args:
        tests: how many.

    Attributes:
        verdict: NOT_TESTED, PASSED or FAILED, shape (tests,).
        since: when it became that, shape (tests,) [ns].
        until: when a test that passes did last, shape (tests,) [ns].
        passed_from: of a test that fails: since when it had passed until then; NEVER: it had not, shape (tests,) [ns].
        residual: of the last test; NaN: not known, shape (tests,).
    """

    def __init__(self, tests: int) -> None:
        self.verdict = np.zeros(tests, np.int8)
        self.since, self.until = np.zeros((2, tests), np.int64)
        self.passed_from: NDArray[np.int64] = np.full(tests, NEVER, np.int64)
        self.residual = np.full(tests, math.nan)

    def take_over(self, test: int, other: State, place: int) -> None:
        """Take over what another state has of a test, at its place there."""
        for name in ("verdict", "since", "until", "passed_from", "residual"):
            getattr(self, name)[test] = getattr(other, name)[place]

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
        self.verdict[test], self.since[test], self.until[test] = verdict, t_ns, t_ns
        return True

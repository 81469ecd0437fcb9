"""What comes out: causes of tests that failed together, ranked, with what speaks for and against them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

#: A diagnosis is the cause if it is at least so probable, and any other so much less.
CERTAIN, ALONE = 0.9, 0.1


class Against(NamedTuple):
    """What contradicts a diagnosis.

    Attributes:
        test: its place; -1: the sizes.
        why: "passed": it would have seen it; "late": it failed later than it would have; "false alarm": the diagnosis
            does not explain it; "size": no one size fits all residuals.
        factor: by which it makes the diagnosis less probable.
    """

    test: int
    why: str
    factor: float


class Wait(NamedTuple):
    """A test that passed before, but can still speak: its place, and until when [ns]."""

    test: int
    until_ns: int


@dataclass(frozen=True)
class Diagnosis:
    """Components that together explain what failed.

    Attributes:
        components: their places; none: all that failed were false alarms.
        probability: among all diagnoses of these failed tests.
        explains: failed tests, by their places.
        against: what contradicts it, heaviest first.
    """

    components: tuple[int, ...]
    probability: float
    explains: tuple[int, ...]
    against: tuple[Against, ...]


@dataclass(frozen=True)
class Group:
    """Failed tests that share components, and what explains them.

    Attributes:
        failed: the tests, by their places.
        diagnoses: likeliest first.
        rest: probability of all that is not listed, 0: all is.
        waiting: tests that can still change it; while there are any, nothing is certain.
    """

    failed: tuple[int, ...]
    diagnoses: tuple[Diagnosis, ...]
    rest: float
    waiting: tuple[Wait, ...]

    @property
    def cause(self) -> Diagnosis | None:
        """The diagnosis that is certain; None: not isolated, or a false alarm, or a slower test can still speak."""
        first = self.diagnoses[0]
        other = max((one.probability for one in self.diagnoses[1:]), default=0.0)
        certain = first.probability >= CERTAIN and max(other, self.rest) < ALONE * first.probability
        return first if certain and first.components and not self.waiting else None

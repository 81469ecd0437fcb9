"""A run through a voter: its output, and what it believed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

from gateway_fdi.jit import Record, zeros
from gateway_plants.pedal import arrays
from gateway_plants.pedal.arrays import Voted
from gateway_plants.pedal.study import hybrid, kalman_hybrid, predictive_hybrid
from gateway_plants.pedal.study.cases import SPAN, Environment, Run
from gateway_plants.pedal.voting import simple
from gateway_plants.pedal.voting.tracking import shape

#: The detector's width; the paper gives none. KHR* is the repaired reading of it.
BETA, REPAIRED_BETA = 0.3, 0.5
#: KHR*: least FT in standard deviations of the sensors' noise.
FLOOR = 4.0
#: Smoothing constant of the predictive voter: about the best one for it.
ALPHA = 0.3


def _prepare_simple(c: simple.Const, channels: int, environment: Environment) -> None:
    simple.prepare(c, channels)


def _prepare_khr(c: kalman_hybrid.Const, channels: int, environment: Environment) -> None:
    hybrid.prepare(c.hybrid, channels, beta=BETA, lower=True)
    kalman_hybrid.prepare(c)


def _prepare_repaired(c: kalman_hybrid.Const, channels: int, environment: Environment) -> None:
    floor = FLOOR * environment.noise
    hybrid.prepare(c.hybrid, channels, beta=REPAIRED_BETA, lower=False, floor=floor, low=0.0, high=SPAN)
    kalman_hybrid.prepare(c)


def _prepare_predictive(c: predictive_hybrid.Const, channels: int, environment: Environment) -> None:
    hybrid.prepare(c.hybrid, channels, beta=BETA, lower=True)
    predictive_hybrid.prepare(c, alpha=ALPHA)


def _prepare_tracking(c: shape.Const, channels: int, environment: Environment) -> None:
    shape.prepare(c, channels, low=0.0, high=SPAN, noise=environment.noise, step=environment.step)


@dataclass(frozen=True, eq=False)
class Voter:
    """A voter as it is evaluated: how many channels it is given, its records and its loop over a run."""

    channels: int
    const: type[Record]
    state: type[Record]
    prepare: Callable[[Any, int, Environment], None]
    loop: Callable[..., None]

    @cache  # noqa: B019 - the few voters live as long as the process
    def constants(self, environment: Environment) -> Any:
        """Return its constants in an environment, whose noise and resolution alone it is told."""
        c = zeros(1, self.const)[0]
        self.prepare(c, self.channels, environment)
        return c

    def begin(self) -> Any:
        """Return its state before the first sample."""
        return zeros(1, self.state)[0]


_KALMAN, _PREDICTIVE = (partial(arrays.each, one.vote) for one in (kalman_hybrid, predictive_hybrid))
_AVERAGE, _MEDIAN = (partial(arrays.each, one) for one in (simple.average, simple.median))
#: The paper gives three channels to the simple voters and two to the hybrid ones.
VOTERS = {
    "average": Voter(3, simple.Const, simple.State, _prepare_simple, _AVERAGE),
    "average of 2": Voter(2, simple.Const, simple.State, _prepare_simple, _AVERAGE),
    "median": Voter(3, simple.Const, simple.State, _prepare_simple, _MEDIAN),
    "predictive": Voter(2, predictive_hybrid.Const, predictive_hybrid.State, _prepare_predictive, _PREDICTIVE),
    "KHR": Voter(2, kalman_hybrid.Const, kalman_hybrid.State, _prepare_khr, _KALMAN),
    "KHR*": Voter(2, kalman_hybrid.Const, kalman_hybrid.State, _prepare_repaired, _KALMAN),
    "tracking": Voter(2, shape.Const, shape.State, _prepare_tracking, arrays.tracking),
    "tracking of 3": Voter(3, shape.Const, shape.State, _prepare_tracking, arrays.tracking),
}


def follow(voter: str, environment: Environment, run: Run) -> Voted:
    """Put a run through a voter."""
    chosen = VOTERS[voter]
    return arrays.through(chosen.loop, chosen.begin(), chosen.constants(environment), run.readings)

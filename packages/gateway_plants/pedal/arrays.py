"""Voters over arrays of redundant readings.

::

    voter = Voter("tracking", 2, low=0.0, high=5.0, noise=0.002)
    voted = voter.run(readings)             # shape (samples, channels)
    print(voted.value, voted.isolated)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gateway_fdi.detectors import numbers
from gateway_fdi.errors import InputError, named
from gateway_fdi.jit import Record, kernel, zeros
from gateway_plants.pedal.voting import simple
from gateway_plants.pedal.voting.tracking import shape, vote

__all__ = ["Voted", "Voter"]


@dataclass(frozen=True)
class Voted:
    """What a voter made of n samples.

    Attributes:
        value: its output, in the readings' unit, shape (n,).
        used: bits of the channels that were in it, shape (n,).
        isolated: bits of the channels that it held for failed; 0 for voters that do not, shape (n,).
        drift: whether it saw a slow disagreement, shape (n,).
    """

    value: NDArray[np.float64]
    used: NDArray[np.int64]
    isolated: NDArray[np.int64]
    drift: NDArray[np.int64]


@kernel
def each(vote: Any, s: Any, c: Any, y: Any, value: Any, used: Any, isolated: Any, drift: Any) -> None:
    """Vote on samples by a kernel that isolates nothing, ``vote(s, c, readings)``; arguments as of :func:`tracking`."""
    for k in range(y.shape[0]):
        vote(s, c, y[k])
        value[k], used[k] = s.value, s.used


@kernel
def tracking(s: Any, c: Any, y: Any, value: Any, used: Any, isolated: Any, drift: Any) -> None:
    """Vote on samples that are a period apart.

    Args:
        s: record of the voter's State.
        c: record of its Const.
        y: readings, shape (n, channels).
        value: output, shape (n,).
        used: bits of the channels that were in it, shape (n,).
        isolated: bits of the channels that are held for failed, shape (n,).
        drift: 1: channels drift apart, shape (n,).
    """
    for k in range(y.shape[0]):
        vote.vote(s, c, y[k], 1.0)
        value[k], used[k] = s.value, s.used
        isolated[k], drift[k] = s.isolated, s.drift


def through(loop: Callable[..., None], s: Any, c: Any, y: NDArray[np.float64]) -> Voted:
    """Put readings through a loop of a voter; arguments as of :func:`tracking`."""
    value = np.empty(len(y))
    used, isolated, drift = (np.zeros(len(y), np.int64) for _ in range(3))
    loop(s, c, y, value, used, isolated, drift)
    return Voted(value, used, isolated, drift)


_RULES: dict[str, tuple[type[Record], type[Record], Callable[..., None]]] = {
    "average": (simple.State, simple.Const, partial(each, simple.average)),
    "median": (simple.State, simple.Const, partial(each, simple.median)),
    "tracking": (shape.State, shape.Const, tracking),
}


class Voter:
    """One value out of two or three redundant readings, sample by sample (docs/pedal).

    Args:
        rule: ``average``, ``median`` or ``tracking``, which isolates channels.
        channels: 2 or 3.
        low: least value of the quantity, in the readings' unit; of ``tracking``.
        high: largest value.
        noise: standard deviation of a reading.
        step: resolution of a reading, 0: none.

    Raises:
        InputError: no such rule, or numbers that make no sense.
    """

    def __init__(
        self, rule: str, channels: int, *, low: float = 0.0, high: float = 1.0, noise: float = 0.0, step: float = 0.0
    ) -> None:
        if rule not in _RULES:
            raise InputError(named("the voters are", rule, _RULES), key="rule", value=rule)
        if channels not in (2, simple.MOST_CHANNELS):
            raise InputError(f"2 or {simple.MOST_CHANNELS}", key="channels", value=channels)
        if not low < high:
            raise InputError("above low", key="high", value=high)
        for key, value in (("noise", noise), ("step", step)):
            if not 0.0 <= value < np.inf:
                raise InputError("0 or more", key=key, value=value)
        self.rule, self.channels = rule, channels
        state, const, self._loop = _RULES[rule]
        self._s: Any = zeros(1, state)[0]
        self._c: Any = zeros(1, const)[0]
        if rule == "tracking":
            shape.prepare(self._c, channels, low=low, high=high, noise=noise, step=step)
        else:
            simple.prepare(self._c, channels)

    def __repr__(self) -> str:
        return f"Voter({self.rule}, {self.channels} channels)"

    def run(self, readings: ArrayLike) -> Voted:
        """Take samples that are a period apart; a reading that is NaN is none.

        Args:
            readings: shape (n, channels).

        Raises:
            InputError: another shape.
        """
        return through(self._loop, self._s, self._c, numbers(readings, "readings", self.channels))

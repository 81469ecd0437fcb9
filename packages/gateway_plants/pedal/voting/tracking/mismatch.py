"""What channels differ by for long: gain and offset errors, and drift.

Each channel's mismatch with the mean of all is followed by an alpha-beta filter while they agree. It is taken off
the readings, so that a slow disagreement does not make one of them look wrong: from two channels nobody can tell
which one drifts. The mean is what two voters can promise (error: half the drift); of three the median tells.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np

from gateway_fdi.jit import Record, f8s, i8s, kernel, means
from gateway_plants.pedal.voting.simple import MOST_CHANNELS, middle

#: Gains of the filter.
ALPHA, BETA = 0.15, 0.012
#: Share of what may be a lag that is taken for a mismatch.
MAY_LAG = 1.0 / 8.0
#: A rate that nothing confirms is not continued for longer than this [samples].
CONTINUE = 10


class State(Record):
    """State, of each channel, in the unit of the readings.

    ``mark[i * 3 + j]`` is of channel j when channel i began to repeat its reading.
    """

    level: Annotated[f8s, MOST_CHANNELS] = means("the mismatch")
    rate: Annotated[f8s, MOST_CHANNELS] = means("its change in a sample")
    error: Annotated[f8s, MOST_CHANNELS] = means("what it was off by last")
    stale: Annotated[i8s, MOST_CHANNELS] = means("samples since it was corrected", "samples")
    mark: Annotated[f8s, MOST_CHANNELS * MOST_CHANNELS] = means("level then")


@kernel
def start(b: State) -> None:
    """Begin without any mismatch."""
    for i in range(MOST_CHANNELS):
        b.level[i] = 0.0
        b.rate[i] = 0.0
        b.error[i] = 0.0
        b.stale[i] = 0


@kernel
def predict(b: State, n: int, dt: float) -> None:
    """Go ``dt`` samples ahead."""
    for i in range(n):
        if b.stale[i] < CONTINUE:
            b.level[i] += b.rate[i] * dt
            b.stale[i] += 1
        else:
            b.rate[i] = 0.0


@kernel
def centre(b: State, n: int) -> float:
    """Return what stands for no mismatch: the middle of two, the median of three."""
    return middle(b.level, n)


@kernel
def learn(b: State, i: int, error: float, dt: float, lagging: bool) -> None:
    """Correct channel ``i``'s mismatch by the difference between what it is and what it was taken for.

    Where that may be a lag (``lagging``), little of it is a mismatch, and its rate is none; one that stays shows.
    Two errors in a row have to agree in sign, and the smaller counts: a small impulse is not a mismatch.
    """
    before = b.error[i]
    b.error[i] = error
    if error * before > 0.0:
        counted = error if abs(error) < abs(before) else before
        b.level[i] += ALPHA * counted * (MAY_LAG if lagging else 1.0)
        b.rate[i] += BETA * counted / dt
    if lagging:
        b.rate[i] = 0.0
    b.stale[i] = 0


@kernel
def mark(b: State, n: int, i: int) -> None:
    """Remember the mismatches as they are now, before channel ``i`` may be found frozen."""
    for j in range(n):
        b.mark[i * MOST_CHANNELS + j] = b.level[j]


@kernel
def forget(b: State, n: int, i: int) -> None:
    """Go back to the mismatches that channel ``i``'s mark remembers."""
    for j in range(n):
        b.level[j] = b.mark[i * MOST_CHANNELS + j]
        b.rate[j] = 0.0
        b.error[j] = 0.0


@kernel
def spread(b: State, n: int, without: int) -> float:
    """Return the largest mismatch between two channels, ``without`` those of its bits."""
    low, high = np.inf, -np.inf
    for i in range(n):
        if without & (1 << i) == 0:
            low, high = min(low, b.level[i]), max(high, b.level[i])
    return float(max(high - low, 0.0))

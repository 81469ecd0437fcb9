"""Outputs of one time, where sensors may be late or early: a slow state of each, by the filters of a set of models.

A sensor that is late by l periods reads y(k) = C x(k - l). All that is neither late nor early is taken ``back`` periods
later (:mod:`gateway_fdi.slow.delay`), each output at a point p near its l, on a line between two samples:

    Y = C x + (p - l) y'

y' from its readings. The filters have l as a slow state (:mod:`.filters`). The line and the tangent leave what is of
second order, f (1 - f) of the bend of y where p lies f behind a sample, and half of (p - l)^2 of it: noise beside the
sensor's own. So nothing is doubted at rest, and little where l is known and whole.

Commands that have counters may come behind their sample, as long as that one waits (:data:`WAITS`).
"""

from __future__ import annotations

from math import ceil
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from gateway_fdi.jit import Record, f8, f8s, i8, i8s, kernel, means
from gateway_fdi.linear_algebra import copy
from gateway_fdi.slow import delay
from gateway_plants.linear.mathematics.plant import MOST_INPUTS, MOST_OUTPUTS, LinearPlant

#: Largest lag of either sign [periods].
MOST = delay.MOST - 1
#: Periods by which all is taken later where commands have counters.
WAITS = 2
#: Change of a lag from which on its point moves; a point that is so near to a whole number of periods is that.
MOVED, WHOLE = 0.1, 0.2


class Ring(delay.State, lengths={"signals": MOST_OUTPUTS + 2 * MOST_INPUTS}):
    """Outputs, commands, and which of these are unsure."""


class Const(Record):
    """Constants."""

    m: i8 = means("inputs")
    p: i8 = means("outputs")
    back: f8 = means("periods by which all is taken later; 0: nothing is late")


class State(Record):
    """State: the newest samples, and the one that is taken."""

    ring: Ring = means("the newest samples")
    now: Annotated[f8s, MOST_OUTPUTS + 2 * MOST_INPUTS] = means("the sample that has come")
    begun: i8 = means("1: there is a sample before")
    y: Annotated[f8s, MOST_OUTPUTS] = means("outputs of the sample that is taken")
    u: Annotated[f8s, MOST_INPUTS] = means("its commands")
    unsure: Annotated[i8s, MOST_INPUTS] = means("1: its command is not known")
    point: Annotated[f8s, MOST_OUTPUTS] = means("lag of each output, at which the line is taken", "periods")
    slope: Annotated[f8s, MOST_OUTPUTS] = means("slope of each output on that line, a period")
    extra: Annotated[f8s, MOST_OUTPUTS] = means("variance that the line adds to each output")


def prepare(c: Const, plant: LinearPlant, lags: NDArray[np.float64], *, counted: bool) -> None:
    """Fill a record of Const.

    Args:
        lags: by how many periods each output may be late or early, shape (p,).
        counted: commands have counters.
    """
    c.m, c.p = plant.inputs, plant.outputs
    c.back = max(ceil(lags.max()) + 1 if lags.any() else 0, WAITS if counted else 0)


@kernel
def align(s: State, c: Const, y: f8s, u: f8s, unsure: i8s) -> bool:
    """Take a sample, NaN where it did not come; tells whether the one that is taken now did."""
    for i in range(c.m):
        s.now[MOST_OUTPUTS + i], s.now[MOST_OUTPUTS + MOST_INPUTS + i] = u[i], float(unsure[i])
    copy(s.now, y, c.p)
    if c.back > 0.0:
        delay.put(s.ring, s.now, s.begun)
        s.begun = 1
        for i in range(MOST_OUTPUTS, len(s.now)):
            s.now[i] = delay.read(s.ring, i, c.back)
        for j in range(c.p):
            s.now[j] = delay.read(s.ring, j, c.back - s.point[j])
    there = True
    for j in range(c.p):
        s.y[j] = s.now[j]
        there = there and s.y[j] == s.y[j]
    for i in range(c.m):
        s.u[i], s.unsure[i] = s.now[MOST_OUTPUTS + i], int(s.now[MOST_OUTPUTS + MOST_INPUTS + i])
    return there


@kernel
def doubt(s: State, c: Const, j: int, lag: float, variance: float) -> None:
    """Find an output's slope, and what the line and the tangent may leave.

    Args:
        j: the output.
        lag: of it, as it is known [periods].
        variance: of that.
    """
    at = c.back - s.point[j]
    share, first = at - int(at), float(int(at))
    a, b = delay.read(s.ring, j, first - 1.0), delay.read(s.ring, j, first)
    d, e = delay.read(s.ring, j, first + 1.0), delay.read(s.ring, j, first + 2.0)
    s.slope[j] = delay.read(s.ring, j, at - 0.5) - delay.read(s.ring, j, at + 0.5)
    bend = abs(a - 2.0 * b + d) + abs(b - 2.0 * d + e)
    off = s.point[j] - lag
    left = (share * (1.0 - share) + 0.5 * (variance + off * off)) * bend
    if bend != bend:  # noqa: PLR0124 - a sample beside it did not come
        s.slope[j], left = 0.0, 1e3 * abs(s.y[j])
    s.extra[j] = left * left


@kernel
def move(s: State, j: int, lag: float) -> None:
    """Move an output's point to its lag, where that has changed."""
    whole = float(round(lag))
    wanted = whole if abs(lag - whole) < WHOLE else lag
    wanted = min(max(wanted, -float(MOST)), float(MOST))
    if abs(wanted - s.point[j]) > MOVED:
        s.point[j] = wanted


@kernel
def late(s: State, c: Const, i: int, value: float, ago: int) -> None:
    """Take a command that comes behind its sample, so many samples ago, if that one has not been taken yet."""
    if ago >= c.back:
        return
    for n in range(ago, -1, -1):
        at = (s.ring.at - n) & (delay.KEPT - 1)
        k = MOST_OUTPUTS + MOST_INPUTS + i
        if n == ago or s.ring.value[at, k] == 1.0:
            s.ring.value[at, MOST_OUTPUTS + i] = value
        if n == ago:
            s.ring.value[at, k] = 0.0

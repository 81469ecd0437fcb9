"""By how much one reading of a quantity is later than another, from their movement; found, and found again.

x is a quantity that is known without noise (a command), y a sensor's reading of it, both once a set. With a constant
lag of j + f sets, f in [0, 1), a gain g and increments dx(k) = x(k) - x(k-1), bias falls out:

    dy(k) = g [(1 - f) dx(k - j) + f dx(k - j - 1)] + noise

C_j = sum dy(k) dx(k - j), R_i = sum dx(k) dx(k - i) over sets in which x moves. The best two neighbours j, j + 1 have
C_j = g [(1 - f) R_0 + f R_1] and C_j+1 = g [(1 - f) R_1 + f R_0], so

    g = (C_j + C_j+1) / (R_0 + R_1),    f = 1/2 + (C_j+1 - C_j) / (2 g (R_0 - R_1))

A sensor with white noise s has dy's of variance 2 s^2, neighbours correlated by -s^2; the variance of C_j+1 - C_j is at
most 8 s^2 (R_0 - R_1), that of f at most 2 s^2 / (R_0 - R_1), for g = 1. Sums forget over KEPT sets of movement.

The remainder of the best f beyond noise, as a share of the movement's root mean square, is ``left``: a filter in the
sensor is no pure lag. Lags of either sign are looked for, up to MOST sets.
"""

from __future__ import annotations

from math import sqrt
from typing import Annotated

from gateway_fdi.jit import Record, f8, f8s, i8, kernel, means

#: Largest lag of either sign [sets] that is compared.
MOST = 4
PLACES = 2 * MOST + 1
#: Sets of movement that are kept in mind.
KEPT = 3000.0
#: A lag is known when its standard deviation is below this [sets], after this number of sets of movement.
KNOWN, AFTER = 0.15, 100.0
#: A lag this near to a whole number is that [sets]; it changes from this on, and by this many standard deviations.
WHOLE, CHANGES, SURE = 0.2, 0.15, 4.0
#: Sets of movement between two decisions.
EVERY = 10
#: Of the correlation of what is the same: less than this is another quantity.
ALIKE = 0.5
#: Share that is left at least.
LEAST = 0.05
#: Movement that counts, in standard deviations of the noise.
MOVES = 2.0


class State(Record):
    """State: increments are newest first."""

    x: f8 = means("last x")
    y: f8 = means("last y")
    dx: Annotated[f8s, PLACES + 1] = means("increments of x")
    dy: Annotated[f8s, MOST + 1] = means("increments of y")
    c: Annotated[f8s, PLACES] = means("C_j")
    r_0: f8 = means("R_0")
    r_1: f8 = means("R_1")
    yy: f8 = means("sum of dy^2")
    counted: f8 = means("sets in the sums, forgetting", "sets")
    lag: f8 = means("positive: y is behind", "sets")
    left: f8 = means("what the best lag leaves, a share of the movement")
    known: i8 = means("1: lag is known")
    sets: i8 = means("sets in a row", "sets")
    due: i8 = means("sets of movement since a decision", "sets")


@kernel
def restart(s: State) -> None:
    """Start again after a gap; the known lag stays."""
    s.sets = 0


@kernel
def _decide(s: State, most: float, noise: float) -> None:
    """Find the lag, if the movement tells it."""
    apart = s.r_0 - s.r_1
    if s.counted < AFTER or apart <= 2.0 * noise * noise / (KNOWN * KNOWN):
        return
    best = 0
    for i in range(1, PLACES):
        if s.c[i] > s.c[best]:
            best = i
    if s.c[best] < ALIKE * sqrt(s.r_0 * s.yy):
        return
    # The better neighbour.
    if best == PLACES - 1 or (best > 0 and s.c[best - 1] > s.c[best + 1]):
        best -= 1
    gain = (s.c[best] + s.c[best + 1]) / (s.r_0 + s.r_1)
    f = 0.5 + (s.c[best + 1] - s.c[best]) / (2.0 * gain * apart)
    f = min(max(f, 0.0), 1.0)
    explained = 2.0 * gain * ((1.0 - f) * s.c[best] + f * s.c[best + 1]) - gain * gain * (
        ((1.0 - f) * (1.0 - f) + f * f) * s.r_0 + 2.0 * f * (1.0 - f) * s.r_1
    )
    found = best - MOST + f
    whole = float(round(found))
    if abs(found - whole) < WHOLE:
        found = whole
    found = min(max(found, -most), most)
    spread = sqrt(2.0 * noise * noise / apart)
    s.left = max(sqrt(max(s.yy - explained - 2.0 * noise * noise * s.counted, 0.0) / s.r_0), LEAST)
    if s.known == 0 or abs(found - s.lag) > max(CHANGES, SURE * spread):
        s.lag = found
    s.known = 1


@kernel
def update(s: State, x: float, y: float, most: float, noise: float) -> None:
    """Take a set.

    Args:
        x: known.
        y: measured.
        most: largest lag that is none [sets], at most MOST.
        noise: standard deviation of a reading.
    """
    before_x, before_y = s.x, s.y
    s.x, s.y = x, y
    s.sets = s.sets + 1 if x == x and y == y else 0  # noqa: PLR0124 - not NaN
    if s.sets < 2:
        return
    for i in range(PLACES, 0, -1):
        s.dx[i] = s.dx[i - 1]
    for i in range(MOST, 0, -1):
        s.dy[i] = s.dy[i - 1]
    s.dx[0], s.dy[0] = x - before_x, y - before_y
    if s.sets < PLACES + 3:
        return
    moved = 0.0
    for i in range(PLACES):
        moved += s.dx[i] * s.dx[i]
    if moved < MOVES * MOVES * noise * noise:
        return
    keep = 1.0 - 1.0 / KEPT
    mine = s.dy[MOST]
    for i in range(PLACES):
        s.c[i] = keep * s.c[i] + mine * s.dx[i]
    s.r_0 = keep * s.r_0 + s.dx[MOST] * s.dx[MOST]
    s.r_1 = keep * s.r_1 + s.dx[MOST] * s.dx[MOST + 1]
    s.yy = keep * s.yy + mine * mine
    s.counted = keep * s.counted + 1.0
    s.due += 1
    if s.due >= EVERY:
        s.due = 0
        _decide(s, most, noise)

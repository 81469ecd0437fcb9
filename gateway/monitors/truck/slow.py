"""What warmth and age change in a healthy machine and battery: followed slowly, within what physics allows.

T2, T5 and T6 take the winding's resistance R, the torque constant k, the battery's resistance R_b and its open circuit
voltage as exact. A winding at 120 degC has 39 % more resistance than at 20 degC, magnets lose 0.1 % a kelvin, a
battery's resistance doubles in its life: none is a fault. So their relative errors are slow states, two and two, of the
equations that hold without a fault:

    U_ctrl - k w - R I           = k w dk + R I dR + noise                      (e7, e8 of paper 004)
    I_em U_em - (U_oc - R_b I_b) I_b = U_oc I_b dU - R_b I_b^2 dR_b + noise     (e5, e6, e11)

each a Kalman filter. First it learns, as fast as the noise lets it; meanwhile T2, T5, T6 are not tested. What it finds
beyond its bound is no warmth and no age: then it is not followed, and the tests see it. Behind that an error changes by
its rate at most, so that a fault that comes at once is there long before it is followed; and while a test has fired, or
T1 is on its way, nothing is followed.

Bounds and rates: copper 0.393 %/K (IEC 60228); NdFeB -0.09 to -0.12 %/K of remanence (IEC 60404-8-1), SmCo -0.04;
resistance of a cell: half to twice as much over 0 to 40 degC, twice at its end of life (ISO 12405-4, IEC 62660-1); its
open circuit voltage is taken from a curve, which ages by percents. Windings heat by some tenths of a kelvin a second at
peak torque, magnets and cells by hundredths.
"""

from __future__ import annotations

from math import sqrt
from typing import Annotated

from gateway.jit import Record, f8, f8s, i8, kernel

#: Errors by their place in a pair.
FIRST, SECOND = range(2)
#: Of the standard deviation of a residual's noise: what is not white in it.
COLOURED = 3.0
#: An error is known when its standard deviation is below this share of its bound; seconds of use within which it is, in
#: any case.
KNOWN, AT_LATEST = 0.12, 120.0
#: Share of that walk: the rate is what happens at most, not always.
WALK = 0.1
#: Of the standard deviation that a set takes away, what an error may move by.
LEARNS = 2.0
#: Standard deviations of what is not known of the errors by which a residual counts less.
GUARD = 3.0
#: Steps of its rate that what is found may be ahead of what is taken, beside what is not known.
LEAD = 100.0
#: Standard deviations by which an error found at the start must lie beyond its bound.
SURE = 2.0


class Const(Record):
    """Constants of a pair: largest errors below and above, rates [1/s], standard deviation beforehand."""

    low: Annotated[f8s, 2]
    high: Annotated[f8s, 2]
    rate: Annotated[f8s, 2]
    prior: Annotated[f8s, 2]


class State(Record):
    """State of a pair: errors with covariance, ``used`` [s], whether they are ``known``; ``refused``: too large.

    ``error``: what is found; ``taken``: what the tests take of it; ``before``: standard deviations at the set before.
    """

    error: Annotated[f8s, 2]
    taken: Annotated[f8s, 2]
    p: Annotated[f8s, 2, 2]
    before: Annotated[f8s, 2]
    used: f8
    known: i8
    refused: i8


def prepare(s: State, c: Const) -> None:
    """Let errors begin at 0 with their prior."""
    for k in range(2):
        s.p[k, k] = c.prior[k] ** 2


@kernel
def _learned(s: State, c: Const) -> None:
    """End the learning, if enough is known: take what is found, or refuse it."""
    known = True
    for k in range(2):
        if sqrt(s.p[k, k]) > KNOWN * (c.high[k] - c.low[k]):
            known = False
    if not known and s.used < AT_LATEST:
        return
    s.known = 1
    for k in range(2):
        spread = SURE * sqrt(s.p[k, k])
        if s.error[k] < c.low[k] - spread or s.error[k] > c.high[k] + spread:
            s.refused = 1
    for k in range(2):
        s.error[k] = 0.0 if s.refused == 1 else min(max(s.error[k], c.low[k]), c.high[k])
        s.taken[k] = s.error[k]


@kernel
def follow(
    s: State, c: Const, rest: float, first: float, second: float, noise: float, dt: float, passed: float
) -> None:
    """Take one sample.

    Args:
        s: state of the pair.
        c: its constants.
        rest: what the equation leaves with the parameters as told.
        first: what the first error adds to it.
        second: likewise.
        noise: standard deviation of the rest.
        dt: since the set before [s].
        passed: since the last set that was followed [s].
    """
    if s.refused == 1:
        return
    s.used += dt
    for k in range(2):
        if s.p[k, k] < c.prior[k] * c.prior[k]:
            # A walk that spans the bound in the time that the rate allows for it.
            s.p[k, k] += passed * c.rate[k] * WALK * (c.high[k] - c.low[k])
        s.before[k] = sqrt(s.p[k, k])
    a = s.p[0, 0] * first + s.p[0, 1] * second
    b = s.p[1, 0] * first + s.p[1, 1] * second
    r = COLOURED * noise
    size = r * r + first * a + second * b
    left = (rest - first * s.error[0] - second * s.error[1]) / size
    s.error[0] += a * left
    s.error[1] += b * left
    s.p[0, 0] -= a * a / size
    s.p[1, 1] -= b * b / size
    s.p[0, 1] -= a * b / size
    s.p[1, 0] = s.p[0, 1]
    if s.known == 0:
        _learned(s, c)
        return
    for k in range(2):
        # As much as time allows, and as much as is known better than before.
        step = c.rate[k] * passed + LEARNS * max(s.before[k] - sqrt(s.p[k, k]), 0.0)
        wanted = min(max(s.error[k], c.low[k]), c.high[k])
        s.taken[k] += min(max(wanted - s.taken[k], -step), step)
        # What it may not follow is none of these errors: it does not run away from what the tests take.
        lead = LEAD * c.rate[k] * passed + GUARD * sqrt(s.p[k, k])
        s.error[k] = s.taken[k] + min(max(s.error[k] - s.taken[k], -lead), lead)


@kernel
def doubt(s: State, first: float, second: float) -> float:
    """Return the standard deviation of what the errors still add to an equation, as :func:`follow` has it."""
    if s.refused == 1:
        return 0.0
    size = first * first * s.p[0, 0] + 2.0 * first * second * s.p[0, 1] + second * second * s.p[1, 1]
    return sqrt(max(size, 0.0))


@kernel
def beyond(residual: float, doubt: float) -> float:
    """Return what is left of a residual beyond what is not known of the errors: a threshold that adapts itself."""
    least = GUARD * doubt
    if residual > least:
        return residual - least
    return residual + least if residual < -least else 0.0 * residual

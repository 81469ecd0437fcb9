"""A Kalman filter for what a model of one's own and its sensors are off by, as shares of the bounds that are told.

State j is what parameter or sensor j is off by, as a share x_j of its bound, so that it lies in [-1, 1]. What a
residual r has of it comes from the model's own sensitivities around a point x0, at which the model stands: g_j is by
how much the residual changes when the model takes x_j + 1 for x_j, to first order. With the noise v of the residual,

    r = - g (x - x0) + v,         x' = w,    E[w w'] = growth,    |x_j| <= 1

for the residual of the corrected model, r + g (x - x0), is noise. So each sample of a residual is a measurement:

    s = g P g' + R,   k = P g' / s,   x := x + k (- r - g (x - x0)),   P := P - k g P                         (1)

x0 follows x in steps (:func:`moved`, :func:`relinearise`): what a product of two that are off leaves is of second
order in x - x0, and a model that moved with each sample would run after the filters of its own residual.

At the beginning x_j may be anywhere between the bounds: x = 0, P = 1/3, the variance of that. A variance grows by
``growth``, which is 1/3 within the time that is told, and no further than 1/3: so what was learned is forgotten.

Residuals' noise is not white (filters, what the model leaves out): it is taken as independent only once in a time tau,
R = tau / h times its variance, h the time between two samples. After (1) x is brought back between its bounds.

A fault that begins moves a residual as a parameter would that jumps, and parameters do not jump. So while a test has
fired x moves no faster than its whole bound within that time (``most`` of :func:`take`), and P does not shrink: what
ages into an alarm leaves it again; a fault that is larger than the bounds stays.
"""

from __future__ import annotations

from typing import Annotated

from gateway.jit import Record, f8, f8s, i8, kernel, means

#: Slow states of a monitor.
MOST_SLOW = 24
#: Variance of a share that may be anywhere between its bounds.
UNKNOWN = 1.0 / 3.0


class Const(Record):
    """Constants."""

    count: i8
    growth: f8 = means("of each variance", "1/s")
    rate: f8 = means("by which a share moves at most while a test has fired", "1/s")


class State(Record):
    """Shares, their covariance, the sensitivities of the residual at hand, and scratch."""

    share: Annotated[f8s, MOST_SLOW]
    point: Annotated[f8s, MOST_SLOW] = means("shares at which the model stands")
    covariance: Annotated[f8s, MOST_SLOW, MOST_SLOW]
    step: Annotated[f8s, MOST_SLOW] = means("by which the model was moved last")
    gain: Annotated[f8s, MOST_SLOW] = means("of the residual by each share")
    product: Annotated[f8s, MOST_SLOW]
    fitted: f8 = means("variance that the shares leave in the residual")


def prepare(c: Const, count: int, seconds: float) -> None:
    """Fill the constants.

    Args:
        c: record of Const.
        count: slow states.
        seconds: time within which all that is off may change by its whole bound.

    Raises:
        ValueError: too many of them.
    """
    if count > MOST_SLOW:
        raise ValueError(f"{count} slow states: a monitor has room for {MOST_SLOW}")
    c.count, c.growth, c.rate = count, UNKNOWN / seconds, 1.0 / seconds


@kernel
def begin(s: State, c: Const) -> None:
    """Know nothing."""
    for i in range(c.count):
        s.share[i] = s.point[i] = s.step[i] = 0.0
        for j in range(c.count):
            s.covariance[i, j] = UNKNOWN if i == j else 0.0


@kernel
def grow(s: State, c: Const, dt: float) -> None:
    """Let a time pass [s]: what was learned is less sure."""
    for i in range(c.count):
        s.covariance[i, i] = min(s.covariance[i, i] + c.growth * dt, max(UNKNOWN, s.covariance[i, i]))


@kernel
def correct(s: State, c: Const, residual: float) -> float:
    """Return the residual of the corrected model, r + g (x - x0); leaves g P g' in ``fitted``, P g' in ``product``."""
    total, corrected = 0.0, residual
    for i in range(c.count):
        row = 0.0
        for j in range(c.count):
            row += s.covariance[i, j] * s.gain[j]
        s.product[i] = row
        total += s.gain[i] * row
        corrected += s.gain[i] * (s.share[i] - s.point[i])
    s.fitted = max(total, 0.0)
    return corrected


@kernel
def moved(s: State, c: Const, most: float) -> bool:
    """Tell whether a share is further than ``most`` from the point at which the model stands."""
    for i in range(c.count):
        if abs(s.share[i] - s.point[i]) > most:
            return True
    return False


@kernel
def relinearise(s: State, c: Const) -> None:
    """Let the model stand where the shares are; leaves the way there in ``step``."""
    for i in range(c.count):
        s.step[i] = s.share[i] - s.point[i]
        s.point[i] = s.share[i]


@kernel
def take(s: State, c: Const, corrected: float, variance: float, most: float) -> None:
    """Take what :func:`correct` has returned for a measurement, (1).

    Args:
        s: record of State, as :func:`correct` has left it.
        c: record of Const.
        corrected: the residual of the corrected model.
        variance: R.
        most: by which a share may move; below 0: as far as (1) says.
    """
    whole = s.fitted + variance
    if s.fitted <= 0.0 or not whole > 0.0:
        return
    for i in range(c.count):
        step = -s.product[i] / whole * corrected
        if most >= 0.0:
            step = min(max(step, -most), most)
        s.share[i] = min(max(s.share[i] + step, -1.0), 1.0)
    if most >= 0.0:
        return
    for i in range(c.count):
        for j in range(c.count):
            s.covariance[i, j] -= s.product[i] * s.product[j] / whole

"""Kalman hybrid redundancy: FT from a scalar Kalman filter (paper 002, section III).

Equations (1) to (10) with A = H = 1, Q = 1, R = 0.5, P(0) = 1 (section IV). Corrected: (5) lacks a hat on its
last term; (6) and (8) have K^T H^T inside the bracket, where H^T alone is right; (9) is P(k+1) on its left side;
in (10) the bracket must close behind K H: ``A (I - K H) P A^T + Q``. K is n x p. With these numbers the gain is
0.73205 (sqrt(3) - 1) after four samples: simple exponential smoothing. Only Q / R matters.

Whether the state is the output or its change does not: the difference of the filtered output is the filtered
difference. The change it is here, because that is what the detector needs.
"""

from __future__ import annotations

from gateway_fdi.jit import Record, f8, f8s, i8, kernel, means
from gateway_plants.pedal.study import hybrid


class Const(Record):
    """Constants."""

    hybrid: hybrid.Const = means("detector and handler")
    q: f8 = means("Q")
    r: f8 = means("R")


class State(Record):
    """State."""

    value: f8 = means("the output")
    used: i8 = means("bits of the channels voted")
    hybrid: hybrid.State = means("detector and handler")
    x: f8 = means("estimate of the change")
    p: f8 = means("its variance")


def prepare(c: Const, *, q: float = 1.0, r: float = 0.5) -> None:
    """Fill the predictor's constants; those of ``c.hybrid`` come from :func:`.hybrid.prepare`.

    Args:
        q: process noise Q.
        r: measurement noise R.
    """
    c.q, c.r = q, r


@kernel
def predict(s: State, c: Const) -> float:
    """Predict the change, (9); returns FT(k)."""
    s.p += c.q
    return float(s.x)


@kernel
def correct(s: State, c: Const, observed: float) -> None:
    """Correct the change by what was observed, (5), (7), (8)."""
    k = s.p / (s.p + c.r)
    s.x += k * (observed - s.x)
    s.p *= 1.0 - k


@kernel
def vote(s: State, c: Const, y: f8s) -> None:
    """Take the readings of one sample.

    Args:
        y: readings.
    """
    h = s.hybrid
    if h.started == 0:
        hybrid.start(h, c.hybrid, y)
        s.p = 1.0
    else:
        correct(s, c, hybrid.vote(h, c.hybrid, y, predict(s, c)))
    s.value = h.value
    s.used = h.used

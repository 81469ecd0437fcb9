"""Predictive hybrid redundancy: FT by double exponential smoothing, the paper's own opponent.

Kim, Lee, Lee, "Predictive hybrid redundancy using exponential smoothing method for safety critical systems",
IJCAS 6 (2008), as paper 002 describes it: detector and handler of :mod:`.hybrid`, the change forecast by Brown's
double exponential smoothing, ``level + trend`` one sample ahead. The smoothing constant it used is not known.
"""

from __future__ import annotations

from gateway_fdi.jit import Record, f8, f8s, i8, kernel, means
from gateway_plants.pedal.study import hybrid


class Const(Record):
    """Constants."""

    hybrid: hybrid.Const = means("detector and handler")
    alpha: f8 = means("smoothing constant")


class State(Record):
    """State."""

    value: f8 = means("the output")
    used: i8 = means("bits of the channels voted")
    hybrid: hybrid.State = means("detector and handler")
    once: f8 = means("the change, smoothed once")
    twice: f8 = means("the change, smoothed twice")


def prepare(c: Const, *, alpha: float) -> None:
    """Fill the predictor's constants; those of ``c.hybrid`` come from :func:`.hybrid.prepare`.

    Args:
        alpha: smoothing constant, 0 to 1.
    """
    c.alpha = alpha


@kernel
def vote(s: State, c: Const, y: f8s) -> None:
    """Take the readings of one sample; arguments as in :func:`.kalman_hybrid.vote`."""
    h = s.hybrid
    if h.started == 0:
        hybrid.start(h, c.hybrid, y)
    else:
        a = c.alpha
        level = 2.0 * s.once - s.twice
        trend = a / (1.0 - a) * (s.once - s.twice)
        observed = hybrid.vote(h, c.hybrid, y, max(level + trend, 0.0))
        s.once += a * (observed - s.once)
        s.twice += a * (s.once - s.twice)
    s.value = h.value
    s.used = h.used

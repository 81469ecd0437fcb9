"""Where on the wheel are we? The last intervals against the wheel's pattern at every place.

The logarithms of the last intervals are the wheel's (of its pitches) plus a straight line, the speed and its change.
For each place on the wheel the sum of squares that is left tells how well it fits; the place is found when the best one
is likelier than the second by :data:`ODDS`. Where they show none, the whole turn is asked for it
(:mod:`gateway_plants.crank.monitor.competing_hypothesis`).
"""

from __future__ import annotations

from math import exp, log, sqrt
from typing import Annotated

from gateway_fdi.jit import Record, f8, f8s, i8, kernel, means

#: Intervals that are compared.
WINDOW = 8
#: Least deviation that is assumed of ln(interval).
LEAST_DEVIATION = 0.05
#: A fit worse than this is none.
WORST_DEVIATION = 0.35
#: A fit worse than this is none where one interval has so much of what is left: a pulse was missed or added there.
ONE_OFF, MOST_OF = 0.1, 0.55
#: [nat] of the best place against the second.
ODDS = 6.0


class Search(Record):
    """Search, and what the last call found."""

    seen: i8 = means("intervals so far")
    logs: Annotated[f8s, WINDOW] = means("logarithms of the last intervals, the latest at ``(seen - 1) % WINDOW``")
    period: f8 = means("time of a pitch", "us")
    growth: f8 = means("growth of the squared speed", "1/pitch")
    variance: f8 = means("variance of the logarithms")


@kernel
def restart(se: Search) -> None:
    """Forget the intervals."""
    se.seen = 0


@kernel
def seek(se: Search, logs: f8s, period: int, y: float) -> int:
    """Take an interval; returns the index of the tooth that ended it, -1: not known yet.

    Args:
        se: record of Search.
        logs: ln of the wheel's pitches.
        period: pulses after which the wheel's pattern repeats.
        y: interval [us].
    """
    se.logs[se.seen % WINDOW] = log(y)
    se.seen += 1
    if se.seen < WINDOW:
        return -1
    middle = (WINDOW - 1) / 2
    norm = WINDOW * (WINDOW * WINDOW - 1) / 12.0
    first, second, place, level, slope = 1e9, 1e9, -1, 0.0, 0.0
    for i in range(period):
        total, moment, square = 0.0, 0.0, 0.0
        at = i - (WINDOW - 1)
        while at < 0:
            at += period
        for k in range(WINDOW):
            d = se.logs[(se.seen + k) % WINDOW] - logs[at]
            total += d
            moment += (k - middle) * d
            square += d * d
            at = at + 1 if at + 1 < period else 0
        rest = square - total * total / WINDOW - moment * moment / norm
        if rest < first:
            second, first, place = first, rest, i
            level, slope = total / WINDOW, moment / norm
        elif rest < second:
            second = rest
    variance = max(first / (WINDOW - 2), LEAST_DEVIATION * LEAST_DEVIATION)
    if second - first < 2.0 * ODDS * variance or sqrt(variance) > WORST_DEVIATION:
        return -1
    odd = period > WINDOW and sqrt(variance) > ONE_OFF
    if odd and _largest(se, logs, period, place, level, slope) > MOST_OF * first:
        return -1
    se.period = exp(level + slope * (middle + 0.5))
    se.growth = min(max(-2.0 * slope, -0.3), 0.3)
    se.variance = first / (WINDOW - 2) / 2.0
    return place + 1 if place + 1 < period else 0


@kernel
def _largest(se: Search, logs: f8s, period: int, place: int, level: float, slope: float) -> float:
    """Return the largest squared residual at a place [nat^2]."""
    most, at = 0.0, place
    for k in range(WINDOW):
        d = se.logs[(se.seen - 1 - k) % WINDOW] - logs[at] - level - slope * ((WINDOW - 1) / 2 - k)
        most = max(most, d * d)
        at = at - 1 if at > 0 else period - 1
    return most

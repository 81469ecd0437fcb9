"""Kick-back: an engine that nearly stood may have turned back.

A sensor without direction shows the same teeth again. From the slowest interval on, behind tooth
``i``, a wheel that turns on shows its gap after ``P - i`` pulses, one that turned back after ``i + 2``,
the gap recognised by the interval after it.

How an engine comes to stand: under a constant torque the times from the turning point are as the roots of the angles.
With the point a share f of a pitch behind the last tooth (f from 0 to 1) the intervals before it are to each other as::

    2 sqrt(f),  sqrt(f + 1) - sqrt(f),  sqrt(f + 2) - sqrt(f + 1),  ...

so that the longest one, over the turning point or just before it, takes more than 1 / sqrt(a) at the deceleration a
[pitch/s^2], and the one before that is longer by more than 1.28 than its own predecessor, or one of the two by more
than 1.62. An engine that passes its
slowest point turning on is nearly even there, and a missed pulse has no such interval before it. Slower still, any
interval may hide a turning point. From there on until the place is proven again nothing is held against the sensor: on
a wheel that turns back each tooth comes at the wrong time.
"""

from __future__ import annotations

from gateway.monitors.contract import report
from gateway_fdi.jit import Record, f8, i4, i8, kernel, means, u1
from gateway_plants.crank.monitor.faults import REVERSED, Reports


class Reversal(Record):
    """What is known of an engine that may turn back."""

    index: i4 = means("tooth before the slowest interval; -1: none")
    count: i4 = means("pulses since")
    slowest: f8 = means("slowest interval", "us")
    stood: u1 = means("1: the engine may have turned back, and the place was not proven since")
    slow: u1 = means("1: an interval was long enough to turn back in, since the gap was seen where it is expected")
    total: i8 = means("reversals told")


#: Pulses that the two counts must differ by, and that a count may be off.
CLEAR, OFF = 4, 2
#: Growth from one interval to the next, less 1, from which on an engine may be about to stand within one pitch (0.28,
#: less jitter); within a gap of S pitches it is as many times smaller (0.13 of three).
GREW = 0.2
#: Growth that one of the last two intervals has before an engine stands (1.62, less jitter); one that is cranked over
#: its compressions has 1.3 on a wheel of 12 teeth.
STEEP = 1.5
#: Deviation of an edge that is usual [pitch]; how many times what goes beyond it an interval grows by itself.
USUAL, JITTERS = 0.03, 5.0
#: An engine stops within a pitch, at its hardest, when the one before takes so much of the least time over a turning
#: point: 2 / (2 + sqrt(2)), less jitter.
STOPS = 0.55


@kernel
def grown(variance: float) -> float:
    """Return by what share an interval may grow by itself, where edges jitter more than usual.

    Args:
        variance: of an edge [pitch^2].
    """
    return float(JITTERS * max(variance**0.5 - USUAL, 0.0))


@kernel
def stopping(longest: float, span: float, u2: float, u1: float, u: float, variance: float) -> bool:
    """Tell whether the latest of three intervals is one over, or just before, a turning point.

    Args:
        longest: least that it takes over one pitch, at the hardest deceleration [us].
        span: of the last interval [pitch].
        u2: the last interval but two, over one pitch [us]; 0: not known.
        u1: the last but one.
        u: the last one.
        variance: of an edge [pitch^2]; of edges that jitter much, an interval grows by itself.
    """
    jitter = grown(variance)
    steep = u > (STEEP + jitter) * u1 or u1 > (STEEP + jitter) * u2
    return bool(u > longest and steep and u >= u1 > (1.0 + GREW / span + jitter) * u2 and u2 > 0.0)


@kernel
def slow(longest: float, y1: float, y: float) -> bool:
    """Tell whether an engine may have turned back in one of two intervals: long enough, as the other one nearly is.

    Args:
        longest: as in :func:`stopping`.
        y1: the last interval but one [us].
        y: the last one [us].
    """
    return max(y1, y) > longest and min(y1, y) > STOPS * longest


@kernel
def begin(re: Reversal, pulses: int, index: int, y: float) -> None:
    """Note that the engine nearly stood behind a tooth; of several slow intervals [us] the slowest counts."""
    if re.index < 0:
        re.index = index
        re.slowest = 0.0
    elif y > re.slowest:
        # Pulses are counted here: so near standstill time does not tell teeth apart.
        re.index = (re.index + re.count + 1) % pulses
    if y > re.slowest:
        re.count = -1
        re.slowest = y


@kernel
def seen(re: Reversal, pulses: int, gap: float, y2: float, y1: float, y: float) -> bool:
    """Take an interval; returns whether the gap came where only a wheel that turned back shows it.

    Args:
        re: record of Reversal.
        pulses: of a revolution.
        gap: pitch at the gap [pitch].
        y2: the last interval but two [us].
        y1: the last but one [us].
        y: the last one [us].
    """
    re.count += 1
    if re.count > pulses + OFF:
        re.index = -1
        return False
    if re.count < 3 or y1 < 0.72 * gap * (y * y2) ** 0.5:
        return False
    back, on = re.index + 2, pulses - re.index
    turned_back = abs(re.count - back) <= OFF and abs(on - back) > CLEAR
    if not turned_back and abs(re.count - on) <= OFF:
        re.index = -1
    return bool(turned_back)


@kernel
def tell(re: Reversal, out: Reports, reported: bool) -> None:
    """Count it, and report it where that is wanted: it is no defect of the sensor."""
    re.total += 1
    if reported:
        e = report(out, REVERSED, True, re.count, 0.0).reversed
        e.tooth, e.pulses = re.index, re.count
    re.index = -1

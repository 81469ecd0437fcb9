"""Bursts of pulses within one tooth: ignition noise, ringing of the edge, a contact that chatters.

Up to six pulses of a burst are hypotheses of the tracker
(:data:`~gateway_plants.crank.pulse_tracking.branching.MOST_CLUTTER`). A longer burst ends them: which of its pulses was
a tooth is not known. The burst then goes on until an interval is as long as a tooth's again; only then is it told, with
all its pulses. The wheel turned on meanwhile: the time since the last tooth says how many passed, where one number fits
it. The place is then doubted until the gap comes where it is expected; else it is looked for again.
"""

from __future__ import annotations

from gateway.monitors.contract import report
from gateway_fdi.jit import Record, f8, f8s, i4, i8, kernel, means, u1
from gateway_plants.crank.monitor.faults import NOISE, Reports
from gateway_plants.crank.pulse_tracking.motion import Hypothesis, travel

#: Pulses that no tooth made, within one interval, from which on they are a burst and no pulse of their own.
BURST = 4
#: Share of a pitch: pulses that follow each other sooner are of the burst.
SHORT = 0.5
#: Pulses after which a burst that does not end is told all the same.
MOST = 256
#: Pitches that a burst lasts while no place is known, at most.
MOST_PITCHES = 2.0
#: Pulses behind a crowd, which may be its end.
BEHIND = 2
#: Teeth that can be told by the time since the last one, and how far from it one may be [pitch].
MOST_TEETH_PASSED, NEAR = 10, 0.3


class Burst(Record):
    """A burst that is not told yet."""

    count: i4 = means("its pulses so far; 0: there is none")
    tooth: i4 = means("tooth behind which it began")
    named: i4 = means("that tooth as it is told")
    us: f8 = means("time since that tooth", "us")
    period: f8 = means("time of a pitch before the burst", "us")
    rpm: f8 = means("speed before the burst; 0: not known, as no place is", "rpm")
    known: u1 = means("1: the place was proven before the burst")
    crowd: i4 = means("pulses that came sooner than half a pitch, one behind the other")
    crowd_us: f8 = means("sum of the intervals of these pulses", "us")
    crowded: i8 = means("number of the latest of these pulses")
    told: i8 = means("pulse at which a burst was last told")


@kernel
def note(b: Burst, number: int, y: float, period: float) -> None:
    """Note an interval [us] that ends with pulse ``number``, at a time of a pitch [us]."""
    if y >= SHORT * period:
        return
    again = number == b.crowded + 1
    b.crowd = b.crowd + 1 if again else 1
    b.crowd_us = y + (b.crowd_us if again else 0.0)
    b.crowded = number


@kernel
def crowd(b: Burst, number: int) -> int:
    """Return how many pulses, just before pulse ``number``, came as a crowd; the one it began at counts."""
    return int(b.crowd) + 1 if number - b.crowded <= BEHIND else 0


@kernel
def close(b: Burst, firing_us: float) -> bool:
    """Tell whether the last crowd's pulses are closer than those of an engine that is turned by its starter.

    One that nearly stood, and was thrown back, has pulses that come sooner than half a pitch as well.

    Args:
        b: record of Burst.
        firing_us: time of a pitch of the slowest engine that fires [us].
    """
    return bool(b.crowd_us < firing_us * b.crowd)


@kernel
def begin(b: Burst, count: int, us: float, period: float, rpm: float, named: int) -> None:
    """Begin a burst of so many pulses, so long since the last tooth, at a time of a pitch [us] and a speed.

    ``rpm`` is 0, and ``named`` -1, while no place is known.
    """
    b.count, b.us, b.period, b.rpm, b.named, b.known = count, us, period, rpm, named, 0


@kernel
def passed(b: Burst, h: Hypothesis, pitches: f8s, pulses: int) -> int:
    """Return how many teeth have passed since the burst began, the latest pulse the last of them; 0: not known.

    Args:
        b: record of Burst.
        h: the hypothesis before it.
        pitches: as learned, of ``pulses`` slots.
        pulses: of one turn.
    """
    span, slot, found, nearest = 0.0, int(b.tooth), 0, NEAR
    for k in range(1, MOST_TEETH_PASSED + 1):
        span += pitches[slot]
        slot = slot + 1 if slot + 1 < pulses else 0
        dt, q = travel(h, span)
        off = abs(b.us - dt) * q / h.period
        if off < nearest:
            nearest, found = off, k
    return found


@kernel
def goes_on(b: Burst, y: float, firing_us: float, out: Reports) -> bool:
    """Take an interval [us]; returns whether its pulse is still of the burst. Tells the burst when it ends.

    Args:
        b: record of Burst.
        y: the interval [us].
        firing_us: time of a pitch of the slowest engine that fires [us], see :func:`tell`.
        out: record of Out.
    """
    b.us += y
    if b.rpm == 0.0 and b.us > MOST_PITCHES * b.period:
        b.count = 0  # no burst: an engine that turns faster than the pulses before
        return False
    if y < SHORT * b.period and b.count < MOST:
        b.count += 1
        return True
    tell(b, firing_us, out)
    return False


@kernel
def tell(b: Burst, firing_us: float, out: Reports) -> None:
    """Report the burst, and forget it.

    Not one whose pulses came no closer than those of an engine that is turned by its starter: one that nearly stood,
    and was thrown back, has such pulses as well.
    """
    if b.us > firing_us * b.count:
        b.count = 0
        return
    e = report(out, NOISE, True, b.count, BURST).noise
    e.count, e.tooth, e.speed = b.count, b.named, b.rpm
    b.count = 0

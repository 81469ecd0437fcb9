"""The paper's method: missed and added tooth pulses (paper 000), at constant speed.

Source: Kim, Suh, Park, Yun, "A Method of Fault Diagnosis for Engine Synchronization Using Analytical
Redundancy" (2003). The signal is the pulse time PT, the interval between two pulses::

    x[k+1] = x[k] + u[k] + f[k],   y[k] = x[k] + n[k]                                (1), (2)
    xh[k+1] = xh[k] + u[k] + D r[k],   r[k] = y[k] - xh[k]                           (6), (8)
    u[k] = alpha (a[i+1] - a[i])                                                     (3)

with ``a`` the wheel's pitches and ``alpha`` the time of one pitch. Written this way the input
generator holds for any wheel; for N-m it is +delta before the gap, -delta after it, as printed.

Corrections to the print, each used below:

* (3), first line: the zeros lie in ``(n-1) Pi < k < n Pi - 1``; as printed the range is empty.
* (6), second line: the output equation is ``yh[k] = xh[k]``; printed ``y[k] = xh[k]``.
* Threshold: 1.0 in section 4 is 2.54 sqrt(gamma); the residual's deviation by (13) is
  ``sqrt(2 gamma / (2 - D))``. At 2.09 sigma a healthy wheel alarms about once a revolution. Default
  here: half the gap's step, ``delta / 2``.
* Count: the residual's duration tells it only for a narrow window of thresholds. The lag from the
  first exceedance to the largest residual of opposite sign is the count for the paper's faults
  (4), (5): missed 1 gives r / delta = 1, -(1+D), ...; missed 2 gives 1, -D, -(1+D)+D^2, ...
* (4), (5) describe only the *displaced gap*. A pulse that is really missed also leaves, at once, an
  interval of 2 alpha. Both are told apart by time: intervals over a displaced gap last as long as
  the model says, those over a missing or an added pulse end that many pitches late or early.

Once the count is known the index of the input generator is shifted by it (the paper's lengthened or
shortened run of zeros), so that synchronisation is kept.
"""

from __future__ import annotations

from math import sqrt
from typing import Annotated

import numpy as np

from gateway.monitors.contract import report
from gateway_fdi.jit import Record, f8, f8s, i4, i8, kernel, means, u1
from gateway_plants.crank.monitor.faults import ADDED, MISSED, RESIDUALS, SYNC_LOST, Reports
from gateway_plants.crank.wheel import MOST_TEETH, Wheel

#: Residuals looked at from the first exceedance on.
WINDOW = 6
#: Largest count that (4), (5) are read for.
LARGEST_COUNT = 3
#: Share of the threshold below which the observer is believed.
QUIET = 0.25
SEARCH, LEARN, TRACK = range(3)


class Const(Record):
    """Constants."""

    pulses: i4 = means("pulses of a turn")
    follow_speed: u1 = means("1: alpha is learned anew after every clean revolution")
    turn: f8 = means("pitches of a turn")
    gap: f8 = means("largest pitch", "pitch")
    gain: f8 = means("D")
    threshold: f8 = means("threshold of the residual", "pitch")
    step: f8 = means("delta, the gap's step", "pitch")
    pitches: Annotated[f8s, MOST_TEETH] = means("a, the wheel's pitches", "pitch")


class State(Record):
    """State."""

    phase: i4 = means("SEARCH, LEARN or TRACK")
    index: i4 = means("latest tooth")
    revolutions: i8 = means("turns so far")
    teeth: i8 = means("pulses so far")
    speed_rpm: f8 = means("speed of the last clean turn", "rpm")
    missed: i8 = means("pulses missed")
    added: i8 = means("pulses added")
    unexplained: i8 = means("alarms that no count explains")
    alarms: i8 = means("first exceedances of the threshold")
    x: f8 = means("xh, the interval that is expected", "us")
    alpha: f8 = means("time of one pitch", "us")
    y1: f8 = means("last interval; 0: not known", "us")
    y2: f8 = means("interval before that; 0: not known", "us")
    turn_us: f8 = means("sum of the intervals of this turn", "us")
    clean: u1 = means("1: this turn has no exceedance so far")
    searched: i8 = means("pulses of the search")
    recent: i8 = means("faults since the last clean turn")
    filled: i4 = means("values in the window")
    at: i4 = means("tooth of the first exceedance")
    scale: f8 = means("time of one pitch before a fault", "us")
    residuals: Annotated[f8s, WINDOW] = means("residuals of the window", "pitch")
    intervals: Annotated[f8s, WINDOW] = means("intervals of the window", "us")


def prepare(s: State, c: Const, wheel: Wheel, gain: float, threshold: float | None, follow_speed: bool) -> None:
    """Fill state and constants.

    Args:
        s: record of State.
        c: record of Const.
        wheel: the wheel.
        gain: observer gain D.
        threshold: of the residual [pitch]; None: half the smallest gap's step.
        follow_speed: learn the pitch time anew after every clean revolution.
    """
    pitches = np.asarray(wheel.pitches, float)
    gaps = pitches[pitches > pitches.min() * 1.5]
    c.pulses = len(pitches)
    c.follow_speed = follow_speed
    c.turn = pitches.sum()
    c.gap = pitches.max()
    c.gain = gain
    c.step = pitches.max() - 1.0
    c.threshold = threshold if threshold is not None else (gaps.min() - 1.0) / 2
    c.pitches[: len(pitches)] = pitches


@kernel
def search(s: State) -> None:
    """Forget synchronisation and look for the gap again."""
    s.phase = SEARCH
    s.searched = 0
    s.recent = 0
    s.filled = 0
    s.y1 = 0.0
    s.y2 = 0.0


@kernel
def _gap_seen(s: State, c: Const, y: float) -> bool:
    """Tell whether the last but one of three intervals is the wheel's largest gap."""
    if s.y1 <= 0.0 or s.y2 <= 0.0:
        return False
    ratio = s.y1 / sqrt(y * s.y2)
    return bool(0.72 * c.gap < ratio < 1.45 * c.gap and 0.45 < y / s.y2 < 2.2)


@kernel
def _synchronise(s: State, c: Const, y: float) -> None:
    """Start the observer behind a gap: ``y`` was interval 0."""
    s.phase = LEARN
    s.alpha = y / c.pitches[0]
    s.index = 1 % c.pulses
    s.x = s.alpha * c.pitches[s.index]
    s.turn_us = y
    s.clean = 1
    s.filled = 0


@kernel
def _shift(s: State, c: Const, number: int) -> None:
    """Shift the input generator by so many pulses."""
    index = s.index + number
    s.revolutions += index // c.pulses
    s.index = index % c.pulses
    s.x = s.alpha * c.pitches[s.index]


@kernel
def _fail(s: State, c: Const, out: Reports, fault: int, number: int) -> None:
    """Report a missed or added pulse with the residual's shape as evidence."""
    e = report(out, fault, True, s.residuals[0], c.threshold).pulses
    e.count = number
    e.tooth = s.at
    e.speed = s.speed_rpm
    for k in range(RESIDUALS):
        e.residual[k] = s.residuals[k]


@kernel
def displacement(residuals: f8s, step: float) -> int:
    """Return by how many pulses the gap came early (+) or late (-), 0 if that is not what is seen.

    Args:
        residuals: from the first exceedance on, at least 5 [pitch].
        step: the gap's step delta [pitch].
    """
    sign = 1.0 if residuals[0] > 0 else -1.0
    lag = 0
    peak = 0.0
    for k in range(1, 5):
        opposite = -sign * residuals[k]
        if opposite > peak:
            peak = opposite
            lag = k
    # The opposite peak of a displaced gap is at least 1.096 of the gap's step.
    if lag == 0 or lag > LARGEST_COUNT or peak < 0.65 * step:
        return 0
    return lag if sign > 0 else -lag


@kernel
def _classify(s: State, c: Const) -> int:
    """Return the signed count of pulses missed (+) or added (-) that a full window shows, 0: none.

    First by time, then by the lag of the opposite peak (see the module).
    """
    measured = 0.0
    expected = 0.0
    for k in range(WINDOW):
        measured += s.intervals[k]
        expected += c.pitches[(s.at + k) % c.pulses]
    direct = int(np.rint(measured / s.scale - expected))
    if direct != 0:
        return direct
    return displacement(s.residuals, c.step)


@kernel
def _judge(s: State, c: Const, out: Reports) -> None:
    """Judge a full window: report, shift the input generator, or give synchronisation up."""
    number = _classify(s, c)
    s.filled = 0
    s.clean = 0
    if number == 0:
        s.unexplained += 1
        return
    _shift(s, c, number)
    s.recent += 1
    if abs(number) > LARGEST_COUNT or s.recent > 2:
        report(out, SYNC_LOST, True, s.recent, 2.0).sync_lost.teeth = s.teeth
        search(s)
    elif number > 0:
        s.missed += number
        _fail(s, c, out, MISSED, number)
    else:
        s.added -= number
        _fail(s, c, out, ADDED, -number)


@kernel
def _turn(s: State, c: Const, out: Reports) -> None:
    """End a revolution: speed, pitch time, and the passed results of a clean one."""
    s.revolutions += 1
    if s.clean == 1 and s.turn_us > 0.0:
        s.speed_rpm = 60e6 / s.turn_us
        if c.follow_speed == 1 or s.phase == LEARN:
            s.alpha = s.turn_us / c.turn
        s.phase = TRACK
        s.recent = 0
        report(out, MISSED, False, 0.0, c.threshold)
        report(out, ADDED, False, 0.0, c.threshold)
        report(out, SYNC_LOST, False, 0.0, 0.0)
    s.clean = 1
    s.turn_us = 0.0


@kernel
def tooth(s: State, c: Const, y: float, out: Reports) -> None:
    """Take one interval between two pulses.

    Args:
        s: state.
        c: constants.
        y: interval [us].
        out: record of Out.
    """
    s.teeth += 1
    found = _gap_seen(s, c, y)
    s.y2 = s.y1
    s.y1 = y
    if s.phase == SEARCH:
        s.searched += 1
        if found:
            _synchronise(s, c, y)
        elif s.searched == 3 * c.pulses:
            s.searched = 0
            report(out, SYNC_LOST, True, s.teeth, 0.0).sync_lost.teeth = s.teeth
        return

    if s.phase == LEARN and found != (s.index == 0):
        # The first revolution must show the gap once, in its place.
        search(s)
        return

    r = y - s.x
    if s.phase == TRACK and (s.filled > 0 or abs(r) > c.threshold * s.alpha):
        if s.filled == 0:
            s.clean = 0
            s.alarms += 1
            s.at = s.index
        s.residuals[s.filled] = r / s.alpha
        s.intervals[s.filled] = y
        s.filled += 1

    if s.filled == 0 and (s.phase != TRACK or abs(r) < QUIET * c.threshold * s.alpha):
        # What a fault has pulled the observer to is not the pitch time.
        s.scale = s.x / c.pitches[s.index]
    s.turn_us += y
    following = s.index + 1
    if following == c.pulses:
        following = 0
    u = s.alpha * (c.pitches[following] - c.pitches[s.index])
    s.x += u + c.gain * r
    s.index = following
    if s.filled == WINDOW:
        _judge(s, c, out)
    if following == 0 and s.phase != SEARCH:
        _turn(s, c, out)

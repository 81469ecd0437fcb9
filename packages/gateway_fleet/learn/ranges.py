"""How far values of a healthy part go: from the tail of those of a drive, not farther than the database says.

Values follow each other, so a drive of a minute may show a signal twice: it counts how often a signal went from one end
of its span to the other. Their number says how much is known of what comes tomorrow. Few ways through its span are no
limit: pedals and currents of one short drive go anywhere on the next.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from cantools.database.can.signal import Signal
from numpy.typing import NDArray

from gateway.signals.columns import limits
from gateway.signals.tables import signal_row
from gateway_fdi.tails import LEAST
from gateway_fleet.learn.course import Course
from gateway_fleet.learn.lines import short, shown
from gateway_fleet.learn.standards import Standard
from gateway_fleet.learn.tails import Rate, block_maxima, limit_above

#: Times the drive's length up to which noise about one level gives a limit: it does not say where a quantity goes.
KNOWN = 1000.0
#: A value beyond counts where it lasts for this time [s], and comes twice.
LASTS_S = 0.5
#: Different values of a floating-point signal: its numbers are no states.
LEAST_DIFFERENT = 8
#: Ways from one end of its span to the other that a signal must have gone for a limit, values, and length of the
#: drives [s].
SWINGS, LEAST_VALUES, LEAST_S = 8, 100, 30.0
#: Room on either side that one test of 10^FAR times the drive gets, of the span: for any number of ways, and beside it
#: for one way. Of nearer ones it gets less, in proportion to the logarithm.
ROOM, ROOM_OF_ONE, FAR = 0.6, 12.0, 5.0
#: A floating-point signal that went fewer ways: a value beyond is wild that is larger than any by this factor.
WILD = 10.0
#: Margin on either side of the database's range, of its width: steering wheels turn farther than databases say.
MARGIN = 0.1
#: Share of the database's range that shows that the range is the signal's; share of the moving signals that leave
#: theirs, or whose bits cannot say it, above which a database says nothing of the others.
EXPLORED, CARELESS = 0.1, 0.25


@dataclass(frozen=True)
class Shown:
    """Values that drives show.

    Attributes:
        matrix: values of all signals at the same times, NaN where there is none, shape (times, signals).
        step_s: time between rows [s].
        rate: of false alarms that is asked for.
        careful: whether the database of a bus has ranges that the drives keep.
    """

    matrix: NDArray[np.float64]
    step_s: float
    rate: Rate
    careful: bool = True

    @property
    def hours(self) -> float:
        """Length of the drives [h]."""
        return len(self.matrix) * self.step_s / 3600.0


def representable(signal: Signal) -> tuple[float, float]:
    """Return the physical values that a signal's bits can say."""
    return limits(signal_row(signal))


def database_range(signal: Signal) -> tuple[float, float] | None:
    """Return the range of a signal in the database, if it says more than the signal's bits do."""
    if signal.minimum is None or signal.maximum is None or not signal.minimum < signal.maximum:
        return None
    low, high = representable(signal)
    step = abs(signal.scale) * 1.001
    if signal.minimum <= low + step and signal.maximum >= high - step:
        return None
    return float(signal.minimum), float(signal.maximum)


def beyond(signal: Signal, course: Course) -> bool:
    """Return whether a signal left the range that the database gives it."""
    given, slack = database_range(signal), abs(signal.scale) * 0.501
    return given is not None and not (given[0] - slack <= course.lowest and course.highest <= given[1] + slack)


def is_careful(signals: Iterable[tuple[Signal, Course]]) -> bool:
    """Return whether the signals that moved keep the ranges of a database, and their bits can say these."""
    asked = wrong = 0
    for signal, course in signals:
        given, (low, high) = database_range(signal), representable(signal)
        if given is not None and course.span > 0.0:
            asked += 1
            step = abs(signal.scale) * 1.001
            wrong += beyond(signal, course) or given[0] < low - step or given[1] > high + step
    return wrong <= CARELESS * asked


def range_of(
    own: Standard | None, signal: Signal, course: Course, column: NDArray[np.float64], every_s: float, drive: Shown
) -> tuple[tuple[float, float] | None, str]:
    """Return the least and greatest value that is plausible, None where the drive supports none; and the evidence.

    Args:
        own: range that it has in any car.
        signal: in the database.
        course: of it.
        column: its values at the times of the drive.
        every_s: usual time from value to value [s].
        drive: what is shown.
    """
    if not course.count:
        return None, ""
    given, (low, high) = database_range(signal), representable(signal)
    out = beyond(signal, course)
    why = f"beyond the database's {shown(given[0])} to {shown(given[1])}" if given is not None and out else ""
    bound = (-np.inf, np.inf)
    known = drive.careful or (given is not None and course.span >= EXPLORED * (given[1] - given[0]))
    if given is not None and not out and known:
        room = MARGIN * (given[1] - given[0])
        bound, why = (given[0] - room, given[1] + room), f"database {shown(given[0])} to {shown(given[1])}"
    found, text = _of_drive(signal, course, column, every_s, drive)
    if own is not None:
        text = "; ".join(part for part in (text, own.why) if part)
        found = max(found[0], own.low), min(found[1], own.high)
    least, most = max(bound[0], found[0]), min(bound[1], found[1])
    if least <= low and most >= high:
        return None, why if out else ""
    if not np.isfinite([least, most]).all():
        least, most = max(least, low), min(most, high)
    if not np.isfinite([least, most]).all():
        return None, why
    return (short(least), short(most)), "; ".join(part for part in (why, text) if part)


def _of_drive(
    signal: Signal, course: Course, column: NDArray[np.float64], every_s: float, drive: Shown
) -> tuple[tuple[float, float], str]:
    """Return the limits that the drive itself gives, infinite where it gives none, and their evidence."""
    nothing = -np.inf, np.inf
    states = len(course.values) < LEAST_DIFFERENT if signal.is_float else course.states
    if states or course.count < LEAST_VALUES:
        return nothing, ""
    wild = WILD * max(abs(course.lowest), abs(course.highest)) if signal.is_float else np.inf
    rare = drive.rate.hours > KNOWN * drive.hours
    ways = course.ways if rare else course.swings
    if ways < SWINGS or drive.hours * 3600.0 < LEAST_S or (rare and course.narrow):
        if not signal.is_float:
            return nothing, ""
        text = "its largest value ten times, as a number of its kind says nothing of a range"
        return (course.lowest - wild, course.highest + wild), text
    longer = drive.rate.hours / drive.hours
    spans = (ROOM + ROOM_OF_ONE / ways) * float(np.clip(np.log10(longer) / FAR, 0.0, 1.0))
    # The tail alone says what comes LEAST times in the drive; what comes once is not nearer than the farthest value.
    once = float(np.clip(np.log(LEAST * longer) / np.log(LEAST), 0.0, 1.0))
    good = column[~np.isnan(column)]
    window = min(max(round(max(LASTS_S, every_s) / drive.step_s), 1) + 1, len(good))
    lasting = np.lib.stride_tricks.sliding_window_view(good, window)
    rows = max(round(1.0 / drive.step_s), len(good) // course.swings, 1)
    step = 0.25 * abs(float(signal.scale)) if not signal.is_float else 0.0
    walk, most_room = course.walk * float(np.sqrt(longer)), wild if course.walk else np.inf
    ends = []
    for sign in (-1.0, 1.0):
        longest = (sign * lasting).min(axis=1)
        tail = limit_above(block_maxima(longest, rows), rows * drive.step_s, step, drive.rate, heavy=True)
        most = course.highest if sign > 0 else -course.lowest
        end = tail + once * max(most + spans * course.span - tail, 0.0) + walk
        ends.append(sign * min(end, most + most_room))
    text = f"through its span {ways} times; beyond once in {shown(drive.rate.hours)} h"
    if walk > 0.0:
        text += f"; its level still moved after {shown(60.0 * drive.hours)} min: room for it {shown(walk)}"
    return (ends[0], ends[1]), text


def waiting(signal: Signal, course: Course, seconds: float) -> str:
    """Return why drives of this length [s] say too little of a quantity for a limit; "": they say enough."""
    if signal.choices or course.states or signal.is_float or course.count < LEAST_VALUES:
        return ""
    if course.ways < SWINGS:
        minutes = np.ceil(max(seconds, LEAST_S) * SWINGS / max(course.ways, 1) / 60.0)
        return f"{course.ways} of {SWINGS} ways through its span: about {minutes:.0f} min"
    if course.narrow:
        return "near one level: another drive may have another"
    return "its level still moves" if course.walk else ""

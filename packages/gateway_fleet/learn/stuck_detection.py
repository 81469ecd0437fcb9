"""Signals that move in nearly every frame: one that does not is frozen, or its frames come twice.

The learned value is the share of values that differ from the one before, in the shortest time that gives evidence of
it, while the car is driven as it was: a car that stands moves nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from cantools.database.can.signal import Signal
from numpy.typing import NDArray

from gateway_fleet.learn.claims import called_checksum
from gateway_fleet.learn.counters import called_counter
from gateway_fleet.learn.gaps import cycle_ns
from gateway_fleet.learn.lines import short
from gateway_fleet.learn.observe import Observation, Seen
from gateway_fleet.learn.tails import Rate, limit_above

#: Values of one share, and the time that they take at least, and at most [s].
VALUES, LEAST_S, MOST_S = 50, 1.0, 15.0
#: Blocks that it takes to know a share, and the least one that is asked for.
LEAST_BLOCKS, LEAST_SHARE = 12, 0.1
#: Most that is asked for, of the least share seen. Frames that come twice halve the share.
OF_LEAST = 0.65
#: Blocks longer by these factors are tried, too, where the share that can be asked for is below this one, which shows
#: such frames.
LONGER, TWICE = (1, 3), 0.46
#: Where nothing says how fast the car is: the signal's own range, if it is this far from zero, of its span. A signal
#: that rests now and then has to be seen for this time [s]; one that moves with this share always is no quantity.
FROM_ZERO, SEEN_S, ALWAYS = 0.2, 30.0, 0.95
#: The car is not taken to stand above this share of its usual speed.
DRIVES = 0.25
#: Unit of a speed -> m/s; names of a car's speed, and words of other speeds.
UNITS = {"mph": 0.44704, "m/s": 1.0} | dict.fromkeys(
    ("km/h", "kph", "kmh", "km/hr", "km/hour", "kilometer per hour"), 1 / 3.6
)
NAMES, OTHERS = (
    ("SPEED", "VELOC", "GESCHW", "VEH_V"),
    ("ENG", "FAN", "WIND", "WIPER", "SET", "LIMIT", "TURB", "MOT", "RATE"),
)
#: A car that is this fast is not being switched off [m/s]. Its speed is what two messages agree about: to this [m/s]
#: and share of it, in all but this share of the rows, of which there are some. They have to change by a share.
MOVES, APART, APART_SHARE, BUT, ROWS, CHANGES = 2.0, 0.5, 0.05, 0.05, 40, 0.1


@dataclass(frozen=True)
class Drives:
    """How fast the car is.

    Attributes:
        name: of the signal, ``Message.Signal``.
        message: of it.
        at: times [ns] -> values, NaN where none is known.
        unit: of it, in small letters.
        least, most: of it, seen.
    """

    name: str
    message: str
    unit: str
    at: Callable[[NDArray[np.int64]], NDArray[np.float64]]
    least: float
    most: float


def drives(observation: Observation, bus: int) -> list[Drives]:
    """Return the signals of a bus that say how fast the car is, the likeliest first."""
    stamps, matrix = observation.snapshots.stamps(), observation.snapshots.matrix()
    found: list[tuple[tuple[bool, bool, bool, int], int, Drives]] = []
    for (index, name), seen in observation.seen.items():
        if index != bus:
            continue
        for k, signal in enumerate(seen.signals):
            course = seen.courses.each[k]
            if course.states or signal.choices or not _says_speed(signal):
                continue
            column = matrix[:, seen.columns.start + k]
            named = any(word in signal.name.upper() for word in NAMES)
            unit = (signal.unit or "").lower()
            rank = unit not in UNITS, not named, "WHEEL" in signal.name.upper(), -seen.frames
            made = Drives(f"{name}.{signal.name}", name, unit, _at(stamps, column), course.lowest, course.highest)
            found.append((rank, len(found), made))
    return [made for _, _, made in sorted(found, key=lambda each: each[:2])]


def motion(observation: Observation, buses: Sequence[str], speeds: Sequence[Sequence[Drives]]) -> list[dict[str, Any]]:
    """Return conditions of which one is met while the car moves: a speed of two messages that say the same; or none."""
    stamps = observation.snapshots.stamps()
    known = [(f"{buses[bus]}.{one.name}", one) for bus, some in enumerate(speeds) for one in some if one.unit in UNITS]
    for k, (name, one) in enumerate(known):
        mine = one.at(stamps) * UNITS[one.unit]
        for other_name, other in known[k + 1 :]:
            theirs = other.at(stamps) * UNITS[other.unit]
            good = (np.fmax(mine, theirs) >= MOVES) & ~np.isnan(mine + theirs)
            if other.message == one.message or good.sum() < ROWS or np.ptp(mine[good]) < CHANGES * mine[good].max():
                continue
            apart = np.abs(mine - theirs)[good] > APART + APART_SHARE * np.fmax(mine, theirs)[good]
            if apart.mean() <= BUT:
                both = (name, one), (other_name, other)
                return [{"signal": full, "min": short(MOVES / UNITS[each.unit])} for full, each in both]
    return []


def _says_speed(signal: Signal) -> bool:
    name = signal.name.upper()
    if any(word in name for word in OTHERS):
        return False
    return (signal.unit or "").lower() in UNITS or any(word in name for word in NAMES)


def _at(stamps: NDArray[np.int64], column: NDArray[np.float64]) -> Callable[[NDArray[np.int64]], NDArray[np.float64]]:
    def at(t_ns: NDArray[np.int64]) -> NDArray[np.float64]:
        places = np.clip(np.searchsorted(stamps, t_ns), 0, len(stamps) - 1)
        near = np.abs(stamps[places] - t_ns) < 500_000_000
        return np.where(near, column[places], np.nan)

    return at


def moving(
    seen: Seen, own: set[str], speeds: Sequence[Drives], rate: Rate, checksum: str | None = None
) -> Iterator[tuple[Signal, dict[str, Any], str]]:
    """Yield the signals of a message that move, the limit of each, and its evidence.

    Args:
        seen: of the message.
        own: names of its counter and checksum.
        speeds: of :func:`drives`.
        rate: of false alarms that is asked for.
        checksum: of a message without a counter: it moves with any bit of the frame; None: not looked at.
    """
    period = cycle_ns(seen.gaps) * 1e-9
    if period <= 0.0 or period * VALUES > MOST_S or not len(seen.samples.runs):
        return
    count = max(VALUES, int(np.ceil(LEAST_S / period)))
    speed = next((each for each in speeds if each.message != seen.message.name), None)
    runs = [seen.values(run) for run in seen.samples.runs]
    for k, (signal, course) in enumerate(zip(seen.signals, seen.courses.each, strict=True)):
        quantity = not (signal.choices or signal.multiplexer_ids or signal.is_multiplexer) and signal.length > 1
        called = called_checksum(signal.name) or called_counter(signal.name) or signal.name in own
        if not quantity or (called and signal.name != checksum) or course.changes < LEAST_BLOCKS or course.none:
            continue
        columns = [values[:, k] for values in runs]
        stamps = seen.samples.stamps
        each = [(found, n * count) for n in LONGER if (found := _asked(columns, stamps, speed, n * count, rate))]
        if each:
            (share, condition, text), values = max(each, key=lambda one: one[0][0] >= TWICE)
            yield signal, {"seconds": short(values * period, 2), "share": share} | condition, text


def _asked(
    columns: Sequence[NDArray[np.float64]],
    times: Sequence[NDArray[np.int64]],
    speed: Drives | None,
    count: int,
    rate: Rate,
) -> tuple[float, dict[str, Any], str] | None:
    """Return the least share of values that move, when it is asked for, and its evidence; None: nothing is.

    Args:
        columns: values of the signal, NaN where there is none, in runs of frames without a gap.
        times: stamps of the runs [ns].
        speed: of the car.
        count: values of one share.
        rate: of false alarms that is asked for.
    """
    shares, lows = [], []
    low, high, ways = np.inf, -np.inf, set[int]()
    for value, stamps in zip(columns, times, strict=True):
        moved = value[1:] != value[:-1]
        ways |= {int(way) for way in np.unique(np.sign(np.diff(value[~np.isnan(value)]))) if way}
        fast = value if speed is None else speed.at(stamps)
        missing = np.concatenate([[0], np.cumsum(np.isnan(fast) | np.isnan(value))])
        for first in range(0, len(moved) - count + 1, max(count // 2, 1)):
            part = slice(first, first + count)
            if missing[first + count] > missing[first]:
                continue
            shares.append(float(moved[part].mean()))
            lows.append(float(fast[part].min()))
            low, high = min(low, value[part].min()), max(high, value[part].max())
    if len(shares) < 2 * LEAST_BLOCKS or len(ways) < 2:
        return None  # what only goes up stands at its end
    every, slowest = np.array(shares), np.array(lows)
    brief = speed is None and (times[-1][-1] - times[0][0]) * 1e-9 < SEEN_S
    if speed is None:
        if min(abs(low), abs(high)) < FROM_ZERO * max(high - low, 1e-9) or low * high <= 0.0:
            return None  # at zero it may rest
        starts = [low]
    else:
        usual = float(np.median(slowest))
        starts = sorted(
            {max(float(np.quantile(slowest, share)), DRIVES * usual, 1e-3) for share in (0.0, 0.1, 0.25, 0.5)}
        )
    for start in starts:
        mine = every[slowest >= start]
        if len(mine) < 2 * LEAST_BLOCKS:
            break
        middle = float(mine.mean())
        if brief and mine.min() < ALWAYS:
            break
        scatter = max(np.sqrt(middle * (1.0 - middle) / count), 1.0 / count)
        limit = -limit_above(-mine, 1.0, 0.25 * scatter, rate)
        share = short(min(limit, OF_LEAST * float(mine.min())), 2)
        if share >= LEAST_SHARE:
            condition: dict[str, Any] = {"inside": [start, high]}
            if speed is not None:
                most = short(max(4.0 * speed.most, 100.0), 2)
                condition = {"during": speed.name, "within": [short(start, 3), most]}
            return share, condition, f"{middle:.2f} of its values move, {mine.min():.2f} at least, of {len(mine)} times"
    return None

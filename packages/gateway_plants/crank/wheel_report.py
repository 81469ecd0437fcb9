"""The wheel that a train of pulses shows, in words for people and programs; :mod:`.wheel_estimation` counts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway_fdi.jit import zeros
from gateway_plants.crank import wheel_pairs
from gateway_plants.crank.wheel import Wheel
from gateway_plants.crank.wheel_estimation import EVEN, Seen, restart, watch

#: How often a turn a pattern may come (Nissan's VQ has that of 12-2 three times), and pitches of a turn up to which
#: there are such wheels.
_OFTEN, MOST_PARTS = {"two": 2, "three": 3}, 36


@dataclass(frozen=True)
class WheelSeen:
    """What a train of pulses shows.

    Attributes:
        pitches: shape (P,), pitches of a turn, the last one the largest; empty: all pitches are equal.
        turns: that showed them.
        even: most pulses in a row without a gap.
    """

    pitches: tuple[float, ...]
    turns: int
    even: int

    @property
    def wheel(self) -> str | None:
        """The wheel as :meth:`Wheel.parse` reads it; None: no gap."""
        return described(self.pitches) if self.pitches else None

    def __str__(self) -> str:
        if not self.pitches:
            return f"no gap seen in {self.even} pulses: all pitches are equal, and how many a turn has is not told"
        often = [word for word, times in _OFTEN.items() if times * sum(self.pitches) <= MOST_PARTS]
        part = f"; or that {' or '.join(often)} times a turn, which pulses do not tell" if often else ""
        return f"{self.wheel} ({len(self.pitches)} pulses a turn, {self.turns} turns{part})"


class Watch:
    """Looks at a train of pulses that comes in parts."""

    def __init__(self) -> None:
        self._seen = zeros(2, Seen)
        self._pairs = zeros(1, wheel_pairs.Pairs)
        for record in self._seen:
            restart(record)

    def add(self, intervals_us: NDArray[np.float64]) -> None:
        """Take intervals.

        Args:
            intervals_us: shape (n,) [us]; zero where pulses were lost or the engine stood.
        """
        intervals = np.ascontiguousarray(intervals_us, np.float64)
        watch(self._seen[0], self._seen[1], intervals)
        wheel_pairs.watch(self._pairs[0], intervals)

    @property
    def result(self) -> WheelSeen | None:
        """The wheel that most turns have shown, or that there is no gap; None: nothing that repeats."""
        now, best = self._seen
        even = max(int(now.even), int(now.run))
        if best.pulses:
            return WheelSeen(tuple(best.pitches[: best.pulses].tolist()), int(best.total), even)
        if even >= EVEN:
            return WheelSeen((), 0, even)
        pairs = self._pairs[0]
        if pairs.most < wheel_pairs.LEAST:
            return None
        longer = round(wheel_pairs.longer(pairs), 2)
        return WheelSeen((round(2.0 - longer, 2), longer), int(pairs.most) // 2, even)


def see(intervals_us: NDArray[np.float64]) -> WheelSeen | None:
    """Return the wheel that a train of pulses shows; None: nothing that repeats.

    Args:
        intervals_us: shape (n,), times from pulse to pulse [us]; zero where pulses were lost or the engine stood.
    """
    watched = Watch()
    watched.add(intervals_us)
    return watched.result


def told(seen: WheelSeen | None) -> str:
    """Return in words what was seen."""
    return "none that repeats" if seen is None else str(seen)


def data(seen: WheelSeen | None) -> dict[str, Any] | None:
    """Return what was seen for programs; None: nothing that repeats."""
    if seen is None:
        return None
    return {"wheel": seen.wheel, "pulses": len(seen.pitches), "turns": seen.turns, "without_gap": seen.even}


def described(pitches: tuple[float, ...]) -> str:
    """Return a wheel as :meth:`Wheel.parse` reads it: ``60-2``, ``36-2-1``, ``12+1``, else its pitches.

    Args:
        pitches: shape (P,), of a turn, from any pulse on [pitch].
    """
    turn = round(sum(pitches))
    gaps = sorted((int(pitch) - 1 for pitch in pitches if pitch > 1), reverse=True)
    names = ["36-2-2-2", "36-2-1-1", f"{turn}+1"]
    if 1 <= len(gaps) <= 2:
        names += [f"{turn}-{'-'.join(map(str, order))}" for order in (gaps, gaps[::-1])]
    for name in names:
        if _same(name, pitches):
            return name
    parts: list[str] = []
    rotations = (pitches[k:] + pitches[:k] for k in range(len(pitches)))
    turned = min(turned for turned in rotations if turned[-1] == max(pitches))
    first = 0
    for k in range(1, len(turned) + 1):
        if k == len(turned) or turned[k] != turned[first]:
            parts.append(f"{k - first}*{turned[first]:g}" if k - first > 1 else f"{turned[first]:g}")
            first = k
    return ",".join(parts)


def _same(name: str, pitches: tuple[float, ...]) -> bool:
    """Tell whether a name is that of a wheel, from any pulse on."""
    try:
        named = Wheel.parse(name).pitches
    except ValueError:
        return False
    return len(named) == len(pitches) and any(named == pitches[k:] + pitches[:k] for k in range(len(pitches)))

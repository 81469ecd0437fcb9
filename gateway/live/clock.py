"""The engine's time in the live run: the wall clock, less all that it was ever set by.

Frames are stamped by the wall clock (CLOCK_REALTIME, the kernel's socket stamps too), which NTP, PTP, GPS and ``date``
set. The monotonic clock beside it tells when: both are slewed alike, so that only a step changes their difference. On
systems where it does not, it may drift as fast as NTP slews, and is followed.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

#: Change of the wall clock against the monotonic one that is a step [ns].
TOLERANCE_NS = 10_000_000
#: Fastest that NTP slews: 500 ppm of frequency and 500 ppm of phase (adjtimex(2)).
SLEW = 1e-3
#: Ticks by which the two clocks go: 16 ms each on Windows before Python 3.13, where no smaller step is seen [ns].
TICK_NS = round(1e9 * sum(time.get_clock_info(name).resolution for name in ("time", "monotonic")))
#: Both clocks are read again where reading took this time [ns], as far as that helps.
QUICK_NS = 100_000
TRIES = 5


@dataclass(eq=False)
class Step:
    """A step of the wall clock.

    Attributes:
        step_ns: by how much, a multiple of 1000 [ns].
        noticed_ns: engine's time when the clocks told.
        t_ns: engine's time at which it stands among the frames: that of the first frame stamped after it.
        seen: whether there was such a frame.
    """

    step_ns: int
    noticed_ns: int
    t_ns: int
    seen: bool = False


class Clock:
    """The engine's time, from the wall clock and the monotonic one.

    Args:
        wall_ns: stamps frames [ns].
        monotonic_ns: never set [ns].
        tolerance_ns: change of one against the other that is a step [ns].
        tick_ns: what the two may differ by because they go in ticks [ns].

    Attributes:
        offset_ns: time that the wall clock is ahead of the engine's [ns].
        untold: steps that do not stand among the frames yet, the oldest first.
        steps: the latest steps, and ``count``, how many there were.
    """

    def __init__(
        self,
        wall_ns: Callable[[], int] = time.time_ns,
        monotonic_ns: Callable[[], int] = time.monotonic_ns,
        *,
        tolerance_ns: int = TOLERANCE_NS,
        tick_ns: int = TICK_NS,
    ) -> None:
        self._wall_ns, self._monotonic_ns = wall_ns, monotonic_ns
        self.tolerance_ns, self._tick_ns = tolerance_ns, tick_ns
        self.offset_ns = 0
        self.untold: list[Step] = []
        self.steps: deque[Step] = deque(maxlen=16)
        self.count = 0
        wall, self._then_ns, _ = self._read()
        self._difference = wall - self._then_ns
        self._latest_ns = wall

    def now(self) -> int:
        """Return the engine's time now [ns]; it never goes back. A step of the wall clock is noticed here."""
        wall, monotonic, doubt = self._read()
        change = wall - monotonic - self._difference
        followed = round(min(monotonic - self._then_ns, 10**9) * SLEW)
        self._then_ns = monotonic
        if abs(change) > self.tolerance_ns + self._tick_ns + doubt + followed:
            self._step(change // 1000 * 1000, wall)
        else:
            self._difference += max(-followed, min(followed, change))
        self._latest_ns = max(self._latest_ns, wall - self.offset_ns)
        return self._latest_ns

    def wall(self) -> int:
        """Return the wall clock's time now [ns]."""
        return self.now() + self.offset_ns

    @property
    def of_system(self) -> bool:
        """Whether it reads the clocks of this system, as a pump does."""
        return self._wall_ns is time.time_ns and self._monotonic_ns is time.monotonic_ns

    @property
    def difference_ns(self) -> int:
        """Time that the wall clock was ahead of the monotonic one at the last look [ns]."""
        return self._difference

    @property
    def reported_offset_ns(self) -> int:
        """Time that the wall clock was ahead of the engine's where the frames are now [ns]."""
        return self.offset_ns - sum(step.step_ns for step in self.untold)

    def _step(self, step_ns: int, wall: int) -> None:
        self._difference += step_ns
        self.offset_ns += step_ns
        self.count += 1
        now = max(self._latest_ns, wall - self.offset_ns)
        step = Step(step_ns, now, now)
        self.untold.append(step)
        self.steps.append(step)

    def _read(self) -> tuple[int, int, int]:
        """Read both clocks: wall, monotonic, and how far apart the readings may be [ns]."""
        best = (0, 0, 1 << 62)
        for _ in range(TRIES):
            before = self._monotonic_ns()
            wall = self._wall_ns()
            after = self._monotonic_ns()
            if after - before < best[2]:
                best = wall, (before + after) // 2, after - before
            if best[2] <= QUICK_NS:
                break
        return best

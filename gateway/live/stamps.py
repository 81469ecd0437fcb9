"""From the stamps of one bus to the engine's time.

Most buses are stamped by the wall clock of this machine; where it was set, some frames of a batch were stamped before
and some after. Others (python-can's adapters, socketcand on another machine) may be stamped by a clock of their own,
whose zero is anywhere, which drifts and is set at other times.
"""

from __future__ import annotations

import numpy as np

from gateway.bus.frames import Frames
from gateway.live.clock import Clock, Step
from gateway_fdi.common.log import get_logger

#: A stamp this far in the future [ns], or this long before the last look at the bus, is of another clock.
AHEAD_NS, BEHIND_NS = 5_000_000, 1_000_000_000
#: Fastest drift of another clock against the engine's.
DRIFT = 2e-4
#: Longest time between a frame's stamp and its arrival in the queue [ns].
FLIGHT_NS = 1_000_000_000

log = get_logger(__name__)


class Stamps:
    """Turns the stamps of one bus into the engine's time.

    Args:
        clock: the engine's.
        name: of the bus, for the log.
        own_clock: whether the stamps may be of another clock than this machine's wall clock.

    Attributes:
        drained: whether the last look left nothing in the queue.
        aligned: whether the stamps are of another clock; its frames are taken to have been stamped when they come.
    """

    def __init__(self, clock: Clock, name: str = "", *, own_clock: bool = False) -> None:
        self._clock = clock
        self._name = name
        self._own_clock = own_clock
        # Times that the stamps are ahead of the engine's: now, and after each step that they may or may not follow.
        self._offsets = [clock.offset_ns]
        self._steps: list[Step] = []
        self._count = clock.count
        self._settled = True  # the next frames were most likely stamped after all steps
        self._floor_ns = self._looked_ns = self._last_ns = clock.now()
        self.drained = True
        self.aligned = False

    def apply(self, frames: Frames, *, more: bool) -> None:
        """Put the engine's time into the stamps of a batch.

        Args:
            frames: as the bus gave them, in its order.
            more: whether the bus may have more.
        """
        now = self._clock.now()
        self._take_steps()
        if len(frames):
            if self._steps:
                self._divide(frames, now)
            else:
                frames["t_ns"] -= self._offsets[0]
            if self._own_clock:
                self._align(frames, now)
        self.drained = not more
        if self.drained:
            while self._steps and not self._own_clock and now > self._steps[0].noticed_ns + FLIGHT_NS:
                del self._steps[0], self._offsets[0]
            self._settled = True
            self._floor_ns = now
        elif len(frames):
            self._floor_ns = int(frames["t_ns"][-1])
        self._looked_ns = now

    @property
    def plain(self) -> bool:
        """Whether the engine's time is the stamp less the clock's offset, for all that may come now."""
        settled = not self._steps and self._count == self._clock.count
        return settled and not self._own_clock and self._offsets == [self._clock.offset_ns]

    def looked(self, t_ns: int) -> None:
        """Note that a pump found nothing more in the queue, at a time of the engine, and has put stamps right."""
        self.drained = self._settled = True
        self._floor_ns = self._looked_ns = t_ns

    def _take_steps(self) -> None:
        missed = min(self._clock.count - self._count, len(self._clock.steps))
        self._count = self._clock.count
        for k in range(len(self._clock.steps) - missed, len(self._clock.steps)):
            step = self._clock.steps[k]
            self._steps.append(step)
            self._offsets.append(self._offsets[-1] + step.step_ns)
            self._settled = False

    def _divide(self, frames: Frames, now: int) -> None:
        """Find which frames were stamped before, and which after each step.

        Of all ways to divide them in their order the one that contradicts least that they came after the last look and
        before now, in order of time.
        """
        stamps = frames["t_ns"].astype(np.int64)
        times = stamps[:, None] - np.asarray(self._offsets)
        count, ways = times.shape
        wrong = np.maximum(self._floor_ns - times, 0) + np.maximum(times - now, 0)
        if not self._own_clock:  # after a step was noticed this machine stamps nothing as before it
            noticed = np.asarray([step.noticed_ns for step in self._steps])
            wrong[:, :-1] += np.maximum(times[:, :-1] - noticed, 0)
        if self._settled:
            wrong += np.arange(ways)[::-1]  # of two that fit the later one
        cost = wrong[0].astype(np.float64)
        chosen = np.zeros((count, ways), np.int64)
        before_or_at = np.tri(ways, dtype=bool).T  # an offset is followed by itself or a later one
        for k in range(1, count):
            back = np.maximum(times[k - 1][:, None] - times[k][None, :], 0)
            paths = np.where(before_or_at, cost[:, None] + back, np.inf)
            chosen[k] = np.argmin(paths, axis=0)
            cost = paths[chosen[k], np.arange(ways)] + wrong[k]
        way = int(np.argmin(cost))
        taken = np.zeros(count, np.int64)
        for k in reversed(range(count)):
            taken[k] = way
            way = int(chosen[k, way])
        frames["t_ns"] = times[np.arange(count), taken]
        for k in map(int, np.flatnonzero(np.diff(taken, prepend=0))):
            for step in self._steps[: taken[k]]:
                step.t_ns, step.seen = min(step.t_ns, int(frames["t_ns"][k])), True
        self._forget(int(taken[-1]), int(frames["t_ns"][-1]))

    def _forget(self, taken: int, t_ns: int) -> None:
        """Forget the offsets before the one that is in use, and steps that the stamps did not follow."""
        del self._offsets[:taken]
        del self._steps[:taken]
        while self._own_clock and self._steps and t_ns > self._steps[0].noticed_ns:
            step = self._steps.pop(0)
            del self._offsets[1]
            self._offsets[1:] = [offset - step.step_ns for offset in self._offsets[1:]]

    def _align(self, frames: Frames, now: int) -> None:
        """Take the stamps of another clock to be of now, and follow its drift: no frame is older than it must be."""
        last = int(frames["t_ns"][-1])
        other = last > now + AHEAD_NS or last < self._floor_ns - BEHIND_NS
        shift = 0
        if other:
            log.info(
                "stamps of another clock: aligned by when frames come",
                bus=self._name,
                ahead_s=(last - now) / 1e9,
            )
            self.aligned = True
            shift = last - now
        elif self.aligned:
            drift = round((now - self._looked_ns) * DRIFT)
            shift = max(last - now, -drift)
        if shift:
            self._offsets = [offset + shift for offset in self._offsets]
            frames["t_ns"] -= shift
        if self.aligned:
            times = np.maximum.accumulate(np.maximum(frames["t_ns"], self._last_ns))
            frames["t_ns"] = np.minimum(times, now)
        self._last_ns = int(frames["t_ns"][-1])

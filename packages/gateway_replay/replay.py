"""Recorded logs through the same engine."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Protocol

from gateway.bus.conditions import overtimes_in_place
from gateway.bus.frames import Frames
from gateway.bus.timeline import LogTime

#: Frames of a log that are fed at once: all that looks at them finds them in the cache of a core (1.3 MB).
FED = 16_384


class FrameConsumer(Protocol):
    """Receiver of a log: the gateway."""

    def start(self, t_ns: int) -> None:
        """Start an operation cycle."""

    def without_own(self, frames: Frames) -> Frames:
        """Return the frames without those that it will make itself."""

    def feed(self, frames: Frames) -> Frames:
        """Take a batch of frames; returns the frames to send."""

    def stop(self, t_ns: int, *, complete: bool = True) -> None:
        """End, and with it the operation cycle if that is complete."""


class Cycle:
    """One operation cycle of a gateway that is fed stamped frames.

    Args:
        gateway: not started yet.

    Attributes:
        count: frames that were fed.
        now_ns: even time of the last one [ns].
    """

    def __init__(self, gateway: FrameConsumer) -> None:
        self._gateway, self._time = gateway, LogTime()
        self.count = self.now_ns = 0

    def take(self, stamped: Frames) -> Frames:
        """Feed a batch; returns the frames to send.

        Args:
            stamped: of FRAME, in order of time but where the clock that stamped them was set (see
                :class:`gateway.bus.timeline.LogTime`).
        """
        if not len(stamped):
            return stamped
        frames = self._time.apply(stamped)
        if not self.count:
            self._gateway.start(int(frames[0]["t_ns"]))
        sent = self._gateway.feed(self._gateway.without_own(frames))
        self.count += len(stamped)
        self.now_ns = int(frames[-1]["t_ns"])
        return sent

    def end(self, t_ns: int = 0, *, complete: bool = True) -> None:
        """End, at the last frame or at a later time [ns]; an operation cycle that is not complete goes on next time."""
        if self.count:
            self._gateway.stop(max(self.now_ns, t_ns), complete=complete)


def replay(
    gateway: FrameConsumer,
    batches: Iterable[Frames],
    *,
    progress: Callable[[Frames], None] | None = None,
    whole: Callable[[], bool] = lambda: True,
) -> int:
    """Feed the batches of a log to a gateway, one operation cycle long.

    Args:
        gateway: not started yet.
        batches: see :meth:`Cycle.take`.
        progress: called after each batch.
        whole: tells at the end whether the log is; one that is damaged or cut off completes no operation cycle.

    Returns:
        how many frames were fed. Frames that the gateway would have sent are not sent anywhere.
    """
    cycle = Cycle(gateway)
    for stamped in batches:
        for k in range(0, len(stamped), FED):
            cycle.take(overtimes_in_place(stamped[k : k + FED]))
        if progress is not None and len(stamped):
            progress(stamped)
    cycle.end(complete=whole())
    return cycle.count

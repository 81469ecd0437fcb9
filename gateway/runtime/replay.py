"""Recorded logs through the same engine."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Protocol

from gateway.bus.frames import Frames
from gateway.bus.timeline import LogTime


class FrameConsumer(Protocol):
    """Receiver of a log: the gateway."""

    def start(self, t_ns: int) -> None:
        """Start an operation cycle."""

    def without_own(self, frames: Frames) -> Frames:
        """Return the frames without those that it will make itself."""

    def feed(self, frames: Frames) -> Frames:
        """Take a batch of frames; returns the frames to send."""

    def stop(self, t_ns: int) -> None:
        """End the operation cycle."""


def replay(
    gateway: FrameConsumer,
    batches: Iterable[Frames],
    *,
    progress: Callable[[Frames], None] | None = None,
) -> int:
    """Feed the batches of a log to a gateway, one operation cycle long.

    Args:
        gateway: not started yet.
        batches: of FRAME, in order of time but where the clock that stamped them was set (see
            :class:`gateway.bus.timeline.LogTime`).
        progress: called after each batch.

    Returns:
        how many frames were fed. Frames that the gateway would have sent are not sent anywhere.
    """
    count = 0
    last_ns = 0
    time = LogTime()
    for stamped in batches:
        if not len(stamped):
            continue
        frames = time.apply(stamped)
        if not count:
            gateway.start(int(frames[0]["t_ns"]))
        gateway.feed(gateway.without_own(frames))
        count += len(stamped)
        last_ns = int(frames[-1]["t_ns"])
        if progress is not None:
            progress(stamped)
    if count:
        gateway.stop(last_ns)
    return count

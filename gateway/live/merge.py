"""Frames of several buses into one order of time, so that a monitor may join their signals."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gateway.bus.frames import Frames, empty

#: Longest time between a frame's time stamp and its arrival in the queue [ns].
SETTLE_NS = 200_000
#: No frame is held back longer than this [ns]: clocks of interfaces may differ.
LONGEST_NS = 5_000_000


class Merger:
    """Holds back what is too new to be sure that no earlier frame of another bus will still come."""

    def __init__(self) -> None:
        self._held = empty(0)
        self._read_ns = np.zeros(0, np.int64)

    @property
    def holding(self) -> bool:
        """Whether frames wait for the next :meth:`take`."""
        return bool(len(self._held))

    def __len__(self) -> int:
        return len(self._held)

    def release(self) -> tuple[Frames, NDArray[np.int64]]:
        """Return the frames that wait, and when each was read [ns]; they wait here no more."""
        held, self._held = self._held, empty(0)
        since, self._read_ns = self._read_ns, np.zeros(0, np.int64)
        return held, since

    def hold(self, frames: Frames, read_ns: NDArray[np.int64]) -> None:
        """Hold frames back that a pump held back, in order of time."""
        self._held, self._read_ns = frames, read_ns

    def take(self, parts: Sequence[tuple[Frames, bool]], read_ns: int, *, final: bool = False) -> Frames:
        """Return the frames that are due, in order of time.

        Args:
            parts: of each bus: frames in order of time, and whether it had more than were read.
            read_ns: time right before the first bus was read [ns].
            final: nothing is held back.
        """
        frames = np.concatenate([self._held, *(part for part, _ in parts)])
        if not len(frames):
            return frames
        fresh = len(frames) - len(self._held)
        since = np.concatenate([self._read_ns, np.full(fresh, read_ns)])
        order = np.argsort(frames["t_ns"], kind="stable")
        frames, since = frames[order], since[order]
        until = read_ns - SETTLE_NS
        for part, more in parts:
            if more and len(part):
                until = min(until, int(part["t_ns"].max()))
        due = int(np.searchsorted(frames["t_ns"], until, side="right"))
        old = np.flatnonzero(since < read_ns - LONGEST_NS)
        if len(old):
            due = max(due, int(old[-1]) + 1)
        if final:
            due = len(frames)
        self._held, self._read_ns = frames[due:], since[due:]
        return frames[:due]

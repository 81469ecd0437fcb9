"""Between the time that goes on evenly and the wall clock that stamps what people read.

A wall clock is set (NTP, PTP, GPS, ``date``), and its stamps before and after cannot be compared. So the engine has a
time of its own: the wall clock's at the start, and even from then on. ``offset_ns`` is what the wall clock is ahead of
it. Where it changes, a frame of the condition STEPPED stands among the others, in recordings too: so a recording has
the stamps that people expect, and its replay the engine's time to the nanosecond.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from gateway.bus.conditions import are_steps, step_frame, step_ns_of
from gateway.bus.frames import ERROR, OWN, Frames

#: Frames of a small batch.
FEW = 64
#: Stamps of one bus in a log never go back by more than this [ns] unless the clock was set: recorders that read several
#: buses put their frames a little out of order.
DISORDER_NS = 100_000_000
#: The clock of another bus in the log is taken to have had the same step if its time then agrees to this [ns].
AGREES_NS = 1_000_000_000


def spans(frames: Frames, offset_ns: int) -> Iterator[tuple[Frames, int]]:
    """Cut frames where the wall clock was set.

    Args:
        frames: of the engine's time, in order.
        offset_ns: before the first of them [ns].

    Yields:
        frames and their offset [ns]; a frame that tells a step is the first of its part.
    """
    # A small batch, as a live bus brings, is told by its identifiers: NumPy takes longer to begin than it to be looked
    # through.
    if len(frames) <= FEW and ERROR not in frames["can_id"].tolist():
        if len(frames):
            yield frames, offset_ns
        return
    start = 0
    for at in np.flatnonzero(are_steps(frames)):
        if at > start:
            yield frames[start:at], offset_ns
        start = int(at)
        offset_ns += step_ns_of(frames[at])
    if start < len(frames):
        yield frames[start:], offset_ns


def to_wall(frames: Frames, offset_ns: int) -> tuple[Frames, int]:
    """Return frames of the engine's time with the stamps of the wall clock, and the offset after them [ns]."""
    stamped = frames
    at = 0
    for part, offset in spans(frames, offset_ns):
        if offset and stamped is frames:
            stamped = frames.copy()
        stamped["t_ns"][at : at + len(part)] += offset
        at += len(part)
        offset_ns = offset
    return stamped, offset_ns


class LogTime:
    """Turns the stamps of a log into time that goes on evenly; one log, batch after batch.

    Where the log has no frame that tells of it, a step back is known by the stamps of a bus that go back. A step
    forward looks like a gap, and is taken for one.
    """

    def __init__(self) -> None:
        self._offsets: dict[int, int] = {}  # by bus: a step may reach one bus's frames before another's
        self._latest: dict[int, int] = {}
        self._now_ns = 0
        self._told_ns = 0  # offset that frames in the log, or ours, have told
        self._started = False

    def apply(self, frames: Frames) -> Frames:
        """Return the frames with even time; a frame is added where the clock was set and the log does not say so."""
        if not len(frames):
            return frames
        if not self._started:
            self._started = True
            self._now_ns = int(frames["t_ns"][0])
        steps = are_steps(frames)
        offsets = {self._offsets.get(int(bus), self._told_ns) for bus in np.unique(frames["bus"])}
        if not steps.any() and len(offsets) == 1 and not self._goes_back(frames, *offsets):
            return self._shifted(frames, *offsets)
        return self._one_by_one(frames, steps)

    def _goes_back(self, frames: Frames, offset: int) -> bool:
        times = frames["t_ns"] - offset
        highest = np.maximum.accumulate(np.concatenate([[self._now_ns], times]))
        return bool((times < highest[1:] - DISORDER_NS).any())

    def _shifted(self, frames: Frames, offset: int) -> Frames:
        if offset:
            frames = frames.copy()
            frames["t_ns"] -= offset
        ordered = frames[_in_order(frames)]
        for bus in np.unique(ordered["bus"]):
            latest = int(ordered["t_ns"][ordered["bus"] == bus].max())
            self._latest[int(bus)] = max(self._latest.get(int(bus), latest), latest)
        self._now_ns = max(self._now_ns, int(frames["t_ns"].max()))
        return frames

    def _one_by_one(self, frames: Frames, steps: NDArray[np.bool_]) -> Frames:
        out: list[Frames] = []
        frames = frames.copy()
        start = 0
        in_order = _in_order(frames)
        for k, told in enumerate(steps):
            frame = frames[k]
            bus, stamp = int(frame["bus"]), int(frame["t_ns"])
            if told:
                step_ns = step_ns_of(frame)
                self._told_ns += step_ns
                self._offsets = {known: offset + step_ns for known, offset in self._offsets.items()}
            t_ns = stamp - self._offsets.get(bus, self._told_ns)
            latest = self._latest.get(bus)
            if in_order[k] and latest is not None and t_ns < latest - DISORDER_NS:
                step_ns = self._step_back(bus, stamp)
                t_ns = stamp - self._offsets[bus]
                if step_ns:
                    out += [frames[start:k], step_frame(t_ns, step_ns // 1000)]
                    start = k
            frame["t_ns"] = t_ns
            self._now_ns = max(self._now_ns, t_ns)
            if in_order[k]:
                self._latest[bus] = max(self._latest.get(bus, t_ns), t_ns)
        return np.concatenate([*out, frames[start:]])

    def _step_back(self, bus: int, stamp: int) -> int:
        """Give a bus whose stamps went back another offset; returns the step if it is a new one, else 0 [ns]."""
        agreeing = [
            offset
            for offset in {self._told_ns, *self._offsets.values()}
            if self._latest[bus] - DISORDER_NS <= stamp - offset <= self._now_ns + AGREES_NS
        ]
        if agreeing:
            self._offsets[bus] = min(agreeing, key=lambda o: abs(stamp - o - self._now_ns))
            return 0
        # How long it took from the last frame before to this one nobody knows: time goes on where it was.
        before = self._offsets.get(bus, self._told_ns)
        step_ns = (stamp - before - self._now_ns) // 1000 * 1000
        for other in self._latest:
            self._offsets.setdefault(other, self._told_ns)  # until its own stamps go back
        self._offsets[bus] = before + step_ns
        self._told_ns += step_ns
        return step_ns


def _in_order(frames: Frames) -> NDArray[np.bool_]:
    """Return which frames a bus has stamped: not those sent here, nor what the gateway says of the bus itself."""
    return np.asarray((frames["flags"] & OWN == 0) & (frames["can_id"] != ERROR), np.bool_)

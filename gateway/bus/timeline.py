"""Between the time that goes on evenly and the wall clock that stamps what people read.

A wall clock is set (NTP, PTP, GPS, ``date``), and its stamps before and after cannot be compared. So the engine has a
time of its own: the wall clock's at the start, and even from then on. ``offset_ns`` is what the wall clock is ahead of
it. Where it changes, a frame of the condition STEPPED stands among the others, in recordings too: so a recording has
the stamps that people expect, and its replay the engine's time to the nanosecond.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from gateway.bus.conditions import STEPPED, are_steps, step_frame, step_ns_of
from gateway.bus.frames import ERROR, FRAME, OWN, Frames, copied, joined
from gateway_fdi.jit import kernel

#: Frames of a small batch.
FEW = 64
#: Stamps of one bus in a log never go back by more than this [ns] unless the clock was set: recorders that read several
#: buses put their frames a little out of order.
DISORDER_NS = 100_000_000
#: The clock of another bus in the log is taken to have had the same step if its time then agrees to this [ns].
AGREES_NS = 1_000_000_000
#: Buses that a frame can name.
_BUSES = 256
#: Time of a bus that has stamped nothing yet.
_NOTHING = np.iinfo(np.int64).min


def spans(frames: Frames, offset_ns: int) -> Iterator[tuple[Frames, int]]:
    """Cut frames of the engine's time where the wall clock was set; ``offset_ns``: before the first of them.

    Yields:
        frames and their offset [ns]; a frame that tells a step is the first of its part.
    """
    # A small batch, as a live bus brings, is recognized by its identifiers: a loop ends before NumPy has begun.
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


@kernel
def go_on_evenly(cells: Any, offsets: Any, latest: Any, now_ns: int) -> tuple[int, int]:
    """Look through frames up to one that tells a step of the clock, or whose bus went back.

    Args:
        cells: frames as uint64, shape (n, 10).
        offsets: of each bus [ns], shape (256,).
        latest: latest time of each bus [ns], shape (256,); brought up to date.
        now_ns: latest time of all.

    Returns:
        how many frames come before it; the latest time of all with them [ns].
    """
    for k in range(cells.shape[0]):
        head = cells[k, 1]
        bus = np.int64((head >> np.uint64(32)) & np.uint64(255))
        t_ns = np.int64(cells[k, 0]) - offsets[bus]
        if (head & np.uint64(0xFFFFFFFF)) == np.uint64(ERROR):  # the gateway says it of the bus: no stamp of the bus
            if (cells[k, 2] & np.uint64(255)) == np.uint64(STEPPED):
                return k, now_ns
        elif (head >> np.uint64(40)) & np.uint64(OWN) == np.uint64(0):  # nor is that of a frame sent here
            if latest[bus] != _NOTHING and t_ns < latest[bus] - DISORDER_NS:
                return k, now_ns
            latest[bus] = max(latest[bus], t_ns)
        now_ns = max(now_ns, t_ns)
    return int(cells.shape[0]), now_ns


class LogTime:
    """Turns the stamps of a log into time that goes on evenly; one log, batch after batch.

    Where the log has no frame that tells of it, a step back is known by the stamps of a bus that go back. A step
    forward looks like a gap, and is taken for one.
    """

    def __init__(self) -> None:
        # By bus: a step may reach one bus's frames before another's.
        self._offsets = np.zeros(_BUSES, np.int64)
        self._latest = np.full(_BUSES, _NOTHING, np.int64)
        self._now_ns = 0
        self._told_ns = 0  # offset by frames in the log, or by the gateway's own
        self._started = False

    def apply(self, frames: Frames) -> Frames:
        """Return the frames with even time; a frame is added where the clock was set and the log does not say so."""
        if not len(frames):
            return frames
        if not self._started:
            self._started = True
            self._now_ns = int(frames["t_ns"][0])
        if not frames.flags.c_contiguous:
            frames = copied(frames)
        cells = frames.view(np.uint64).reshape(len(frames), FRAME.itemsize // 8)
        parts: list[Frames] = []
        start = 0
        while start < len(frames):
            count, self._now_ns = go_on_evenly(cells[start:], self._offsets, self._latest, self._now_ns)
            if count:
                part = frames[start : start + count]
                if self._offsets.any():
                    part = copied(part)
                    part["t_ns"] -= self._offsets[part["bus"]]
                parts.append(part)
                start += count
            if start < len(frames):
                parts += self._stepped(frames[start : start + 1].copy())
                start += 1
        return joined(parts)

    def _stepped(self, frame: Frames) -> list[Frames]:
        """Take a frame, shape (1,), at which the clock was set; returns it, after one that tells so if it is new."""
        bus, stamp = int(frame["bus"][0]), int(frame["t_ns"][0])
        before: list[Frames] = []
        if are_steps(frame)[0]:
            self._told_ns += step_ns_of(frame[0])
            self._offsets += step_ns_of(frame[0])
            t_ns = stamp - int(self._offsets[bus])
        else:
            step_ns = self._step_back(bus, stamp)
            t_ns = stamp - int(self._offsets[bus])
            self._latest[bus] = max(int(self._latest[bus]), t_ns)
            if step_ns:
                before = [step_frame(t_ns, step_ns // 1000)]
        self._now_ns = max(self._now_ns, t_ns)
        frame["t_ns"] = t_ns
        return [*before, frame]

    def _step_back(self, bus: int, stamp: int) -> int:
        """Give a bus whose stamps went back another offset; returns the step if it is a new one, else 0 [ns]."""
        known = self._latest != _NOTHING
        agreeing = [
            offset
            for offset in {self._told_ns, *self._offsets[known].tolist()}
            if self._latest[bus] - DISORDER_NS <= stamp - offset <= self._now_ns + AGREES_NS
        ]
        if agreeing:
            self._offsets[bus] = min(agreeing, key=lambda o: abs(stamp - o - self._now_ns))
            return 0
        # The time since the frame before is unknown: time goes on where it was.
        before = int(self._offsets[bus])
        step_ns = (stamp - before - self._now_ns) // 1000 * 1000
        self._offsets[bus] = before + step_ns  # the others keep theirs until their own stamps go back
        self._told_ns += step_ns
        self._offsets[~known] = self._told_ns
        return step_ns

"""Frames put beside those of a log: another sender's. Written apart from the checks that are to see them."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from gateway.bus.frames import EXTENDED, Frames, empty, joined

#: Beside each frame of a message comes: the same one again; one of some time before; one of the same identifier with a
#: payload by chance; the same one with a signal changed.
BESIDE = ("double", "replay", "fuzz", "forge")
#: Frames of an identifier that nobody has.
ALONE = "unknown"
#: Age of a replayed frame [s], frames a second of an unknown identifier: where none is given.
AGE_S, RATE_HZ = 5.0, 40.0


class InjectedFrames:
    """Puts frames into batches, in order of time; a frame that is later than a batch comes with the next one."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng, self._waiting = rng, empty(0)
        self._phase = float(rng.uniform(0.1, 0.9))  # of the gap before a frame: when the other sender sends after it
        self._last_ns: int | None = None
        self._gap_ns = 0
        self._past: deque[np.void] = deque()
        self._next_ns: int | None = None

    def beside(
        self, kind: str, frames: Frames, mine: Frames, hit: NDArray[np.bool_], value: float, change: Callable[..., None]
    ) -> tuple[Frames, int]:
        """Return a batch with frames beside those of a message, and how many these are.

        Args:
            kind: of BESIDE.
            frames: the batch.
            mine: those of the message in it.
            hit: shape of ``mine``, beside which of them one comes.
            value: age of what is replayed [s]; 0: AGE_S.
            change: changes a batch of forged frames in place.
        """
        made = []
        for frame, wanted in zip(mine, hit, strict=True):
            t_ns = int(frame["t_ns"])
            if self._last_ns is not None and t_ns > self._last_ns:
                self._gap_ns = t_ns - self._last_ns
            self._last_ns = t_ns
            if kind == "replay":
                self._past.append(frame.copy())
                while t_ns - int(self._past[0]["t_ns"]) > (value or AGE_S) * 1e9:
                    self._past.popleft()
            if wanted:
                other = empty(1)
                other[0] = self._past[0] if kind == "replay" else frame
                other["t_ns"] = t_ns + round(self._phase * self._gap_ns)
                if kind == "fuzz":
                    length = int(frame["length"])
                    other["data"][0, :length] = self._rng.integers(0, 256, length)
                made.append(other)
        added = np.concatenate(made) if made else empty(0)
        if kind == "forge" and len(added):
            change(added)
        return self._merged(frames, added), len(added)

    def alone(
        self, frames: Frames, bus: int, can_id: int, rate_hz: float, from_ns: int, to_ns: int
    ) -> tuple[Frames, int]:
        """Return a batch with frames of an identifier of its own, and how many these are."""
        step = round(1e9 / (rate_hz or RATE_HZ))
        if self._next_ns is None:
            self._next_ns = from_ns + round(self._phase * step)
        until = min(int(frames["t_ns"].max()), to_ns)
        stamps = np.arange(self._next_ns, until, step, dtype=np.int64)
        added = empty(len(stamps))
        if len(stamps):
            self._next_ns = int(stamps[-1]) + step
        added["t_ns"], added["bus"], added["length"] = stamps, bus, 8
        added["can_id"] = can_id | (EXTENDED if can_id > 0x7FF else 0)
        added["data"][:, :8] = self._rng.integers(0, 256, (len(stamps), 8))
        return self._merged(frames, added), len(added)

    def _merged(self, frames: Frames, added: Frames) -> Frames:
        waiting = joined([self._waiting, added])
        now = waiting["t_ns"] <= frames["t_ns"].max()
        self._waiting = waiting[~now]
        both = joined([frames, waiting[now]])
        return both[np.argsort(both["t_ns"], kind="stable")]

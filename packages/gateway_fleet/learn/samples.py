"""Frames that are kept of a message, to find its protection in: bounded, runs without a gap."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gateway_fleet.learn.protection_check import Payloads

#: Frames of one run, and runs of a message, at most.
RUN, RUNS = 512, 16


class Samples:
    """Runs of frames of one message: the first one, then others with ever more room between them.

    Attributes:
        again: frames that repeat the payload of the one before.
        rest_ns, rest_frames: the longest time that the payload did not change [ns], and the frames that repeated it.
    """

    def __init__(self) -> None:
        self.again = self.rest_ns = self.rest_frames = 0
        self._last: NDArray[np.uint64] | None = None
        self._rests = 0, 0  # since when the payload is the same [ns], frames that repeat it
        self._runs: list[tuple[NDArray[np.uint64], NDArray[np.int64], NDArray[np.int64]]] = []
        self._seen = 0
        self._next = 0

    def add(self, words: NDArray[np.uint64], lengths: NDArray[np.int64], t_ns: NDArray[np.int64]) -> None:
        """Add frames that came one after the other: payloads, shape (frames, 8), lengths [byte], stamps [ns]."""
        count = len(words)
        self._follow(words, t_ns)
        while self._seen + count > self._next:
            first = max(0, self._next - self._seen)
            part = slice(first, first + RUN)
            self._runs.append((words[part].copy(), lengths[part].copy(), t_ns[part].copy()))
            self._next = max(self._seen + first + RUN, int(1.5 * self._next))
            if len(self._runs) > RUNS:
                del self._runs[1]  # the first is kept, and the later ones lie farther apart
        self._seen += count

    def _follow(self, words: NDArray[np.uint64], t_ns: NDArray[np.int64]) -> None:
        """Note how long the payload rests."""
        before = words[:1] + np.uint64(1) if self._last is None else self._last
        changed = np.flatnonzero((words != np.concatenate([before, words[:-1]])).any(axis=1))
        self.again += len(words) - len(changed)
        since, repeats = self._rests
        for first, last in zip([-1, *changed.tolist()], [*changed.tolist(), len(words)], strict=True):
            if first >= 0:
                since, repeats = int(t_ns[first]), 0
            repeats += last - max(first + 1, 0)
            if last - 1 > first and repeats and int(t_ns[last - 1]) - since > self.rest_ns:
                self.rest_ns, self.rest_frames = int(t_ns[last - 1]) - since, repeats
        self._rests, self._last = (since, repeats), words[-1:]

    @property
    def runs(self) -> list[Payloads]:
        """The runs, each in order."""
        return [Payloads(words, lengths) for words, lengths, _ in self._runs]

    def repeated(self) -> float:
        """Return the share of frames that repeat the content of the one before."""
        again = [(words[1:] == words[:-1]).all(axis=1) for words, _, _ in self._runs]
        return float(np.concatenate(again).mean()) if sum(map(len, again)) else 0.0

    @property
    def stamps(self) -> list[NDArray[np.int64]]:
        """Stamps of the runs' frames [ns]."""
        return [t_ns for _, _, t_ns in self._runs]

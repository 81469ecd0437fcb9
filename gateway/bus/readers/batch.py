"""Room for a batch of frames while it is read, with the channel of each."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, BinaryIO, Protocol

import numpy as np
from numpy.typing import NDArray

from gateway.bus.frames import FRAME, Frames

#: 64-bit words of a frame.
WORDS = FRAME.itemsize // 8
#: Numbers of channels that lie farther apart than this are sorted.
_WIDEST = 100_000
#: Channel of a frame whose log names none.
NO_CHANNEL = -(1 << 40)
#: Byte of a frame where its payload begins.
DATA = FRAME.itemsize - 64
#: Where the second word has flags and length.
FLAGS, LENGTH = 40, 48


class Names:
    """Names of a log's channels, in the order in which they come; frames have their places."""

    def __init__(self) -> None:
        self.known: list[str] = []
        self._place: dict[str, int] = {}

    def place(self, name: str) -> int:
        """Return the place of a name."""
        found = self._place.get(name)
        if found is None:
            found = self._place[name] = len(self.known)
            self.known.append(name)
        return found


def placed(channel: NDArray[np.int64], names: Names) -> NDArray[np.int64]:
    """Return the places of numbered channels' names, shape (n,)."""
    if not len(channel):
        return channel
    low, high = int(channel.min()), int(channel.max())
    if high - low > _WIDEST:
        numbers, inverse = np.unique(channel, return_inverse=True)
        return np.array([_place(number, names) for number in numbers.tolist()], np.int64)[inverse]
    table = np.zeros(high - low + 1, np.int64)
    for number in np.flatnonzero(np.bincount(channel - low)).tolist():
        table[number] = _place(low + number, names)
    return table[channel - low]


def _place(number: int, names: Names) -> int:
    return names.place("none" if number == NO_CHANNEL else str(number))


class Batch:
    """Room for frames, filled from the front; frames that were handed out are not written again.

    Args:
        size: frames at most.

    Attributes:
        count: frames that are in.
        words, data: the frames as 64-bit words and as bytes, shape (size, 10) and (size, 80).
        channel: of each frame, shape (size,).
    """

    def __init__(self, size: int) -> None:
        self.size = size
        self._renew()

    def _renew(self) -> None:
        self._frames = np.empty(self.size, FRAME)
        self.words: NDArray[np.uint64] = self._frames.view(np.uint64).reshape(self.size, WORDS)
        self.data: NDArray[np.uint8] = self._frames.view(np.uint8).reshape(self.size, FRAME.itemsize)
        self.channel = np.empty(self.size, np.int64)
        self.count = 0

    @property
    def full(self) -> bool:
        """Whether there is room for no more."""
        return self.count == self.size

    def last(self) -> Any:
        """Return the last frame."""
        return self._frames[self.count - 1]

    def put(self, frames: Frames, channel: NDArray[np.int64]) -> None:
        """Append frames; there must be room for them."""
        end = self.count + len(frames)
        self._frames[self.count : end] = frames
        self.channel[self.count : end] = channel
        self.count = end

    def take(self) -> tuple[Frames, NDArray[np.int64]]:
        """Return the frames that are in, and start again."""
        taken = self._frames[: self.count], self.channel[: self.count]
        self._renew()
        return taken


#: Frames, and the places of their channels' names.
Read = tuple[Frames, NDArray[np.int64]]


class Reader(Protocol):
    """Reader of a format.

    Attributes:
        passed_over: lines or records that could not be read as frames, one text each.
        origin_ns: wall time of the log's begin where stamps count from there, 0 where they are wall time [ns].
    """

    @property
    def passed_over(self) -> list[str]:
        """Lines or records that could not be read as frames."""

    @property
    def origin_ns(self) -> int:
        """Added to stamps to make them wall time [ns]."""

    def read(self, stream: BinaryIO, names: Names, chunk: int) -> Iterator[Read]:
        """Yield a log's frames; an error that ends it early is raised after all frames before it.

        Args:
            stream: the log, unpacked.
            names: takes the names of the channels.
            chunk: frames of a batch at most.
        """

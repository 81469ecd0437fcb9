"""Room for a batch of frames while it is read, with the channel of each."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, tzinfo
from pathlib import Path
from typing import Any, BinaryIO, Protocol

import numpy as np
from numpy.typing import NDArray

from gateway.bus.frames import ERROR, FRAME, Frames, single
from gateway_fdi.errors import InputError

#: 64-bit words of a frame.
WORDS = FRAME.itemsize // 8
#: Numbers of channels that lie farther apart than this are sorted.
_WIDEST = 100_000
#: Channel of a frame whose log names none.
NO_CHANNEL = -(1 << 40)
#: Kinds of places that give no frame, which are counted apart.
_MOST_KINDS = 40
#: Where the second word has flags and length.
FLAGS, LENGTH = 40, 48


#: Frames, and the places of their channels' names.
Read = tuple[Frames, NDArray[np.int64]]


class Names:
    """Names of a log's channels, in the order in which they come; frames have their places."""

    def __init__(self) -> None:
        self._places: dict[str, int] = {}

    @property
    def known(self) -> list[str]:
        """The names, in the order of their places."""
        return list(self._places)

    def place(self, name: str) -> int:
        """Return the place of a name."""
        return self._places.setdefault(name, len(self._places))


def placed(channel: NDArray[np.int64], names: Names) -> NDArray[np.int64]:
    """Return the places of numbered channels' names, shape (n,)."""
    if not len(channel):
        return channel
    low, high = int(channel.min()), int(channel.max())
    if low == high:  # as of nearly every log
        return np.full(len(channel), _place(low, names))
    if high - low > _WIDEST:
        numbers, inverse = np.unique(channel, return_inverse=True)
        return np.array([_place(number, names) for number in numbers.tolist()], np.int64)[inverse]
    table = np.zeros(high - low + 1, np.int64)
    for number in np.flatnonzero(np.bincount(channel - low)).tolist():
        table[number] = _place(low + number, names)
    return table[channel - low]


def _place(number: int, names: Names) -> int:
    return names.place("none" if number == NO_CHANNEL else str(number))


def scaled(text: str, places: int) -> int:
    """Return 10 to the power of ``places`` times a decimal number; further digits are left out."""
    whole, _, part = text.partition(".")
    return int(whole + part[:places].ljust(places, "0"))


def wall_ns(zone: tzinfo, part_ns: int, *fields: int) -> int:
    """Return the time of a year, month, day, hour, minute, second and a part of one [ns], 0 if it is none."""
    try:
        return int(datetime(*fields, tzinfo=zone).timestamp()) * 10**9 + part_ns  # type: ignore[misc,arg-type]
    except ValueError:
        return 0


def bytes_of(frames: Frames) -> NDArray[np.uint8]:
    """Return a view of frames as bytes, shape (n, 80); a payload begins at byte 16."""
    return frames.view(np.uint8).reshape(len(frames), FRAME.itemsize)


def flags_of(columns: Mapping[str, NDArray[Any]], flags: Mapping[str, int], count: int) -> NDArray[np.uint32]:
    """Return the flags that columns say of ``count`` frames, where they are not 0; those that are missing say none."""
    found = np.zeros(count, np.uint32)
    for name in flags.keys() & columns.keys():
        found |= (columns[name] != 0) * np.uint32(flags[name])
    return found


def error_frame(batch: Batch, t_ns: int, classes: int, data: bytes, channel: int) -> None:
    """Append an error frame (linux/can/error.h): its classes, and up to 8 bytes."""
    batch.put(t_ns, ERROR | classes, data.ljust(8, b"\0"), channel)


class Batch:
    """Room for frames, filled from the front; frames that were handed out are not written again.

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
        self.data = bytes_of(self._frames)
        self.channel = np.empty(self.size, np.int64)
        self.count = 0

    @property
    def room(self) -> tuple[NDArray[np.uint64], NDArray[np.uint8], NDArray[np.int64], int]:
        """Words, data, channel and count, as a kernel takes them."""
        return self.words, self.data, self.channel, self.count

    def last(self) -> Any:
        """Return the last frame."""
        return self._frames[self.count - 1]

    def put(self, t_ns: int, can_id: int, payload: bytes, channel: int, *, flags: int = 0) -> None:
        """Append a frame; there must be room for it."""
        self._frames[self.count] = single(t_ns, can_id, payload, flags=flags)[0]
        self.channel[self.count] = channel
        self.count += 1

    def take(self, names: Names | None) -> Read:
        """Return the frames that are in with the places of their channels' names, and start again.

        ``names`` takes those of channels that are numbers; None: they are places.
        """
        frames, channel = self._frames[: self.count], self.channel[: self.count]
        self._renew()
        return frames, channel if names is None else placed(channel, names)


@dataclass
class Passed:
    """Places of one kind that gave no frame.

    Attributes:
        count: how many there are.
        first: what is there, of the first of them.
        line: number of its line, where there are lines.
        damaged: whether a frame is lost there, or may be; else it is an event of another kind.
    """

    count: int
    first: str
    line: int | None
    damaged: bool


class PassedOver:
    """Places of a log that gave no frame, by kind; the length is their number."""

    def __init__(self) -> None:
        self.kinds: dict[str, Passed] = {}

    def add(self, kind: str, first: str, line: int | None = None, *, count: int = 1, damaged: bool = True) -> None:
        """Count places of a kind."""
        if kind not in self.kinds and len(self.kinds) >= _MOST_KINDS:
            kind = f"more kinds, {'damaged' if damaged else 'no frames'}"
        known = self.kinds.setdefault(kind, Passed(0, first, line, damaged))
        known.count += count

    def take(self, more: PassedOver | Iterable[str]) -> None:
        """Count those of another reader; one of a plug-in may have them as a list of texts."""
        if isinstance(more, PassedOver):
            for kind, one in more.kinds.items():
                self.add(kind, one.first, one.line, count=one.count, damaged=one.damaged)
        else:
            for text in more:
                self.add("no frame can be made of it", text)

    def errors(self, path: Path) -> list[InputError]:
        """Return what is damaged, an error a kind."""
        return [
            InputError(f"damaged, passed over: {one.count} x {kind}", file=path, line=one.line, value=one.first)
            for kind, one in self.kinds.items()
            if one.damaged
        ]

    def notes(self) -> list[str]:
        """Return what is no damage, a text a kind."""
        return [
            f"passed over: {one.count} x {kind}, first{'' if one.line is None else f' in line {one.line}'}: {one.first}"
            for kind, one in self.kinds.items()
            if not one.damaged
        ]

    def __len__(self) -> int:
        return sum(one.count for one in self.kinds.values())


class FormatReader:
    """A reader of a format of ours.

    Attributes:
        passed_over, origin_ns: as of a :class:`Reader`.
        zone: of the dates in its header.
    """

    def __init__(self, path: Path) -> None:
        self._path, self.passed_over = path, PassedOver()
        self.origin_ns = 0
        self.zone: tzinfo = UTC


class Reader(Protocol):
    """Reader of a format.

    A class of readers may have a static method ``sniff(first: bytes) -> bool``: whether a log that begins with these
    bytes (64 KiB, or all) is surely of its format. One without it is found by the suffix alone.

    Attributes:
        passed_over: places that gave no frame; texts will do.
        origin_ns: wall time of the log's begin where stamps count from there, 0 where they are wall time [ns].
    """

    @property
    def passed_over(self) -> PassedOver | list[str]:
        """Places that gave no frame."""

    @property
    def origin_ns(self) -> int:
        """Added to stamps to make them wall time [ns]."""

    def read(self, stream: BinaryIO, names: Names, chunk: int) -> Iterator[Read]:
        """Yield a log's frames; an error that ends it early is raised after all frames before it.

        Args:
            stream: the log, unpacked.
            names: takes the names of the channels; numbers count from 0, whatever the format counts from.
            chunk: frames of a batch at most.
        """

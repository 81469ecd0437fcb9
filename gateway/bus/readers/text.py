"""Logs of lines: blocks of whole lines to a format's kernel, and rules for a log's last line."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from gateway.bus.frames import Frames, empty
from gateway.bus.log_source import LINE, CutOffError, damage, pull
from gateway.bus.readers.batch import Batch, Names, Read, placed
from gateway.bus.readers.scan import ASK, BAD, DONE, PASSED
from gateway_fdi.errors import InputError

#: Bytes that are read at a time.
BLOCK = 1 << 20
#: Characters of a line that are shown.
SHOWN = 60


class Lines(ABC):
    """A format of lines.

    Args:
        path: for errors.

    Attributes:
        passed_over: lines that could not be read as frames, one text each.
        origin_ns: added to stamps to make them wall time [ns].
    """

    #: Whether channels are numbers, and not places of names.
    numbered = True

    def __init__(self, path: Path) -> None:
        self._path = path
        self.passed_over: list[str] = []
        self.origin_ns = 0

    @abstractmethod
    def scan(self, text: NDArray[np.uint8], at: int, batch: Batch) -> tuple[int, int, int]:
        """Read lines into a batch until one of both ends.

        Args:
            text: lines; the last one ends, too.
            at: where to begin.
            batch: not full.

        Returns:
            where reading stopped, lines that were read, and the state of the line there (``scan.DONE`` etc.).
        """

    def asked(self, line: bytes, names: Names) -> bool:
        """Look at a line at which the kernel stopped with ASK; returns whether that was all of it."""
        raise AssertionError(f"the kernel of {type(self).__name__} asks of no line, but did of {shown(line)!r}")

    @abstractmethod
    def bad(self, line: bytes, number: int) -> InputError:
        """Return the error of a line that cannot be read."""

    @abstractmethod
    def cut(self, line: bytes, frame: Any, before: Frames) -> bool:
        """Return whether a log ends within its last line, which has no end.

        Args:
            line: it.
            frame: made of it; None: nothing.
            before: frames before it.
        """

    def unfinished(self) -> str:
        """Return what is missing at the log's end, "" if nothing is: most formats have no end of their own."""
        return ""


def shown(line: bytes) -> str:
    """Return the beginning of a line, for people."""
    return line[:SHOWN].decode("ascii", "replace").strip()


def _too_long(text: bytes) -> int:
    """Return where the first line begins that is longer than :data:`LINE`, -1 if none is.

    Args:
        text: lines; the last one ends, too.
    """
    at = 0
    while at + LINE < len(text):
        end = text.rfind(b"\n", at, at + LINE + 1)
        if end < 0:
            return at
        at = end + 1
    return -1


class TextReader:
    """Reads a log of lines.

    Args:
        path: for errors.
        lines: its format.
    """

    def __init__(self, path: Path, lines: Lines) -> None:
        self._path, self._lines = path, lines
        self._line, self._frames = 1, 0
        self._before = empty(0)

    @property
    def passed_over(self) -> list[str]:
        """Lines that could not be read as frames, one text each."""
        return self._lines.passed_over

    @property
    def origin_ns(self) -> int:
        """Added to stamps to make them wall time [ns]."""
        return self._lines.origin_ns

    def read(self, stream: BinaryIO, names: Names, chunk: int) -> Iterator[Read]:
        """Yield a log's frames (see :class:`gateway.bus.readers.batch.Reader`)."""
        batch = Batch(chunk)
        tail, broken = b"", None
        wrong: InputError | None = None
        while broken is None and wrong is None:
            block, broken = pull(stream, BLOCK)
            if not block:
                break
            cut = block.rfind(b"\n") + 1
            text, tail = (tail + block[:cut], block[cut:]) if cut else (b"", tail + block)
            if (at := _too_long(text)) >= 0:
                text, tail = text[:at], text[at:]
            for wrong in self._scanned(text, names, batch):
                if batch.full or (wrong is not None and batch.count):
                    yield self._taken(batch, names)
            if wrong is None and len(tail) > LINE:
                wrong = self._endless(tail, self._frames + batch.count)
        if wrong is None and tail and broken is None:
            wrong = self._last(tail, names, batch)
        if batch.count:
            yield self._taken(batch, names)
        if wrong is not None:
            raise wrong
        if broken is not None:
            raise damage(broken, self._path, self._frames)
        if missing := self._lines.unfinished():
            raise CutOffError(f"cut off after frame {self._frames}: {missing}", file=self._path)

    def _taken(self, batch: Batch, names: Names) -> Read:
        taken = batch.take()
        self._frames += len(taken[0])
        self._before = taken[0]
        return taken[0], placed(taken[1], names) if self._lines.numbered else taken[1]

    def _scanned(self, text: bytes, names: Names, batch: Batch) -> Iterator[InputError | None]:
        """Read lines; yields where the batch is full, and the error at the end."""
        array, at, asked = np.frombuffer(text, np.uint8), 0, -1
        while at < len(array):
            at, lines, status = self._lines.scan(array, at, batch)
            self._line += lines
            if status == DONE:
                if batch.full:
                    yield None
                continue
            end = text.index(b"\n", at) + 1
            line = text[at:end]
            if status == BAD or (status == ASK and at == asked):  # asked again: what was learned does not help
                yield self._lines.bad(line, self._line)
                return
            asked = at
            if status == PASSED:
                self.passed_over.append(f"line {self._line}: {shown(line)}")
            if status == PASSED or (status == ASK and self._lines.asked(line, names)):
                at = end
                self._line += 1

    def _endless(self, line: bytes, frames: int) -> InputError:
        """Return the error of a line that is too long to be one."""
        if not line[:LINE].strip(b"\0"):  # as a file system leaves a file that was being written
            text = f"cut off after frame {frames}: from here on there is nothing but {LINE} zero bytes and more"
            return CutOffError(text, file=self._path, line=self._line)
        text = f"a line that is longer than {LINE} bytes, after frame {frames}: no log has such lines"
        return InputError(text, file=self._path, line=self._line, value=shown(line))

    def _last(self, tail: bytes, names: Names, batch: Batch) -> InputError | None:
        """Read a last line without an end; returns that it is cut off."""
        if not tail.strip():
            return None
        frames, channel = batch.take()
        if len(frames):
            self._before = frames
        passed, number = len(self.passed_over), self._line
        wrong = next((wrong for wrong in self._scanned(tail + b"\n", names, batch) if wrong is not None), None)
        frame = batch.last() if batch.count else None
        cut = wrong is not None or self._lines.cut(tail, frame, self._before)
        more = 0 if cut else batch.count
        channel = np.concatenate((channel, batch.channel[:more]))
        joined = np.concatenate((frames, batch.take()[0][:more]))
        if len(joined) > batch.size:  # a full batch, and one more
            batch.size = len(joined)
            batch.take()
        batch.put(joined, channel)
        if not cut:
            return None
        del self.passed_over[passed:]
        return CutOffError(
            f"cut off in this line, after frame {self._frames + batch.count}",
            file=self._path,
            line=number,
            value=shown(tail),
        )

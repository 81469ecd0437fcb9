"""Logs of lines: blocks of whole lines to a format's kernel; what happens to a damaged line, and to the last one."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from datetime import UTC, tzinfo
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from gateway.bus.frames import Frames, empty
from gateway.bus.log_source import LINE, OBJECT, CutOffError, damage, pull
from gateway.bus.readers.batch import Batch, Names, PassedOver, Read, placed
from gateway.bus.readers.scan import ASK, BAD, DONE, PASSED
from gateway_fdi.errors import InputError

#: Bytes that are read at a time.
BLOCK = 1 << 20
#: Characters of a line that are shown.
SHOWN = 60
#: Mark that Windows puts at the begin of a text.
BOM = b"\xef\xbb\xbf"
ZEROS = "a run of zero bytes"
LONG = f"a line that is longer than {LINE} bytes"


#: How often a line is asked for at most: after the header, for what it names, for what it says.
ASKED = 4


class Lines(ABC):
    """A format of lines.

    Attributes:
        origin_ns: added to stamps to make them wall time [ns].
        zone: of the dates in its header.
    """

    #: Whether channels are numbers, and not places of names.
    numbered = True
    #: A line that can be read, for errors.
    good = ""
    #: Whether commas stand for points.
    comma = False

    def __init__(self, path: Path) -> None:
        self._path = path
        self.origin_ns = 0
        self.zone: tzinfo = UTC

    @staticmethod
    @abstractmethod
    def sniff(first: bytes) -> bool:
        """Return whether a log that begins with these bytes is of this format."""

    def begin(self, first: bytes) -> None:  # noqa: B027 - most formats need no look ahead
        """Look at the log's begin before it is read."""

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

    def asked(self, line: bytes, names: Names, batch: Batch) -> int:
        """Look at a line at which the kernel stopped with ASK; the batch has room for a frame.

        Returns:
            DONE: that was all of it; ASK: the kernel can read it now; BAD, PASSED.
        """
        raise AssertionError(f"the kernel of {type(self).__name__} asks of no line, but did of {shown(line)!r}")

    def kind(self, line: bytes) -> str:
        """Return what an event is called that is no frame."""
        return "an event that is no frame"

    @abstractmethod
    def cut(self, line: bytes, frame: Any, before: Frames) -> bool:
        """Return whether a log ends within its last line, which has no end; a frame was made of it, or None."""

    def unfinished(self) -> str:
        """Return what is missing at the log's end, "" if nothing is: most formats have no end of their own."""
        return ""


def shown(line: bytes) -> str:
    """Return the beginning of a line, for people."""
    return line[:SHOWN].decode("ascii", "replace").strip(" \r\n\t\0")


def _too_long(text: bytes) -> int:
    """Return where the first of some ended lines begins that is longer than :data:`LINE`, -1 if none is."""
    at = 0
    while at + LINE < len(text):
        end = text.rfind(b"\n", at, at + LINE + 1)
        if end < 0:
            return at
        at = end + 1
    return -1


class TextReader:
    """Reads a log of lines; one that is damaged is passed over.

    Attributes:
        passed_over: lines that gave no frame.
    """

    def __init__(self, path: Path, lines: Lines) -> None:
        self._path, self.lines = path, lines
        self._line, self._frames = 1, 0
        self._before = empty(0)
        self._long = b""  # begin of a line that is too long, whose end has not come
        self.passed_over = PassedOver()

    @property
    def origin_ns(self) -> int:
        """Added to stamps to make them wall time [ns]."""
        return self.lines.origin_ns

    def read(self, stream: BinaryIO, names: Names, chunk: int) -> Iterator[Read]:
        """Yield a log's frames (see :class:`gateway.bus.readers.batch.Reader`)."""
        batch, tail, size = Batch(chunk), b"", 0
        block, broken = pull(stream, BLOCK)
        block = block.removeprefix(BOM)
        self.lines.begin(block)
        while block:
            if self.lines.comma:
                block = block.replace(b",", b".")
            if self._long:
                block, size = self._after_long(block, size)
            cut = block.rfind(b"\n") + 1
            text, tail = (tail + block[:cut], block[cut:]) if cut else (b"", tail + block)
            for _ in self._scanned(text, names, batch):
                yield self._taken(batch, names)
            if len(tail) > LINE and not tail[:LINE].strip(b"\0") and (rest := tail.lstrip(b"\0")):
                self._pass_over(ZEROS, tail)
                tail = rest
            if len(tail) > LINE:
                self._long, tail, size = tail[:LINE], b"", size + len(tail)
            if broken is not None or size > OBJECT:
                break
            block, broken = pull(stream, BLOCK)
        wrong: InputError | None = None
        if self._long:
            wrong = self._endless(self._frames + batch.count)
        elif tail and broken is None:
            wrong = self._last(tail, names, batch)
        if batch.count:
            yield self._taken(batch, names)
        if wrong is not None:
            raise wrong
        if broken is not None:
            raise damage(broken, self._path, self._frames)
        if missing := self.lines.unfinished():
            raise CutOffError(f"cut off after frame {self._frames}: {missing}", file=self._path)

    def _taken(self, batch: Batch, names: Names) -> Read:
        taken = batch.take()
        self._frames += len(taken[0])
        self._before = taken[0]
        return taken[0], placed(taken[1], names) if self.lines.numbered else taken[1]

    def _after_long(self, block: bytes, size: int) -> tuple[bytes, int]:
        """Return what follows a line that is too long, and how much of it has come while it goes on [byte]."""
        zeros = not self._long.strip(b"\0")
        rest = block.lstrip(b"\0") if zeros else block[block.find(b"\n") + 1 or len(block) :]
        if not rest and not (block.endswith(b"\n") and not zeros):
            return b"", size + len(block)
        self._pass_over(ZEROS if zeros else LONG, self._long)
        self._long = b""
        self._line += not zeros
        return rest, 0

    def _pass_over(self, kind: str, line: bytes, *, damaged: bool = True) -> None:
        self.passed_over.add(kind, shown(line), self._line, damaged=damaged)

    def _scanned(self, text: bytes, names: Names, batch: Batch) -> Iterator[None]:
        """Read lines; yields where the batch is full."""
        while (at := _too_long(text)) >= 0:
            yield from self._some(text[:at], names, batch)
            end = text.index(b"\n", at) + 1
            line = text[at:end]
            rest = b"" if line[:LINE].strip(b"\0") else line.lstrip(b"\0")  # a line that zeros were put before
            self._pass_over(ZEROS if rest else LONG, line)
            self._line += not rest
            text = rest + text[end:]
        yield from self._some(text, names, batch)

    def _some(self, text: bytes, names: Names, batch: Batch) -> Iterator[None]:
        array, at, asked = np.frombuffer(text, np.uint8), 0, [0, 0]
        while at < len(array):
            at, lines, status = self.lines.scan(array, at, batch)
            self._line += lines
            if status == DONE:
                if batch.full:
                    yield None
                continue
            end = text.index(b"\n", at) + 1
            line = text[at:end]
            if status == ASK:
                asked = [at, asked[1] + 1 if at == asked[0] else 1]
                # Asked again and again at one place: what was learned does not help.
                status = BAD if asked[1] > ASKED else self.lines.asked(line, names, batch)
            if status == BAD:
                self._pass_over(f"no line of this format ({self.lines.good})", line)
            elif status == PASSED:
                self._pass_over(self.lines.kind(line), line, damaged=False)
            if status != ASK:
                at = end
                self._line += 1
                if batch.full:
                    yield None

    def _endless(self, frames: int) -> InputError:
        """Return the error of a line that is too long to be one, and has no end."""
        if not self._long.strip(b"\0"):  # as a file system leaves a file that was being written
            text = f"cut off after frame {frames}: from here on there is nothing but {LINE} zero bytes and more"
            return CutOffError(text, file=self._path, line=self._line)
        text = f"{LONG}, after frame {frames}: no log has such lines"
        return InputError(text, file=self._path, line=self._line, value=shown(self._long))

    def _last(self, tail: bytes, names: Names, batch: Batch) -> InputError | None:
        """Read a last line without an end; returns that it is cut off."""
        if not tail.strip():
            return None
        frames, channel = batch.take()
        if len(frames):
            self._before = frames
        number, kept, self.passed_over = self._line, self.passed_over, PassedOver()
        list(self._scanned(tail + b"\n", names, batch))
        frame = batch.last() if batch.count else None
        wrong = any(one.damaged for one in self.passed_over.kinds.values())
        cut = wrong or self.lines.cut(tail, frame, self._before)
        more = 0 if cut else batch.count
        if not cut:
            kept.take(self.passed_over)
        self.passed_over = kept
        channel = np.concatenate((channel, batch.channel[:more]))
        joined = np.concatenate((frames, batch.take()[0][:more]))
        if len(joined) > batch.size:  # a full batch, and one more
            batch.size = len(joined)
            batch.take()
        batch.put(joined, channel)
        if not cut:
            return None
        return CutOffError(
            f"cut off in this line, after frame {self._frames + batch.count}",
            file=self._path,
            line=number,
            value=shown(tail),
        )

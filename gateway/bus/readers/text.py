"""Logs of lines: blocks of whole lines to a format's kernel; what happens to a damaged line, and to the last one."""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from gateway.bus.frames import Frames, empty
from gateway.bus.log_source import LINE, OBJECT, CutOffError, damage, pull
from gateway.bus.readers.batch import Batch, FormatReader, Names, PassedOver, Read
from gateway.bus.readers.scan import ASK, BAD, DONE
from gateway_fdi.errors import InputError

#: Bytes that are read at a time.
BLOCK = 1 << 20
#: Characters of a line that are shown.
SHOWN = 60
#: Mark that Windows puts at the begin of a text.
BOM = b"\xef\xbb\xbf"
ZEROS = "a run of zero bytes"
LONG = f"a line that is longer than {LINE} bytes"


class Lines(FormatReader, ABC):
    """Reads a log of lines; one that is damaged is passed over."""

    #: Whether channels are numbers, and not places of names.
    numbered = True
    #: A line that can be read, for errors.
    good = ""
    #: Whether commas stand for points.
    comma = False
    #: Begin of a line that is no frame and may be a log's last one.
    last: re.Pattern[bytes]
    #: The part that is missing if the log ends now.
    missing = ""
    #: The kernel of the format (see :mod:`gateway.bus.readers.scan`), and its own arguments.
    scanner: tuple[Callable[..., tuple[int, int, int, int]], tuple[Any, ...]]

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._line, self._frames = 1, 0
        self._before = empty(0)

    @staticmethod
    @abstractmethod
    def sniff(first: bytes) -> bool:
        """Return whether a log that begins with these bytes is of this format."""

    def begin(self, first: bytes) -> None:
        """Look at the log's begin before it is read."""

    @abstractmethod
    def asked(self, line: bytes, names: Names, batch: Batch) -> int:
        """Look at a line at which the kernel stopped with ASK; the batch has room for a frame.

        Returns:
            DONE: that was all of it; ASK: the kernel can read it now; BAD.
        """

    def short(self, frame: Any, before: Frames) -> bool:
        """Return whether a frame, the last one, has fewer bytes than it should have, after the frames before it."""
        return False

    def event(self, kind: str, line: bytes) -> int:
        """Count a line that is an event of some kind, and no frame; returns DONE."""
        self._pass_over(kind, line, damaged=False)
        return DONE

    def read(self, stream: BinaryIO, names: Names, chunk: int) -> Iterator[Read]:
        """Yield a log's frames (see :class:`gateway.bus.readers.batch.Reader`)."""
        batch, tail, size = Batch(chunk), b"", 0
        block, broken = pull(stream, BLOCK)
        block = block.removeprefix(BOM)
        self.begin(block)
        while block:
            if self.comma:
                block = block.replace(b",", b".")
            cut = block.rfind(b"\n") + 1
            text, tail = (tail + block[:cut], block[cut:]) if cut else (b"", tail + block)
            for _ in self._scanned(text, names, batch):
                yield self._taken(batch, names)
            if len(tail) > LINE and not tail[:LINE].strip(b"\0") and (rest := tail.lstrip(b"\0")):
                self._pass_over(ZEROS, tail)
                tail = rest
            size = size + len(block) if len(tail) > LINE else 0
            tail = tail[: LINE + 1]  # of a line that is too long the begin is enough
            if broken is not None or size > OBJECT:
                break
            block, broken = pull(stream, BLOCK)
        if batch.count:
            yield self._taken(batch, names)
        if len(tail) > LINE:
            raise self._endless(tail)
        if tail.strip() and broken is None:
            self._read_last(tail, names, batch)
            if batch.count:
                yield self._taken(batch, names)
        if broken is not None:
            raise damage(broken, self._path, self._frames)
        if self.missing:
            raise CutOffError(f"cut off after frame {self._frames}: {self.missing}", file=self._path)

    def _taken(self, batch: Batch, names: Names) -> Read:
        taken = batch.take(names if self.numbered else None)
        self._before = taken[0]
        self._frames += len(self._before)
        return taken

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
        array, at = np.frombuffer(text, np.uint8), 0
        while at < len(array):
            scan, own = self.scanner
            at, lines, batch.count, status = scan(array, at, *batch.room, *own)
            self._line += lines
            if status != DONE:
                end = text.index(b"\n", at) + 1
                line = text[at:end]
                if status == ASK:
                    status = self.asked(line, names, batch)
                if status == ASK:
                    continue
                if status == BAD:
                    self._pass_over(f"no line of this format ({self.good})", line)
                at = end
                self._line += 1
            if batch.count == batch.size:
                yield None

    def _endless(self, tail: bytes) -> InputError:
        """Return the error of a line that is too long to be one, and has no end."""
        if not tail.strip(b"\0"):  # as a file system leaves a file that was being written
            text = f"cut off after frame {self._frames}: from here on there is nothing but {LINE} zero bytes and more"
            return CutOffError(text, file=self._path, line=self._line)
        text = f"{LONG}, after frame {self._frames}: no log has such lines"
        return InputError(text, file=self._path, line=self._line, value=shown(tail))

    def _read_last(self, tail: bytes, names: Names, batch: Batch) -> None:
        """Read a last line without an end into an empty batch.

        Raises:
            CutOffError: the log ends within it.
        """
        number, kept, self.passed_over = self._line, self.passed_over, PassedOver()
        list(self._scanned(tail + b"\n", names, batch))
        cut = any(one.damaged for one in self.passed_over.kinds.values()) or (
            self.short(batch.last(), self._before) if batch.count else not self.last.match(tail)
        )
        if not cut:
            kept.take(self.passed_over)
        self.passed_over = kept
        if cut:
            text = f"cut off in this line, after frame {self._frames}"
            raise CutOffError(text, file=self._path, line=number, value=shown(tail))


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

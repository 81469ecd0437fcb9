"""What stands below the reader of a log: compressed files, and whether a log ends before its end."""

from __future__ import annotations

import bz2
import gc
import gzip
import importlib
import io
import lzma
import struct
import sys
import traceback
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, BinaryIO

from gateway.common.extras import need
from gateway.errors import InputError

#: Suffix -> what compressed the log.
COMPRESSIONS = {".gz": "gzip", ".bz2": "bzip2", ".xz": "xz", ".zst": "Zstandard"}

#: Header of an MF4 block: mark, length, number of links; where the first one is.
_MF4_BLOCK, _MF4_FIRST = struct.Struct("<4s4xQQ"), 64
#: Bytes of a BLF object's base header (signature, sizes, type): where a file may end.
_BLF_HEADER = 16
#: Bytes of its file header: the size of the file that it names until the recorder has finished it.
_BLF_FILE_HEADER = 144
#: Bytes that may be missing at the end of a BLF file: padding.
_BLF_PADDING = 3


class CutOffError(InputError):
    """A log that ends before its end: the recorder was killed, the copy was not finished."""


def compression_of(path: Path) -> str:
    """Return the suffix of a file's compression, "" if it has none."""
    suffix = path.suffix.lower()
    return suffix if suffix in COMPRESSIONS else ""


def _zstd() -> Any:
    try:
        return importlib.import_module("compression.zstd")  # since Python 3.14
    except ImportError:
        need("zst", "logs in Zstandard")
        return importlib.import_module("backports.zstd")


def open_log(path: Path, stack: ExitStack) -> tuple[BinaryIO, BinaryIO]:
    """Open a log, compressed or not.

    Args:
        path: of the log.
        stack: closes what was opened.

    Returns:
        the log's bytes; the file itself, whose ``tell()`` says how far reading is.

    Raises:
        InputError: unreadable, or Zstandard is not installed.
    """
    compression = compression_of(path)
    try:
        raw = stack.enter_context(path.open("rb"))
    except OSError as error:
        raise InputError(error.strerror or str(error), file=path) from error
    if not compression:
        return raw, raw
    if compression == ".gz":
        return stack.enter_context(gzip.GzipFile(fileobj=raw)), raw  # type: ignore[return-value]
    if compression == ".bz2":
        return stack.enter_context(bz2.BZ2File(raw)), raw  # type: ignore[return-value]
    if compression == ".xz":
        return stack.enter_context(lzma.LZMAFile(raw)), raw  # type: ignore[return-value]
    try:
        return stack.enter_context(_zstd().ZstdFile(raw)), raw
    except InputError as error:
        raise error.within(path) from error


def take(lines: Iterator[bytes], count: int) -> tuple[list[bytes], Exception | None]:
    """Return so many lines, and what ended them early: what came before a damaged place is kept."""
    taken: list[bytes] = []
    try:
        for line in lines:
            taken.append(line)
            if len(taken) == count:
                break
    except Exception as error:  # each decompressor has its own
        return taken, error
    return taken, None


def damage(error: Exception, path: Path, frames: int) -> InputError:
    """Return what ended a log early as an error of ours."""
    if isinstance(error, CutOffError):
        return error
    if isinstance(error, EOFError):  # all of our decompressors
        return CutOffError(f"cut off after frame {frames}: the compressed file ends", file=path)
    text = " ".join(str(error).split()) or type(error).__name__
    return InputError(f"damaged after frame {frames}: {text}", file=path)


class TextLines:
    """The lines of a text log for python-can's readers, which read over a last line that is cut.

    Attributes:
        open_end: the last line, if it was handed out and has no end; else None.
        block: whether a trigger block of ASC was begun and not ended.
    """

    def __init__(self, stream: BinaryIO) -> None:
        # What matters is ASCII; a date or a comment may be in the recorder's own code page.
        self._file = io.TextIOWrapper(stream, "utf-8", errors="replace")
        self.open_end: str | None = None
        self.block = False

    def __iter__(self) -> Iterator[str]:
        return self

    def __next__(self) -> str:
        line = next(self._file)
        if line[:1] in "BbEe":
            word = line[:18].lower()
            if word.startswith("begin triggerblock"):
                self.block = True
            elif word.startswith("end triggerblock"):
                self.block = False
        if not line.endswith("\n"):
            self.open_end = line
        return line

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def cut_line(self, message: Any) -> bool:
        """Tell whether the log ends within a frame.

        Args:
            message: what the last line became; None: nothing.
        """
        line = self.open_end
        if line is None or not line.strip() or _no_frame(line):
            return False
        if message is None:
            return True
        from can.util import dlc2len  # noqa: PLC0415 - slow to load

        lengths = (message.dlc, dlc2len(message.dlc))
        return not message.is_remote_frame and len(message.data) not in lengths


def _no_frame(line: str) -> bool:
    return line.lstrip()[:1] in (";", "/") or line.lower().startswith("end triggerblock")


class Records:
    """A binary log for python-can's BLF reader, which takes a short record for the file's end.

    Attributes:
        short: whether the file ended within a record.
    """

    def __init__(self, stream: BinaryIO) -> None:
        self._file = stream
        self.short = False

    def read(self, size: int = -1) -> bytes:
        """Read so many bytes."""
        data = self._file.read(size)
        if len(data) < size and size > _BLF_PADDING and (data or size != _BLF_HEADER):
            self.short = True
        return data

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def cut(self, reader: Any, path: Path, frames: int) -> CutOffError | None:
        """Return how the log is cut off, None if it is whole.

        Args:
            reader: python-can's, of this file.
            path: for errors, and for its size.
            frames: how many came.
        """
        size = path.stat().st_size
        missing = 0 if compression_of(path) else reader.file_size - size
        if self.short or missing > 0:
            whole = f": {size} bytes of {reader.file_size}" if missing > 0 else ""
            return CutOffError(f"cut off after frame {frames}{whole}", file=path)
        if frames and not reader.object_count and reader.file_size <= _BLF_FILE_HEADER:
            return CutOffError(f"cut off after frame {frames}: its recorder did not finish the file", file=path)
        return None


def mf4_is_cut(path: Path) -> bool:
    """Tell whether a block of an MF4 file lies beyond its end (ASAM MDF 4.1: all blocks are reached by links)."""
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(3)
        if head not in (b"MDF", b"UnF"):  # finished, or not finalised by its recorder
            return False
        waiting, known = [_MF4_FIRST], {_MF4_FIRST}
        while waiting:
            at = waiting.pop()
            file.seek(at)
            block = file.read(_MF4_BLOCK.size)
            if len(block) < _MF4_BLOCK.size:
                return True
            mark, length, count = _MF4_BLOCK.unpack(block)
            if mark[:2] != b"##":
                continue
            if at + length > size:
                return True
            links = struct.unpack(f"<{count}Q", file.read(8 * count)) if count else ()
            more = [link for link in links if link and link not in known]
            known.update(more)
            waiting += more
    return False


@contextmanager
def tidy() -> Iterator[None]:
    """Let go of what an exception holds before it goes on: asammdf's half-made files fail when they end.

    Python would print their failure, which says nothing new, as a traceback at the program's end.
    """
    try:
        yield
    except Exception as error:
        before, sys.unraisablehook = sys.unraisablehook, lambda _: None
        try:
            traceback.clear_frames(error.__traceback__)
            gc.collect()
        finally:
            sys.unraisablehook = before
        raise

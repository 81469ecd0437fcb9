"""Files below the reader of a log: compressed files, errors that end a log early, and limits of size.

A few kB unpack to gigabytes. So reading is bounded: a line, an object of BLF, and files that must be held whole.
"""

from __future__ import annotations

import bz2
import gzip
import importlib
import lzma
import zipfile
from contextlib import ExitStack
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

from gateway.common.extras import need
from gateway_fdi.errors import InputError

#: Suffix -> what compressed the log.
COMPRESSIONS = {".gz": "gzip", ".bz2": "bzip2", ".xz": "xz", ".zst": "Zstandard", ".zip": "zip"}
#: Suffix of an archive: it may hold several logs.
ARCHIVE = ".zip"

#: Bytes of a line at most; lines of all formats are a few hundred bytes long at most.
LINE = 1 << 16
#: Bytes of an object of BLF, and of what a container unpacks to, at most; recorders write containers of 128 KiB.
OBJECT = 1 << 24
#: Bytes of a compressed log, unpacked, whose format is held whole (MF4, Parquet).
WHOLE = 1 << 29
#: Bytes that are asked of a decompressor at once.
_PIECE = 1 << 18


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


def members(path: Path) -> list[str]:
    """Return the names of the logs in an archive, in order.

    Raises:
        InputError: it cannot be read, or holds none.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            found = sorted(one.filename for one in archive.infolist() if not one.is_dir())
    except OSError as error:
        raise InputError(error.strerror or str(error), file=path) from error
    except zipfile.BadZipFile as error:
        raise CutOffError(f"no archive, or cut off: {error}", file=path) from error
    if not found:
        raise InputError("no log in this archive", file=path)
    return found


def open_log(path: Path, stack: ExitStack, member: str = "") -> tuple[BinaryIO, BinaryIO]:
    """Open a log, compressed or not.

    Args:
        path: of the log.
        stack: closes what was opened.
        member: name of a log in an archive.

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
    if not compression or (compression == ARCHIVE and not member):
        return raw, raw
    if compression == ARCHIVE:
        archive = stack.enter_context(zipfile.ZipFile(raw))
        return stack.enter_context(archive.open(member)), raw  # type: ignore[return-value]
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


def pull(stream: BinaryIO, size: int) -> tuple[bytes, Exception | None]:
    """Return this number of bytes, less at the end, and the error that ended them; bytes before it are kept."""
    parts: list[bytes] = []
    read = getattr(stream, "read1", stream.read)
    while size > 0:
        try:
            part = read(min(size, _PIECE))
        except Exception as error:  # each decompressor has its own
            return b"".join(parts), error
        if not part:
            break
        parts.append(part)
        size -= len(part)
    return b"".join(parts), None


def whole(stream: BinaryIO, path: Path) -> BytesIO:
    """Return all bytes of a compressed log whose format needs all of them.

    Raises:
        InputError: there are more than :data:`WHOLE`.
    """
    held = BytesIO()
    while part := stream.read(_PIECE):
        held.write(part)
        if held.tell() > WHOLE:
            text = f"unpacks to more than {WHOLE} bytes, which this format would need in memory: unpack it first"
            raise InputError(text, file=path)
    held.seek(0)
    return held


def damage(error: Exception, path: Path, frames: int) -> InputError:
    """Return the cause that ended a log early as an error of the gateway."""
    if isinstance(error, CutOffError):
        return error
    if isinstance(error, EOFError):  # all of our decompressors
        return CutOffError(f"cut off after frame {frames}: the compressed file ends", file=path)
    text = " ".join(str(error).split()) or type(error).__name__
    return InputError(f"damaged after frame {frames}: {text}", file=path)

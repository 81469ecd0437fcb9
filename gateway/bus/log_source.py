"""Files below the reader of a log: compressed files, errors that end a log early, and limits of size.

A few kB unpack to gigabytes. So reading is bounded: a line, an object of BLF, and files that must be held whole.
"""

from __future__ import annotations

import re
from contextlib import ExitStack
from pathlib import Path
from typing import BinaryIO

from gateway.common.archives import BadArchive, open_archive, stream_of
from gateway_fdi.errors import InputError

#: Suffix -> what compressed the log.
COMPRESSIONS = {".gz": "gzip", ".bz2": "bzip2", ".xz": "xz", ".zst": "Zstandard", ".zip": "zip"}
#: Suffix of an archive: it may hold several logs.
ARCHIVE = ".zip"

#: Bytes of a line at most; lines of all formats are a few hundred bytes long at most.
LINE = 1 << 16
#: Bytes of an object of BLF, and of what a container unpacks to, at most; recorders write containers of 128 KiB.
OBJECT = 1 << 24
#: Bytes that are asked of a decompressor at once.
_PIECE = 1 << 18


#: Name of a segment that ``gateway record`` writes.
_SEGMENT = re.compile(r"^frames-\d{6,}-\d{8}T\d{6}Z\.(?:log|blf)$")


class CutOffError(InputError):
    """A log that ends before its end: the recorder was killed, the copy was not finished."""


def compression_of(path: Path) -> str:
    """Return the suffix of a file's compression, "" if it has none."""
    suffix = path.suffix.lower()
    return suffix if suffix in COMPRESSIONS else ""


def segments(folder: Path) -> list[Path]:
    """Return the segments of a folder, the oldest first.

    Raises:
        InputError: it cannot be read.
    """
    try:
        return sorted((path for path in folder.iterdir() if _SEGMENT.match(path.name)), key=number_of)
    except OSError as error:
        raise InputError(error.strerror or str(error), file=folder) from error


def number_of(segment: Path) -> int:
    """Return the number of a segment."""
    return int(segment.name.split("-")[1])


def members(path: Path) -> list[str]:
    """Return the names of the files in an archive, in order, without those that a Mac or a file manager puts beside.

    Raises:
        InputError: it cannot be read, or holds none.
    """
    try:
        with path.open("rb") as file, open_archive(path, file) as archive:
            names = sorted(one.filename for one in archive.infolist() if not one.is_dir())
            found = [name for name in names if not name.startswith("__MACOSX/") and Path(name).name[:1] != "."]
    except OSError as error:
        raise InputError(error.strerror or str(error), file=path) from error
    except BadArchive as error:
        raise CutOffError(f"no archive, or cut off: {error}", file=path) from error
    if not found:
        raise InputError("no log in this archive", file=path)
    return found


def open_log(path: Path, stack: ExitStack, member: str = "") -> tuple[BinaryIO, BinaryIO]:
    """Open a log, compressed or not; of an archive this member. The stack closes what was opened.

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
        archive = stack.enter_context(open_archive(path, raw))
        inside: BinaryIO = stack.enter_context(archive.open(member))  # type: ignore[assignment]
        packed = compression_of(Path(member))
        return (stream_of(packed, inside, path) if packed not in ("", ARCHIVE) else inside), raw
    return stack.enter_context(stream_of(compression, raw, path)), raw


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


def damage(error: Exception, path: Path, frames: int) -> InputError:
    """Return the cause that ended a log early as an error of the gateway."""
    if isinstance(error, InputError):
        return error
    if isinstance(error, EOFError):  # all of our decompressors
        return CutOffError(f"cut off after frame {frames}: the compressed file ends", file=path)
    said = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    text = " ".join(said.split()) or type(error).__name__
    return InputError(f"damaged after frame {frames}: {text}", file=path)

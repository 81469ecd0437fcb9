"""Archives and compressed files from outside: opened here and nowhere else, within bounds.

A few kB unpack to gigabytes. A stream (a log) stays flat in memory whatever it unpacks to, so it has no bound of its
size: an honest log of a bus that repeats itself is packed a thousand times. Its decompressor is bounded
(:data:`WINDOW`). Files that are held or written whole (PDX, FMU, packed MF4 and Parquet) have a :class:`Budget`. An
archive in an archive is not opened.
"""

from __future__ import annotations

import bz2
import gzip
import importlib
import io
import lzma
import os
import struct
import zipfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, cast

from gateway.common.extras import need
from gateway_fdi.errors import InputError

#: Error of an archive that is none, or is cut off.
BadArchive = zipfile.BadZipFile

#: Memory of a decompressor at most [byte]; ``xz -9`` and ``zstd --ultra -22`` need half of it.
WINDOW = 1 << 27
#: Members of an archive at most, and bytes of its directory.
ENTRIES, DIRECTORY = 10_000, 1 << 23
#: Bytes that are held or written whole: at most, in relation to the packed file, and allowed in any case.
WHOLE, RATIO, LEAST = 1 << 29, 100, 1 << 25
#: Variable of the environment that raises the bound for what is held or written whole [MB].
VARIABLE = "GATEWAY_UNPACK_MB"
#: Marks of XML documents that are allowed in any case, and in relation to the packed file: each may be an element or an
#: attribute in memory, some 100 bytes; an ODX file has some 25 bytes a mark, and packs to a fortieth at best.
MARKS, MARKS_RATIO, MARK = 1_000_000, 3, 25
#: Methods whose decompressors hold little: stored, deflate, bzip2. LZMA holds what the member asks for.
_METHODS = frozenset({zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2})
#: Bytes that are asked of a decompressor at once.
_PIECE = 1 << 18
_XZ, _ZSTD = b"\xfd7zXZ\0", b"\x28\xb5\x2f\xfd"


class Budget:
    """Bytes that a file may unpack to.

    Raises:
        InputError: :data:`VARIABLE` is no number.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._packed, self._taken = path, max(path.stat().st_size, 1), 0
        self.bound = min(WHOLE, max(LEAST, RATIO * self._packed))
        self.marks = max(MARKS, min(MARKS_RATIO * self._packed, WHOLE // MARK))
        raised = os.environ.get(VARIABLE)
        if raised is not None:
            try:
                bound = int(raised) * 1_000_000
            except ValueError:
                raise InputError("a number of megabytes", key=VARIABLE, value=raised) from None
            self.bound, self.marks = max(self.bound, bound), max(self.marks, bound // MARK)

    def take(self, count: int, member: str = "") -> None:
        """Count bytes.

        Args:
            count: of them.
            member: of the archive that they are of.

        Raises:
            InputError: they are more than the bound.
        """
        self._taken += count
        if self._taken > self.bound:
            text = (
                f"unpacks to more than {self.bound} bytes, {self._taken // self._packed} times the file or more:"
                f" unpack it first, or allow it by {VARIABLE}"
            )
            raise InputError(f"{member} {text}" if member else text, file=self._path)


class _Unpacked(io.RawIOBase):
    """A compressed file, stream after stream, by decompressors that are bounded; those of Python's files are not.

    Args:
        raw: the file.
        path: of it.
        make: makes a decompressor.
        mark: with which a stream begins; what does not begin so after a stream is no part of the file.
    """

    def __init__(self, raw: BinaryIO, path: Path, make: Callable[[], Any], mark: bytes) -> None:
        self._raw, self._path, self._make, self._mark = raw, path, make, mark
        self._one, self._over = make(), False

    def readable(self) -> bool:
        """Return True."""
        return True

    def readinto(self, buffer: Any) -> int:
        """Read; returns the number of bytes.

        Raises:
            EOFError: the file is cut off.
            InputError: its decompressor would hold too much.
        """
        size = len(buffer)
        while size and not self._over:
            data = b""
            if self._one.eof:
                data = (self._one.unused_data + self._raw.read(_PIECE)).lstrip(b"\0")  # xz is padded so
                if not data.startswith(self._mark):
                    self._over = True
                    break
                self._one = self._make()
            elif self._one.needs_input:
                data = self._raw.read(_PIECE)
                if not data:
                    raise EOFError("the compressed file ends")
            found = self._decompress(data, size)
            if found:
                buffer[: len(found)] = found
                return len(found)
        return 0

    def _decompress(self, data: bytes, size: int) -> bytes:
        try:
            return cast("bytes", self._one.decompress(data, size))
        except Exception as error:  # each decompressor has its own
            if "memory" not in str(error).lower():
                raise
            text = f"its decompressor would hold more than {WINDOW} bytes: pack it again with a smaller dictionary"
            raise InputError(text, file=self._path) from error


def _zstd() -> Any:
    try:
        return importlib.import_module("compression.zstd")  # since Python 3.14
    except ImportError:
        need("zst", "files in Zstandard")
        return importlib.import_module("backports.zstd")


def zstd_decompressor() -> Any:
    """Make a decompressor of Zstandard with a window of :data:`WINDOW` at most.

    Raises:
        InputError: Zstandard is not installed.
    """
    zstd = _zstd()
    return zstd.ZstdDecompressor(options={zstd.DecompressionParameter.window_log_max: WINDOW.bit_length() - 1})


def stream_of(compression: str, raw: BinaryIO, path: Path) -> BinaryIO:
    """Return what a compressed file holds, piece by piece.

    Args:
        compression: ``.gz``, ``.bz2``, ``.xz`` or ``.zst``.
        raw: the open file.
        path: of it.

    Raises:
        InputError: Zstandard is not installed.
    """
    if compression == ".gz":
        return cast("BinaryIO", gzip.GzipFile(fileobj=raw))
    if compression == ".bz2":
        one = _Unpacked(raw, path, bz2.BZ2Decompressor, b"BZh")
    elif compression == ".xz":
        one = _Unpacked(raw, path, lambda: lzma.LZMADecompressor(memlimit=WINDOW), _XZ)
    else:
        try:
            zstd_decompressor()
        except InputError as error:
            raise error.within(path) from error
        one = _Unpacked(raw, path, zstd_decompressor, _ZSTD)
    return cast("BinaryIO", io.BufferedReader(one, _PIECE))


def unpacked(data: bytes, make: Callable[[], Any], most: int) -> bytes:
    """Return what a compressed block within a file holds.

    Args:
        data: of the block.
        make: makes a decompressor.
        most: bytes at most.

    Raises:
        InputError: it is more.
    """
    found = cast("bytes", make().decompress(data, most + 1))
    if len(found) > most:
        raise InputError(f"a block of {len(data)} bytes unpacks to more than {most}")
    return found


def _directory(file: BinaryIO) -> int:
    """Return how long the directory of an archive is, by its last record; 0: there is none."""
    end = file.seek(0, os.SEEK_END)
    file.seek(max(0, end - (1 << 16) - 100))
    tail = file.read()
    file.seek(0)
    at = tail.rfind(b"PK\5\6")
    if at < 0 or len(tail) < at + 16:
        return 0
    (size,) = struct.unpack_from("<I", tail, at + 12)
    wide = tail.rfind(b"PK\6\6", 0, at)
    return max(0 if size == 0xFFFFFFFF else size, struct.unpack_from("<Q", tail, wide + 40)[0] if wide >= 0 else 0)


def open_archive(path: Path, file: BinaryIO) -> zipfile.ZipFile:
    """Open an archive (zip) whose members may be read.

    Raises:
        BadArchive: it is none, or is cut off.
        InputError: more members than :data:`ENTRIES`; one is encrypted, or packed by another method.
    """
    size = _directory(file)
    if size > DIRECTORY:
        raise InputError(f"a directory of {size} bytes; at most {DIRECTORY}", file=path)
    archive = zipfile.ZipFile(file)
    entries = archive.infolist()
    if len(entries) > ENTRIES:
        raise InputError(f"{len(entries)} members; at most {ENTRIES}", file=path)
    for entry in entries:
        if entry.flag_bits & 1:
            raise InputError(f"{entry.filename} is encrypted: unpack it first", file=path)
        if entry.compress_type not in _METHODS:
            text = f"{entry.filename} is packed by method {entry.compress_type}, and not by deflate: unpack it first"
            raise InputError(text, file=path)
    return archive


def pieces(stream: BinaryIO, budget: Budget, member: str = "") -> Iterator[bytes]:
    """Yield what a stream holds, within a budget.

    Raises:
        InputError: it is more.
    """
    while part := stream.read(_PIECE):
        budget.take(len(part), member)
        yield part


def whole(stream: BinaryIO, path: Path) -> BytesIO:
    """Return all that a compressed file holds, for formats that need all of it.

    Raises:
        InputError: it is more than its :class:`Budget`.
    """
    held = BytesIO()
    for part in pieces(stream, Budget(path)):
        held.write(part)
    held.seek(0)
    return held


@contextmanager
def _archive_errors(path: Path) -> Iterator[None]:
    """Raise what is wrong with an archive as an error of the gateway."""
    try:
        yield
    except InputError:
        raise
    except OSError as error:
        raise InputError(error.strerror or str(error), file=path) from error
    except (BadArchive, EOFError) as error:
        raise InputError(f"no archive, or cut off: {error}", file=path) from error
    except Exception as error:  # zlib.error, and what zipfile makes of a wrong directory
        raise InputError(f"damaged: {type(error).__name__}: {error}", file=path) from error


def _members(path: Path, suffix: str) -> Iterator[tuple[str, Iterator[bytes]]]:
    """Yield the names of members whose suffixes begin so, and what they hold, within one budget."""
    budget = Budget(path)
    with path.open("rb") as file, open_archive(path, file) as archive:
        for entry in archive.infolist():
            if not entry.is_dir() and Path(entry.filename).suffix.lower().startswith(suffix):
                with archive.open(entry) as stream:
                    yield entry.filename, pieces(cast("BinaryIO", stream), budget, entry.filename)


def members_of(path: Path, suffix: str) -> Iterator[tuple[str, bytes]]:
    """Yield the members of an archive whose suffixes begin so, each whole: name and bytes.

    Raises:
        InputError: it cannot be read, or its members are more than its :class:`Budget` together.
    """
    with _archive_errors(path):
        for name, parts in _members(path, suffix):
            yield name, b"".join(parts)


def unpack(path: Path, folder: Path) -> None:
    """Unpack an archive into a folder.

    Raises:
        InputError: as :func:`members_of`; a member would lie outside of the folder.
    """
    with _archive_errors(path):
        for name, parts in _members(path, ""):
            place = folder / name
            if "\\" in name or ":" in name or not place.resolve().is_relative_to(folder.resolve()):
                raise InputError(f"{name!r} would lie outside of the archive's folder", file=path)
            place.parent.mkdir(parents=True, exist_ok=True)
            with place.open("wb") as out:
                out.writelines(parts)


def packed(files: Mapping[str, bytes]) -> bytes:
    """Return an archive of files, the same bytes everywhere: they are stored, without times."""
    made = BytesIO()
    with zipfile.ZipFile(made, "w") as archive:
        for name, data in files.items():
            archive.writestr(zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0)), data)
    return made.getvalue()


def refuse_large_xml(data: bytes, path: Path, member: str = "") -> None:
    """Refuse an XML document that would take too much memory as a tree.

    Args:
        data: the document.
        path: of its file, or of the archive that it comes of.
        member: of the archive.

    Raises:
        InputError: more marks than its :class:`Budget` has.
    """
    marks, most = data.count(b"<") + data.count(b"="), Budget(path).marks
    if marks > most:
        text = f"an XML document with {marks} elements and attributes; at most {most}, or more by {VARIABLE}"
        raise InputError(f"{member}: {text}" if member else text, file=path)

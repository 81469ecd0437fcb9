"""Log files in and out, by their formats (:mod:`gateway.bus.log_format`)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from datetime import UTC, tzinfo
from pathlib import Path
from typing import BinaryIO, Self

import numpy as np
from numpy.typing import NDArray

from gateway.bus.conditions import BUS_ERROR, PROTOCOL
from gateway.bus.frames import ERROR, ID_MASK, Frames, chosen, of_bus
from gateway.bus.log_format import OTHERS, LogFormat, formats
from gateway.bus.log_source import (
    ARCHIVE,
    COMPRESSIONS,
    CutOffError,
    compression_of,
    damage,
    members,
    open_log,
    pull,
    segments,
)
from gateway.bus.readers.batch import Names, PassedOver, Reader
from gateway.bus.readers.text import BOM, Lines
from gateway.common.plugins import Registry, accept_callable
from gateway_fdi.common.log import get_logger
from gateway_fdi.errors import InputError

log = get_logger(__name__)

#: Suffix -> reader of another package's format; it may be one that we have.
READERS: Registry[Callable[[Path], Reader]] = Registry("gateway.readers", accept_callable)

#: Bytes by which a format is told.
_FIRST = 1 << 16
#: Frames of a batch at most.
CHUNK = 100_000


def is_format(suffix: str) -> bool:
    """Return whether files of a suffix are logs that can be read."""
    return suffix.lower() in (".log", *OTHERS, *READERS)


def _known(suffix: str, path: Path, *, read: bool) -> LogFormat:
    """Return the format of a suffix.

    Raises:
        InputError: there is none, or its package is not installed.
    """
    every = formats()
    if suffix not in every:
        known = ", ".join(f"{name} ({each.name})" for name, each in sorted(every.items()))
        OTHERS.get(suffix)  # its own error, if it cannot be used
        more = f"; to be read also with {', '.join(COMPRESSIONS)} after it" if read else ""
        raise InputError(f"a log is one of {known}{more}", file=path)
    every[suffix].need(path)
    return every[suffix]


def _maker(name: str, first: bytes, path: Path) -> tuple[str, Callable[[Path], Reader]]:
    """Return the format of a log, and what makes its reader: its first bytes say so, or else its suffix."""
    suffix, first, every = Path(name).suffix.lower(), first.removeprefix(BOM), formats()
    fitting = [own for own, each in every.items() if (sniff := getattr(each.reader, "sniff", None)) and sniff(first)]
    fitting = [own for own in fitting if not _has_lines(every[own])] or fitting
    if suffix in READERS:
        made = READERS[suffix]
        sniff = getattr(made, "sniff", None)
        if sniff(first) if sniff else suffix not in every or not fitting:
            return f"{suffix} (of a plug-in)", made
    if fitting and suffix not in fitting:
        suffix = fitting[0]
    found = _known(suffix, path, read=True)
    return found.name, found.reader


def _has_lines(of: LogFormat) -> bool:
    return isinstance(of.reader, type) and issubclass(of.reader, Lines)


def _first(path: Path, member: str = "") -> bytes:
    with ExitStack() as stack:
        return pull(open_log(path, stack, member)[0], _FIRST)[0]


#: A log of a file: its name within an archive, "" if that is none, its format, and what makes its reader.
_Log = tuple[str, str, Callable[[Path], Reader]]


class LogReader:
    """Reads a log in chunks, or all segments of a folder, one after the other; an iterable of batches, once.

    Lines and objects that are damaged are passed over, and told by ``problems``. An error that ends the log is raised
    after all frames before it: :class:`CutOffError` where the log ends before its end. One that ends a segment is told
    by ``problems``, too; the newest may be unfinished.

    Args:
        path: the file; its content tells the format, or else its suffix. Of several logs in a ``.zip`` one is read
            after the other, in the order of their names. A folder has the segments of ``gateway record``.
        channels: interface or channel in the file -> bus index; None puts all on bus 0. Frames of others are left
            out, and counted. Numbers count from 0 in all formats: ``0`` is CANalyzer's channel 1.
        zone: of the dates in headers of ASC, BLF and TRC, which have none; segments are in UTC.
        chunk: frames of a batch at most.

    Raises:
        InputError: unknown format or unreadable file; while reading: what ends it early.

    Attributes:
        formats: of the file, or of each log in an archive.
        bytes_total, bytes_done: size of the files, and how far reading is [byte].
        seen: frames of each interface or channel in the file so far, left out or not.
        passed_over: places that gave no frame.
        problems: damage that did not end reading, an error each kind.
        origin_ns: wall time of the log's begin, by its header, where stamps count from there; else 0 [ns].
    """

    def __init__(
        self,
        path: Path,
        channels: Mapping[str, int] | None = None,
        zone: tzinfo = UTC,
        *,
        chunk: int = CHUNK,
    ) -> None:
        self.path = path
        self._segmented = path.is_dir()
        self._chunk, self._channels, self._zone = chunk, channels, UTC if self._segmented else zone
        self._names = Names()
        self._counts = np.zeros(0, np.int64)
        self._passed: dict[Path, PassedOver] = {}
        self._ended: list[InputError] = []
        self.origin_ns = 0
        self._files: dict[Path, tuple[list[_Log], int]] = {}
        for file in segments(path) if self._segmented else [path]:
            try:
                self._files[file] = self._members(file), file.stat().st_size
            except (InputError, FileNotFoundError):
                if not self._segmented or file.exists():
                    raise
                log.warning("a segment was deleted by its recorder before it was read", file=str(file))
        if not self._passed:
            raise InputError("no recorded segments here (frames-000001-....log)", file=path)
        formats = [name for logs, _ in self._files.values() for _, name, _ in logs]
        self.formats = sorted(set(formats)) if self._segmented else formats
        self.bytes_total = sum(size for _, size in self._files.values())
        self.bytes_done = 0

    def _members(self, path: Path) -> list[_Log]:
        """Return the logs of a file."""
        passed = self._passed[path] = PassedOver()
        packed = compression_of(path)
        if packed != ARCHIVE:
            name = path.stem if packed else path.name
            try:
                first = _first(path)
            except InputError:
                if not is_format(Path(name).suffix):
                    _known(Path(name).suffix, path, read=True)
                raise
            return [("", *_maker(name, first, path))]
        found, wrong = [], None
        for name in members(path):
            try:
                plain = name[: len(name) - len(compression_of(Path(name)))]
                found.append((name, *_maker(plain, _first(path, name), path)))
            except InputError as error:
                wrong = error
                passed.add("a file in the archive that is no log", name, damaged=False)
        if wrong is not None and not found:
            raise wrong
        return found

    @property
    def seen(self) -> Counter[str]:
        """Frames of each interface or channel so far."""
        return Counter(dict(zip(self._names.known, self._counts.tolist(), strict=False)))

    @property
    def passed_over(self) -> PassedOver:
        """Places that gave no frame."""
        made = PassedOver()
        for passed in self._passed.values():
            made.take(passed)
        return made

    @property
    def problems(self) -> list[InputError]:
        """Damage that did not end reading."""
        return [error for file, passed in self._passed.items() for error in passed.errors(file)] + self._ended

    def __iter__(self) -> Iterator[Frames]:
        done = 0
        for file, (logs, size) in self._files.items():
            try:
                for member, _, make in logs:
                    for frames, raw in self._read(file, member, make):
                        self.bytes_done = done + (size if raw.closed else min(raw.tell(), size))
                        yield frames
            except InputError as error:
                if not self._segmented:
                    raise
                log.warning("the rest of a segment is left out", error=str(error))
                if file != next(reversed(self._files)) or not isinstance(error, CutOffError):
                    self._ended.append(error)
            done += size
            self.bytes_done = done

    def _read(self, path: Path, member: str, make: Callable[[Path], Reader]) -> Iterator[tuple[Frames, BinaryIO]]:
        """Yield the frames of a log of a file, and the file."""
        reader = make(path)
        if hasattr(reader, "zone"):
            reader.zone = self._zone
        with ExitStack() as stack:
            stream, raw = open_log(path, stack, member)
            try:
                for frames, channel in reader.read(stream, self._names, self._chunk):
                    self.origin_ns = reader.origin_ns
                    yield self._placed(frames, channel), raw
            except InputError:
                raise
            except Exception as error:  # a value that no format has
                raise damage(error, path, int(self._counts.sum())) from error
            finally:
                self._passed[path].take(reader.passed_over)

    def _placed(self, frames: Frames, channel: NDArray[np.int64]) -> Frames:
        """Count the frames of each channel, and leave out those of no bus."""
        errors = np.flatnonzero(frames["can_id"] & ERROR)
        if len(errors):
            ids = of_bus(frames["can_id"][errors])
            bare = (ids & (ERROR | ID_MASK) == ERROR) & (frames["length"][errors] == 0)
            frames["can_id"][errors] = np.where(bare, ERROR | PROTOCOL | BUS_ERROR, ids)
            frames["length"][errors[bare]] = 8  # the error frame of a logger that knows no classes
        known = self._names.known
        now = np.bincount(channel, minlength=len(known))
        counts = now.copy()
        counts[: len(self._counts)] += self._counts
        self._counts = counts
        if self._channels is None:
            return frames
        places = np.array([self._channels.get(name, -1) for name in known], np.int64)
        if (here := np.unique(places[now > 0])).size == 1:  # as of nearly every log: the frames need no look
            if here[0] > 0:  # bus 0 is what readers give them
                frames["bus"] = here[0]
            return frames[:0] if here[0] < 0 else frames
        buses = places[channel]
        kept = buses >= 0
        frames["bus"] = np.maximum(buses, 0)
        return frames if kept.all() else chosen(frames, kept)


class LogWriter:
    """Writes a log; a context manager.

    Args:
        path: the file; its suffix tells the format.
        interfaces: names of the buses, for candump and Parquet.

    Raises:
        InputError: unknown format, or the file cannot be written.
    """

    def __init__(self, path: Path, *, interfaces: Mapping[int, str] | None = None) -> None:
        of = _known(path.suffix.lower(), path, read=False)
        self._path, self._format = path, of.name
        try:
            self._sink = of.writer(path, interfaces)
        except OSError as error:
            raise InputError(error.strerror or str(error), file=path) from error

    def write(self, frames: Frames) -> None:
        """Append a batch."""
        self._sink.write(frames)

    @property
    def problems(self) -> list[InputError]:
        """Properties of the frames that the format cannot hold, as one error."""
        lost = Counter(getattr(self._sink, "lost", ()))
        what = ", ".join(f"{name} ({count} frames)" for name, count in lost.items() if count)
        text = f"{self._format} cannot hold all of these frames; not in this log: {what}"
        return [InputError(text, file=self._path)] if what else []

    def close(self) -> None:
        """Finish the file."""
        self._sink.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


#: Opens a log for writing.
open_writer = LogWriter

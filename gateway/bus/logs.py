"""Log files in and out: read by ourselves (:mod:`gateway.bus.readers`), written by us or python-can."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Protocol, Self, cast

import numpy as np
from numpy.typing import NDArray

from gateway.bus.candump import CandumpWriter
from gateway.bus.frames import Frames, chosen, to_message
from gateway.bus.log_source import ARCHIVE, COMPRESSIONS, compression_of, damage, members, open_log
from gateway.bus.parquet import ParquetWriter
from gateway.bus.readers.asc import Asc
from gateway.bus.readers.batch import Names, Reader
from gateway.bus.readers.blf import Blf
from gateway.bus.readers.candump import Candump
from gateway.bus.readers.csv import Csv
from gateway.bus.readers.mf4 import Mf4
from gateway.bus.readers.parquet import Parquet
from gateway.bus.readers.text import Lines, TextReader
from gateway.bus.readers.trc import Trc
from gateway.common.extras import need
from gateway.common.plugins import Registry
from gateway_fdi.errors import InputError

#: Suffix -> what it is.
FORMATS = {
    ".log": "candump",
    ".asc": "Vector ASC",
    ".blf": "Vector BLF",
    ".mf4": "ASAM MDF 4",
    ".trc": "PEAK trace",
    ".csv": "python-can CSV",
    ".parquet": "Parquet",
}
#: Formats that need an extra -> the extra, and its purpose.
_EXTRAS = {".mf4": ("mf4", "MF4 logs"), ".parquet": ("parquet", "logs in Parquet")}


def _accepted(found: object, name: str) -> Callable[[Path], Reader]:
    if not callable(found):
        raise InputError(f"no class of readers, but {type(found).__name__}", value=name)
    return cast("Callable[[Path], Reader]", found)


#: Suffix -> reader of another package's format.
READERS: Registry[Callable[[Path], Reader]] = Registry("gateway.readers", _accepted)

#: Formats of lines.
_LINES: dict[str, Callable[[Path], Lines]] = {".log": Candump, ".asc": Asc, ".trc": Trc, ".csv": Csv}
#: Frames of a batch at most.
CHUNK = 100_000


def is_format(suffix: str) -> bool:
    """Return whether files of a suffix are logs that can be read."""
    return suffix.lower() in FORMATS or suffix.lower() in READERS


def _format(name: str, path: Path, *, read: bool) -> str:
    """Return the suffix that tells a log's format.

    Args:
        name: of the log, without a compression's suffix.
        path: for errors.
        read: whether it is to be read.
    """
    suffix = Path(name).suffix.lower()
    if suffix not in FORMATS and not (read and suffix in READERS):
        known = ", ".join(f"{name} ({what})" for name, what in FORMATS.items())
        more = f"; to be read also with {', '.join(COMPRESSIONS)} after it" if read else ""
        raise InputError(f"a log is one of {known}{more}", file=path)
    if suffix in _EXTRAS:
        need(*_EXTRAS[suffix], file=path)
    return suffix


def _checked(path: Path) -> list[tuple[str, str]]:
    """Return the logs of a file: name within an archive, "" if it is none, and the suffix that tells the format."""
    packed = compression_of(path)
    if packed != ARCHIVE:
        return [("", _format(path.stem if packed else path.name, path, read=True))]
    return [(name, _format(name, path, read=True)) for name in members(path)]


def _reader(suffix: str, path: Path) -> Reader:
    """Return what reads a format."""
    if suffix == ".blf":
        return Blf(path)
    if suffix == ".mf4":
        return Mf4(path)
    if suffix == ".parquet":
        return Parquet(path)
    if suffix not in FORMATS:
        return READERS[suffix](path)
    return TextReader(path, _LINES[suffix](path))


class LogReader:
    """Reads a log in chunks; an iterable of batches, once.

    Frames before a damaged place are delivered, then the damage is raised: :class:`CutOffError` where the log ends
    before its end.

    Args:
        path: the file; its suffix tells the format. Of several logs in a ``.zip`` one is read after the other, in the
            order of their names.
        chunk: frames of a batch at most.
        channels: interface or channel in the file -> bus index; None puts all on bus 0. Frames of others are left
            out, and counted.

    Attributes:
        bytes_total, bytes_done: size of the file, and how far reading is [byte].
        seen: frames of each interface or channel in the file so far, left out or not.
        passed_over: lines or records that could not be read as frames, one text each.
        problems: damage that did not end reading; none in a single file.
        origin_ns: wall time of the log's begin, by its header, where stamps count from there; else 0 [ns].
    """

    def __init__(self, path: Path, *, chunk: int = CHUNK, channels: Mapping[str, int] | None = None) -> None:
        self._suffixes = _checked(path)
        self.path = path
        self._chunk = chunk
        self._channels = channels
        self._names = Names()
        self._counts = np.zeros(0, np.int64)
        self.passed_over: list[str] = []
        self.problems: list[InputError] = []
        self.origin_ns = 0
        try:
            self.bytes_total = path.stat().st_size
        except OSError as error:
            raise InputError(error.strerror or str(error), file=path) from error
        with ExitStack() as stack:
            open_log(path, stack)
        self.bytes_done = 0

    @property
    def seen(self) -> Counter[str]:
        """Frames of each interface or channel so far."""
        return Counter(dict(zip(self._names.known, self._counts.tolist(), strict=False)))

    def __iter__(self) -> Iterator[Frames]:
        for member, suffix in self._suffixes:
            reader = _reader(suffix, self.path)
            with ExitStack() as stack:
                stream, raw = open_log(self.path, stack, member)
                try:
                    for frames, channel in reader.read(stream, self._names, self._chunk):
                        self.bytes_done = self.bytes_total if raw.closed else min(raw.tell(), self.bytes_total)
                        self.origin_ns = reader.origin_ns
                        yield self._placed(frames, channel)
                except InputError:
                    raise
                except Exception as error:  # a value that no format has
                    raise damage(error, self.path, int(self._counts.sum())) from error
                finally:
                    self.passed_over += reader.passed_over
        self.bytes_done = self.bytes_total

    def _placed(self, frames: Frames, channel: NDArray[np.int64]) -> Frames:
        """Count the frames of each channel, and leave out those of no bus."""
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


def read_log(path: Path, *, chunk: int = CHUNK, channels: Mapping[str, int] | None = None) -> LogReader:
    """Open a log for reading (see :class:`LogReader`).

    Raises:
        InputError: unknown format or unreadable file; while reading: a damaged place.
    """
    return LogReader(path, chunk=chunk, channels=channels)


class _Sink(Protocol):
    def write(self, frames: Frames) -> None: ...

    def close(self) -> None: ...


class _PythonCanWriter:
    def __init__(self, path: Path) -> None:
        import can  # noqa: PLC0415 - slow to load

        self._logger = can.Logger(path)

    def write(self, frames: Frames) -> None:
        for frame in frames:
            self._logger.on_message_received(to_message(frame, channel=int(frame["bus"])))

    def close(self) -> None:
        self._logger.stop()


def _sink(suffix: str, path: Path, interfaces: Mapping[int, str] | None) -> _Sink:
    """Return what writes a format."""
    if suffix == ".log":
        return CandumpWriter(path.open("wb"), interfaces)
    if suffix == ".parquet":
        return ParquetWriter(path, interfaces)
    return _PythonCanWriter(path)


class LogWriter:
    """Writes a log; a context manager.

    Args:
        path: the file; its suffix tells the format.
        interfaces: names of the buses, for candump and Parquet.

    Raises:
        InputError: unknown format, or the file cannot be written.
    """

    def __init__(self, path: Path, *, interfaces: Mapping[int, str] | None = None) -> None:
        suffix = _format(path.name, path, read=False)
        try:
            self._sink = _sink(suffix, path, interfaces)
        except OSError as error:
            raise InputError(error.strerror or str(error), file=path) from error

    def write(self, frames: Frames) -> None:
        """Append a batch."""
        self._sink.write(frames)

    def close(self) -> None:
        """Finish the file."""
        self._sink.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def open_writer(path: Path, *, interfaces: Mapping[int, str] | None = None) -> LogWriter:
    """Open a log for writing (see :class:`LogWriter`)."""
    return LogWriter(path, interfaces=interfaces)

"""Log files in and out: candump by ourselves, all others by python-can."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from itertools import islice
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, BinaryIO, Protocol, Self

from gateway.bus.candump import CandumpWriter, cut_short, parse
from gateway.bus.frames import Frames, empty, put_message, to_message
from gateway.bus.log_source import (
    COMPRESSIONS,
    CutOffError,
    Records,
    TextLines,
    compression_of,
    damage,
    mf4_is_cut,
    open_log,
    take,
    tidy,
)
from gateway.common.extras import need
from gateway.errors import InputError

if TYPE_CHECKING:
    import can

#: Suffix -> what it is.
FORMATS = {
    ".log": "candump",
    ".asc": "Vector ASC",
    ".blf": "Vector BLF",
    ".mf4": "ASAM MDF 4",
    ".trc": "PEAK trace",
    ".csv": "python-can CSV",
}


def _checked_suffix(path: Path, *, read: bool) -> str:
    """Return the suffix that tells the format; logs to read may be compressed."""
    packed = compression_of(path)
    suffix = Path(path.stem).suffix.lower() if packed and read else path.suffix.lower()
    if suffix not in FORMATS:
        known = ", ".join(f"{name} ({what})" for name, what in FORMATS.items())
        more = f"; to be read also with {', '.join(COMPRESSIONS)} after it" if read else ""
        raise InputError(f"a log is one of {known}{more}", file=path)
    if suffix == ".mf4":
        need("mf4", "MF4 logs", file=path)
    return suffix


class _Warnings(logging.Handler):
    """Counts what python-can's readers pass over."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.texts: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.texts.append(" ".join(record.getMessage().split()))


class LogReader:
    """Reads a log in chunks; an iterable of batches, once.

    Frames before a damaged place are delivered, then the damage is raised: :class:`CutOffError` where the log ends
    before its end.

    Args:
        path: the file; its suffix tells the format.
        chunk: frames of a batch.
        channels: interface or channel in the file -> bus index; None puts all on bus 0. Frames of others are left
            out, and counted.

    Attributes:
        bytes_total, bytes_done: size of the file, and how far reading is [byte].
        seen: frames of each interface or channel in the file so far, left out or not.
        passed_over: what was no frame that can be read, one text each.
        problems: damage that did not end reading; none in a single file.
    """

    def __init__(self, path: Path, *, chunk: int = 100_000, channels: Mapping[str, int] | None = None) -> None:
        self._suffix = _checked_suffix(path, read=True)
        self.path = path
        self._chunk = chunk
        self._channels = channels
        self.seen: Counter[str] = Counter()
        self.passed_over: list[str] = []
        self.problems: list[InputError] = []
        try:
            self.bytes_total = path.stat().st_size
        except OSError as error:
            raise InputError(error.strerror or str(error), file=path) from error
        with ExitStack() as stack:
            open_log(path, stack)
        self.bytes_done = 0

    def __iter__(self) -> Iterator[Frames]:
        with ExitStack() as stack:
            stream, raw = open_log(self.path, stack)
            yield from (self._candump(stream, raw) if self._suffix == ".log" else self._python_can(stream, raw))
        self.bytes_done = self.bytes_total

    def _candump(self, stream: BinaryIO, raw: BinaryIO) -> Iterator[Frames]:
        line, before = 1, empty(0)
        file = iter(stream)
        while True:
            lines, broken = take(file, self._chunk)
            if not lines and broken is None:
                return
            frames, wrong = parse(lines, line, self.path, self._channels, self.seen)
            line += len(lines)
            if wrong is None and lines and not lines[-1].endswith(b"\n"):
                frames, wrong = self._without_cut(frames, before, lines[-1], line - 1)
            if len(frames):
                before = frames
                self.bytes_done = raw.tell()
                yield frames
            if wrong is None and broken is not None:
                wrong = damage(broken, self.path, self.seen.total())
            if wrong is not None:
                raise wrong

    def _without_cut(
        self, frames: Frames, before: Frames, line: bytes, number: int
    ) -> tuple[Frames, InputError | None]:
        """Take the frame of a last line without an end away if it is shorter than others of its identifier."""
        if not len(frames) or not cut_short(frames, before):
            return frames, None
        self.seen[line.split()[1].decode("ascii", "replace")] -= 1
        shown = line[:60].decode("ascii", "replace")
        text = "cut off in this line: it has no end, and its frame is shorter than the one before"
        return frames[:-1], CutOffError(text, file=self.path, line=number, value=shown)

    def _python_can(self, stream: BinaryIO, raw: BinaryIO) -> Iterator[Frames]:
        warnings, log = _Warnings(), logging.getLogger("can")
        log.addHandler(warnings)
        messages = self._messages(stream)
        try:
            while True:
                frames = empty(self._chunk)
                filled, taken = 0, 0
                wrong: Exception | None = None
                try:
                    for message in islice(messages, self._chunk):
                        taken += 1
                        name = "none" if message.channel is None else str(message.channel)
                        bus = 0
                        if self._channels is not None:
                            found = self._channels.get(name)
                            if found is None:
                                self.seen[name] += 1
                                continue
                            bus = found
                        put_message(frames, filled, message, bus=bus)
                        self.seen[name] += 1
                        filled += 1
                except Exception as error:  # each reader lets its parser's exceptions through
                    wrong = error
                if filled:
                    self.bytes_done = self.bytes_total if raw.closed else raw.tell()
                    yield frames[:filled]
                if wrong is not None:
                    raise damage(wrong, self.path, self.seen.total()) from None
                if taken < self._chunk:
                    return
        finally:
            log.removeHandler(warnings)
            self.passed_over = warnings.texts

    def _messages(self, stream: BinaryIO) -> Iterator[can.Message]:
        """Yield python-can's messages; at the end, that the log was cut off."""
        from can.io.player import MESSAGE_READERS  # noqa: PLC0415 - slow to load

        kind: Any = MESSAGE_READERS[self._suffix]
        if self._suffix == ".mf4":
            yield from self._mf4(stream, kind)
        elif self._suffix == ".blf":
            records = Records(stream)
            reader = kind(records)
            yield from reader
            if cut := records.cut(reader, self.path, self.seen.total()):
                raise cut
        else:
            yield from self._lines(TextLines(stream), kind)

    def _mf4(self, stream: BinaryIO, kind: Any) -> Iterator[can.Message]:
        # asammdf maps a file that has a name, and reads another one whole.
        source: Any = stream if compression_of(self.path) else self.path
        cut = not compression_of(self.path) and mf4_is_cut(self.path)
        try:
            with tidy():
                reader = kind(source)
            try:
                yield from reader
            finally:
                reader.stop()
        except EOFError:
            raise
        except Exception as error:
            if not cut:
                raise
            text = " ".join(str(error).split()) or type(error).__name__
            raise CutOffError(f"cut off after frame {self.seen.total()}: {text}", file=self.path) from None
        if cut:
            raise CutOffError(f"cut off after frame {self.seen.total()}", file=self.path)

    def _lines(self, lines: TextLines, kind: Any) -> Iterator[can.Message]:
        last, wrong = None, None
        messages = iter(kind(lines))
        while True:
            try:
                message = next(messages)
            except StopIteration:
                break
            except Exception as error:  # each reader lets its parser's exceptions through
                wrong = error
                break
            if lines.open_end is None:
                yield message
            else:
                last = message
        if wrong is not None and lines.open_end is None:
            raise wrong
        if wrong is not None or lines.cut_line(last):
            text = f"cut off after frame {self.seen.total()}, in its last line"
            raise CutOffError(text, file=self.path, value=(lines.open_end or "")[:60]) from wrong
        if last is not None:
            yield last
        if lines.block:
            text = f"cut off after frame {self.seen.total()}: its trigger block has no end"
            raise CutOffError(text, file=self.path)


def read_log(path: Path, *, chunk: int = 100_000, channels: Mapping[str, int] | None = None) -> LogReader:
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


class LogWriter:
    """Writes a log; a context manager.

    Args:
        path: the file; its suffix tells the format.
        interfaces: names of the buses, for candump.

    Raises:
        InputError: unknown format, or the file cannot be written.
    """

    def __init__(self, path: Path, *, interfaces: Mapping[int, str] | None = None) -> None:
        suffix = _checked_suffix(path, read=False)
        try:
            self._sink: _Sink = (
                CandumpWriter(path.open("wb"), interfaces) if suffix == ".log" else _PythonCanWriter(path)
            )
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

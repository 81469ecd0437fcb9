"""Log files in and out: candump by ourselves, all others by python-can."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import islice
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Protocol, Self

from gateway.bus.candump import CandumpWriter, parse
from gateway.bus.frames import Frames, empty, put_message, to_message
from gateway.errors import InputError
from gateway.extras import need

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


def _checked_suffix(path: Path) -> str:
    suffix = path.suffix.lower()
    if suffix not in FORMATS:
        known = ", ".join(f"{name} ({what})" for name, what in FORMATS.items())
        raise InputError(f"a log is one of {known}", file=path)
    if suffix == ".mf4":
        need("mf4", "MF4 logs", file=path)
    return suffix


class LogReader:
    """Reads a log in chunks; an iterable of batches, once.

    Frames before a damaged place are delivered, then the damage is raised.

    Args:
        path: the file; its suffix tells the format.
        chunk: frames of a batch.
        channels: interface or channel in the file -> bus index; None puts all on bus 0.

    Attributes:
        bytes_total, bytes_done: size of the file, and how far reading is [byte].
    """

    def __init__(
        self, path: Path, *, chunk: int = 100_000, channels: Mapping[str, int] | None = None
    ) -> None:
        self._suffix = _checked_suffix(path)
        self.path = path
        self._chunk = chunk
        self._channels = channels
        try:
            self.bytes_total = path.stat().st_size
            path.open("rb").close()
        except OSError as error:
            raise InputError(error.strerror or str(error), file=path) from error
        self.bytes_done = 0

    def __iter__(self) -> Iterator[Frames]:
        return self._candump() if self._suffix == ".log" else self._python_can()

    def _candump(self) -> Iterator[Frames]:
        with self.path.open("rb") as file:
            line = 1
            while lines := list(islice(file, self._chunk)):
                frames, wrong = parse(lines, line, self.path, self._channels)
                line += len(lines)
                self.bytes_done = file.tell() if wrong is None else self.bytes_done
                if len(frames):
                    yield frames
                if wrong is not None:
                    raise wrong
        self.bytes_done = self.bytes_total

    def _python_can(self) -> Iterator[Frames]:
        count = 0
        messages = self._messages()
        while True:
            frames = empty(self._chunk)
            filled = 0
            wrong: Exception | None = None
            try:
                for message in islice(messages, self._chunk):
                    bus = 0
                    if self._channels is not None:
                        found = self._channels.get(str(message.channel))
                        if found is None:
                            continue
                        bus = found
                    put_message(frames, filled, message, bus=bus)
                    filled += 1
            except InputError as error:
                wrong = error
            except Exception as error:  # each reader lets its parser's exceptions through
                wrong = error
            count += filled
            if filled:
                yield frames[:filled]
            if wrong is not None:
                text = " ".join(str(wrong).split()) or type(wrong).__name__
                raise InputError(f"damaged after frame {count}: {text}", file=self.path) from wrong
            if filled == 0:
                self.bytes_done = self.bytes_total
                return

    def _messages(self) -> Iterator[can.Message]:
        import can  # noqa: PLC0415 - slow to load

        with can.LogReader(self.path) as reader:
            file = getattr(reader, "file", None)
            for number, message in enumerate(reader):
                if number % 4096 == 0 and file is not None and not file.closed:
                    try:
                        self.bytes_done = file.tell()
                    except OSError:  # text files cannot tell while being iterated
                        file = None
                yield message


def read_log(
    path: Path, *, chunk: int = 100_000, channels: Mapping[str, int] | None = None
) -> LogReader:
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
        suffix = _checked_suffix(path)
        try:
            self._sink: _Sink = (
                CandumpWriter(path.open("wb"), interfaces)
                if suffix == ".log"
                else _PythonCanWriter(path)
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

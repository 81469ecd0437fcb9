"""``gateway replay --signals``, ``--plot`` and ``gateway plot``: values of monitors, as a file and as a picture."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from gateway.runtime.app import Gateway
from gateway.runtime.assemble import Parts
from gateway_fdi.errors import InputError, named
from gateway_replay.replay import FrameConsumer
from gateway_replay.series.envelope import Envelope
from gateway_replay.series.files import open_series, read_series
from gateway_replay.series.gather import Fed, Gatherer
from gateway_replay.series.rows import Series, Sink

_PICTURES = (".svg", ".png", ".pdf")


def _picture(path: Path, key: str) -> None:
    """Refuse what is no picture.

    Raises:
        InputError: another suffix.
    """
    if path.suffix.lower() not in _PICTURES:
        raise InputError(f"a picture is {', '.join(_PICTURES)}", key=key, value=str(path))


class Watched:
    """Outputs that are asked of a replay beside its events.

    Args:
        series: file to be written, None: none.
        plot: picture to be drawn, None: none.
        chosen: signals that are wanted beside what monitors compute.

    Raises:
        InputError: a file of no such kind, a package that is missing, signals for nothing.
    """

    def __init__(self, series: Path | None, plot: Path | None, chosen: Sequence[str]) -> None:
        self.notes: list[str] = []
        self._series, self._plot, self._chosen = series, plot, chosen
        if chosen and series is None and plot is None:
            raise InputError("goes with --signals or --plot", key="--signal", value=chosen[0])
        if plot is not None:
            _picture(plot, "--plot")
        self._file = None if series is None else open_series(series, key="--signals")

    @contextmanager
    def of(self, gateway: Gateway, parts: Parts, fed: Fed) -> Iterator[FrameConsumer]:
        """Yield the taker of the log's frames; the files are complete after it.

        Args:
            gateway: not started yet.
            parts: of it.
            fed: the gateway, or what feeds it.
        """
        if self._file is None and self._plot is None:
            yield fed
            return
        envelope = Envelope()
        sinks: list[Sink] = [self._file] if self._file is not None else []
        if self._plot is not None:
            sinks.append(envelope)
        slots = {name: parts.slots[name] for name in dict.fromkeys(self._chosen)}
        gatherer = Gatherer(gateway, sinks, slots, fed=fed)
        try:
            yield gatherer
        finally:
            gatherer.close()
        if self._file is not None:
            self.notes.append(f"{gatherer.rows} rows of {gatherer.count} series: {self._series}")
        if self._plot is not None:
            self.notes += _drawn(self._plot, envelope, str(gateway.config.name or "replay"))


def _drawn(path: Path, envelope: Envelope, title: str) -> list[str]:
    from gateway_replay.cli.series_figures import draw  # noqa: PLC0415 - slow to load

    return [f"drawn: {path}", *draw(path, envelope, title)]


def plot_file(series: Path, output: Path, only: Sequence[str]) -> int:
    """Draw a file of series; returns the exit code.

    Raises:
        InputError: it is none; a name that it does not have.
    """
    _picture(output, "--output")
    names: set[str] = set()

    def wanted(one: Series) -> bool:
        own = (one.monitor, one.name, f"{one.monitor}.{one.name}")  # the last as lines of DTCs have it
        names.update(own)
        return not only or any(name in only for name in own)

    envelope = Envelope(wanted)
    for rows, known in read_series(series, key="SERIES"):
        envelope.write(rows, known)
    for name in only:
        if name not in names:
            known_names = {each for each in names if not each.startswith(".")} - {""}
            raise InputError(named("series of the file:", name, known_names), key="--only", value=name)
    for line in _drawn(output, envelope, series.stem):
        print(line)
    return 0

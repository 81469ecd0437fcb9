"""Healthy logs: replayed, each with a gateway of its own, and named by their contents."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np

from gateway.bus.frames import Frames
from gateway.bus.logs import LogReader
from gateway.bus.timeline import LogTime
from gateway.config.answer_bus import AnswerBus
from gateway.config.model import Config
from gateway.config.monitor_types import monitor_of
from gateway.monitors.contract import Calibration, CusumCalibration, MonitorParams, Refinement, SensorCalibration
from gateway.runtime.app import Gateway
from gateway.signals.tables import DecodePlan
from gateway_ask.log_answers import Answers
from gateway_fdi.errors import InputError, InputErrors
from gateway_replay.channels import channels_of
from gateway_replay.log_contents import contents

Progress = Callable[[int], None]
Kind = TypeVar("Kind", Calibration, CusumCalibration, Refinement, SensorCalibration)


@dataclass(frozen=True)
class Reading:
    """How healthy logs are read.

    Attributes:
        file: of the configuration, for errors.
        maps: channels of the logs taken as buses, ``"channel=bus"`` each.
        progress: called with the number of frames after each batch.
    """

    file: Path | None = None
    maps: Sequence[str] = ()
    progress: Progress = lambda _: None


@dataclass(frozen=True)
class Chosen(Generic[Kind]):
    """A monitor that logs can calibrate.

    Attributes:
        place: in the configuration.
        name: of the monitor.
        calibration: the values that it lets be set.
        params: its parameters.
    """

    place: int
    name: str
    calibration: Kind
    params: MonitorParams


def of_kind(config: Config, kind: type[Kind]) -> list[Chosen[Kind]]:
    """Return the monitors of a configuration that can be calibrated in one way."""
    found = []
    for place, entry in enumerate(config.monitor):
        monitor, params = monitor_of(entry)
        calibration = monitor.capability(kind)
        if calibration is not None:
            found.append(Chosen(place, entry.name, calibration, params))
    return found


def refuse(what: str, file: Path | None) -> InputError:
    """Return the error of a configuration that has none."""
    return InputError(f"no monitor here has {what} that logs can set", file=file, key="monitor")


def digest(logs: Iterable[Path]) -> str:
    """Return the first 12 digits of the SHA-256 of the logs' contents."""
    total = hashlib.sha256()
    for path in logs:
        files = sorted(path.iterdir()) if path.is_dir() else [path]
        for file in files:
            with file.open("rb") as stream:
                while block := stream.read(1 << 20):
                    total.update(block)
    return total.hexdigest()[:12]


class NothingToLearnError(InputErrors):
    """A log of which nothing is to be learnt.

    Args:
        errors: of the log.
        state: of its contents (:class:`gateway_replay.log_contents.Contents`).
    """

    def __init__(self, errors: list[InputError], state: str) -> None:
        super().__init__(errors)
        self.state = state


def read_even(config: Config, path: Path, maps: Sequence[str] = ()) -> Iterator[tuple[Frames, float]]:
    """Yield a log's frames in even time, batch by batch, without empty ones, and how far the log is then, 0 to 1.

    Raises:
        InputError, InputErrors: the log is damaged, cut off, or holds no frame of a configured bus: nothing is to be
            learnt from such a one.
    """
    channels = channels_of(config, maps)
    reader = LogReader(path, channels)
    time = LogTime()
    for frames in reader:
        if len(frames):
            yield time.apply(frames), reader.bytes_done / max(reader.bytes_total, 1)
    buses = {bus.name: bus.channel for bus in config.bus}
    found = contents(reader, buses, channels)
    if found.wrong:
        raise NothingToLearnError(found.wrong, found.state)


def read_answered(
    config: Config, answers: Sequence[AnswerBus], plan: DecodePlan, path: Path, maps: Sequence[str]
) -> Iterator[tuple[Frames, float]]:
    """Yield a healthy log as :func:`read_even` does, with the frames of answers and of messages of several frames."""
    heard = Answers(config, answers, plan)
    for frames, done in read_even(config, path, maps):
        yield heard.add(frames), done


def parts(frames: Frames, end_ns: int, block_ns: int) -> Iterator[tuple[Frames, bool]]:
    """Yield parts of a batch; True after a part at whose end a block ends."""
    first = 0
    while first < len(frames):
        last = int(np.searchsorted(frames["t_ns"], end_ns))
        yield frames[first:last], last < len(frames)
        if last >= len(frames):
            return
        first = last
        end_ns += block_ns


class Replay:
    """A gateway of its own for one healthy log; it is closed at the end of ``with``.

    Attributes:
        gateway: that the log's frames are fed to.
        failed: DTCs that the log sets.
        begun_ns, last_ns: time of the log's first and latest frame, 0 before it.
    """

    def __init__(self, config: Config, how: Reading) -> None:
        self._config, self._how = config, how
        self.gateway = Gateway(config, None, file=how.file)
        self.failed: set[str] = set()
        self.begun_ns = self.last_ns = 0
        self.gateway.listen(lambda event: self.failed.add(str(event["dtc"])) if event["event"] == "dtc" else None)

    def __enter__(self) -> Replay:
        return self

    def __exit__(self, *_: object) -> None:
        self.gateway.close()

    @property
    def seconds(self) -> float:
        """How long the log is so far [s]."""
        return (self.last_ns - self.begun_ns) * 1e-9

    def frames(self, log: Path) -> Iterator[Frames]:
        """Yield a log's frames without the gateway's own, batch by batch, to be fed; it is started with the first.

        Raises:
            InputError, InputErrors: as of :func:`read_even`.
        """
        for frames, _ in read_even(self._config, log, self._how.maps):
            if not self.begun_ns:
                self.begun_ns = int(frames[0]["t_ns"])
                self.gateway.start(self.begun_ns)
            yield self.gateway.without_own(frames)
            self.last_ns = int(frames[-1]["t_ns"])
            self._how.progress(len(frames))

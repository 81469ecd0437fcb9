"""Always the last hours of raw frames: segments in a folder, the oldest given up for the newest.

A batch is with the operating system before :meth:`Ring.write` returns, so that ``kill -9`` loses nothing of a candump
segment; BLF is written in compressed containers, of which the last may be lost.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal

from pydantic import Field

from gateway.bus.frames import Frames
from gateway.bus.log_source import number_of, segments
from gateway.bus.logs import LogWriter, open_writer
from gateway_fdi.common.log import get_logger
from gateway_fdi.common.tomlfile import StrictModel
from gateway_fdi.errors import InputError

#: Time from a failure (disk full) to the next attempt [s].
PAUSE_S = 1.0

log = get_logger(__name__)


class RingParams(StrictModel):
    """An always-on recording of all frames."""

    folder: Path = Field(description="where the segments are; relative to the work folder")
    keep_mb: float = Field(256.0, gt=0, le=1e7, allow_inf_nan=False, description="size of all segments [MB]")
    segment_mb: float = Field(16.0, gt=0, le=1e5, allow_inf_nan=False, description="size of a segment [MB]")
    segment_s: float = Field(600.0, gt=0, le=1e6, allow_inf_nan=False, description="longest time of a segment [s]")
    format: Literal["log", "blf"] = Field(
        "log", description="log: candump, nothing lost at kill -9; blf: a third of the size"
    )


class Ring:
    """Writes segments, and deletes the oldest beyond the size asked for.

    Raises:
        InputError: the folder cannot be made or written.

    Attributes:
        lost: frames that could not be written.
    """

    def __init__(self, params: RingParams, interfaces: Mapping[int, str]) -> None:
        self._params = params
        self._interfaces = dict(interfaces)
        self._writer: LogWriter | None = None
        self._path = params.folder
        self._first_ns = 0
        self._resume = 0.0
        self.lost = 0
        try:
            params.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"not usable for recordings: {error.strerror}", file=params.folder) from error
        self._next = max(map(number_of, segments(params.folder)), default=0) + 1

    def write(self, frames: Frames) -> None:
        """Append a batch; frames that cannot be written are counted, and stop nothing."""
        if not len(frames):
            return
        if self._writer is None and time.monotonic() < self._resume:
            self.lost += len(frames)
            return
        try:
            self._write(frames)
        except (OSError, InputError) as error:
            self.lost += len(frames)
            self._resume = time.monotonic() + PAUSE_S
            log.warning("frames not recorded", folder=str(self._params.folder), error=str(error))
            self.close()

    def _write(self, frames: Frames) -> None:
        t_ns = int(frames[0]["t_ns"])
        if self._writer is None:
            self._begin(t_ns)
        assert self._writer is not None
        self._writer.write(frames)
        full = self._path.stat().st_size >= self._params.segment_mb * 1e6
        if full or abs(t_ns - self._first_ns) >= self._params.segment_s * 1e9:
            self.close()

    def _begin(self, t_ns: int) -> None:
        self._trim()
        stamp = datetime.fromtimestamp(t_ns // 10**9, UTC).strftime("%Y%m%dT%H%M%SZ")
        name = f"frames-{self._next:06d}-{stamp}.{self._params.format}"
        self._path = self._params.folder / name
        self._next += 1
        self._first_ns = t_ns
        self._writer = open_writer(self._path, interfaces=self._interfaces)

    def _trim(self) -> None:
        """Delete the oldest segments until another one has room."""
        found = segments(self._params.folder)
        room = (self._params.keep_mb - self._params.segment_mb) * 1e6
        sizes = [path.stat().st_size for path in found]
        while found and sum(sizes) > max(room, 0.0):
            found.pop(0).unlink()
            sizes.pop(0)

    def close(self) -> None:
        """Finish the segment."""
        writer, self._writer = self._writer, None
        if writer is not None:
            try:
                writer.close()
            except OSError as error:
                log.warning("segment not finished", file=str(self._path), error=str(error))

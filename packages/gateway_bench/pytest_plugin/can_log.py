"""All frames of a bench, for a test to look at and for people to replay."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from gateway.bus.frames import EXTENDED, Frames, empty, payload
from gateway.bus.logs import open_writer
from gateway_bench.pytest_plugin.bench import Bench

if TYPE_CHECKING:
    from cantools.database.can import Message


class CanLog:
    """The frames of all buses from now on, in order of time; the gateway's are among them.

    Args:
        bench: whose frames.
        path: of the file that a failed test leaves.
    """

    def __init__(self, bench: Bench, path: Path) -> None:
        self._bench, self.path = bench, path
        self._parts: list[Frames] = []
        bench.on_frames(lambda frames: self._parts.append(frames.copy()))

    @property
    def frames(self) -> Frames:
        """Shape (n,) of FRAME."""
        frames = np.concatenate(self._parts) if self._parts else empty(0)
        return frames[np.argsort(frames["t_ns"], kind="stable")]

    def of(self, message: str) -> list[tuple[float, dict[str, Any]]]:
        """Return a message's frames as cantools decodes them: time [s], signals; of those cut short what is there.

        Raises:
            InputError: no bus has such a message.
        """
        databases = self._bench.gateway.databases
        bus = next((k for k, each in enumerate(databases) if any(one.name == message for one in each)), 0)
        found = databases[bus].message(message)
        can_id = found.frame_id | (EXTENDED if found.is_extended_frame else 0)
        frames = self.frames
        mine = frames[(frames["can_id"] == can_id) & (frames["bus"] == bus)]
        return [(frame["t_ns"] / 1e9, _values(found, payload(frame))) for frame in mine]

    def write(self, path: Path | None = None) -> Path:
        """Write a log that ``gateway replay`` and others read; returns its path, by default ``path``."""
        if path is None:
            path = self.path
            path.parent.mkdir(parents=True, exist_ok=True)
        with open_writer(path) as writer:
            writer.write(self.frames)
        return path


def _values(message: Message, data: bytes) -> dict[str, Any]:
    return dict(cast("dict[str, Any]", message.decode(data, decode_choices=False, allow_truncated=True)))

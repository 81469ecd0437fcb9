"""Writes candump logs: our native recording, because it keeps integer nanoseconds (see ``readers.candump``)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import BinaryIO

import numpy as np

from gateway.bus.frames import BRS, ERROR, ESI, EXTENDED, FD, ID_MASK, OWN, REMOTE, Frames, payload


def format_frame(frame: np.void, interface: str) -> str:
    """Return one frame as a line, without its end."""
    t_ns, can_id, flags = int(frame["t_ns"]), int(frame["can_id"]), int(frame["flags"])
    kept = ~EXTENDED if can_id & ERROR else ID_MASK if can_id & EXTENDED else 0x7FF
    name = f"{can_id & kept:0{3 if kept == 0x7FF else 8}X}"
    data = payload(frame).hex().upper()
    if can_id & REMOTE:
        body = f"{name}#R{int(frame['length']) or ''}"
    elif flags & FD:
        bits = (1 if flags & BRS else 0) | (2 if flags & ESI else 0)
        body = f"{name}##{bits:X}{data}"
    else:
        body = f"{name}#{data}"
    sent = " T" if flags & OWN else ""
    return f"({t_ns // 10**9}.{t_ns % 10**9:09d}) {interface} {body}{sent}"


class CandumpWriter:
    """Writes a candump log into a file, which it closes, flushed after each batch; ``interfaces``: name of each bus."""

    def __init__(self, file: BinaryIO, interfaces: Mapping[int, str] | None = None) -> None:
        self._file = file
        self._interfaces = interfaces or {}

    def write(self, frames: Frames) -> None:
        """Append a batch."""
        lines = [
            format_frame(frame, self._interfaces.get(int(frame["bus"]), f"can{int(frame['bus'])}")) for frame in frames
        ]
        if lines:
            self._file.write(("\n".join(lines) + "\n").encode("ascii"))
            self._file.flush()

    def close(self) -> None:
        """Close the file."""
        self._file.close()

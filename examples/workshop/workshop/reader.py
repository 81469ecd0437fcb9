"""Logs of the workshop's bench, ``.bench``: a line a frame, time [us], channel, identifier, payload.

::

    1500 can0 1A0 0011223344556677
"""

from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import numpy as np

from gateway.bus.frames import Frames, empty, put
from gateway.bus.readers.batch import Names


class BenchLog:
    """Reads one log.

    Args:
        path: of the file, for messages.
    """

    origin_ns = 0  # stamps count from the log's begin

    def __init__(self, path: Path) -> None:
        self.path = path
        self.passed_over: list[str] = []

    def read(self, stream: BinaryIO, names: Names, chunk: int) -> Iterator[tuple[Frames, np.ndarray]]:
        """Yield batches: frames of shape (n,), and the place of each frame's channel among the names, shape (n,)."""
        frames, channels = empty(chunk), np.zeros(chunk, np.int64)
        count = 0
        for number, line in enumerate(stream, 1):
            try:
                time_us, channel, can_id, payload = line.split()
                put(frames, count, int(time_us) * 1000, int(can_id, 16), bytes.fromhex(payload.decode()))
            except ValueError:
                self.passed_over.append(f"line {number}: {line.decode(errors='replace').strip()}")
                continue
            channels[count] = names.place(channel.decode())
            count += 1
            if count == chunk:
                yield frames, channels
                frames, channels, count = empty(chunk), np.zeros(chunk, np.int64), 0
        yield frames[:count], channels[:count]

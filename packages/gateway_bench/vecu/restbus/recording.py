"""A signal's course in a recorded log."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gateway.bus.logs import LogReader
from gateway.signals.database import Database
from gateway.signals.protection.protection import Protection
from gateway.signals.signal_access import ChangedMessage, ChangedSignal, words_of
from gateway_bench.vecu.restbus.courses import Log
from gateway_fdi.errors import InputError, InputErrors

Values = NDArray[np.float64]


@lru_cache(maxsize=64)
def _points(database: Database, file: Path, channel: str | None, name: str, _changed_ns: int) -> Values:
    message, _, own = name.rpartition(".")
    wanted = ChangedMessage(0, database, message, Protection())
    signal = ChangedSignal(0, database, message, own)
    times: list[int] = []
    values: list[float] = []
    start = None
    reader = LogReader(file, channels=None if channel is None else {channel: 0})
    for frames in reader:
        start = int(frames["t_ns"][0]) if start is None and len(frames) else start
        for frame in frames[wanted.among(frames)]:
            value = signal.value(words_of(frame), int(frame["length"]))
            if not np.isnan(value) and (not times or frame["t_ns"] > times[-1]):
                times.append(int(frame["t_ns"]))
                values.append(value)
    if reader.problems:
        raise InputErrors(reader.problems)
    if not times:
        seen = ", ".join(sorted(reader.seen)) or "nothing"
        of = f"channel {channel} (the log has {seen})" if channel is not None else "the log"
        raise InputError(f"no frame of {of} carries this signal", key="log.signal", value=name)
    return np.column_stack([(np.asarray(times) - (start or 0)) * 1e-9, values])


def points_of(course: Log, name: str, database: Database) -> Values:
    """Return times since the log's first frame, or since ``from_s`` [s], and values, shape (n, 2).

    Args:
        course: where it is.
        name: "Message.Signal" that has the course.
        database: of the bus.

    Raises:
        InputError: a log that cannot be read, or has no such signal.
    """
    points = _points(database, course.file, course.channel, course.signal or name, course.file.stat().st_mtime_ns)
    points = points - [course.from_s, 0.0]
    begin = max(int(np.searchsorted(points[:, 0], 0.0, side="right")) - 1, 0)
    return np.asarray(points[begin:], np.float64)

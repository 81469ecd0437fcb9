"""Logic-analyser captures of a crank sensor: CSV of time and levels, into pulse times."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gateway_fdi.errors import InputError


@dataclass(frozen=True)
class Capture:
    """Edges of one channel.

    Attributes:
        times_ns: shape (n,), rising [ns].
    """

    times_ns: NDArray[np.int64]

    @property
    def edges(self) -> int:
        """Number of edges."""
        return len(self.times_ns)

    @property
    def duration_s(self) -> float:
        """From the first edge to the last [s]."""
        return float(self.times_ns[-1] - self.times_ns[0]) / 1e9 if self.edges else 0.0


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _column(header: list[str] | None, width: int, channel: str, path: Path) -> int:
    """Return the column of a channel given by number or by name."""
    names = [] if header is None else [name.strip() for name in header[1:]]
    if channel in names:
        return 1 + names.index(channel)
    if channel.isdigit() and int(channel) + 1 < width:
        return int(channel) + 1
    known = f"names {', '.join(names)} or " if names else ""
    raise InputError(
        f"no such channel; there are {known}numbers 0 to {width - 2}",
        file=path,
        key="channel",
        value=channel,
    )


def read_capture(path: Path, *, channel: str = "0", edge: str = "falling") -> Capture:
    """Read the edges of one channel.

    The file has a row for each change of any channel: time [s], then each channel's level after it; a header
    line may come first. Rows in which the channel keeps its level are passed over; the first row only tells
    the level.

    Args:
        path: CSV file.
        channel: number from 0, or its name in the header.
        edge: ``rising`` or ``falling``.

    Raises:
        InputError: not readable, no such channel, or a row that is wrong (with its line).
    """
    wanted = {"rising": 1, "falling": 0}[edge]
    times: list[int] = []
    header: list[str] | None = None
    column = 0
    level: int | None = None
    last_s = -np.inf
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            for line, row in enumerate(csv.reader(file), start=1):
                if not row or not "".join(row).strip():
                    continue
                if column == 0:
                    if not _is_number(row[0]) and header is None:
                        header = row
                        continue
                    column = _column(header, len(row), channel, path)
                try:
                    t_s, now = float(row[0]), int(float(row[column]))
                except (ValueError, IndexError, OverflowError) as error:
                    raise InputError(
                        "a row is a time [s] and the level 0 or 1 of each channel",
                        file=path,
                        line=line,
                        value=",".join(row),
                    ) from error
                if now not in (0, 1) or not np.isfinite(t_s):
                    raise InputError(
                        "a level is 0 or 1, a time a number [s]",
                        file=path,
                        line=line,
                        value=",".join(row),
                    )
                if t_s < last_s:
                    raise InputError("time runs backwards", file=path, line=line, value=row[0])
                last_s = t_s
                if level is not None and now != level and now == wanted:
                    times.append(round(t_s * 1e9))
                level = now
    except OSError as error:
        raise InputError(error.strerror or str(error), file=path) from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"not a CSV text file: {error}", file=path) from error
    if level is None:
        raise InputError("the capture holds no rows", file=path)
    return Capture(np.unique(np.asarray(times, np.int64)))

"""PEAK's TRC, file versions 1.0, 1.1, 1.3, 2.0 and 2.1.

Lines are, with the columns of each version::

    1)      1841 0001 8 00 00 00 00 00 00 00 00                1.0: number, time, identifier, length
    1)    1059.9 Rx     0300  7  00 00 00 00 04 00 00           1.1: number, time, type, identifier, length
    1)    1059.9  1  Rx     0300 -  7  00 00 00 00 04 00 00     1.3: with a bus, and a reserved column
    1    1059.900 DT     0300 Rx 7  00 00 00 00 04 00 00        2.x: as its header says ($COLUMNS)

Times are milliseconds since a start that the header has, as days since 1899-12-30; 1.0 has none.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway.bus.frames import BRS, ESI, EXTENDED, FD, ID_MASK, OWN, REMOTE, Frames
from gateway.bus.readers.batch import Batch, Names
from gateway.bus.readers.scan import (
    ASK,
    BAD,
    DONE,
    HEX,
    PASSED,
    begin_frame,
    byte_words,
    decimal,
    line_end,
    number,
    set_length,
    skip,
    word_end,
)
from gateway.bus.readers.text import Lines, shown
from gateway_fdi.errors import InputError
from gateway_fdi.jit import kernel

#: Days from 1899-12-30 to 1970-01-01.
_EPOCH_DAYS = 25569
#: Columns of a line at most.
_MOST = 16
#: Where a version has its columns; -1: nowhere. In this order they are the kernel's ``place``.
TIME, TYPE, ID, LENGTH, DIRECTION, BUS, DATA = range(7)
_VERSIONS = {
    "1.0": (1, -1, 2, 3, -1, -1, 4),
    "1.1": (1, 2, 3, 4, 2, -1, 5),
    "1.3": (1, 3, 4, 6, 3, 2, 7),
}
#: Versions whose types are directions, and lie in no column of their own.
_NO_FRAME, _BAD, _FRAME = -1, -2, 0


@kernel
def two(text: Any, at: int, first: int, second: int) -> bool:
    """Return whether a word is these two characters."""
    return bool(text[at] == first and text[at + 1] == second and text[at + 2] <= 32)


@kernel
def flags_of(text: Any, at: int) -> int:
    """Return the flags of a type of version 2, + 256 for a remote frame, -1: no frame."""
    if two(text, at, 68, 84):  # DT
        return 0
    if two(text, at, 82, 82):  # RR
        return 256
    if two(text, at, 70, 68):  # FD
        return FD
    if two(text, at, 70, 66):  # FB
        return FD | BRS
    if two(text, at, 70, 69):  # FE
        return FD | BRS | ESI
    if two(text, at, 66, 73):  # BI
        return FD | ESI
    return -1


@kernel
def trc_line(
    text: Any, begin: Any, count: int, place: Any, hexes: Any, words: Any, row: Any, k: int, start: int
) -> int:
    """Read a line whose words are known into a frame.

    Args:
        text: bytes.
        begin: where each word begins.
        count: words of the line.
        place: of the columns; then the first version's number.
        hexes: digits.
        words: the batch.
        row: bytes of the frame.
        k: which frame.
        start: of the log [ns].

    Returns:
        its bus, -1: no frame, -2: a bad line, -3: a line with too few columns.
    """
    second = place[7] == 2
    if count <= max(place[ID], place[TYPE], place[LENGTH], place[DIRECTION], place[BUS]):
        return -3
    flags, remote = 0, False
    if second:
        flags = flags_of(text, begin[place[TYPE]])
        if flags < 0:
            return _NO_FRAME
        remote, flags = flags >= 256, flags & 255
    at = begin[place[ID]]
    end = word_end(text, at)
    value = number(text, at, end, 16, hexes)
    t_ns, _, _ = decimal(text, begin[place[TIME]], 6)
    if place[DIRECTION] >= 0:
        i = begin[place[DIRECTION]]
        own = not two(text, i, 82, 120)  # Rx
        if own and not second and not two(text, i, 84, 120):  # Tx
            return _NO_FRAME
        flags |= OWN if own else 0
    if place[DIRECTION] < 0 and end - at == 8 and value == 0xFFFFFFFF:  # 1.0: state of the bus
        return _NO_FRAME
    i = begin[place[LENGTH]]
    wanted = number(text, i, word_end(text, i), 10, hexes)
    bus = 1
    if place[BUS] >= 0:
        i = begin[place[BUS]]
        bus = number(text, i, word_end(text, i), 10, hexes)
    if value < 0 or t_ns < 0 or not 0 <= wanted <= 64 or bus < 0:
        return _BAD
    can_id = (value & ID_MASK) | (EXTENDED if end - at > 4 else 0)
    if count > place[DATA] and not second and text[begin[place[DATA]]] == 82:  # RTR
        remote = True
    begin_frame(words, k, start + t_ns, can_id | (REMOTE if remote else 0), flags)
    if not remote and wanted:
        if count <= place[DATA]:
            return -3
        length, i = byte_words(text, begin[place[DATA]], 64 if second else wanted, 16, hexes, row)
        if length < 0:
            return _BAD
        if length < wanted and not second:
            return -3
        set_length(words, k, length)
    return bus


@kernel
def scan_trc(
    text: Any, at: int, words: Any, data: Any, channel: Any, k: int, place: Any, start: int, hexes: Any, begin: Any
) -> tuple[int, int, int, int]:
    """Read lines into a batch.

    Args:
        text: lines, uint8.
        at: where to begin.
        words: the batch, uint64, shape (frames, 10).
        data: the same as uint8, shape (frames, 80).
        channel: takes the bus of each frame.
        k: frames that are in already.
        place: of the columns, see :func:`trc_line`.
        start: of the log [ns].
        hexes: :data:`gateway.bus.readers.scan.HEX`.
        begin: scratch, int64, where words begin.

    Returns:
        where the next line begins, lines read, frames that are in, state of the line there.
    """
    lines = 0
    while at < text.shape[0] and k < words.shape[0]:
        i = skip(text, at)
        if text[i] == 10:
            at = i + 1
            lines += 1
            continue
        if text[i] == 59 or place[7] == 0:  # ";", or nothing is known yet
            return at, lines, k, ASK
        count = 0
        while text[i] != 10 and count < begin.shape[0]:
            begin[count] = i
            count += 1
            i = skip(text, word_end(text, i))
        bus = trc_line(text, begin, count, place, hexes, words, data[k], k, start)
        if bus == -3:
            return at, lines, k, PASSED
        if bus == _BAD:
            return at, lines, k, BAD
        if bus >= 0:
            channel[k] = bus
            k += 1
        at = line_end(text, i)
        lines += 1
    return at, lines, k, DONE


class Trc(Lines):
    """Lines of TRC.

    Args:
        path: for errors.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._start = 0
        self._version, self._columns = "1.0", ""
        self._place = np.zeros(8, np.int64)
        self._begin = np.zeros(_MOST, np.int64)

    def scan(self, text: NDArray[np.uint8], at: int, batch: Batch) -> tuple[int, int, int]:
        """Read lines."""
        start = 0 if self._version == "1.0" else self._start
        at, lines, batch.count, status = scan_trc(
            text, at, batch.words, batch.data, batch.channel, batch.count, self._place, start, HEX, self._begin
        )
        return at, lines, status

    def asked(self, line: bytes, names: Names) -> bool:
        """Look at a line of the header, or the first one after it."""
        del names
        text = line.decode("ascii", "replace").strip()
        if not text.startswith(";"):
            self._settle()
            return False
        if not self._place[7]:
            key, _, value = text.partition("=")
            match key:
                case ";$FILEVERSION":
                    self._version = value if value in (*_VERSIONS, "2.0", "2.1") else "1.0"
                case ";$STARTTIME":
                    self._start = round((float(value) - _EPOCH_DAYS) * 86400e6) * 1000
                case ";$COLUMNS":
                    self._columns = value
        return True

    def _settle(self) -> None:
        """Find the columns: the header is over.

        Raises:
            InputError: version 2 without columns that are needed.
        """
        if self._version in _VERSIONS:
            self._place[:] = (*_VERSIONS[self._version], 1)
            return
        columns = self._columns.split(",")
        where = {name: k for k, name in enumerate(columns)}
        where.setdefault("l", where.get("L", -1))
        missing = [name for name in ("O", "T", "I", "d", "D", "l") if where.get(name, -1) < 0]
        if missing:
            text = f"its $COLUMNS lack {', '.join(missing)}" if self._columns else "it has no $COLUMNS"
            raise InputError(f"not a TRC log of version {self._version}: {text}", file=self._path)
        self._place[:] = [*(where[name] for name in "OTIld"), where.get("B", -1), where["D"], 2]

    def bad(self, line: bytes, number: int) -> InputError:
        """Return the error of a bad line."""
        text = f"not a line of a TRC log, version {self._version}"
        return InputError(text, file=self._path, line=number, value=shown(line))

    def cut(self, line: bytes, frame: Any, before: Frames) -> bool:
        """Return whether the last line is cut: it is no frame where it should be one."""
        del before
        return frame is None and not line.strip().startswith(b";")

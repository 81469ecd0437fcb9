"""PEAK's TRC, file versions 1.0 to 1.3, 2.0 and 2.1.

Lines are, with the columns of each version::

    1)      1841 0001 8 00 00 00 00 00 00 00 00                1.0: number, time, identifier, length
    1)    1059.9 Rx     0300  7  00 00 00 00 04 00 00           1.1: number, time, type, identifier, length
    1)    1059.9  1  Rx     0300    7  00 00 00 00 04 00 00     1.2: with a bus
    1)    1059.9  1  Rx     0300 -  7  00 00 00 00 04 00 00     1.3: with a reserved column, too
    1    1059.900 DT     0300 Rx 7  00 00 00 00 04 00 00        2.x: as its header says ($COLUMNS)

Times are milliseconds since a start that the header has, as days since 1899-12-30 without a time zone; 1.0 has none.
Lines of the bus's state (Warng, ST), of its errors (Error, ER) and their counters (EC) become error frames.
"""

from __future__ import annotations

import re
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway.bus import conditions
from gateway.bus.conditions import RX_OVERFLOW, RX_PASSIVE, RX_WARNING, TX_OVERFLOW, TX_PASSIVE, TX_WARNING
from gateway.bus.frames import BRS, ESI, EXTENDED, FD, ID_MASK, OWN, REMOTE, Frames
from gateway.bus.readers.batch import Batch, Names, error_frame
from gateway.bus.readers.scan import (
    ASK,
    BAD,
    DONE,
    HEX,
    PASSED,
    begin_frame,
    byte_words,
    decimal,
    fd_length,
    line_end,
    number,
    set_length,
    skip,
    word_end,
)
from gateway.bus.readers.text import Lines
from gateway_fdi.errors import InputError
from gateway_fdi.jit import kernel

#: Days from 1899-12-30 to 1970-01-01.
EPOCH_DAYS = 25569
#: Columns of a line at most.
_MOST = 16
#: Where a version has its columns; -1: nowhere. In this order they are the kernel's ``place``.
TIME, TYPE, ID, LENGTH, DIRECTION, BUS, DATA = range(7)
_VERSIONS = {
    "1.0": (1, -1, 2, 3, -1, -1, 4),
    "1.1": (1, 2, 3, 4, 2, -1, 5),
    "1.2": (1, 3, 4, 5, 3, 2, 6),
    "1.3": (1, 3, 4, 6, 3, 2, 7),
}
#: Codes of a bus's state (PCAN-Basic), and byte 1 of an error frame of class CONTROLLER that says it.
_CODES = {0x01: TX_OVERFLOW, 0x02: RX_OVERFLOW, 0x04: RX_WARNING | TX_WARNING, 0x08: RX_WARNING | TX_WARNING}
_CODES |= {0x40: RX_OVERFLOW, 0x80: TX_OVERFLOW, 0x40000: RX_PASSIVE | TX_PASSIVE}
_OFF = 0x10
#: Kind of an error, as PEAK has it in the place of the identifier -> byte 2 of an error frame: bit, form, stuff.
_ERRORS = {1: 0x01, 2: 0x02, 4: 0x04}
_STARTS = re.compile(rb"\s*\d+\)?\s+\d")
#: Result of a line that is no frame: an event, or damaged.
_NO_FRAME, _BAD = -2, -3


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
    """Read a line into frame ``k``, whose bytes are ``row``; ``begin`` has where its words begin.

    ``place`` is that of the columns, then the first version's number; ``start`` is the log's [ns].

    Returns:
        its bus, counted from 0; _NO_FRAME, _BAD.
    """
    second = place[7] == 2
    if count <= max(place[ID], place[TYPE], place[LENGTH], place[DIRECTION], place[BUS]):
        return _BAD
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
    if remote:
        set_length(words, k, min(wanted, 8))
    elif wanted:
        if count <= place[DATA]:
            return _BAD
        length, i = byte_words(text, begin[place[DATA]], 64 if second else wanted, 16, hexes, row)
        if length != wanted and not (second and length in (fd_length(wanted), min(wanted, 8))):
            return _BAD
        set_length(words, k, length)
    return bus - 1


@kernel
def scan_trc(
    text: Any, at: int, words: Any, data: Any, channel: Any, k: int, place: Any, start: int, hexes: Any, begin: Any
) -> tuple[int, int, int, int]:
    """Read lines into a batch (see :mod:`gateway.bus.readers.scan`).

    ``place`` and ``start`` are those of :func:`trc_line`; ``begin`` is scratch, int64: where words begin.
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
        if bus == _NO_FRAME:
            return at, lines, k, ASK
        if bus == _BAD:
            return at, lines, k, BAD
        channel[k] = bus
        k += 1
        at = line_end(text, i)
        lines += 1
    return at, lines, k, DONE


class Trc(Lines):
    """Lines of TRC."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._start = 0
        self._version, self._columns = "1.0", ""
        self._place = np.zeros(8, np.int64)
        self._begin = np.zeros(_MOST, np.int64)

    @property
    def good(self) -> str:  # type: ignore[override]
        """The format of a line."""
        return f"TRC of version {self._version}"

    @staticmethod
    def sniff(first: bytes) -> bool:
        """Return whether its header tells its version, or its lines are those of 1.0."""
        if b";$FILEVERSION=" in first[:4096]:
            return True
        lines = [line for line in first.splitlines()[:40] if line.strip()]
        rest = [line for line in lines if not line.startswith(b";")]
        return len(rest) < len(lines) and bool(rest) and bool(_STARTS.match(rest[0]))

    def scan(self, text: NDArray[np.uint8], at: int, batch: Batch) -> tuple[int, int, int]:
        """Read lines."""
        start = 0 if self._version == "1.0" else self._start
        at, lines, batch.count, status = scan_trc(text, at, *batch.room, self._place, start, HEX, self._begin)
        return at, lines, status

    def asked(self, line: bytes, names: Names, batch: Batch) -> int:
        """Look at a line of the header, the first one after it, or an event."""
        text = line.decode("ascii", "replace").strip()
        if not text.startswith(";"):
            if self._place[7]:
                return self._event(line, batch)
            self._settle()
            return ASK
        if not self._place[7]:
            key, _, value = text.partition("=")
            match key:
                case ";$FILEVERSION":
                    self._version = value
                case ";$STARTTIME":
                    since_us = round((float(value) - EPOCH_DAYS) * 86400e6)
                    here = datetime(1970, 1, 1, tzinfo=self.zone) + timedelta(microseconds=since_us)
                    self._start = (since_us - (here.utcoffset() or timedelta()) // timedelta(microseconds=1)) * 1000
                case ";$COLUMNS":
                    self._columns = value
        return DONE

    def _event(self, line: bytes, batch: Batch) -> int:
        """Take a line that is no frame: a state of the bus becomes an error frame."""
        words, place = line.split(), self._place
        kind = words[place[TYPE]] if place[TYPE] >= 0 else b"Warng"
        if place[DIRECTION] >= 0 and place[7] == 1:
            kind = words[place[DIRECTION]]
        first = place[DATA]
        try:
            whole, _, part = words[place[TIME]].partition(b".")
            t_ns = int(whole) * 10**6 + int(part.ljust(6, b"0")[:6])
            t_ns += self._start if self._version != "1.0" else 0
            channel = int(words[place[BUS]]) - 1 if place[BUS] >= 0 else 0
            data = bytes.fromhex(b"".join(words[first : first + int(words[place[LENGTH]])]).decode())
        except ValueError:
            return BAD
        if exact := conditions.exact_in(line):
            found = exact
        elif kind in (b"Warng", b"ST"):
            code = int.from_bytes(data, "big")
            said = conditions.ACTIVE if code == 0 else sum({_CODES[bit] for bit in _CODES if code & bit})
            found = (
                (conditions.BUS_OFF if code & _OFF else 0) | (conditions.CONTROLLER if said else 0),
                bytes([0, said]),
            )
        elif kind in (b"Error", b"ER"):
            which = words[place[ID]]
            where = _ERRORS.get(int(which, 16) if which.isalnum() else 0, 0)
            found = conditions.PROTOCOL | conditions.BUS_ERROR, bytes([0, 0, where])
        elif kind == b"EC" and len(data) >= 2:
            found = conditions.COUNTERS, bytes([0, 0, 0, 0, 0, 0, data[1], data[0]])
        else:
            return PASSED
        error_frame(batch, t_ns, *found, channel)
        return DONE

    def _settle(self) -> None:
        """Find the columns: the header is over.

        Raises:
            InputError: an unknown version, or version 2 without columns that are needed.
        """
        if self._version not in (*_VERSIONS, "2.0", "2.1"):
            known = f"versions {', '.join(_VERSIONS)}, 2.0 and 2.1 are"
            raise InputError(f"a TRC log of version {self._version} is not read; {known}", file=self._path)
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

    def cut(self, line: bytes, frame: Any, before: Frames) -> bool:
        """Return whether the last line is cut: it is no frame where it should be one."""
        return frame is None and not line.strip().startswith(b";")

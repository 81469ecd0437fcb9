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

from gateway.bus import conditions
from gateway.bus.conditions import RX_OVERFLOW, RX_PASSIVE, RX_WARNING, TX_OVERFLOW, TX_PASSIVE, TX_WARNING
from gateway.bus.frames import BRS, ESI, EXTENDED, FD, ID_MASK, OWN, REMOTE
from gateway.bus.readers.batch import Batch, Names, error_frame, scaled
from gateway.bus.readers.scan import (
    ASK,
    BAD,
    DONE,
    RX,
    TX,
    begin_frame,
    byte_words,
    decimal,
    fd_length,
    line_end,
    next_number,
    pair,
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
#: Where a version has its columns; -1: nowhere. In this order they are the kernel's ``place``, with the first version's
#: number behind them, which is 0 before the header's end, and the time of the log's start [ns].
TIME, TYPE, ID, LENGTH, DIRECTION, BUS, DATA, VERSION, START = range(9)
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


#: Types of version 2 -> the flags of their frames, RTR of a remote one.
RTR = 256
TYPES = {"DT": 0, "RR": RTR, "FD": FD, "FB": FD | BRS, "FE": FD | BRS | ESI, "BI": FD | ESI}
_KINDS = np.array([(ord(name[0]) << 8 | ord(name[1]), flags) for name, flags in TYPES.items()], np.int64)


@kernel
def flags_of(text: Any, at: int) -> int:
    """Return the flags of a type of version 2, -1: no frame."""
    kind = pair(text, at)
    for k in range(len(_KINDS)):
        if _KINDS[k, 0] == kind:
            return int(_KINDS[k, 1])
    return -1


@kernel
def trc_line(text: Any, begin: Any, count: int, place: Any, words: Any, row: Any, k: int) -> int:
    """Read a line into frame ``k``, whose bytes are ``row``; ``begin`` has where its words begin.

    Returns:
        its bus, counted from 0; _NO_FRAME, _BAD.
    """
    second = place[VERSION] == 2
    if count <= max(place[ID], place[TYPE], place[LENGTH], place[DIRECTION], place[BUS]):
        return _BAD
    flags, remote = 0, False
    if second:
        flags = flags_of(text, begin[place[TYPE]])
        if flags < 0:
            return _NO_FRAME
        remote, flags = flags >= RTR, flags & 255
    at = begin[place[ID]]
    value, end = next_number(text, at, 16)
    t_ns, _, _ = decimal(text, begin[place[TIME]], 6)
    if place[DIRECTION] >= 0:
        way = pair(text, begin[place[DIRECTION]])
        if way not in (RX, TX) and not second:
            return _NO_FRAME
        flags |= OWN if way != RX else 0
    elif end - at == 8 and value == 0xFFFFFFFF:  # 1.0: state of the bus
        return _NO_FRAME
    wanted, _ = next_number(text, begin[place[LENGTH]], 10)
    bus = 1
    if place[BUS] >= 0:
        bus, _ = next_number(text, begin[place[BUS]], 10)
    if value < 0 or t_ns < 0 or not 0 <= wanted <= 64 or bus < 0:
        return _BAD
    can_id = (value & ID_MASK) | (EXTENDED if end - at > 4 else 0)
    if count > place[DATA] and not second and text[begin[place[DATA]]] == 82:  # RTR
        remote = True
    begin_frame(words, k, place[START] + t_ns, can_id | (REMOTE if remote else 0), flags)
    if remote:
        set_length(words, k, min(wanted, 8))
    elif wanted:
        if count <= place[DATA]:
            return _BAD
        length, _ = byte_words(text, begin[place[DATA]], 64 if second else wanted, 16, row)
        if length != wanted and not (second and length in (fd_length(wanted), min(wanted, 8))):
            return _BAD
        set_length(words, k, length)
    return bus - 1


@kernel
def scan_trc(
    text: Any, at: int, words: Any, data: Any, channel: Any, k: int, place: Any, begin: Any
) -> tuple[int, int, int, int]:
    """Read lines into a batch (see :mod:`gateway.bus.readers.scan`); ``begin`` is scratch, int64."""
    lines = 0
    while at < text.shape[0] and k < words.shape[0]:
        i = skip(text, at)
        if text[i] == 10:
            at = i + 1
            lines += 1
            continue
        if text[i] == 59 or place[VERSION] == 0:  # ";", or nothing is known yet
            return at, lines, k, ASK
        count = 0
        while text[i] != 10 and count < begin.shape[0]:
            begin[count] = i
            count += 1
            i = skip(text, word_end(text, i))
        bus = trc_line(text, begin, count, place, words, data[k], k)
        if bus < -1:
            return at, lines, k, ASK if bus == _NO_FRAME else BAD
        channel[k] = bus
        k += 1
        at = line_end(text, i)
        lines += 1
    return at, lines, k, DONE


class Trc(Lines):
    """Lines of TRC."""

    last = re.compile(rb"\s*;")

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._version, self._columns = "1.0", ""
        self._place = np.zeros(9, np.int64)
        self.scanner = scan_trc, (self._place, np.zeros(_MOST, np.int64))

    @staticmethod
    def sniff(first: bytes) -> bool:
        """Return whether its header tells its version, or its lines are those of 1.0."""
        if b";$FILEVERSION=" in first[:4096]:
            return True
        lines = [line for line in first.splitlines()[:40] if line.strip()]
        rest = [line for line in lines if not line.startswith(b";")]
        return len(rest) < len(lines) and bool(rest) and bool(_STARTS.match(rest[0]))

    def asked(self, line: bytes, names: Names, batch: Batch) -> int:
        """Look at a line of the header, the first one after it, or an event."""
        text = line.decode("ascii", "replace").strip()
        if not text.startswith(";"):
            if self._place[VERSION]:
                return self._event(line, batch)
            self._settle()
            return ASK
        if not self._place[VERSION]:
            key, _, value = text.partition("=")
            match key:
                case ";$FILEVERSION":
                    self._version = value
                case ";$STARTTIME":
                    since_us = round((float(value) - EPOCH_DAYS) * 86400e6)
                    here = datetime(1970, 1, 1, tzinfo=self.zone) + timedelta(microseconds=since_us)
                    behind_us = (here.utcoffset() or timedelta()) // timedelta(microseconds=1)
                    self._place[START] = (since_us - behind_us) * 1000
                case ";$COLUMNS":
                    self._columns = value
        return DONE

    def _event(self, line: bytes, batch: Batch) -> int:
        """Take a line that is no frame: a state of the bus becomes an error frame."""
        words, place = line.split(), self._place
        kind = words[place[TYPE]] if place[TYPE] >= 0 else b"Warng"
        if place[DIRECTION] >= 0 and place[VERSION] == 1:
            kind = words[place[DIRECTION]]
        first = place[DATA]
        try:
            t_ns = scaled(words[place[TIME]].decode("latin-1"), 6) + int(place[START])
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
            return self.event("an event that is no frame", line)
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
        self.good = f"TRC of version {self._version}"
        if self._version == "1.0":
            self._place[START] = 0  # it has no start
        if self._version in _VERSIONS:
            self._place[:START] = (*_VERSIONS[self._version], 1)
            return
        columns = self._columns.split(",")
        where = {name: k for k, name in enumerate(columns)}
        where.setdefault("l", where.get("L", -1))
        missing = [name for name in ("O", "T", "I", "d", "D", "l") if where.get(name, -1) < 0]
        if missing:
            text = f"its $COLUMNS lack {', '.join(missing)}" if self._columns else "it has no $COLUMNS"
            raise InputError(f"not a TRC log of version {self._version}: {text}", file=self._path)
        self._place[:START] = [*(where[name] for name in "OTIld"), where.get("B", -1), where["D"], 2]

"""CSV: a line a frame, as its header says.

python-can's has its payload in base64::

    timestamp,arbitration_id,extended,remote,error,dlc,data
    1483389946.197,0x00dadada,1,0,0,6,WzQyLCA5XQ==

Its stamps are float seconds; those of a recorder that counts microseconds are restored
(:func:`gateway.bus.frames.nanoseconds`), nine digits are nanoseconds. All are read by the names of their columns
(:data:`ROLES`), e.g. SavvyCAN's (GVRET) and that of CANedge's converter::

    Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8
    166064000,0000021A,false,Rx,0,8,FE,36,12,FE,69,05,07,AD,
    TimestampEpoch;BusChannel;ID;IDE;DLC;DataLength;Dir;EDL;BRS;DataBytes
    1578922367.777150;1;14F;0;8;8;0;0;0;01551B9A5CA01F04
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway.bus.frames import BRS, ERROR, ESI, EXTENDED, FD, ID_MASK, OWN, REMOTE, nanoseconds
from gateway.bus.log_source import LINE
from gateway.bus.readers.batch import FLAGS, NO_CHANNEL, Batch, Names
from gateway.bus.readers.scan import ASK, BAD, DONE, HEX, begin_frame, byte, decimal, number, set_length
from gateway.bus.readers.text import Lines, shown
from gateway_fdi.errors import InputError
from gateway_fdi.jit import kernel

#: Character -> its value in base64, 255: none.
BASE64 = np.full(256, 255, np.uint8)
for _value, _character in enumerate(b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/"):
    BASE64[_character] = _value

_HOUR_NS = 3_600_000_000_000
#: Doubles near stamps this large [ns] are too far apart for more than microseconds (gateway.bus.frames.nanoseconds).
_COARSE = 10**15
_PYTHON_CAN = b"timestamp,arbitration_id,extended,remote,error,dlc,data"
#: Roles of columns; NOTHING: none of these. The last ones are flags.
NOTHING = -1
TIME, ID, DATA, LEN, BUS, EXT, DIR, EDL, BRS_AT, ESI_AT, RTR, ERR = range(12)
#: How a log is written: what separates fields, the unit of stamps, the layout of the payload, the number of the first
#: channel, the last column that a line must have, a bit for each role that a column has, and what is added to stamps
#: that begin below zero [ns].
SEPARATOR, UNIT, LAYOUT, FIRST, LAST, KNOWN, SHIFT = range(7)
#: Names of each of these columns, letters and digits in lower case; of several the first that is there.
ROLES = (
    ("timestampepoch", "timestamp", "time", "times", "timestamps", "timesec"),
    ("id", "identifier", "canid", "arbitrationid"),
    ("databytes", "data", "d0", "d1", "data0", "data1", "byte0", "byte1", "b0", "b1"),
    ("datalength", "len", "length", "dlc"),
    ("bus", "buschannel", "channel", "chn", "chan"),
    ("extended", "ide", "ext"),
    ("dir", "direction", "rxtx"),
    ("edl", "fd", "fdf"),
    ("brs",),
    ("esi",),
    ("rtr", "remote"),
    ("error",),
)
#: How a payload is written: in one field, a field a byte, in base64.
JOINED, APART, ENCODED = range(3)
#: No bus carries a frame in less than this on average, not even several together [us]: a classic one has 47 bits at
#: least, so 47 us at 1 Mbit/s.
_LEAST_GAP_US = 15


@kernel
def base64(text: Any, at: int, row: Any) -> tuple[int, int]:
    """Return how many bytes a payload in base64 has, which go into the frame; -1: it is none; and where it ends."""
    count, bits, value = 0, 0, 0
    while BASE64[text[at]] < 64:
        value = ((value << 6) | byte(BASE64, text[at])) & 0xFFFFFF
        bits += 6
        if bits >= 8:
            bits -= 8
            if count == 64:
                return -1, at
            row[16 + count] = (value >> bits) & 255
            count += 1
        at += 1
    while text[at] == 61:
        at += 1
    return (count, at) if text[at] <= 32 and bits < 6 else (-1, at)


@kernel
def ends(text: Any, at: int, separator: int) -> bool:
    """Return whether a word ends at a place: at what separates fields, a blank, a quote, or the line's end."""
    return bool(text[at] == separator or text[at] <= 34)


@kernel
def field_number(text: Any, at: int, separator: int, base: int) -> tuple[int, int]:
    """Return the number of a field, -1: it is none; and where it ends."""
    if text[at] == 48 and text[at + 1] in (120, 88):  # 0x
        at += 2
    end = at
    while not ends(text, end, separator):
        end += 1
    return number(text, at, end, base), end


@kernel
def field_bytes(text: Any, at: int, separator: int, count: int, most: int, row: Any) -> int:
    """Read bytes behind the first ``count`` ones; returns how many there are then, -1: one is none."""
    while count < most and (text[at] == 32 or not ends(text, at, separator)):
        if text[at] == 32 or (text[at] == 48 and text[at + 1] in (120, 88)):
            at += 1 if text[at] == 32 else 2
            continue
        high, low = byte(HEX, text[at]), byte(HEX, text[at + 1])
        single = ends(text, at + 1, separator)
        if high > 15 or (low > 15 and not single):
            return -1
        row[16 + count] = high if single else high * 16 + low
        count += 1
        at += 1 if single else 2
    return count


@kernel
def finished(can_id: int, wanted: int, length: int, said: int, how: Any, words: Any, row: Any, k: int) -> bool:
    """Complete a frame by what its line says; returns whether it is one."""
    if not 0 <= can_id <= ID_MASK or length < 0 or wanted > 64:
        return False
    if said >> EXT & 1 or (how[KNOWN] >> EXT & 1 == 0 and can_id > 0x7FF):
        can_id |= EXTENDED
    can_id |= (REMOTE if said >> RTR & 1 else 0) | (ERROR if said >> ERR & 1 else 0)
    if can_id & REMOTE:
        for j in range(length):
            row[16 + j] = 0
        length = min(max(wanted, 0), 8)
    elif how[KNOWN] >> LEN & 1 and length != wanted:
        return False
    flags = OWN if said >> DIR & 1 else 0
    if length > 8 or said >> EDL & 1:
        flags |= FD | (BRS if said >> BRS_AT & 1 else 0) | (ESI if said >> ESI_AT & 1 else 0)
    words[k, 1] = np.uint64(can_id) | np.uint64(flags) << np.uint64(FLAGS)
    set_length(words, k, length)
    return True


@kernel
def csv_line(text: Any, at: int, roles: Any, how: Any, words: Any, row: Any, k: int) -> tuple[int, int]:
    """Read a line into a frame; returns its channel, -2: it is damaged; and where the line ends."""
    separator, field, said = how[SEPARATOR], 0, 0
    t_ns, can_id, wanted, length, bus = -1, -1, -1, 0, -1
    begin_frame(words, k, 0, 0, 0)
    while text[at] != 10:
        while text[at] == 32 or text[at] == 34:
            at += 1
        role = roles[field] if field < roles.shape[0] else NOTHING
        if role >= EXT:
            said |= (text[at] == 49 or (text[at] | 32) in (116, 121)) << role  # 1, true, yes, Tx
        elif role == TIME:
            below = text[at] == 45
            t_ns, at, digits = decimal(text, at + below, how[UNIT])
            t_ns = how[SHIFT] + (-t_ns if below else t_ns) if t_ns >= 0 else t_ns
            if not ends(text, at, separator):
                return -2, at
            if how[LAYOUT] == ENCODED and t_ns >= _COARSE and digits < 9:
                t_ns = (t_ns + 500) // 1000 * 1000
        elif role == ID:
            can_id, at = field_number(text, at, separator, 16)
        elif role == LEN:
            wanted, at = field_number(text, at, separator, 10)
        elif role == BUS:
            bus, at = field_number(text, at, separator, 10)
        elif role == DATA and how[LAYOUT] == ENCODED:
            length, at = base64(text, at, row)
        elif role == DATA and length >= 0:
            length = field_bytes(text, at, separator, length, 64 if wanted < 0 else wanted, row)
        field += 1
        while text[at] != separator and text[at] != 10:
            at += 1
        at += 1 if text[at] == separator else 0
    if field <= how[LAST] or t_ns < 0 or not finished(can_id, wanted, length, said, how, words, row, k):
        return -2, at
    words[k, 0] = np.uint64(t_ns)
    if how[KNOWN] >> BUS & 1 == 0:
        return NO_CHANNEL, at
    return bus - how[FIRST] if bus >= 0 else -2, at


@kernel
def scan_csv(
    text: Any, at: int, words: Any, data: Any, channel: Any, k: int, roles: Any, how: Any
) -> tuple[int, int, int, int]:
    """Read lines into a batch (see :mod:`gateway.bus.readers.scan`); ``roles`` and ``how`` are of :func:`_mapped`."""
    lines = 0
    while at < text.shape[0] and k < words.shape[0]:
        if text[at] != 10:
            found, end = csv_line(text, at, roles, how, words, data[k], k)
            if found == -2:
                return at, lines, k, ASK
            channel[k] = found
            k += 1
            at = end
        at += 1
        lines += 1
    return at, lines, k, DONE


def _mapped(line: bytes, more: Sequence[bytes] = ()) -> tuple[NDArray[np.int64], NDArray[np.int64]] | None:
    """Return the role of each column of a header, and how its log is written; None: it is no header of frames.

    Args:
        line: the header.
        more: lines after it, whose stamps tell their unit (:func:`_unit`).
    """
    separator = max(",;\t", key=line.decode("latin-1").count)
    names = ["".join(filter(str.isalnum, name)).lower() for name in line.decode("latin-1").split(separator)]
    place = [next((names.index(name) for name in known if name in names), -1) for known in ROLES]
    if min(place[:3]) < 0:
        return None
    rows = [one.decode("latin-1").split(separator) for one in more]
    fields = rows[0] if rows else []
    stamps = [row[place[TIME]].strip(' "') for row in rows if place[TIME] < len(row)]
    unit = _unit([stamp.removeprefix("-") for stamp in stamps])
    below = re.match(r"-(\d+)", stamps[0] if stamps else "")
    shift = int(below[1]) * 10**unit + _HOUR_NS if below else 0  # the first frame is seldom the earliest
    bus = names[place[BUS]] if place[BUS] >= 0 else ""
    first = 1 if bus == "buschannel" or (bus == "channel" and fields[place[BUS] :][:1] != ["0"]) else 0
    layout = JOINED if names[place[DATA]] in ("data", "databytes") else APART
    if line.startswith(_PYTHON_CAN):
        unit, layout = 9, ENCODED
    roles = [place.index(column) if column in place else NOTHING for column in range(len(names))]
    if layout == APART:  # bytes go on to the end, also in columns that have no name
        roles = [DATA if column >= place[DATA] and role == NOTHING else role for column, role in enumerate(roles)]
        roles += [DATA] * max(64 + place[DATA] - len(roles), 0)
    last = max(column for role, column in enumerate(place) if role != DATA)  # a frame without bytes may have no DATA
    known_roles = sum(1 << role for role, column in enumerate(place) if column >= 0)
    how = [ord(separator), unit, layout, first, last, known_roles, shift]
    return np.array(roles, np.int64), np.array(how, np.int64)


def _unit(stamps: Sequence[str]) -> int:
    """Return the unit of stamps, as how many digits of it are a nanosecond: 9 for s, 6 for ms, 3 for us, 0 for ns.

    One with a point counts seconds; a whole one of 13, 16 or 19 digits is of the wall clock. Of fewer digits it counts
    microseconds, or milliseconds where a bus could not carry that many frames.
    """
    first = stamps[0] if stamps else ""
    if "." in first:
        return 9
    whole = [int(one) for one in stamps if one.isdecimal()]
    crowded = len(whole) > 1 and 0 < max(whole) - min(whole) < _LEAST_GAP_US * (len(whole) - 1)
    return {13: 6, 16: 3, 19: 0}.get(len(first), 6 if crowded else 3)


class Csv(Lines):
    """Lines of CSV."""

    good = "its fields as the header has them"
    last = re.compile(_PYTHON_CAN)

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._header = 0
        self.scanner = scan_csv, _mapped(_PYTHON_CAN) or ()

    @staticmethod
    def sniff(first: bytes) -> bool:
        """Return whether one of the first lines is a header that we know."""
        return any(_mapped(line) for line in first.splitlines()[:20])

    def begin(self, first: bytes) -> None:
        """Look for the header; a log without one is python-can's.

        Raises:
            InputError: it is none that we know.
        """
        lines = first[:LINE].splitlines()
        for k, line in enumerate(lines[:20]):
            mapped = _mapped(line, lines[k + 1 : -1] or lines[k + 1 :])
            if mapped:
                self._header, self.scanner = k + 1, (scan_csv, mapped)
                return
        if lines and len(lines[0]) < LINE and not lines[0][:1].isdigit():
            known = f"{_PYTHON_CAN.decode()}, or columns of a time, an identifier and data by their names"
            raise InputError(f"no CSV of frames that we know ({known})", file=self._path, line=1, value=shown(lines[0]))

    def asked(self, line: bytes, names: Names, batch: Batch) -> int:
        """Look at a line of the header, or one that is damaged or has a stamp with an exponent."""
        if self._line <= self._header:
            return DONE
        if (plain := _plain(line)) is None:
            return BAD
        scan, own = self.scanner
        _, _, batch.count, status = scan(np.frombuffer(plain, np.uint8), 0, *batch.room, *own)
        return DONE if status == DONE else BAD


def _plain(line: bytes) -> bytes | None:
    """Return a line whose stamp has an exponent without it, None if it has none."""
    stamp, comma, rest = line.partition(b",")
    if b"e" not in stamp.lower():
        return None
    try:
        t_ns = nanoseconds(float(stamp))
    except (ValueError, OverflowError):
        return None
    return b"%d.%09d" % divmod(t_ns, 10**9) + comma + rest if 0 <= t_ns < 2**63 else None

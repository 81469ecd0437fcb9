"""CSV: a line a frame, as its header says.

python-can's has its payload in base64, and a kernel of its own::

    timestamp,arbitration_id,extended,remote,error,dlc,data
    1483389946.197,0x00dadada,1,0,0,6,WzQyLCA5XQ==

Its stamps are float seconds; those of a recorder that counts microseconds are restored
(:func:`gateway.bus.frames.nanoseconds`), nine digits are nanoseconds. Others are read by the names of their columns
(:data:`ROLES`), e.g. SavvyCAN's (GVRET) and that of CANedge's converter::

    Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8
    166064000,0000021A,false,Rx,0,8,FE,36,12,FE,69,05,07,AD,
    TimestampEpoch;BusChannel;ID;IDE;DLC;DataLength;Dir;EDL;BRS;DataBytes
    1578922367.777150;1;14F;0;8;8;0;0;0;01551B9A5CA01F04
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway.bus.frames import BRS, ERROR, ESI, EXTENDED, FD, ID_MASK, OWN, REMOTE, Frames, nanoseconds
from gateway.bus.log_source import LINE
from gateway.bus.readers.batch import FLAGS, LENGTH, NO_CHANNEL, Batch
from gateway.bus.readers.scan import BAD, DONE, HEX, begin_frame, byte, decimal, line_end, number, set_length
from gateway.bus.readers.text import Lines, shown
from gateway_fdi.errors import InputError
from gateway_fdi.jit import kernel

#: Character -> its value in base64, 255: none.
BASE64 = np.full(256, 255, np.uint8)
for _value, _character in enumerate(b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/"):
    BASE64[_character] = _value

#: Doubles near stamps this large [ns] are too far apart for more than microseconds (gateway.bus.frames.nanoseconds).
_COARSE = 10**15
_PYTHON_CAN = b"timestamp,arbitration_id,extended,remote,error,dlc,data"
#: Columns of a map, in the order of the kernel's ``place``.
TIME, ID, DATA, LEN, EXT, DIR, BUS, EDL, BRS_AT, ESI_AT, RTR, ERR = range(12)
#: Names of each of these columns, letters and digits in lower case; of several the first that is there.
ROLES = (
    ("timestampepoch", "timestamp", "time", "times", "timestamps", "timesec"),
    ("id", "identifier", "canid", "arbitrationid"),
    ("databytes", "data", "d0", "d1", "data0", "data1", "byte0", "byte1", "b0", "b1"),
    ("datalength", "len", "length", "dlc"),
    ("extended", "ide", "ext"),
    ("dir", "direction", "rxtx"),
    ("bus", "buschannel", "channel", "chn", "chan"),
    ("edl", "fd", "fdf"),
    ("brs",),
    ("esi",),
    ("rtr", "remote"),
    ("error",),
)
#: Columns of a line at most.
_MOST = 96
#: No bus carries a frame in less than this on average, not even several together [us]: a classic one has 47 bits at
#: least, so 47 us at 1 Mbit/s.
_LEAST_GAP_US = 15


@kernel
def field_end(text: Any, at: int) -> int:
    """Return where a field ends: at a comma or the line's end."""
    while text[at] != 44 and text[at] > 32:
        at += 1
    return at


@kernel
def base64(text: Any, at: int, sixes: Any, row: Any) -> tuple[int, int]:
    """Read a payload; returns its bytes, -1 if it is none, and where it ends."""
    count, bits, value = 0, 0, 0
    while sixes[text[at]] < 64:
        value = ((value << 6) | byte(sixes, text[at])) & 0xFFFFFF
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
def csv_line(text: Any, at: int, hexes: Any, sixes: Any, words: Any, row: Any, k: int) -> int:
    """Read a line into a frame; returns where its payload ends, -1 if it is bad."""
    t_ns, i, digits = decimal(text, at, 9)
    if t_ns < 0 or digits < 0 or text[i] != 44:
        return -1
    if t_ns >= _COARSE and digits < 9:
        t_ns = (t_ns + 500) // 1000 * 1000
    at = i + 1
    end = field_end(text, at)
    if text[at] == 48 and text[at + 1] in (120, 88):  # 0x
        at += 2
    can_id = number(text, at, end, 16, hexes)
    if can_id < 0:
        return -1
    can_id &= ID_MASK
    for flag in (EXTENDED, REMOTE, ERROR):
        if text[end] != 44:
            return -1
        at = end + 1
        end = field_end(text, at)
        if end - at == 1 and text[at] == 49:
            can_id |= flag
    if text[end] != 44:
        return -1
    at = end + 1
    end = field_end(text, at)
    dlc = number(text, at, end, 10, hexes)
    if dlc < 0 or text[end] != 44:
        return -1
    begin_frame(words, k, t_ns, can_id, 0)
    length, at = base64(text, end + 1, sixes, row)
    if length < 0:
        return -1
    if can_id & REMOTE:
        for j in range(length):
            row[16 + j] = 0
        length = min(dlc, 8)
    flags = FD if length > 8 else 0
    words[k, 1] |= (np.uint64(length) << np.uint64(LENGTH)) | (np.uint64(flags) << np.uint64(FLAGS))
    return at


@kernel
def scan_csv(
    text: Any, at: int, words: Any, data: Any, channel: Any, k: int, hexes: Any, sixes: Any
) -> tuple[int, int, int, int]:
    """Read lines into a batch.

    Args:
        text: lines, uint8.
        at: where to begin.
        words: the batch, uint64, shape (frames, 10).
        data: the same as uint8, shape (frames, 80).
        channel: takes NO_CHANNEL for each frame: the format has none.
        k: frames that are in already.
        hexes: :data:`gateway.bus.readers.scan.HEX`.
        sixes: :data:`BASE64`.

    Returns:
        where the next line begins, lines read, frames that are in, state of the line there.
    """
    lines = 0
    while at < text.shape[0] and k < words.shape[0]:
        i = csv_line(text, at, hexes, sixes, words, data[k], k)
        if i < 0:
            return at, lines, k, BAD
        channel[k] = NO_CHANNEL
        at = line_end(text, i)
        lines += 1
        k += 1
    return at, lines, k, DONE


@kernel
def is_set(text: Any, at: int) -> bool:
    """Return whether a field says yes: 1, true, yes, Tx."""
    return bool(text[at] == 49 or (text[at] | 32) in (116, 121))


@kernel
def column_bytes(
    text: Any, begin: Any, end: Any, count: int, field: int, apart: int, most: int, hexes: Any, row: Any
) -> int:
    """Read a payload of one field, or of a field a byte; returns how many bytes, -1: one is none."""
    length, i = 0, begin[min(field, count - 1)]
    while field < count and length < most:
        if i >= end[field]:
            field += 1
            if apart == 0 or field >= count:
                break
            i = begin[field]
            continue
        if text[i] == 32 or (text[i] == 48 and text[i + 1] in (120, 88)):
            i += 1 if text[i] == 32 else 2
            continue
        high, low = byte(hexes, text[i]), byte(hexes, text[i + 1])
        single = i + 1 >= end[field]
        if high > 15 or (low > 15 and not single):
            return -1
        row[16 + length] = high if single else high * 16 + low
        length += 1
        i += 2
    return length


@kernel
def column_says(text: Any, begin: Any, column: int) -> bool:
    """Return whether a column is there, and says yes."""
    return bool(column >= 0 and is_set(text, begin[column]))


@kernel
def column_flags(text: Any, begin: Any, place: Any, length: int) -> int:
    """Return the flags of a frame."""
    flags = OWN if column_says(text, begin, place[DIR]) else 0
    if length > 8 or column_says(text, begin, place[EDL]):
        flags |= FD
        flags |= BRS if column_says(text, begin, place[BRS_AT]) else 0
        flags |= ESI if column_says(text, begin, place[ESI_AT]) else 0
    return flags


@kernel
def columns_line(
    text: Any, begin: Any, end: Any, count: int, place: Any, how: Any, hexes: Any, words: Any, row: Any, k: int
) -> int:
    """Read the fields of a line into a frame; returns its channel, -2: it is damaged."""
    for j in range(place.shape[0]):
        if place[j] >= count and j != DATA:  # a frame without bytes may have no such field
            return -2
    t_ns, at, _ = decimal(text, begin[place[TIME]], how[1])
    at = begin[place[ID]]
    if text[at] == 48 and text[at + 1] in (120, 88):  # 0x
        at += 2
    can_id = number(text, at, end[place[ID]], 16, hexes)
    if t_ns < 0 or not 0 <= can_id <= ID_MASK:
        return -2
    if is_set(text, begin[place[EXT]]) if place[EXT] >= 0 else can_id > 0x7FF:
        can_id |= EXTENDED
    can_id |= REMOTE if column_says(text, begin, place[RTR]) else 0
    can_id |= ERROR if column_says(text, begin, place[ERR]) else 0
    wanted = -1
    if place[LEN] >= 0:
        wanted = number(text, begin[place[LEN]], end[place[LEN]], 10, hexes)
        if not 0 <= wanted <= 64:
            return -2
    begin_frame(words, k, t_ns, can_id, 0)
    most = 64 if wanted < 0 else wanted
    length = column_bytes(text, begin, end, count, place[DATA], how[2], most, hexes, row)
    if length < 0:
        return -2
    if can_id & REMOTE:
        for j in range(length):
            row[16 + j] = 0
        length = min(max(wanted, 0), 8)
    elif wanted >= 0 and length != wanted:
        return -2
    flags = column_flags(text, begin, place, length)
    words[k, 1] |= np.uint64(flags) << np.uint64(FLAGS)
    set_length(words, k, length)
    if place[BUS] < 0:
        return NO_CHANNEL
    bus = number(text, begin[place[BUS]], end[place[BUS]], 10, hexes)
    return bus - how[3] if bus >= 0 else -2


@kernel
def scan_columns(
    text: Any, at: int, words: Any, data: Any, channel: Any, k: int, place: Any, how: Any, hexes: Any, ends: Any
) -> tuple[int, int, int, int]:
    """Read lines of a map into a batch.

    Args:
        text: lines, uint8.
        at: where to begin.
        words: the batch, uint64, shape (frames, 10).
        data: the same as uint8, shape (frames, 80).
        channel: takes the channel of each frame, counted from 0.
        k: frames that are in already.
        place: number of each column, -1: there is none; in the order of :data:`ROLES`.
        how: what separates fields, 10 to the power of what makes a stamp ns, whether each byte is a field, number of
            the first channel.
        hexes: :data:`gateway.bus.readers.scan.HEX`.
        ends: scratch, int64, shape (2, fields): where each begins and ends.

    Returns:
        where the next line begins, lines read, frames that are in, state of the line there.
    """
    lines = 0
    while at < text.shape[0] and k < words.shape[0]:
        i, count = at, 0
        while text[i] != 10 and count < ends.shape[1]:
            while text[i] == 32 or text[i] == 34:
                i += 1
            ends[0, count] = i
            while text[i] != how[0] and text[i] != 10 and text[i] != 13 and text[i] != 34:
                i += 1
            ends[1, count] = i
            count += 1
            while text[i] != how[0] and text[i] != 10:
                i += 1
            if text[i] == how[0]:
                i += 1
        if count == 0:
            at = line_end(text, i)
            lines += 1
            continue
        found = columns_line(text, ends[0], ends[1], count, place, how, hexes, words, data[k], k)
        if found == -2:
            return at, lines, k, BAD
        channel[k] = found
        at = line_end(text, i)
        lines += 1
        k += 1
    return at, lines, k, DONE


def _mapped(line: bytes, more: Sequence[bytes] = ()) -> tuple[NDArray[np.int64], NDArray[np.int64]] | None:
    """Return the places of a header's columns, and how they are written; None: it is no header of frames.

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
    unit = _unit([row[place[TIME]].strip(' "') for row in rows if place[TIME] < len(row)])
    bus = names[place[BUS]] if place[BUS] >= 0 else ""
    first = 1 if bus == "buschannel" or (bus == "channel" and fields[place[BUS] :][:1] != ["0"]) else 0
    apart = names[place[DATA]] not in ("data", "databytes")
    return np.array(place, np.int64), np.array([ord(separator), unit, apart, first], np.int64)


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
    """Lines of CSV.

    Args:
        path: for errors.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._header = 0
        self._map: tuple[NDArray[np.int64], NDArray[np.int64]] | None = None
        self._ends = np.zeros((2, _MOST), np.int64)

    @staticmethod
    def sniff(first: bytes) -> bool:
        """Return whether one of the first lines is a header that we know."""
        return any(line.startswith(_PYTHON_CAN) or _mapped(line) for line in first.splitlines()[:20])

    def begin(self, first: bytes) -> None:
        """Look for the header.

        Raises:
            InputError: it is none that we know.
        """
        lines = first[:LINE].splitlines()
        for k, line in enumerate(lines[:20]):
            self._header = k + 1
            if line.startswith(_PYTHON_CAN):
                return
            if mapped := _mapped(line, lines[k + 1 : -1] or lines[k + 1 :]):
                self._map = mapped
                return
        self._header = 0
        if lines and len(lines[0]) < LINE and not lines[0][:1].isdigit():
            known = f"{_PYTHON_CAN.decode()}, or columns of a time, an identifier and data by their names"
            raise InputError(f"no CSV of frames that we know ({known})", file=self._path, line=1, value=shown(lines[0]))

    @property
    def good(self) -> str:  # type: ignore[override]
        """The fields of a line."""
        return _PYTHON_CAN.decode() if self._map is None else "its fields as the header has them"

    def scan(self, text: NDArray[np.uint8], at: int, batch: Batch) -> tuple[int, int, int]:
        """Read lines."""
        if self._header:
            self._header -= 1
            return int(line_end(text, at)), 1, DONE
        room = batch.words, batch.data, batch.channel, batch.count
        if self._map is not None:
            at, lines, batch.count, status = scan_columns(text, at, *room, *self._map, HEX, self._ends)
            return at, lines, status
        at, lines, batch.count, status = scan_csv(text, at, *room, HEX, BASE64)
        if status == BAD and (again := _plain(bytes(text[at : line_end(text, at)]))) is not None:
            one = np.frombuffer(again, np.uint8)
            _, _, batch.count, status = scan_csv(
                one, 0, batch.words, batch.data, batch.channel, batch.count, HEX, BASE64
            )
            if status == DONE:
                at, lines = int(line_end(text, at)), lines + 1
        return at, lines, status

    def cut(self, line: bytes, frame: Any, before: Frames) -> bool:
        """Return whether the last line is cut: it is no frame, or one with fewer bytes than it says."""
        del before
        if frame is None or self._map is not None:
            return frame is None and self._header == 0 and not line.startswith(_PYTHON_CAN)
        words = line.split(b",")
        return not int(frame["can_id"]) & REMOTE and int(frame["length"]) != int(words[5])


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

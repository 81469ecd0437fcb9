"""Vector's ASC: events as lines, frames among them.

Lines are::

    date Sat Sep 30 15:06:13.191 2017
    base hex  timestamps absolute
    0.015991 1  18EBFF00x       Rx   d 8 01 A0 0F A6 60 3B D1 40  Length = 273910 BitCount = 141 ID = 418119424x
    0.021964 1  1234ABCDx       Rx   r
    0.100000 2  ErrorFrame
    30.80673 CANFD   3 Rx        50005x                                   1 0 8  8 01 02 03 04 05 06 07 08  ...

Error frames and chip states become error frames of SocketCAN's classes; other events are counted, or known to be none.
Stamps count from the begin of the measurement; the date has no time zone. Where the header says ``timestamps relative``
a stamp counts from the event before, which python-can does not know. Where the first stamp is below 0, as converters
write it, all are counted from a whole second before it.
"""

from __future__ import annotations

import re
from datetime import UTC, datetime, tzinfo
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway.bus import conditions
from gateway.bus.frames import BRS, ESI, EXTENDED, FD, ID_MASK, OWN, REMOTE, Frames
from gateway.bus.readers.batch import FLAGS, Batch, Names, error_frame
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
    is_digit,
    line_end,
    next_word,
    number,
    set_length,
    skip,
    word_end,
)
from gateway.bus.readers.text import Lines
from gateway_fdi.jit import kernel

#: Result of a line: an event, a frame, a frame whose line has fewer bytes than it says, no frame but should be one.
_NOTHING, _FRAME, _SHORT, _WRONG = 0, 1, 2, 3
#: Flags of a line of CAN FD (Vector): a remote frame, a frame of CAN FD.
_RTR, _EDL = 0x10, 0x1000
#: Error frames and chip states.
_STATE = re.compile(
    rb"\s*(-?\d+\.\d+)\s+(?:CAN(?:FD)?\s+)?(\d+)\s+(?:[TR]x\s+)?"
    rb"(?:ErrorFrame|Status:\s*chip status (error active|warning level|error passive|bus off))(.*)",
    re.IGNORECASE,
)
_STAMP = re.compile(rb"\s*(-?)(\d+)\.(\d+)\s+(.*)")
#: Lines that are known to be no frames, and lose nothing.
_KNOWN = re.compile(
    rb"\s*(?://|$|date |base |(?:no )?internal events logged|begin |end |-?[\d.]+\s+(?:CANFD\s+)?(?:CAN\s+)?"
    rb"(?:start of measurement|\d+\s+statistic:|\d+\s+\S+\s+txrq\b))",
    re.IGNORECASE,
)
#: The first event's stamp.
_FIRST = re.compile(rb"^[ \t]*(-?)(\d+)([.,])\d+\s", re.MULTILINE)
_COUNTERS = re.compile(rb"TxErr:\s*(\d+)\s+RxErr:\s*(\d+)")

_MONTHS = {
    name: k
    for names in (
        ["Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec"],
        ["Jan", "Feb", "Mär", "Apr", "Mai", "Jun", "Jul", "Aug", "Sep", "Okt", "Nov", "Dez"],
    )
    for k, name in enumerate(names, start=1)
}
_DATE = re.compile(r"\w+\s+(\w+)\s+(\d+)\s+(\d+):(\d+):(\d+)(?:\.(\d+))?(?:\s+([ap]m))?\s+(\d{4})\s*$", re.IGNORECASE)


@kernel
def begins(text: Any, at: int, lower: Any) -> bool:
    """Return whether a line goes on with letters, here in lower case (uint8), whatever their case."""
    for k in range(lower.shape[0]):
        if (text[at + k] | 32) != lower[k]:
            return False
    return True


@kernel
def is_direction(text: Any, at: int) -> bool:
    """Return whether a word is Rx or Tx, in any case."""
    return bool((text[at] | 32) in (114, 116) and (text[at + 1] | 32) == 120 and text[at + 2] <= 32)


@kernel
def received(text: Any, at: int, end: int) -> bool:
    """Return whether a word is Rx."""
    return bool(end - at == 2 and text[at] == 82 and text[at + 1] == 120)


@kernel
def identifier(text: Any, at: int, end: int, base: int, hexes: Any) -> int:
    """Return an identifier with its flag, -1 if it is none; extended ones end with x."""
    flag = 0
    if (text[end - 1] | 32) == 120:
        flag, end = EXTENDED, end - 1
    value = number(text, at, end, base, hexes)
    return -1 if value < 0 else (value & ID_MASK) | flag


@kernel
def classic(text: Any, at: int, base: int, hexes: Any, words: Any, row: Any, k: int, t_ns: int) -> int:
    """Read what follows the channel of a classic frame; returns what it became."""
    end = word_end(text, at)
    for j in range(at, end):
        letter = 97 <= (text[j] | 32) <= 122
        if not (letter or is_digit(text, j) or text[j] == 95 or text[j] > 127):
            return _NOTHING
    word = skip(text, end)
    can_id = identifier(text, at, end, base, hexes)
    if not is_direction(text, word):
        return _WRONG if can_id >= 0 and text[word] == 10 else _NOTHING
    end = word_end(text, word)
    flags = 0 if received(text, word, end) else OWN
    at = skip(text, end)
    if can_id < 0 or text[at] == 10:
        return _WRONG
    if (text[at] | 32) == 114:
        begin_frame(words, k, t_ns, can_id | REMOTE, flags)
        at = skip(text, word_end(text, at))
        dlc = number(text, at, word_end(text, at), base, hexes)
        set_length(words, k, min(max(dlc, 0), 8))
        return _FRAME
    begin_frame(words, k, t_ns, can_id, flags)
    at = skip(text, word_end(text, at))
    end = word_end(text, at)
    dlc = number(text, at, end, base, hexes)
    if dlc < 0:
        return _WRONG
    wanted = min(fd_length(dlc), 8)
    length, at = byte_words(text, end, wanted, base, hexes, row)
    if length < 0:
        return _WRONG
    set_length(words, k, length)
    return _FRAME if length == fd_length(dlc) else _SHORT


@kernel
def flexible(text: Any, at: int, base: int, hexes: Any, error: Any, words: Any, row: Any, k: int, t_ns: int) -> int:
    """Read what follows the channel of a line of CAN FD, which may have a classic frame; returns what it became."""
    end = word_end(text, at)
    if not is_direction(text, at):
        return _NOTHING
    flags = 0 if received(text, at, end) else OWN
    at = skip(text, end)
    if begins(text, at, error):
        return _NOTHING
    end = word_end(text, at)
    if end == at:
        return _WRONG
    can_id = identifier(text, at, end, base, hexes)
    at, end = next_word(text, end)
    if number(text, at, end, 10, hexes) < 0:  # the frame's name
        at, end = next_word(text, end)
    if end - at == 1 and text[at] == 49:
        flags |= BRS
    at, end = next_word(text, end)
    if end - at == 1 and text[at] == 49:
        flags |= ESI
    at, end = next_word(text, end)
    dlc = number(text, at, end, base, hexes)
    at, end = next_word(text, end)
    wanted = number(text, at, end, 10, hexes)
    at = skip(text, end)
    if can_id < 0 or dlc < 0 or not 0 <= wanted <= 64:
        return _WRONG
    begin_frame(words, k, t_ns, can_id, 0)
    length, at = byte_words(text, at, wanted, base, hexes, row)
    if length < 0:
        return _WRONG
    for _ in range(2):  # how long it took, in time and in bits
        at = word_end(text, skip(text, at))
    at = skip(text, at)
    bits = number(text, at, word_end(text, at), 16, hexes)
    if (bits >= 0 and bits & _RTR) or (bits < 0 and wanted == 0 and dlc > 0):
        words[k, 1] |= np.uint64(REMOTE) | (np.uint64(flags & OWN) << np.uint64(FLAGS))
        set_length(words, k, min(dlc, 8))
        return _FRAME
    if bits < 0 or bits & _EDL or wanted > 8 or flags & (BRS | ESI):
        flags |= FD
    words[k, 1] |= np.uint64(flags) << np.uint64(FLAGS)
    set_length(words, k, length)
    return _FRAME if length == wanted else _SHORT


@kernel
def scan_asc(
    text: Any, at: int, words: Any, data: Any, channel: Any, k: int, base: int, hexes: Any, marks: Any, clock: Any
) -> tuple[int, int, int, int, int]:
    """Read lines into a batch (see :mod:`gateway.bus.readers.scan`).

    Args of its own: ``base`` of identifiers and data, 10 or 16. ``marks``: the letters of ``errorframe`` and ``canfd``.
    ``clock``: whether stamps count from the event before, the time of that, and what is added to each [ns]. It returns,
    too, whether the last frame had fewer bytes than it said.
    """
    error, fd = marks[:10], marks[10:]
    lines, short = 0, 0
    relative, shift = clock[0] != 0, clock[2]
    while at < text.shape[0] and k < words.shape[0]:
        i = skip(text, at)
        if text[i] == 10:
            at = i + 1
            lines += 1
            continue
        below = text[i] == 45
        if not is_digit(text, i + below):
            return at, lines, k, ASK, short
        t_ns, i, digits = decimal(text, i + below, 9)
        if t_ns < 0 or digits <= 0 or text[i] > 32:
            return at, lines, k, BAD, short
        t_ns = shift - t_ns if below else shift + t_ns
        if relative:
            t_ns += clock[1]
        made = _NOTHING
        i, end = next_word(text, i)
        place = number(text, i, end, 10, hexes)
        if place >= 0:
            made = classic(text, skip(text, end), base, hexes, words, data[k], k, t_ns)
        elif end - i == 5 and begins(text, i, fd) and text[i] == 67:
            i, end = next_word(text, end)
            place = number(text, i, end, 10, hexes)
            if place >= 0:
                made = flexible(text, skip(text, end), base, hexes, error, words, data[k], k, t_ns)
        if made == _NOTHING:
            return at, lines, k, ASK, short
        if relative:
            clock[1] = t_ns
        if made == _WRONG:
            return at, lines, k, BAD, short
        channel[k] = place - 1
        short = 1 if made == _SHORT else 0
        k += 1
        at = line_end(text, i)
        lines += 1
    return at, lines, k, DONE, short


def date_ns(text: str, zone: tzinfo = UTC) -> int:
    """Return a date as ASC writes it [ns], 0 if it is none."""
    found = _DATE.match(text)
    if found is None:
        return 0
    month, day, hour, minute, second, part, half, year = found.groups()
    number = _MONTHS.get(month.capitalize()) or (int(month) if month.isdigit() else 0)
    hours = int(hour) % 12 + (12 if half.lower() == "pm" else 0) if half else int(hour)
    try:
        date = datetime(int(year), number, int(day), hours, int(minute), int(second), tzinfo=zone)
    except ValueError:
        return 0
    return int(date.timestamp()) * 10**9 + int((part or "0").ljust(9, "0")[:9])


class Asc(Lines):
    """Lines of ASC."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._base = 16
        self._marks = np.frombuffer(b"errorframecanfd", np.uint8).copy()
        self._clock = np.zeros(3, np.int64)
        self._block, self._short = False, 0

    @staticmethod
    def sniff(first: bytes) -> bool:
        """Return whether one of the first lines is of its header."""
        begins = (b"base hex", b"base dec", b"begin triggerblock", b"internal events logged", b"no internal events")
        return any(line.strip().lower().startswith(begins) for line in first.splitlines()[:40])

    def begin(self, first: bytes) -> None:
        """Find out whether numbers have a comma, and whether stamps begin below 0."""
        if found := _FIRST.search(first):
            self.comma = found[3] == b","
            self._clock[2] = (int(found[2][:9]) + 1) * 10**9 if found[1] else 0

    def scan(self, text: NDArray[np.uint8], at: int, batch: Batch) -> tuple[int, int, int]:
        """Read lines."""
        at, lines, batch.count, status, self._short = scan_asc(
            text, at, *batch.room, self._base, HEX, self._marks, self._clock
        )
        return at, lines, status

    def asked(self, line: bytes, names: Names, batch: Batch) -> int:
        """Look at a line of the header, of a trigger block, or at an event."""
        t_ns = self._time(line)
        if t_ns is not None:
            if found := _STATE.match(line):
                classes, data = state_of(found[3], found[4])
                error_frame(batch, t_ns, classes, data, int(found[2]) - 1)
                return DONE
            return DONE if _KNOWN.match(line) else PASSED
        self._header(line)
        if _KNOWN.match(line):
            return DONE
        return PASSED if line.strip()[:1].isalpha() or line.strip()[:1] in b"#;" else BAD

    def _time(self, line: bytes) -> int | None:
        """Return the time of an event [ns], None: the line has no stamp."""
        found = _STAMP.match(line)
        if found is None:
            return None
        t_ns = int(found[2]) * 10**9 + int(found[3].ljust(9, b"0")[:9])
        t_ns = (-t_ns if found[1] else t_ns) + int(self._clock[2])
        if self._clock[0]:
            t_ns = self._clock[1] = t_ns + int(self._clock[1])
        return int(t_ns)

    def _header(self, line: bytes) -> None:
        text = line.decode("utf-8", "replace").strip()
        first, _, rest = text.partition(" ")
        rest = rest.strip()
        match first.lower():
            case "date":
                self._date(rest)
            case "base":
                words = rest.lower().split()
                self._base = 10 if words[:1] == ["dec"] else 16
                self._clock[0] = words[1:3] == ["timestamps", "relative"]
            case "begin" if rest.lower().startswith("triggerblock"):
                self._block = True
                self._date(rest.partition(" ")[2].strip())
            case "end" if rest.lower().startswith("triggerblock"):
                self._block = False

    def _date(self, text: str) -> None:
        if begin_ns := date_ns(text.replace(",", "."), self.zone):
            self.origin_ns = begin_ns - int(self._clock[2])

    def kind(self, line: bytes) -> str:
        """Return the first word of an event that is not read."""
        found = _STAMP.match(line)
        words = (found[4] if found else line).split()
        word = next((word for word in words if not word.isdigit()), b"")
        return f"an event that is no frame ({word[:20].decode('ascii', 'replace').rstrip(':')})"

    def cut(self, line: bytes, frame: Any, before: Frames) -> bool:
        """Return whether the last line is cut: it is no frame where it should be one, or has too few bytes."""
        text = line.strip().lower()
        if text[:1] in (b";", b"/") or text.startswith(b"end triggerblock"):
            return False
        return frame is None or bool(self._short)

    def unfinished(self) -> str:
        """Return whether a trigger block has no end."""
        return "its trigger block has no end" if self._block else ""


def state_of(status: bytes | None, rest: bytes) -> tuple[int, bytes]:
    """Return the classes and data of an error frame (linux/can/error.h); no ``status``: of an error on the bus."""
    if exact := conditions.exact_in(rest):
        return exact
    if status is None:
        return conditions.PROTOCOL | conditions.BUS_ERROR, b""
    counters = _COUNTERS.search(rest)
    transmit, receive = (min(int(text), 255) for text in counters.groups()) if counters else (0, 0)
    limit, sent, heard = conditions.CHIP_STATES.get(status.decode().lower(), (0, 0, 0))
    where = (sent if transmit >= limit else 0) | (heard if receive >= limit else 0) or sent | heard
    classes = conditions.CONTROLLER if where else conditions.BUS_OFF
    return classes, bytes([0, where, 0, 0, 0, 0, transmit, receive])

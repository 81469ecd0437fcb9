"""Vector's ASC: events as lines, frames among them.

Lines are::

    date Sat Sep 30 15:06:13.191 2017
    base hex  timestamps absolute
    0.015991 1  18EBFF00x       Rx   d 8 01 A0 0F A6 60 3B D1 40  Length = 273910 BitCount = 141 ID = 418119424x
    0.021964 1  1234ABCDx       Rx   r
    0.100000 2  ErrorFrame
    30.80673 CANFD   3 Rx        50005x                                   1 0 8  8 01 02 03 04 05 06 07 08  ...

Lines that are not frames are skipped, as in python-can. Stamps count from the begin of the measurement; the date,
which has no time zone, is taken as UTC where wall time is wanted. Where the header says ``timestamps relative`` a
stamp counts from the event before, which python-can does not know.
"""

from __future__ import annotations

import re
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway.bus.frames import BRS, ERROR, ESI, EXTENDED, FD, ID_MASK, OWN, REMOTE, Frames
from gateway.bus.readers.batch import Batch, Names
from gateway.bus.readers.scan import (
    ASK,
    BAD,
    DONE,
    HEX,
    begin_frame,
    byte_words,
    decimal,
    fd_length,
    is_digit,
    line_end,
    number,
    set_length,
    skip,
    word_end,
)
from gateway.bus.readers.text import Lines, shown
from gateway_fdi.errors import InputError
from gateway_fdi.jit import kernel

#: Result of a line: nothing, a frame, a frame whose line has fewer bytes than it says, no frame but should be one.
_NOTHING, _FRAME, _SHORT, _WRONG = 0, 1, 2, 3

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
    """Return whether a line goes on with letters, whatever their case.

    Args:
        text: bytes.
        at: where.
        lower: the letters in lower case, uint8.
    """
    for k in range(lower.shape[0]):
        if (text[at + k] | 32) != lower[k]:
            return False
    return True


@kernel
def is_direction(text: Any, at: int) -> bool:
    """Return whether Rx or Tx, in any case, begins here."""
    return bool((text[at] | 32) in (114, 116) and (text[at + 1] | 32) == 120)


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
def classic(text: Any, at: int, base: int, hexes: Any, error: Any, words: Any, row: Any, k: int, t_ns: int) -> int:
    """Read what follows the channel of a classic frame; returns what it became."""
    end = word_end(text, at)
    if begins(text, at, error):
        begin_frame(words, k, t_ns, EXTENDED | ERROR, 0)
        return _FRAME
    for j in range(at, end):
        letter = 97 <= (text[j] | 32) <= 122
        if not (letter or is_digit(text, j) or text[j] == 95 or text[j] > 127):
            return _NOTHING
    word = skip(text, end)
    if not is_direction(text, word):
        return _NOTHING
    can_id = identifier(text, at, end, base, hexes)
    end = word_end(text, word)
    flags = 0 if received(text, word, end) else OWN
    at = skip(text, end)
    if can_id < 0 or text[at] == 10:
        return _WRONG
    if (text[at] | 32) == 114:
        begin_frame(words, k, t_ns, can_id | REMOTE, flags)
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
    """Read what follows the channel of a line of CAN FD; returns what it became."""
    end = word_end(text, at)
    flags = FD if received(text, at, end) else FD | OWN
    at = skip(text, end)
    if begins(text, at, error):
        begin_frame(words, k, t_ns, EXTENDED | ERROR, flags)
        return _FRAME
    end = word_end(text, at)
    if end == at:
        return _WRONG
    can_id = identifier(text, at, end, base, hexes)
    at = skip(text, end)
    end = word_end(text, at)
    if number(text, at, end, 10, hexes) < 0:  # the frame's name
        at = skip(text, end)
        end = word_end(text, at)
    if end - at == 1 and text[at] == 49:
        flags |= BRS
    at = skip(text, end)
    end = word_end(text, at)
    if end - at == 1 and text[at] == 49:
        flags |= ESI
    at = skip(text, end)
    end = word_end(text, at)
    dlc = number(text, at, end, base, hexes)
    at = skip(text, end)
    end = word_end(text, at)
    wanted = number(text, at, end, 10, hexes)
    at = skip(text, end)
    if can_id < 0 or dlc < 0 or not 0 <= wanted <= 64 or text[at] == 10:
        return _WRONG
    if wanted == 0:
        begin_frame(words, k, t_ns, can_id | REMOTE, flags)
        return _FRAME
    begin_frame(words, k, t_ns, can_id, flags)
    length, at = byte_words(text, at, wanted, base, hexes, row)
    if length < 0:
        return _WRONG
    set_length(words, k, length)
    return _FRAME if length == wanted else _SHORT


@kernel
def scan_asc(
    text: Any, at: int, words: Any, data: Any, channel: Any, k: int, base: int, hexes: Any, marks: Any, clock: Any
) -> tuple[int, int, int, int, int]:
    """Read lines into a batch.

    Args:
        text: lines, uint8.
        at: where to begin.
        words: the batch, uint64, shape (frames, 10).
        data: the same as uint8, shape (frames, 80).
        channel: takes the channel of each frame, counted from 0.
        k: frames that are in already.
        base: of identifiers and data, 10 or 16.
        hexes: :data:`gateway.bus.readers.scan.HEX`.
        marks: the letters of ``errorframe`` and ``canfd``, uint8.
        clock: whether stamps count from the event before, and the time of that [ns].

    Returns:
        where the next line begins, lines read, frames that are in, state of the line there, whether the last frame
        had fewer bytes than it said.
    """
    error, fd = marks[:10], marks[10:]
    lines, short = 0, 0
    while at < text.shape[0] and k < words.shape[0]:
        i = skip(text, at)
        if not is_digit(text, i):
            if text[i] in (66, 98, 68, 100, 69, 101):  # begin, base, date, end
                return at, lines, k, ASK, short
            at = line_end(text, i)
            lines += 1
            continue
        t_ns, i, digits = decimal(text, i, 9)
        made = _NOTHING
        if t_ns >= 0 and digits > 0 and text[i] <= 32:
            if clock[0]:
                clock[1] += t_ns
                t_ns = clock[1]
            i = skip(text, i)
            end = word_end(text, i)
            place = number(text, i, end, 10, hexes)
            if place >= 0:
                made = classic(text, skip(text, end), base, hexes, error, words, data[k], k, t_ns)
            elif end - i == 5 and begins(text, i, fd) and text[i] == 67:
                i = skip(text, end)
                end = word_end(text, i)
                place = number(text, i, end, 10, hexes)
                made = _WRONG
                if place >= 0:
                    made = flexible(text, skip(text, end), base, hexes, error, words, data[k], k, t_ns)
            if made == _WRONG:
                return at, lines, k, BAD, short
            if made != _NOTHING:
                channel[k] = place - 1
                short = 1 if made == _SHORT else 0
                k += 1
        at = line_end(text, i)
        lines += 1
    return at, lines, k, DONE, short


def date_ns(text: str) -> int:
    """Return a date as ASC writes it as if it were UTC [ns], 0 if it is none."""
    found = _DATE.match(text)
    if found is None:
        return 0
    month, day, hour, minute, second, part, half, year = found.groups()
    number = _MONTHS.get(month.capitalize()) or (int(month) if month.isdigit() else 0)
    hours = int(hour) % 12 + (12 if half.lower() == "pm" else 0) if half else int(hour)
    try:
        date = datetime(int(year), number, int(day), hours, int(minute), int(second), tzinfo=UTC)
    except ValueError:
        return 0
    return int(date.timestamp()) * 10**9 + int((part or "0").ljust(9, "0")[:9])


class Asc(Lines):
    """Lines of ASC.

    Args:
        path: for errors.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._base = 16
        self._marks = np.frombuffer(b"errorframecanfd", np.uint8).copy()
        self._clock = np.zeros(2, np.int64)
        self._block, self._short = False, 0
        self._places: dict[int, int] = {}

    def scan(self, text: NDArray[np.uint8], at: int, batch: Batch) -> tuple[int, int, int]:
        """Read lines."""
        at, lines, batch.count, status, self._short = scan_asc(
            text, at, batch.words, batch.data, batch.channel, batch.count, self._base, HEX, self._marks, self._clock
        )
        return at, lines, status

    def asked(self, line: bytes, names: Names) -> bool:
        """Look at a line of the header, or of a trigger block."""
        del names
        text = line.decode("utf-8", "replace").strip()
        first, _, rest = text.partition(" ")
        rest = rest.strip()
        match first.lower():
            case "date":
                self.origin_ns = date_ns(rest)
            case "base":
                words = rest.lower().split()
                self._base = 10 if words[:1] == ["dec"] else 16
                self._clock[0] = words[1:3] == ["timestamps", "relative"]
            case "begin" if rest.lower().startswith("triggerblock"):
                self._block = True
                self.origin_ns = date_ns(rest.partition(" ")[2].strip()) or self.origin_ns
            case "end" if rest.lower().startswith("triggerblock"):
                self._block = False
        return True

    def bad(self, line: bytes, number: int) -> InputError:
        """Return the error of a bad line."""
        return InputError("not a line of an ASC log", file=self._path, line=number, value=shown(line))

    def cut(self, line: bytes, frame: Any, before: Frames) -> bool:
        """Return whether the last line is cut: it is no frame where it should be one, or has too few bytes."""
        del before
        text = line.strip().lower()
        if text[:1] in (b";", b"/") or text.startswith(b"end triggerblock"):
            return False
        return frame is None or bool(self._short)

    def unfinished(self) -> str:
        """Return whether a trigger block has no end."""
        return "its trigger block has no end" if self._block else ""

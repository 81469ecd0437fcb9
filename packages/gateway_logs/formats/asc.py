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
from datetime import UTC, tzinfo
from pathlib import Path
from typing import Any

import numpy as np

from gateway.bus import conditions
from gateway.bus.frames import BRS, ESI, EXTENDED, FD, ID_MASK, OWN, REMOTE, Frames
from gateway.bus.readers.batch import FLAGS, Batch, Names, error_frame, scaled, wall_ns
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
    is_digit,
    line_end,
    next_number,
    next_word,
    number,
    pair,
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
#: State of the kernel: base of identifiers and data; whether stamps count from the event before, and the time of that
#: [ns]; what is added to each stamp [ns]; whether the last frame has fewer bytes than its line says.
BASE, RELATIVE, BEFORE, SHIFT, SHORT = range(5)
#: Error frames and chip states.
_STATE = re.compile(
    rb"\s*-?\d+\.\d+\s+(?:CAN(?:FD)?\s+)?(\d+)\s+(?:[TR]x\s+)?"
    rb"(?:ErrorFrame|Status:\s*chip status (error active|warning level|error passive|bus off))(.*)",
    re.IGNORECASE,
)
_STAMP = re.compile(rb"\s*(-?\d+\.\d+)\s+(.*)")
#: Lines that are known to be no frames, and lose nothing.
_KNOWN = re.compile(
    rb"\s*(?://|$|date |base |(?:no )?internal events logged|begin |end |-?[\d.]+\s+(?:CANFD\s+)?(?:CAN\s+)?"
    rb"(?:start of measurement|\d+\s+statistic:|\d+\s+\S+\s+txrq\b))",
    re.IGNORECASE,
)
#: The first event's stamp.
_FIRST = re.compile(rb"^[ \t]*(-?)(\d+)([.,])\d+\s", re.MULTILINE)
_COUNTERS = re.compile(rb"TxErr:\s*(\d+)\s+RxErr:\s*(\d+)")
#: Name of a month in English or German -> its number.
_MONTHS = {
    name: k
    for names in ("Jan Feb Mar Apr May Jun Jul Aug Sep Oct Nov Dec", "Jan Feb Mär Apr Mai Jun Jul Aug Sep Okt Nov Dez")
    for k, name in enumerate(names.split(), start=1)
}
_DATE = re.compile(r"\w+\s+(\w+)\s+(\d+)\s+(\d+):(\d+):(\d+(?:\.\d+)?)(?:\s+([ap]m))?\s+(\d{4})\s*$", re.IGNORECASE)


@kernel
def begins(text: Any, at: int, lower: bytes) -> bool:
    """Return whether a line goes on with letters, here in lower case, whatever their case."""
    for k in range(len(lower)):
        if (text[at + k] | 32) != lower[k]:
            return False
    return True


@kernel
def direction(text: Any, at: int) -> int:
    """Return the flag of a direction, which is Rx or Tx in any case; -1: it is none."""
    way = pair(text, at)
    if way == RX:
        return 0
    return OWN if way | 0x2020 in (RX | 0x2020, TX | 0x2020) else -1


@kernel
def identifier(text: Any, at: int, end: int, base: int) -> int:
    """Return an identifier with its flag, -1 if it is none; extended ones end with x."""
    flag = 0
    if (text[end - 1] | 32) == 120:
        flag, end = EXTENDED, end - 1
    value = number(text, at, end, base)
    return -1 if value < 0 else (value & ID_MASK) | flag


@kernel
def classic(text: Any, at: int, base: int, words: Any, row: Any, k: int, t_ns: int) -> int:
    """Read what follows the channel of a classic frame; returns what it became."""
    at, end = next_word(text, at)
    for j in range(at, end):
        letter = 97 <= (text[j] | 32) <= 122
        if not (letter or is_digit(text, j) or text[j] == 95 or text[j] > 127):
            return _NOTHING
    can_id = identifier(text, at, end, base)
    at, end = next_word(text, end)
    flags = direction(text, at)
    if flags < 0:
        return _WRONG if can_id >= 0 and text[at] == 10 else _NOTHING
    at, end = next_word(text, end)
    if can_id < 0 or text[at] == 10:
        return _WRONG
    begin_frame(words, k, t_ns, can_id, flags)
    dlc, end = next_number(text, end, base)
    if (text[at] | 32) == 114:
        words[k, 1] |= np.uint64(REMOTE)
        set_length(words, k, min(max(dlc, 0), 8))
        return _FRAME
    if dlc < 0:
        return _WRONG
    length, at = byte_words(text, end, min(fd_length(dlc), 8), base, row)
    if length < 0:
        return _WRONG
    set_length(words, k, length)
    return _FRAME if length == fd_length(dlc) else _SHORT


@kernel
def flexible(text: Any, at: int, base: int, words: Any, row: Any, k: int, t_ns: int) -> int:
    """Read what follows the channel of a line of CAN FD, which may have a classic frame; returns what it became."""
    at, end = next_word(text, at)
    flags = direction(text, at)
    at, end = next_word(text, end)
    if flags < 0 or begins(text, at, b"errorframe"):
        return _NOTHING
    if end == at:
        return _WRONG
    can_id = identifier(text, at, end, base)
    brs, after = next_number(text, end, 10)
    if brs < 0:  # the frame's name
        brs, after = next_number(text, word_end(text, skip(text, end)), 10)
    esi, end = next_number(text, after, 10)
    dlc, end = next_number(text, end, base)
    wanted, end = next_number(text, end, 10)
    if can_id < 0 or dlc < 0 or not 0 <= wanted <= 64:
        return _WRONG
    begin_frame(words, k, t_ns, can_id, 0)
    length, at = byte_words(text, end, wanted, base, row)
    if length < 0:
        return _WRONG
    for _ in range(2):  # how long it took, in time and in bits
        at = word_end(text, skip(text, at))
    bits, _ = next_number(text, at, 16)
    if (bits >= 0 and bits & _RTR) or (bits < 0 and wanted == 0 and dlc > 0):
        words[k, 1] |= np.uint64(REMOTE) | (np.uint64(flags) << np.uint64(FLAGS))
        set_length(words, k, min(dlc, 8))
        return _FRAME
    flags |= (BRS if brs == 1 else 0) | (ESI if esi == 1 else 0)
    if bits < 0 or bits & _EDL or wanted > 8 or flags & (BRS | ESI):
        flags |= FD
    words[k, 1] |= np.uint64(flags) << np.uint64(FLAGS)
    set_length(words, k, length)
    return _FRAME if length == wanted else _SHORT


@kernel
def scan_asc(text: Any, at: int, words: Any, data: Any, channel: Any, k: int, state: Any) -> tuple[int, int, int, int]:
    """Read lines into a batch (see :mod:`gateway.bus.readers.scan`); ``state``, int64, is kept from call to call."""
    lines, base = 0, state[BASE]
    while at < text.shape[0] and k < words.shape[0]:
        i = skip(text, at)
        if text[i] == 10:
            at = i + 1
            lines += 1
            continue
        below = text[i] == 45
        if not is_digit(text, i + below):
            return at, lines, k, ASK
        t_ns, i, digits = decimal(text, i + below, 9)
        if t_ns < 0 or digits <= 0 or text[i] > 32:
            return at, lines, k, BAD
        t_ns = state[SHIFT] + state[BEFORE] + (-t_ns if below else t_ns)
        made = _NOTHING
        i, end = next_word(text, i)
        place = number(text, i, end, 10)
        if place >= 0:
            made = classic(text, end, base, words, data[k], k, t_ns)
        elif end - i == 5 and text[i] == 67 and begins(text, i, b"canfd"):
            place, end = next_number(text, end, 10)
            if place >= 0:
                made = flexible(text, end, base, words, data[k], k, t_ns)
        if made == _NOTHING:
            return at, lines, k, ASK
        if state[RELATIVE]:
            state[BEFORE] = t_ns
        if made == _WRONG:
            return at, lines, k, BAD
        channel[k] = place - 1
        state[SHORT] = made == _SHORT
        k += 1
        at = line_end(text, i)
        lines += 1
    return at, lines, k, DONE


def date_ns(text: str, zone: tzinfo = UTC) -> int:
    """Return a date as ASC writes it [ns], 0 if it is none."""
    found = _DATE.match(text)
    if found is None:
        return 0
    month, day, hour, minute, second, half, year = found.groups()
    number = _MONTHS.get(month.capitalize()) or (int(month) if month.isdigit() else 0)
    hours = int(hour) % 12 + (12 if half.lower() == "pm" else 0) if half else int(hour)
    seconds, part_ns = divmod(scaled(second, 9), 10**9)
    return wall_ns(zone, part_ns, int(year), number, int(day), hours, int(minute), seconds)


class Asc(Lines):
    """Lines of ASC."""

    last = re.compile(rb"\s*(?:;|/|end triggerblock)", re.IGNORECASE)

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._state = np.zeros(5, np.int64)
        self._state[BASE] = 16
        self.scanner = scan_asc, (self._state,)

    @staticmethod
    def sniff(first: bytes) -> bool:
        """Return whether one of the first lines is of its header."""
        begins = (b"base hex", b"base dec", b"begin triggerblock", b"internal events logged", b"no internal events")
        return any(line.strip().lower().startswith(begins) for line in first.splitlines()[:40])

    def begin(self, first: bytes) -> None:
        """Find out whether numbers have a comma, and whether stamps begin below 0."""
        if found := _FIRST.search(first):
            self.comma = found[3] == b","
            self._state[SHIFT] = (int(found[2][:9]) + 1) * 10**9 if found[1] else 0

    def asked(self, line: bytes, names: Names, batch: Batch) -> int:
        """Look at a line of the header, of a trigger block, or at an event."""
        stamp = _STAMP.match(line)
        if stamp is None:
            self._header(line.decode("utf-8", "replace").strip())
        else:
            t_ns = scaled(stamp[1].decode(), 9) + int(self._state[SHIFT] + self._state[BEFORE])
            if self._state[RELATIVE]:
                self._state[BEFORE] = t_ns
            if found := _STATE.match(line):
                error_frame(batch, t_ns, *state_of(found[2], found[3]), int(found[1]) - 1)
                return DONE
        if _KNOWN.match(line):
            return DONE
        text = (stamp[2] if stamp else line).strip()
        if not stamp and not (text[:1].isalpha() or text[:1] in b"#;"):
            return BAD
        word = next((word for word in text.split() if not word.isdigit()), b"")
        return self.event(f"an event that is no frame ({word[:20].decode('ascii', 'replace').rstrip(':')})", line)

    def _header(self, text: str) -> None:
        first, _, rest = text.partition(" ")
        rest = rest.strip()
        words = rest.lower().split()
        match first.lower():
            case "date":
                self._date(rest)
            case "base":
                self._state[BASE] = 10 if words[:1] == ["dec"] else 16
                relative = words[1:3] == ["timestamps", "relative"]
                self._state[RELATIVE], self._state[BEFORE] = relative, relative * self._state[BEFORE]
            case "begin" if rest.lower().startswith("triggerblock"):
                self.missing = "its trigger block has no end"
                self._date(rest.partition(" ")[2].strip())
            case "end" if rest.lower().startswith("triggerblock"):
                self.missing = ""

    def _date(self, text: str) -> None:
        if begin_ns := date_ns(text.replace(",", "."), self.zone):
            self.origin_ns = begin_ns - int(self._state[SHIFT])

    def short(self, frame: Any, before: Frames) -> bool:
        """Return whether the last line has fewer bytes than it says."""
        return bool(self._state[SHORT])


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

"""candump logs, as ``candump -L`` (and ``-N`` with nanoseconds) writes them, and what it prints with ``-t``.

Lines are, of a log, and of a console::

    (1700000000.123456789) can0 123#1122
    (1700000000.123456789) can0 12345678##5112233
    (1700000000.123456789) can0 123#R3
    (1700000000.123456) can0 123#1122334455667788_B
    (2023-11-14 22:13:20.123456)  can0  RX - -  123   [2]  11 22
    (000.001000)  can0  123   [3]  remote request

Those of a log are read by a kernel, those of a console (-t a, A, d, z; -x) by Python. A raw DLC (``_B``) is left out: a
frame of 8 bytes has 8 bytes.

python-can reads such stamps as float seconds, whose spacing today is 238 ns; here each nanosecond is kept, so that live
equals replay.
"""

from __future__ import annotations

import re
from datetime import datetime
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from gateway.bus.frames import BRS, ERROR, ESI, EXTENDED, FD, OWN, REMOTE, Frames
from gateway.bus.readers.batch import FLAGS, Batch, Names, scaled, wall_ns
from gateway.bus.readers.scan import (
    ASK,
    BAD,
    DONE,
    HEX,
    begin_frame,
    byte,
    decimal,
    hex_pairs,
    line_end,
    next_word,
    number,
    set_length,
    skip,
)
from gateway.bus.readers.text import Lines
from gateway_fdi.jit import kernel

#: A line of a log whose interface the kernel does not know, and one of a console.
_LOGGED = re.compile(rb"\s*\(\d+(?:\.\d+)?\)\s+([^\0-\x20]+)\s+[0-9A-Fa-f]{3,8}#")
_PRINTED = re.compile(
    rb"\s*\(([\d.: -]+\.\d+)\)\s+(\S+)\s+(?:([TR]X)\s+([B-]\s+[E-])\s+)?([0-9A-Fa-f]{1,8})\s+"
    rb"(\[\d{1,2}\]|\{[0-9A-Fa-f]\})\s*(.*)"
)
#: Seconds from which on stamps are wall time.
_WALL_S = 315_532_800
#: Bytes of a log's begin that are looked at.
_LOOK = 1 << 16
#: Characters of an interface's name at most.
_LONGEST = 64


@kernel
def name_place(text: Any, at: int, end: int, names: Any, first: int) -> int:
    """Return the place of a name, which is text from ``at`` to ``end``, among those known, -1: not there.

    ``names`` are bytes, shape (names, longest + 1), zeros behind each. The place ``first`` is looked at first.
    """
    for step in range(-1, names.shape[0]):
        k, j = first if step < 0 else step, 0
        while j < end - at and names[k, j] == text[at + j]:
            j += 1
        if j == end - at and names[k, j] == 0:
            return k
    return -1


@kernel
def identifier(text: Any, at: int, end: int) -> int:
    """Return an identifier with its flags, -1 if it is none: three digits, or eight.

    Eight digits are an extended identifier, or the kernel's identifier of an error frame.
    """
    value = number(text, at, end, 16)
    if end - at == 3:
        return value if value <= 0x7FF else -1
    if end - at != 8 or value < 0:
        return -1
    return value if value & ERROR else (value & 0x1FFFFFFF) | EXTENDED


@kernel
def body(text: Any, at: int, words: Any, row: Any, k: int, t_ns: int) -> int:
    """Read ``ID#DATA``, ``ID##FDATA`` or ``ID#R`` into a frame; returns where it ends, -1 if it is bad."""
    end = at
    while HEX[text[end]] < 16:
        end += 1
    can_id = identifier(text, at, end)
    if can_id < 0 or text[end] != 35:
        return -1
    at = end + 1
    if text[at] == 35:
        bits = byte(HEX, text[at + 1])
        if bits > 15:
            return -1
        flags = FD | (BRS if bits & 1 else 0) | (ESI if bits & 2 else 0)
        begin_frame(words, k, t_ns, can_id, flags)
        length, at = hex_pairs(text, at + 2, 64, row)
        if length > 8 and not (length % 4 == 0 and (length <= 24 or length in (32, 48, 64))):
            return -1
    elif text[at] in (82, 114):
        begin_frame(words, k, t_ns, can_id | REMOTE, 0)
        length, at = byte(HEX, text[at + 1]), at + 1
        if length > 8:
            length = 0
        else:
            at += 1
    else:
        begin_frame(words, k, t_ns, can_id, 0)
        length, at = hex_pairs(text, at, 8, row)
    if length == 8 and text[at] == 95 and 9 <= HEX[text[at + 1]] <= 15:
        at += 2
    if length < 0 or text[at] > 32:
        return -1
    set_length(words, k, length)
    return at


@kernel
def scan_candump(
    text: Any, at: int, words: Any, data: Any, channel: Any, k: int, names: Any
) -> tuple[int, int, int, int]:
    """Read lines into a batch (see :mod:`gateway.bus.readers.scan`); names as :func:`name_place` has them."""
    lines, place = 0, 0
    while at < text.shape[0] and k < words.shape[0]:
        i = skip(text, at)
        if text[i] == 10:
            at = i + 1
            lines += 1
            continue
        if text[i] != 40:
            return at, lines, k, ASK
        t_ns, i, digits = decimal(text, i + 1, 9)
        if t_ns < 0 or digits > 9 or text[i] != 41 or text[i + 1] > 32:
            return at, lines, k, ASK
        i, end = next_word(text, i + 1)
        if end == i or end - i >= names.shape[1]:
            return at, lines, k, BAD
        place = name_place(text, i, end, names, place)
        if place < 0:
            return at, lines, k, ASK
        i = body(text, skip(text, end), words, data[k], k, t_ns)
        if i < 0:
            return at, lines, k, ASK
        channel[k] = place
        i = skip(text, i)
        if text[i] in (84, 116) and text[i + 1] <= 32:
            words[k, 1] |= np.uint64(OWN) << np.uint64(FLAGS)
        at = line_end(text, i)
        lines += 1
        k += 1
    return at, lines, k, DONE


class Candump(Lines):
    """Lines of candump."""

    numbered = False
    good = '"(seconds) interface ID#DATA", or as candump prints it with -t'
    last = re.compile(rb"\t")

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._names = np.zeros((8, _LONGEST + 1), np.uint8)
        self.scanner = scan_candump, (self._names,)
        self._delta, self._last_ns = False, 0

    @staticmethod
    def sniff(first: bytes) -> bool:
        """Return whether one of the first lines is of candump."""
        return any(_LOGGED.match(line) or _PRINTED.match(line) for line in first.splitlines()[:20])

    def begin(self, first: bytes) -> None:
        """Find out whether stamps count from the frame before (-t d): then they go down about as often as up."""
        if not _PRINTED.match(first):
            return
        found = [one[1] for one in map(_PRINTED.match, first[:_LOOK].splitlines()) if one]
        stamps = [float(stamp) for stamp in found if stamp.count(b".") == 1 and b"-" not in stamp]
        down, up = (sum(a > b for a, b in pairwise(ways)) for ways in (stamps, stamps[::-1]))
        self._delta = len(stamps) > 1 and max(stamps) < _WALL_S and 2 * down >= up

    def asked(self, line: bytes, names: Names, batch: Batch) -> int:
        """Take the name of a line's interface, or read a line of a console."""
        if line[:1] == b"\t":  # of candump -e
            return self.event("explanation of an error frame", line)
        if found := _PRINTED.match(line):
            return self._printed(found, names, batch)
        if not (found := _LOGGED.match(line)) or len(found[1]) > _LONGEST:
            return BAD
        place = names.place(found[1].decode("ascii", "backslashreplace"))
        if place >= len(self._names):
            self._names = np.pad(self._names, ((0, place + 1), (0, 0)))
            self.scanner = scan_candump, (self._names,)
        if self._names[place, 0]:  # the kernel knows it
            return BAD
        self._names[place, : len(found[1])] = np.frombuffer(found[1], np.uint8)
        return ASK

    def _printed(self, found: re.Match[bytes], names: Names, batch: Batch) -> int:
        """Read a line of a console."""
        stamp, name, sent, bits, digits, size, rest = found.groups()
        t_ns = self._stamp_ns(stamp.decode())
        can_id = int(digits, 16)
        if (len(digits) == 8 or can_id > 0x7FF) and not can_id & ERROR:  # others than candump fill up with no zeros
            can_id |= EXTENDED
        count = 8 if size[:1] == b"{" else int(size[1:-1])
        fd = count > 8 or len(size) == 4  # [08]: CAN FD, [8]: classic
        flags = (FD if fd else 0) | (OWN if sent == b"TX" else 0)
        if fd and bits:
            flags |= (BRS if b"B" in bits else 0) | (ESI if b"E" in bits else 0)
        data = bytes(count)
        if rest[:14] == b"remote request":
            can_id |= REMOTE
        else:
            try:
                data = bytes.fromhex(b" ".join(rest.split()[:count]).decode())
            except ValueError:
                return BAD
        if t_ns is None or len(data) != count or count > 64 or (can_id & REMOTE and count > 8):
            return BAD
        batch.put(t_ns, can_id, data, names.place(name.decode("ascii", "backslashreplace")), flags=flags)
        return DONE

    def _stamp_ns(self, text: str) -> int | None:
        """Return a stamp of a console [ns], None: it is none."""
        whole, _, part = text.partition(".")
        try:
            if not whole.isdecimal():
                date = datetime.strptime(whole, "%Y-%m-%d %H:%M:%S")
                return wall_ns(self.zone, scaled(f"0.{part}", 9), *date.timetuple()[:6])
            t_ns = scaled(text, 9)
        except ValueError:
            return None
        if self._delta:
            t_ns = self._last_ns = self._last_ns + t_ns
        return t_ns

    def short(self, frame: Any, before: Frames) -> bool:
        """Return whether the last frame is shorter than the one before it of the same identifier."""
        same = before[before["can_id"] == frame["can_id"]]
        return bool(len(same) and frame["length"] < same[-1]["length"])

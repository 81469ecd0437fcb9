"""candump logs, as ``candump -L`` (and ``-N`` with nanoseconds) writes them.

Lines are::

    (1700000000.123456789) can0 123#1122
    (1700000000.123456789) can0 12345678##5112233
    (1700000000.123456789) can0 123#R

python-can reads such stamps as float seconds, whose spacing today is 238 ns; here each nanosecond is kept, so that live
equals replay.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway.bus.frames import BRS, ERROR, ESI, EXTENDED, FD, OWN, REMOTE, Frames
from gateway.bus.readers.batch import FLAGS, Batch, Names
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
    number,
    set_length,
    skip,
    word_end,
)
from gateway.bus.readers.text import Lines, shown
from gateway_fdi.errors import InputError
from gateway_fdi.jit import kernel

_BAD_LINE = 'a line is "(seconds) interface ID#DATA"'
#: Characters of an interface's name at most.
_LONGEST = 64


@kernel
def name_place(text: Any, at: int, end: int, names: Any, lengths: Any, first: int) -> int:
    """Return the place of a name among those known, -1: not there.

    Args:
        text: bytes.
        at: where the name begins.
        end: where it ends.
        names: bytes of each name, shape (names, longest).
        lengths: of each name, -1: no more; shape (names,).
        first: the place to look at first.
    """
    count = names.shape[0]
    for step in range(-1, count):
        k = first if step < 0 else step
        if lengths[k] != end - at:
            if lengths[k] < 0 and step >= 0:
                return -1
            continue
        same = True
        for j in range(end - at):
            if names[k, j] != text[at + j]:
                same = False
                break
        if same:
            return k
    return -1


@kernel
def identifier(text: Any, at: int, end: int, hexes: Any) -> int:
    """Return an identifier with its flags, -1 if it is none: three digits, or eight.

    Eight digits are an extended identifier, or the kernel's identifier of an error frame.
    """
    value = number(text, at, end, 16, hexes)
    if end - at == 3:
        return value if value <= 0x7FF else -1
    if end - at != 8 or value < 0:
        return -1
    return value if value & ERROR else (value & 0x1FFFFFFF) | EXTENDED


@kernel
def body(text: Any, at: int, hexes: Any, words: Any, row: Any, k: int, t_ns: int) -> int:
    """Read ``ID#DATA``, ``ID##FDATA`` or ``ID#R`` into a frame; returns where it ends, -1 if it is bad."""
    end = at
    while hexes[text[end]] < 16:
        end += 1
    can_id = identifier(text, at, end, hexes)
    if can_id < 0 or text[end] != 35:
        return -1
    at = end + 1
    if text[at] == 35:
        bits = byte(hexes, text[at + 1])
        if bits > 15:
            return -1
        flags = FD | (BRS if bits & 1 else 0) | (ESI if bits & 2 else 0)
        begin_frame(words, k, t_ns, can_id, flags)
        length, at = hex_pairs(text, at + 2, 64, hexes, row)
        if length > 8 and not (length % 4 == 0 and (length <= 24 or length in (32, 48, 64))):
            return -1
    elif text[at] in (82, 114):
        begin_frame(words, k, t_ns, can_id | REMOTE, 0)
        return int(word_end(text, at))
    else:
        begin_frame(words, k, t_ns, can_id, 0)
        length, at = hex_pairs(text, at, 8, hexes, row)
    if length < 0 or text[at] > 32:
        return -1
    set_length(words, k, length)
    return at


@kernel
def scan_candump(
    text: Any, at: int, words: Any, data: Any, channel: Any, k: int, names: Any, lengths: Any, hexes: Any
) -> tuple[int, int, int, int]:
    """Read lines into a batch.

    Args:
        text: lines, uint8.
        at: where to begin.
        words: the batch, uint64, shape (frames, 10).
        data: the same as uint8, shape (frames, 80).
        channel: takes the place of each frame's interface.
        k: frames that are in already.
        names: of interfaces, see :func:`name_place`.
        lengths: of them.
        hexes: :data:`gateway.bus.readers.scan.HEX`.

    Returns:
        where the next line begins, lines read, frames that are in, state of the line there.
    """
    lines, place = 0, 0
    while at < text.shape[0] and k < words.shape[0]:
        i = skip(text, at)
        if text[i] == 10:
            at = i + 1
            lines += 1
            continue
        if text[i] != 40:
            return at, lines, k, BAD
        t_ns, i, digits = decimal(text, i + 1, 9)
        if t_ns < 0 or digits > 9 or text[i] != 41:
            return at, lines, k, BAD
        if text[i + 1] > 32:
            return at, lines, k, BAD
        i = skip(text, i + 1)
        end = word_end(text, i)
        if end == i or end - i > names.shape[1]:
            return at, lines, k, BAD
        place = name_place(text, i, end, names, lengths, place)
        if place < 0:
            return at, lines, k, ASK
        i = body(text, skip(text, end), hexes, words, data[k], k, t_ns)
        if i < 0:
            return at, lines, k, BAD
        channel[k] = place
        i = skip(text, i)
        if text[i] in (84, 116) and text[i + 1] <= 32:
            words[k, 1] |= np.uint64(OWN) << np.uint64(FLAGS)
        at = line_end(text, i)
        lines += 1
        k += 1
    return at, lines, k, DONE


def cut_short(frame: np.void, before: Frames) -> bool:
    """Return whether a log's last frame is shorter than the one before it of the same identifier."""
    same = before[before["can_id"] == frame["can_id"]]
    return bool(len(same) and frame["length"] < same[-1]["length"])


class Candump(Lines):
    """Lines of candump.

    Args:
        path: for errors.
    """

    numbered = False

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._names = np.zeros((8, _LONGEST), np.uint8)
        self._lengths = np.full(8, -1, np.int64)

    def scan(self, text: NDArray[np.uint8], at: int, batch: Batch) -> tuple[int, int, int]:
        """Read lines."""
        at, lines, batch.count, status = scan_candump(
            text, at, batch.words, batch.data, batch.channel, batch.count, self._names, self._lengths, HEX
        )
        return at, lines, status

    def asked(self, line: bytes, names: Names) -> bool:
        """Take the name of a line's interface."""
        name = line.split()[1]
        place = names.place(name.decode("ascii", "backslashreplace"))
        if place >= len(self._names):
            self._names = np.concatenate((self._names, np.zeros_like(self._names)))
            self._lengths = np.concatenate((self._lengths, np.full_like(self._lengths, -1)))
        self._names[place, : len(name)] = np.frombuffer(name, np.uint8)
        self._lengths[place] = len(name)
        return False

    def bad(self, line: bytes, number: int) -> InputError:
        """Return the error of a bad line."""
        return InputError(_BAD_LINE, file=self._path, line=number, value=shown(line))

    def cut(self, line: bytes, frame: Any, before: Frames) -> bool:
        """Return whether the last line is cut: it is no frame, or one that is shorter than its like."""
        del line
        return frame is None or cut_short(frame, before)

"""CSV as python-can writes it: a line a frame, its payload in base64.

Lines are, after the header::

    timestamp,arbitration_id,extended,remote,error,dlc,data
    1483389946.197,0x00dadada,1,0,0,6,WzQyLCA5XQ==

Stamps are float seconds; those of a recorder that counts microseconds are restored
(:func:`gateway.bus.frames.nanoseconds`).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gateway.bus.frames import ERROR, EXTENDED, ID_MASK, REMOTE, Frames, nanoseconds
from gateway.bus.readers.batch import NO_CHANNEL, Batch
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
    if t_ns >= _COARSE:
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
    if number(text, at, end, 10, hexes) < 0 or text[end] != 44:
        return -1
    begin_frame(words, k, t_ns, can_id, 0)
    length, at = base64(text, end + 1, sixes, row)
    if length < 0:
        return -1
    if can_id & REMOTE:
        for j in range(length):
            row[16 + j] = 0
        return at
    set_length(words, k, length)
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


class Csv(Lines):
    """Lines of CSV.

    Args:
        path: for errors.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._header = True

    def scan(self, text: NDArray[np.uint8], at: int, batch: Batch) -> tuple[int, int, int]:
        """Read lines."""
        if self._header:
            self._header = False
            return int(line_end(text, at)), 1, DONE
        begin = at
        at, lines, batch.count, status = scan_csv(
            text, at, batch.words, batch.data, batch.channel, batch.count, HEX, BASE64
        )
        if status == BAD and (again := _plain(bytes(text[at : line_end(text, at)]))) is not None:
            one = np.frombuffer(again, np.uint8)
            _, _, batch.count, status = scan_csv(
                one, 0, batch.words, batch.data, batch.channel, batch.count, HEX, BASE64
            )
            if status == DONE:
                at, lines = int(line_end(text, at)), lines + 1
        assert at > begin or status == BAD
        return at, lines, status

    def bad(self, line: bytes, number: int) -> InputError:
        """Return the error of a bad line."""
        text = "a line is timestamp,arbitration_id,extended,remote,error,dlc,data"
        return InputError(text, file=self._path, line=number, value=shown(line))

    def cut(self, line: bytes, frame: Any, before: Frames) -> bool:
        """Return whether the last line is cut: it is no frame, or one with fewer bytes than it says."""
        del before
        if frame is None:
            return not line.startswith(b"timestamp,")
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

"""Common code of the text formats' kernels: words, numbers and stamps in lines.

``text`` is bytes that end with a newline; no function goes beyond it. Characters are numbers: 10 newline, 32 blank,
46 ``.``, 48 ``0``, 57 ``9``.

The kernel of a format, ``scan_asc`` etc., takes ``text`` (uint8), the place ``at`` where to begin, the batch as
:attr:`gateway.bus.readers.batch.Batch.room` has it, and what its format needs. It ends where the batch is full, and
returns where the next line begins, lines read, frames that are in, and the state of the line there.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from gateway.bus.frames import FD_LENGTHS
from gateway.bus.readers.batch import FLAGS, LENGTH
from gateway_fdi.jit import kernel

#: State of the line where a kernel stops: all is read or the batch is full; it is damaged; Python is to look at it.
DONE, BAD, ASK = 0, 1, 2

#: Character -> its value as a hexadecimal digit, 255: none.
HEX = np.full(256, 255, np.uint8)
for _digit in range(16):
    HEX[ord(f"{_digit:x}")] = HEX[ord(f"{_digit:X}")] = _digit

#: Two words as :func:`pair` has them.
RX, TX = 0x5278, 0x5478

#: Largest stamp [ns].
_MOST_NS = (1 << 63) - 1


@kernel
def byte(raw: Any, at: int) -> int:
    """Return a byte as a number that arithmetic does not wrap."""
    return np.int64(raw[at])  # type: ignore[return-value]


@kernel
def skip(text: Any, at: int) -> int:
    """Return where the next word of a line begins, or its newline."""
    while text[at] <= 32 and text[at] != 10:
        at += 1
    return at


@kernel
def word_end(text: Any, at: int) -> int:
    """Return where a word ends."""
    while text[at] > 32:
        at += 1
    return at


@kernel
def next_word(text: Any, at: int) -> tuple[int, int]:
    """Return where the next word of a line begins, and where it ends."""
    at = skip(text, at)
    return at, word_end(text, at)


@kernel
def pair(text: Any, at: int) -> int:
    """Return a word of two characters as a number, 256 times the first and the second; -1: it has other ones."""
    if text[at] <= 32 or text[at + 1] <= 32 or text[at + 2] > 32:
        return -1
    return byte(text, at) << 8 | byte(text, at + 1)


@kernel
def line_end(text: Any, at: int) -> int:
    """Return where the next line begins."""
    while text[at] != 10:
        at += 1
    return at + 1


@kernel
def is_digit(text: Any, at: int) -> bool:
    """Return whether a character is a decimal digit."""
    return bool(48 <= text[at] <= 57)


@kernel
def number(text: Any, at: int, end: int, base: int) -> int:
    """Return the number that a word is in a base, -1 if it is none of at most 15 digits."""
    if at == end or end - at > 15:
        return -1
    value = 0
    for k in range(at, end):
        digit = byte(HEX, text[k])
        if digit >= base:
            return -1
        value = value * base + digit
    return value


@kernel
def next_number(text: Any, at: int, base: int) -> tuple[int, int]:
    """Return the number that the next word of a line is, as :func:`number` has it, and where it ends."""
    at, end = next_word(text, at)
    return number(text, at, end, base), end


@kernel
def decimal(text: Any, at: int, places: int) -> tuple[int, int, int]:
    """Read a decimal number.

    Args:
        text: bytes.
        at: where it begins.
        places: 10 to the power of it times the number is wanted, rounded.

    Returns:
        the number so, -1 if there is none; where it ends; digits after its point, -1: no point.
    """
    begin, value = at, 0
    while 48 <= text[at] <= 57:
        value = value * 10 + (byte(text, at) - 48)
        at += 1
    if at == begin or at - begin > 20 - places or (at - begin > 9 and value >= _MOST_NS // 10**places):
        return -1, at, -1
    if text[at] != 46:
        for _ in range(places):
            value *= 10
        return value, at, -1
    at += 1
    begin, up = at, 0
    while at - begin < places and 48 <= text[at] <= 57:
        value = value * 10 + (byte(text, at) - 48)
        at += 1
    if at - begin == places and 53 <= text[at] <= 57:
        up = 1
    while 48 <= text[at] <= 57:
        at += 1
    digits = at - begin
    for _ in range(digits, places):
        value *= 10
    return value + up, at, digits


@kernel
def begin_frame(words: Any, k: int, t_ns: int, can_id: int, flags: int) -> None:
    """Write frame ``k`` of a batch (:class:`gateway.bus.readers.batch.Batch`) without its payload."""
    words[k, 0] = np.uint64(np.int64(t_ns))
    words[k, 1] = np.uint64(can_id) | (np.uint64(flags) << np.uint64(FLAGS))
    for j in range(2, 10):
        words[k, j] = np.uint64(0)


@kernel
def set_length(words: Any, k: int, length: int) -> None:
    """Set the length of a frame's payload, which was 0."""
    words[k, 1] |= np.uint64(length) << np.uint64(LENGTH)


@kernel
def fd_length(dlc: int) -> int:
    """Return the bytes that a DLC stands for (ISO 11898-1); 64 above 15, as python-can has it."""
    return FD_LENGTHS[min(dlc, 15)]


@kernel
def byte_words(text: Any, at: int, most: int, base: int, row: Any) -> tuple[int, int]:
    """Read bytes of a base, a word each, until there are ``most`` or the line ends, into a frame's bytes, shape (80,).

    Returns:
        how many there are, -1 if one is no byte; where they end.
    """
    count = 0
    while count < most:
        at = skip(text, at)
        if text[at] == 10:
            break
        end = word_end(text, at)
        value = number(text, at, end, base)
        if not 0 <= value <= 255:
            return -1, at
        row[16 + count] = value
        count += 1
        at = end
    return count, at


@kernel
def hex_pairs(text: Any, at: int, most: int, row: Any) -> tuple[int, int]:
    """Read bytes of two hexadecimal digits each without blanks; dots between them are passed over.

    Returns:
        how many there are, -1 if there are more than ``most`` or half a one; where they end.
    """
    count = 0
    while True:
        if text[at] == 46:
            at += 1
            continue
        high = byte(HEX, text[at])
        if high > 15:
            return count, at
        low = byte(HEX, text[at + 1])
        if low > 15 or count == most:
            return -1, at
        row[16 + count] = high * 16 + low
        count += 1
        at += 2


@kernel
def scatter(raw: Any, begins: Any, counts: Any, rows: Any) -> int:
    """Copy payloads that lie in one array into frames.

    Args:
        raw: bytes.
        begins: where each payload begins, shape (frames,).
        counts: its bytes, shape (frames,).
        rows: frames as bytes, shape (frames, 80), zero where payloads go.

    Returns:
        the first frame whose payload is longer than 64 bytes, -1: none.
    """
    for k in range(rows.shape[0]):
        if not 0 <= counts[k] <= 64:
            return k
        for j in range(counts[k]):
            rows[k, 16 + j] = raw[begins[k] + j]
    return -1

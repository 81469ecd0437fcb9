"""Raw bits of a payload: the one place where a field is read and written, by its word, shift and byte order.

The payload is read as 64-bit words. A little-endian field starts at bit ``s`` of the payload: word ``s >> 6``, shift
``s & 63``, bits that spill over come from the next word. For a big-endian field count bits from the first byte's most
significant one: its last bit is ``q``; in byte-swapped words that is word ``q >> 6``, shift ``63 - (q & 63)``, and the
spill comes from the word before.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from gateway_fdi.jit import Record, kernel, means, u1

if TYPE_CHECKING:
    from cantools.database.can.signal import Signal


#: Longest payload of a frame [byte].
LONGEST = 64


class Field(Record):
    """Where a field of at most 64 bits lies; records of SIGNAL have the same names."""

    word: u1 = means("word of its lowest bit")
    shift: u1 = means("place of that bit in the word", "bit")
    length: u1 = means("its length", "bit")
    big: u1 = means("1: big-endian")
    spill: u1 = means("1: it goes on in the next word, of a big-endian field in the one before")


def place(row: Any, start: int, length: int, *, big: bool) -> None:
    """Fill where a field lies, in a record of :class:`Field` or of SIGNAL.

    ``start`` is as a database numbers it: of the lowest bit, big-endian of the highest one.
    """
    if big:
        first = 8 * (start // 8) + 7 - start % 8
        last = first + length - 1
        row["big"] = 1
        row["word"], row["shift"] = last >> 6, 63 - (last & 63)
    else:
        row["word"], row["shift"] = start >> 6, start & 63
    row["length"] = length
    row["spill"] = int(row["shift"]) + length > 64


def field_of(signal: Signal) -> Any:
    """Return the place of a signal's bits, as a record of :class:`Field`."""
    row = np.zeros(1, Field.dtype)[0]
    place(row, signal.start, signal.length, big=signal.byte_order == "big_endian")
    return row


def field_at(byte: int, bits: int, *, big: bool = False, shift: int = 0) -> Any:
    """Return the place of a number in a header.

    Args:
        byte: the first of its bytes.
        bits: how many.
        big: most significant byte first.
        shift: bits of the byte before it: lower ones, big-endian higher ones.
    """
    row = np.zeros(1, Field.dtype)[0]
    place(row, 8 * byte + (7 - shift if big else shift), bits, big=big)
    return row


def placed(row: Any, value: int) -> int:
    """Return a payload as a number, bit 0 of the first byte lowest, that is zero but for a field."""
    word, shift = int(row["word"]), int(row["shift"])
    bits = value & ((1 << int(row["length"])) - 1)
    if row["big"]:
        return int.from_bytes((bits << (64 * (7 - word) + shift)).to_bytes(64, "big"), "little")
    return bits << (64 * word + shift)


def mask_of(row: Any) -> int:
    """Return the bits of a payload that a field takes, bit 0 of the first byte lowest."""
    return placed(row, 0xFFFFFFFFFFFFFFFF)


@kernel
def swapped(word: Any) -> Any:
    """Return a 64-bit word with its bytes reversed."""
    low8 = np.uint64(0x00FF00FF00FF00FF)
    low16 = np.uint64(0x0000FFFF0000FFFF)
    word = ((word >> np.uint64(8)) & low8) | ((word & low8) << np.uint64(8))
    word = ((word >> np.uint64(16)) & low16) | ((word & low16) << np.uint64(16))
    return (word >> np.uint64(32)) | (word << np.uint64(32))


@kernel
def needed_by(s: Any) -> int:
    """Return the length from which on a payload has all bits of a record of :class:`Field`, or of SIGNAL [byte]."""
    if s.big == 1:
        return 8 * int(s.word) + (63 - int(s.shift)) // 8 + 1
    return 8 * int(s.word) + (int(s.shift) + int(s.length) + 7) // 8


@kernel
def read_bits(words: Any, s: Any) -> Any:
    """Return the raw bits, uint64, of a record of :class:`Field` or SIGNAL in a payload of 8 little-endian uint64."""
    shift = np.uint64(s.shift)
    if s.big == 1:
        bits = swapped(words[s.word]) >> shift
        if s.spill == 1:
            bits |= swapped(words[s.word - 1]) << (np.uint64(64) - shift)
    else:
        bits = words[s.word] >> shift
        if s.spill == 1:
            bits |= words[s.word + 1] << (np.uint64(64) - shift)
    unused = np.uint64(64 - s.length)
    return (bits << unused) >> unused


@kernel
def write_bits(words: Any, s: Any, bits: Any) -> None:
    """Put raw bits into a field that is zero; bits beyond its length are left out; else as :func:`read_bits`."""
    unused = np.uint64(64 - s.length)
    bits = (bits << unused) >> unused
    shift = np.uint64(s.shift)
    if s.big == 1:
        words[s.word] = swapped(swapped(words[s.word]) | (bits << shift))
        if s.spill == 1:
            rest = bits >> (np.uint64(64) - shift)
            words[s.word - 1] = swapped(swapped(words[s.word - 1]) | rest)
    else:
        words[s.word] |= bits << shift
        if s.spill == 1:
            words[s.word + 1] |= bits >> (np.uint64(64) - shift)

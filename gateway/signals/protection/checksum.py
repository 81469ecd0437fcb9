"""Checksums of a payload: CRCs, sums and exclusive ors of bytes or nibbles, in one form that one kernel computes.

Rules of carmakers and AUTOSAR's profiles differ in data only: which bytes, in which order, bytes before and after them
(an identifier, one byte of a list by the counter), and the operation on the result.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from gateway.signals.bits import mask_of, swapped
from gateway.signals.protection.cmac import Mac
from gateway.signals.protection.crc import Crc, register_of
from gateway_fdi.jit import Record, i4, i8, kernel, lowest_bit, means, u1, u1s, u8, u8s

NONE, CRC, SUM, XOR, MAC = range(5)

#: A byte of a data id in a configuration.
Byte = Annotated[int, Field(ge=0, le=0xFF)]

#: Bytes that go in before or after a payload at most.
MOST_EXTRA = 8

#: Values of the counter that a list of data ids has an entry for.
LIST = 16

NOWHERE, BEFORE, AFTER = range(3)


@dataclass(frozen=True)
class Checksum:
    """A checksum of one message.

    Attributes:
        crc: the polynomial; None: a sum, or an exclusive or.
        mac: a MAC instead (see :mod:`gateway.signals.protection.cmac`).
        fresh: bits of the freshness value that it is computed over, too.
        xor: exclusive or instead of a sum.
        nibbles: of half bytes instead of bytes.
        first: byte that it begins with.
        last: byte before which it ends, None: the frame's length.
        backwards: from the last byte to the first.
        before: bytes that go in before the payload.
        after: bytes that go in after it.
        by_counter: of these 16 bytes the one of the counter's value goes in, too; empty: none.
        list_after: after the payload, else before it.
        plus: added to a sum, or first value of an exclusive or.
        plus_length: the frame's length is added, too.
        negative: the sum is taken from ``plus`` instead of added to it.
        xorout: applied to the result of a sum.
    """

    crc: Crc | None = None
    xor: bool = False
    nibbles: bool = False
    first: int = 0
    last: int | None = None
    backwards: bool = False
    before: Sequence[int] = ()
    after: Sequence[int] = ()
    by_counter: Sequence[int] = ()
    list_after: bool = True
    plus: int = 0
    plus_length: bool = False
    negative: bool = False
    xorout: int = 0
    mac: Mac | None = None
    fresh: int = 0


class ChecksumConst(Record):
    """A checksum as the kernel computes it."""

    kind: u1 = means("CRC, SUM, XOR or MAC")
    width: u1 = means("of the result", "bit")
    reflected: u1 = means("bytes go in with their least significant bit first")
    turned: u1 = means("the result's bits are reversed")
    nibbles: u1 = means("1: of half bytes instead of bytes")
    backwards: u1 = means("1: from the last byte to the first")
    plus_length: u1 = means("1: the frame's length is added, too")
    negative: u1 = means("1: the sum is taken from plus")
    listed: u1 = means("where a byte of the list goes in: NOWHERE, BEFORE, AFTER")
    before: u1 = means("how many bytes go in before")
    after: u1 = means("how many bytes go in after")
    fresh: u1 = means("of the freshness value that goes in after the payload", "bit")
    table: i4 = means("place of its table among the tables of CRCs; of a MAC: of its key")
    box: i4 = means("place of a MAC's round table among them")
    first: i4 = means("byte that it begins with")
    last: i4 = means("-1: the frame's length")
    plus: i8 = means("added to a sum, or first value of an exclusive or")
    init: u8 = means("first value of a CRC")
    xorout: u8 = means("applied to the result")
    skipped: u8 = means("bit k: byte k of the payload is the checksum's own")
    cleared: Annotated[u8s, 8] = means("bits of the payload that count as zero: the checksum's own")
    before_bytes: u8 = means("bytes that go in before, the first one lowest")
    after_bytes: u8 = means("bytes that go in after, the first one lowest")
    list_bytes: Annotated[u1s, LIST] = means("the list: the byte of the counter's value goes in")


def fill_checksum(row: Any, asked: Checksum, field: Any, table: int, box: int = 0) -> None:
    """Fill a zeroed record; ``table``: place of its CRC's table or its MAC's key, ``box`` of a MAC's round table."""
    assert len(asked.before) <= MOST_EXTRA
    assert len(asked.after) <= MOST_EXTRA
    assert len(asked.by_counter) in (0, LIST)
    own = mask_of(field)
    row["cleared"] = np.frombuffer(own.to_bytes(64, "little"), "<u8")
    row["skipped"] = sum(1 << k for k in range(64) if own >> (8 * k) & 0xFF == 0xFF)
    row["width"] = int(field["length"])
    row["first"], row["last"] = asked.first, -1 if asked.last is None else asked.last
    row["nibbles"], row["backwards"] = asked.nibbles, asked.backwards
    row["before"], row["after"] = len(asked.before), len(asked.after)
    row["before_bytes"] = int.from_bytes(bytes(asked.before), "little")
    row["after_bytes"] = int.from_bytes(bytes(asked.after), "little")
    if asked.by_counter:
        row["listed"] = AFTER if asked.list_after else BEFORE
        row["list_bytes"] = asked.by_counter
    if asked.mac is not None:
        row["kind"], row["table"], row["box"], row["fresh"] = MAC, table, box, asked.fresh
        return
    if asked.crc is None:
        row["kind"] = XOR if asked.xor else SUM
        row["plus"], row["plus_length"], row["negative"] = asked.plus, asked.plus_length, asked.negative
        row["xorout"] = asked.xorout
        return
    crc = asked.crc
    assert crc.width == field["length"], "checked where it is read"
    row["kind"], row["table"], row["width"] = CRC, table, crc.width
    row["reflected"], row["turned"] = crc.refin, crc.refin != crc.refout
    row["init"], row["xorout"] = register_of(crc), crc.xorout


@kernel
def take_bytes(register: Any, word: Any, count: int, reflect: int, table: Any) -> Any:
    """Return a CRC's register after up to 8 bytes of a word, the lowest first; uint64 all but the count.

    A register is linear in its bits: what each byte changes is looked up by itself, so that none waits for another.
    """
    if count == 0:
        return register
    index = word ^ (register if reflect == 1 else swapped(register))
    if count == 8:
        register = np.uint64(0)
    elif reflect == 1:
        register >>= np.uint64(8 * count)
    else:
        register <<= np.uint64(8 * count)
    for k in range(count - 1, -1, -1):
        register ^= table[np.uint64(k), index & np.uint64(0xFF)]
        index >>= np.uint64(8)
    return register


@kernel
def payload_byte(words: Any, p: Any, k: int) -> Any:
    """Return byte ``k`` of a payload without the checksum's own bits, uint64."""
    at = k >> 3
    return ((words[at] & ~p.cleared[at]) >> np.uint64((k & 7) * 8)) & np.uint64(0xFF)


@kernel
def crc_forwards(register: Any, words: Any, p: Any, last: int, table: Any) -> Any:
    """Return a CRC's register after a payload's bytes, a word at a time."""
    for at in range(p.first >> 3, (last + 7) >> 3):
        begin, end = max(p.first, 8 * at), min(last, 8 * at + 8)
        word = words[at] & ~p.cleared[at]
        own = np.int64((p.skipped >> np.uint64(8 * at)) & np.uint64(0xFF))
        while own != 0:
            k = 8 * at + lowest_bit(int(own))
            own &= own - 1
            if begin <= k < end:
                register = take_bytes(register, word >> np.uint64(8 * (begin & 7)), k - begin, p.reflected, table)
                begin = k + 1
        register = take_bytes(register, word >> np.uint64(8 * (begin & 7)), end - begin, p.reflected, table)
    return register


@kernel
def crc_backwards(register: Any, words: Any, p: Any, last: int, table: Any) -> Any:
    """Return a CRC's register after a payload's bytes, the last one first."""
    for j in range(p.first, last):
        k = p.first + last - 1 - j
        if (p.skipped >> np.uint64(k)) & np.uint64(1) == np.uint64(0):
            register = take_bytes(register, payload_byte(words, p, k), 1, p.reflected, table)
    return register


@kernel
def reversed_bits(value: Any, width: int) -> Any:
    """Return a value with its ``width`` bits in reverse order, uint64."""
    turned = np.uint64(0)
    for _ in range(width):
        turned = (turned << np.uint64(1)) | (value & np.uint64(1))
        value >>= np.uint64(1)
    return turned


@kernel
def crc_of(words: Any, length: int, counter: int, p: Any, table: Any) -> Any:
    """Return a payload's CRC, uint64; arguments as of :func:`checksum_of`, ``table`` of shape (8, 256)."""
    register = np.uint64(p.init)
    register = take_bytes(register, p.before_bytes, p.before, p.reflected, table)
    if p.listed == BEFORE:
        register = take_bytes(register, np.uint64(p.list_bytes[counter & 15]), 1, p.reflected, table)
    last = length if p.last < 0 else min(p.last, length)
    if p.backwards == 1:
        register = crc_backwards(register, words, p, last, table)
    else:
        register = crc_forwards(register, words, p, last, table)
    if p.listed == AFTER:
        register = take_bytes(register, np.uint64(p.list_bytes[counter & 15]), 1, p.reflected, table)
    register = take_bytes(register, p.after_bytes, p.after, p.reflected, table)
    if p.reflected == 0:
        register >>= np.uint64(64 - p.width)
    if p.turned == 1:
        register = reversed_bits(register, p.width)
    return register ^ p.xorout


@kernel
def sum_of(words: Any, length: int, p: Any) -> Any:
    """Return a payload's sum or exclusive or, uint64; arguments as of :func:`checksum_of`."""
    total = np.int64(0)
    last = length if p.last < 0 else min(p.last, length)
    for k in range(p.first, last):
        byte = np.int64(payload_byte(words, p, k))
        if p.kind == XOR:
            total ^= (byte >> 4) ^ (byte & 15) if p.nibbles == 1 else byte
        else:
            total += (byte >> 4) + (byte & 15) if p.nibbles == 1 else byte
    if p.plus_length == 1:
        total += length
    if p.kind == XOR:
        total ^= p.plus
    else:
        total = p.plus - total if p.negative == 1 else p.plus + total
    unused = np.uint64(64 - p.width)
    return ((np.uint64(total) ^ p.xorout) << unused) >> unused


@kernel
def checksum_of(words: Any, length: int, counter: int, p: Any, tables: Any) -> Any:
    """Return the checksum of a payload, uint64.

    Args:
        words: payload, 8 little-endian uint64, zero beyond its length.
        length: payload length [byte].
        counter: the payload's own, for a list of data ids.
        p: record of :class:`ChecksumConst`.
        tables: uint64, shape (CRCs, 8, 256).
    """
    if p.kind == CRC:
        return crc_of(words, length, counter, p, tables[p.table])
    return sum_of(words, length, p)

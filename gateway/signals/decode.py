"""Decode kernels: one frame's payload into physical values, by the tables of a decode plan."""

from __future__ import annotations

from typing import Any

import numpy as np

from gateway.bus.frames import ERROR
from gateway.signals.bits import needed_by, read_bits
from gateway_fdi.jit import f8, i2, i4, kernel, record, u1, u4

OK, TOO_SHORT, UNKNOWN_MUX, INVALID_VALUE = 0, 1, 2, 3

UNSIGNED, SIGNED, FLOAT16, FLOAT32, FLOAT64 = range(5)

#: One signal. ``parent`` is the multiplexer's place among the message's signals (-1: always there), present when its
#: raw value is in one of the ranges ``mux_ids[first_id:+ids]``, pairs of least and greatest; a multiplexer's own known
#: values are those of ``mux_ids[first_known:+known]``. ``slot`` is -1 for a signal that is not asked for. A
#: floating-point signal is valid between ``low`` and ``high``. One of several signals of one name puts its value at the
#: place ``into``, too; that place has a parent without ids: by itself it is never there. A ``plain`` signal is an
#: unsigned number of less than 64 bits: little-endian in one word, neither multiplexed nor a multiplexer.
SIGNAL = record(
    scale=f8,
    offset=f8,
    low=f8,
    high=f8,
    slot=i4,
    first_id=i4,
    ids=i4,
    first_known=i4,
    known=i4,
    parent=i2,
    into=i2,
    word=u1,
    shift=u1,
    length=u1,
    big=u1,
    spill=u1,
    kind=u1,
    plain=u1,
)

#: One message: length from which on a frame has all its signals, these ``signals[first:first + count]``, its identity,
#: and whether floating-point signals are among them. A ``whole`` one has only integers that are always there and asked
#: for, one slot after the other from ``slot`` on: a frame that is long enough has all of them.
MESSAGE = record(length=i4, first=i4, count=i4, can_id=u4, slot=i4, bus=u1, floats=u1, whole=u1)

_PGN = np.uint64(1 << 40)  # marks keys that match by PGN
_GROUP = 0x3FFFF | ERROR >> 8  # of an identifier without its lowest byte: the group, and that it is of a woven message
_TO_ONE = _GROUP & ~0xFF  # the same without a destination


@kernel
def hashed(key: Any, mask: int) -> int:
    """Return where a key's search in the table begins (Fibonacci hashing of 32 bits)."""
    folded = (key ^ (key >> np.uint64(29)) ^ (key >> np.uint64(35))) & np.uint64(0xFFFFFFFF)
    mixed = folded * np.uint64(0x9E3779B1)
    return np.int64((mixed >> np.uint64(13)) & np.uint64(mask))  # type: ignore[return-value]


@kernel
def find(keys: Any, rows: Any, key: Any) -> int:
    """Return the row of a key in an open-addressed table, -1 if it is not there."""
    mask = keys.shape[0] - 1
    at = hashed(key, mask)
    while rows[at] >= 0:
        if keys[at] == key:
            return int(rows[at])
        at = (at + 1) & mask
    return -1


@kernel
def pgn_key(bus: int, can_id: int) -> Any:
    """Return the key by which a J1939 message matches: priority and addresses left out.

    SAE J1939-21: the PDU format is byte 2 of the identifier; below 240 (PDU1) byte 1 is the
    destination address, from 240 on (PDU2) it belongs to the parameter group number.
    """
    group = (can_id >> 8) & _GROUP
    if (can_id >> 16) & 0xFF < 240:
        group &= _TO_ONE
    return _PGN | (np.uint64(bus) << np.uint64(32)) | np.uint64(group)


@kernel
def source_key(bus: int, can_id: int) -> Any:
    """Return the key by which a J1939 message of one source address matches: priority and destination left out."""
    return (pgn_key(bus, can_id) << np.uint64(8)) | np.uint64(can_id & 0xFF)


@kernel
def exact_key(bus: int, can_id: int) -> Any:
    """Return the key of a frame's bus and identifier (with its EXTENDED flag)."""
    return (np.uint64(bus) << np.uint64(32)) | np.uint64(can_id)


@kernel
def lookup(keys: Any, rows: Any, bus: int, can_id: int) -> int:
    """Return the row of a frame's message, -1 for a foreign frame.

    Exact identifiers win over PGNs; of these the message of the frame's source address wins.
    """
    row = find(keys, rows, exact_key(bus, can_id))
    if row < 0 and can_id & 0x80000000:
        row = find(keys, rows, source_key(bus, can_id))
        if row < 0:
            row = find(keys, rows, pgn_key(bus, can_id))
    return row


@kernel
def of_a_tester(can_id: int) -> bool:
    """Return whether an identifier, with its flags, is one of diagnostics: frames come when a tester asks."""
    if can_id & 0x80000000:
        return (can_id & 0x1FFFFFFF) >> 16 in (0x18DA, 0x18DB)
    return 0x700 <= can_id <= 0x7FF


@kernel
def ieee(bits: Any, exponent_bits: int, mantissa_bits: int) -> float:
    """Return the value of an IEEE 754 binary16, binary32 or binary64 pattern."""
    top = (1 << exponent_bits) - 1
    mantissa = float(bits & np.uint64((1 << mantissa_bits) - 1))
    exponent = np.int64((bits >> np.uint64(mantissa_bits)) & np.uint64(top))
    sign = -1.0 if (bits >> np.uint64(mantissa_bits + exponent_bits)) & np.uint64(1) else 1.0
    bias = top >> 1
    if exponent == top:
        return sign * np.inf if mantissa == 0.0 else np.nan
    if exponent == 0:
        return sign * mantissa * 2.0 ** (1 - bias) * 2.0**-mantissa_bits
    return float(sign * (1.0 + mantissa * 2.0**-mantissa_bits) * 2.0 ** (exponent - bias))


@kernel
def extract(words: Any, s: Any) -> float:
    """Return the physical value of one signal, a record of SIGNAL, in a payload of 8 little-endian uint64."""
    bits = read_bits(words, s)
    if s.kind == SIGNED:
        unused = np.uint64(64 - s.length)
        raw = float(np.int64(bits << unused) >> np.int64(unused))
    elif s.kind == UNSIGNED:
        raw = float(bits)
    elif s.kind == FLOAT32:
        raw = ieee(bits, 8, 23)
    elif s.kind == FLOAT64:
        raw = ieee(bits, 11, 52)
    else:
        raw = ieee(bits, 5, 10)
    return float(raw * s.scale + s.offset)


@kernel
def plain_value(words: Any, s: Any) -> float:
    """Return the physical value of a plain signal; arguments as those of :func:`extract`."""
    unused = np.uint64(64 - s.length)
    bits = ((words[s.word] >> np.uint64(s.shift)) << unused) >> unused
    return float(np.int64(bits) * s.scale + s.offset)


@kernel
def among(value: int, ids: Any, first: int, count: int) -> bool:
    """Return whether a value is in one of the ranges ``ids[first:first + count]``, pairs of least and greatest."""
    for k in range(first, first + count):
        if ids[k, 0] <= value <= ids[k, 1]:
            return True
    return False


@kernel
def decode(
    words: Any,
    length: int,
    row: int,
    messages: Any,
    signals: Any,
    mux_ids: Any,
    values: Any,
    present: Any,
) -> int:
    """Decode the wanted signals of one frame into scratch arrays.

    Args:
        words: payload, 8 little-endian uint64, zero beyond its length.
        length: payload length [byte].
        row: of the message.
        messages: shape (messages,) of MESSAGE.
        signals: shape (signals,) of SIGNAL.
        mux_ids: int64, shape (ranges, 2), the multiplexer values of all signals.
        values: float64, takes the physical value of the message's j-th signal.
        present: uint8, takes whether the j-th signal is in this frame.

    Returns:
        OK; TOO_SHORT: some signals are beyond the frame's end; UNKNOWN_MUX: a multiplexer selects none.
    """
    m = messages[row]
    first = int(m.first)
    short = length < m.length
    status = OK
    for j in range(m.count):
        s = signals[np.uint64(first + j)]
        if short and needed_by(s) > length:
            present[j] = 0
            continue
        if s.plain == 1:
            present[j] = 1
            values[j] = plain_value(words, s)
            continue
        if s.parent >= 0 and (
            s.ids == 0
            or present[s.parent] == 0
            or not among(int(values[s.parent]), mux_ids, s.first_id, s.ids)  # raw: multiplexers have no scaling
        ):
            present[j] = 0
            continue
        present[j] = 1
        values[j] = extract(words, s)
        if s.into >= 0:
            present[s.into] = 1
            values[s.into] = values[j]
        if s.known > 0 and not among(int(values[j]), mux_ids, s.first_known, s.known):
            status = UNKNOWN_MUX
    return TOO_SHORT if short else status


@kernel
def invalid_value(row: int, messages: Any, signals: Any, values: Any, present: Any) -> int:
    """Return the place of a message's first floating-point signal that carries no value, -1 if all do.

    NaN, an infinity, or a magnitude that no sensor has would stay in the state of a monitor for ever. Integers
    cannot carry them.
    """
    m = messages[row]
    for j in range(m.count):
        s = signals[m.first + j]
        if s.kind >= FLOAT16 and present[j] == 1 and not s.low <= values[j] <= s.high:
            return j
    return -1


@kernel
def void(row: int, messages: Any, signals: Any, values: Any, present: Any) -> None:
    """Put NaN where a message's floating-point signal carries no value."""
    m = messages[row]
    for j in range(m.count):
        s = signals[m.first + j]
        if s.kind >= FLOAT16 and present[j] == 1 and not s.low <= values[j] <= s.high:
            values[j] = np.nan
            if s.into >= 0:
                values[s.into] = np.nan


@kernel
def commit(row: int, messages: Any, signals: Any, values: Any, present: Any, mailbox: Any) -> None:
    """Copy the decoded signals that are asked for into the mailbox."""
    m = messages[row]
    first = int(m.first)
    for j in range(m.count):
        slot = signals[np.uint64(first + j)].slot
        if slot >= 0 and present[j] == 1:
            mailbox[np.uint64(slot)] = values[j]


@kernel
def decode_whole(words: Any, m: Any, signals: Any, mailbox: Any) -> None:
    """Decode a frame that is long enough into the mailbox (float64, shape (slots,)); ``m``: record of a whole one."""
    first, slot = int(m.first), int(m.slot)
    for j in range(m.count):
        s = signals[np.uint64(first + j)]
        mailbox[np.uint64(slot + j)] = plain_value(words, s) if s.plain == 1 else extract(words, s)

"""Identifiers that no database has: a message for each, made of its frames, and the database that holds these.

Its timeout, length and checksum ("byte 7") need no signal; its counter does, so the bits that count become one.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path

import numpy as np
from cantools.database.can import Database, Message
from cantools.database.can.signal import Signal
from numpy.typing import NDArray

from gateway.bus.frames import EXTENDED, ID_MASK
from gateway.signals.bits import field_at, field_of, mask_of
from gateway.signals.payloads import bits_of
from gateway_fleet.learn.counters import WRAPS, of_raw
from gateway_fleet.learn.protection_check import Payloads

#: Identifiers of one log that are looked at; others are counted.
MOST = 1000
#: Frames that show a length.
SHOWN = 100
#: The lowest bit of a counter changes in more than this share of the frames, whatever is lost.
TURNS = 0.5
#: Fields of one byte that may count: two bits and more.
IN_A_BYTE = 28
#: Another field that says so much of what the best one says counts as well: nothing tells which of them is the counter.
ALIKE = 0.99


def database_path(out: Path, bus: str) -> Path:
    """Return where the messages of a bus lie that no database has, beside a configuration."""
    return out.with_suffix(f".learned.{bus}.dbc")


def message_of(can_id: int, taken: Collection[str]) -> Message:
    """Return a message without signals for an identifier with its flags; ``taken``: names that others have."""
    extended = bool(can_id & EXTENDED)
    name = f"ID_{can_id & ID_MASK:X}{'x' * extended}"
    while name in taken:
        name += "_"
    return Message(can_id & ID_MASK, name, 8, [], is_extended_frame=extended, strict=False)


def with_signals(message: Message, length: int, signals: Sequence[Signal]) -> Message:
    """Return a message with another length [byte] and other signals."""
    return Message(
        message.frame_id, message.name, length, list(signals), comment=message.comment, senders=message.senders,
        is_extended_frame=message.is_extended_frame, strict=False,
    )  # fmt: skip


def with_counter(
    message: Message, frames: Payloads, follows: NDArray[np.bool_], cycles: NDArray[np.float64] | None
) -> tuple[Message, str]:
    """Return a message with the bits that count as a signal, and what is not sure about it; "": nothing.

    Only fields of one byte are looked for that came round often, of 2^n or 2^n - 1 values: what counts to 60 or to 100
    is a clock.

    Args:
        message: of the frames.
        frames: payloads of its length.
        follows: shape (frames - 1,), whether nothing lies between a frame and the next.
        cycles: shape (frames - 1,), time between them, in cycles of the message; None: it has none.
    """
    found = _counting(message, frames, follows, cycles)
    if not found:
        return message, ""
    said, (start, bits) = max(found)
    for other, (at, wide) in found:
        if other >= ALIKE * said and (at >= start + bits or at + wide <= start):
            return message, f"bits {start} and {at} count alike: no counter"
    name = f"BYTE{start // 8}_COUNTER"
    if any(signal.name == name for signal in message.signals):
        return message, ""
    made = Signal(name, start, bits, byte_order="little_endian")
    return with_signals(message, message.length, [*message.signals, made]), ""


def _counting(
    message: Message, frames: Payloads, follows: NDArray[np.bool_], cycles: NDArray[np.float64] | None
) -> list[tuple[float, tuple[int, int]]]:
    """Return the fields that count, each with how much its steps say [bit], first bit and length."""
    if len(frames) < 2:
        return []
    turned = np.unpackbits(frames.bytes[1:] ^ frames.bytes[:-1], axis=1, bitorder="little").mean(axis=0)
    taken = 0
    for signal in message.signals:
        taken |= mask_of(field_of(signal))
    found = []
    for start in (int(bit) for bit in np.flatnonzero(turned[: 8 * message.length] > TURNS)):
        for bits in range(8 - start % 8, 1, -1):
            if turned[start + bits - 1] == 0.0 or taken >> start & ((1 << bits) - 1):
                continue
            raw = bits_of(frames.words, field_at(start // 8, bits, shift=start % 8)).astype(np.int64)
            counter = of_raw("", raw, follows, bits, cycles, IN_A_BYTE * message.length)
            if counter is None or counter.wraps < WRAPS or (1 << bits) - counter.modulus not in (0, 1):
                continue
            if (start + bits) % 8 == 0 or not _goes_on(raw, frames, start, bits):
                found.append((counter.ones * float(np.log2(counter.modulus)), (start, bits)))
    return found


def _goes_on(raw: NDArray[np.int64], frames: Payloads, start: int, bits: int) -> bool:
    """Return whether a field is the low end of a number that has more bits in its byte.

    The bit above turns where the field comes round, and only there: they count together. Or all of them go up by 5, so
    that the lowest two go up by one.
    """
    width = 8 - start % 8
    whole = bits_of(frames.words, field_at(start // 8, width, shift=start % 8)).astype(np.int64)
    above = whole >> bits & 1
    turns, rounds = above[1:] != above[:-1], raw[1:] < raw[:-1]
    steps, often = np.unique(np.mod(np.diff(whole), 1 << width), return_counts=True)
    most = int(often.argmax())
    together = (turns & rounds).sum() > TURNS * max(turns.sum(), rounds.sum())
    return bool(together or (steps[most] != 1 and often[most] > TURNS * len(turns)))


def database_text(messages: Sequence[Message]) -> str:
    """Return messages as a DBC file."""
    return str(Database(messages=list(messages), strict=False).as_dbc_string())

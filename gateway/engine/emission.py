"""Messages that monitors send: made in the loop, in the batch that caused them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from cantools.database.can import Message
from numpy.typing import NDArray

from gateway.bus.frames import EXTENDED, FD, FRAME
from gateway.errors import InputError
from gateway.jit import COMPILED, Record, i4, i8, kernel, means, u1, u4
from gateway.monitors.contract import Emission
from gateway.signals.crc import ALGORITHMS, crc8
from gateway.signals.decode import SIGNAL
from gateway.signals.encode import insert
from gateway.signals.tables import encode_rows

#: Signals that the engine fills, where a message has them.
COUNTER, CRC = "FrameCnt", "Crc"
ALGORITHM = "crc8_sae_j1850"
#: Frames that one pass of the loop can send.
MOST_FRAMES = 1024


class EmitPlace(Record):
    """One message: identity, its signals ``signals[first:first + count]``, the byte of its CRC (-1: none)."""

    can_id: u4
    can_flags: u1
    bus: u1
    local: u1 = means("whether the engine itself decodes it")
    length: i4
    first: i4
    count: i4
    counter: i4 = means("place of the counter among the signals; -1: none")
    crc_byte: i4


class EmitConst(Record):
    """What it counts by."""

    modulo: i8


class EmitState(Record):
    """What it has counted."""

    next: i8


class Emit(EmitState, EmitConst, EmitPlace):
    """A message that a monitor sends."""


_INIT, _XOROUT = ALGORITHMS[ALGORITHM].init, ALGORITHMS[ALGORITHM].xorout
_CRC_TABLE = list(ALGORITHMS).index(ALGORITHM)


@dataclass(frozen=True)
class Emitted:
    """What a monitor sends, and by which message of which bus."""

    emission: Emission
    message: Message
    bus: int


def fill(emitted: Sequence[Emitted], local: Sequence[bool]) -> tuple[NDArray[np.void], NDArray[np.void]]:
    """Return the tables Emit and SIGNAL of the messages to be sent.

    Args:
        emitted: what is sent.
        local: whether the engine decodes it too.

    Raises:
        InputError: a signal that the message does not have or that cannot be encoded, a CRC off its
            byte boundary.
    """
    table = np.zeros(len(emitted), Emit.dtype)
    rows: list[Any] = []
    for k, (entry, own) in enumerate(zip(emitted, local, strict=True)):
        message = entry.message
        names = {signal.name: signal for signal in message.signals}
        row = table[k]
        row["can_id"] = message.frame_id | (EXTENDED if message.is_extended_frame else 0)
        row["can_flags"] = FD if message.is_fd else 0
        row["bus"], row["local"], row["length"] = entry.bus, own, message.length
        row["first"], row["count"] = len(rows), len(entry.emission.names)
        rows += encode_rows(message, entry.emission.names)
        row["counter"], row["crc_byte"] = -1, -1
        if COUNTER in names:
            row["counter"], row["modulo"] = len(rows), 1 << names[COUNTER].length
            rows += encode_rows(message, [COUNTER])
        if CRC in names:
            signal = names[CRC]
            if signal.length != 8 or signal.start % 8 != (7 if signal.byte_order == "big_endian" else 0):
                raise InputError(
                    "a CRC signal has 8 bits on a byte boundary",
                    key=f"{message.name}.{CRC}",
                    value=f"start {signal.start}, length {signal.length}",
                )
            row["crc_byte"] = signal.start // 8
    signals = np.asarray(rows, SIGNAL) if rows else np.zeros(0, SIGNAL)
    if not COMPILED:
        return table.view(np.recarray), signals.view(np.recarray)
    return table, signals


def outbox() -> tuple[NDArray[np.void], NDArray[np.uint64]]:
    """Return room for the frames of one pass: as FRAME, and the same memory as uint64 cells."""
    frames = np.zeros(MOST_FRAMES, FRAME)
    cells = frames.view("<u8").reshape(MOST_FRAMES, FRAME.itemsize // 8)
    return (frames if COMPILED else frames.view(np.recarray)), cells


@kernel
def emit(T: Any, t_ns: int, m: Any) -> None:
    """Append a message with the values of the step's results to the frames to be sent."""
    clock = T.clock[0]
    at = clock.sent
    if at >= T.outbox.shape[0]:
        clock.sent_lost += 1
        return
    clock.sent = at + 1
    frame = T.outbox[at]
    frame["t_ns"] = t_ns
    frame["can_id"] = m.can_id
    frame["bus"] = m.bus
    frame["flags"] = m.can_flags
    frame["length"] = m.length
    frame["rank"] = m.local  # until it leaves
    words = T.outbox_cells[at, 2:]
    for k in range(words.shape[0]):
        words[k] = np.uint64(0)
    out = T.out[0]
    for k in range(m.count):
        insert(words, T.emit_signals[m.first + k], out.values[k])
    if m.counter >= 0:
        insert(words, T.emit_signals[m.counter], float(m.next))
        m.next = (m.next + 1) % m.modulo
    if m.crc_byte >= 0:
        crc = crc8(
            words,
            m.length,
            m.crc_byte,
            int(m.can_id & 0x1FFFFFFF),
            T.crc_tables[_CRC_TABLE],
            _INIT,
            _XOROUT,
        )
        words[m.crc_byte >> 3] |= np.uint64(crc) << np.uint64((m.crc_byte & 7) * 8)

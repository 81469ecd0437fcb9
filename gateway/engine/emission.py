"""Messages that monitors send: made in the loop, in the batch that caused them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gateway.bus.frames import EXTENDED, FD, FRAME
from gateway.monitors.contract import Emission
from gateway.signals.columns import insert
from gateway.signals.decode import SIGNAL
from gateway.signals.protection import protection
from gateway.signals.protection.default_profile import own_protection
from gateway.signals.protection.protection import ProtectionConst, protect
from gateway.signals.tables import encode_rows
from gateway_fdi.jit import COMPILED, Record, i4, i8, kernel, means, u1, u4

if TYPE_CHECKING:
    from cantools.database.can import Message

#: Frames that one pass of the loop can send.
MOST_FRAMES = 1024


class EmitPlace(Record):
    """One message: identity, its signals ``signals[first:first + count]``."""

    can_id: u4 = means("identifier")
    can_flags: u1 = means("flags of the frame")
    bus: u1 = means("number of the bus")
    local: u1 = means("whether the engine itself decodes it")
    length: i4 = means("bytes of the frame", "byte")
    first: i4 = means("its first signal")
    count: i4 = means("its signals")


class EmitConst(Record):
    """How it is protected."""

    protection: ProtectionConst = means("checksum, alive counter, header")


class EmitState(Record):
    """Its counts."""

    count_sent: i8 = means("frames; the alive counter is made of it")


class Emit(EmitState, EmitConst, EmitPlace):
    """A message that a monitor sends."""


@dataclass(frozen=True)
class Emitted:
    """A set of values that a monitor sends, and the message and bus for them."""

    emission: Emission
    message: Message
    bus: int


def fill(
    emitted: Sequence[Emitted], local: Sequence[bool], tables: protection.Tables
) -> tuple[NDArray[np.void], NDArray[np.void]]:
    """Return the tables Emit and SIGNAL of the messages to be sent.

    Args:
        emitted: values and message.
        local: whether the engine decodes it too.
        tables: of the CRCs.

    Raises:
        InputError: a signal that the message does not have or that cannot be encoded, a CRC off its
            byte boundary.
    """
    table = np.zeros(len(emitted), Emit.dtype)
    rows: list[Any] = []
    for k, (entry, own) in enumerate(zip(emitted, local, strict=True)):
        message = entry.message
        row = table[k]
        row["can_id"] = message.frame_id | (EXTENDED if message.is_extended_frame else 0)
        row["can_flags"] = FD if message.is_fd else 0
        row["bus"], row["local"], row["length"] = entry.bus, own, message.length
        row["first"], row["count"] = len(rows), len(entry.emission.names)
        rows += encode_rows(message, entry.emission.names)
        protection.fill(row["protection"], own_protection(message), tables)
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
    protect(words, m.length, m.count_sent, m.protection, T.crc_tables)
    m.count_sent += 1

"""Messages of a database as frames: columns of values, encoded and protected as the gateway checks them."""

from __future__ import annotations

from collections.abc import Mapping

import cantools
import numpy as np
from cantools.database.can import Message
from cantools.database.can.signal import Signal
from numpy.typing import NDArray

from gateway.bus.frames import EXTENDED, FD, Frames, empty
from gateway.signals.protection.params import ProtectionParams, protection_for
from gateway.signals.protection.protection import ProtectionConst, Tables, fill, protect_all
from gateway_fdi.errors import InputError

Columns = Mapping[str, NDArray[np.float64]]


def _range(signal: Signal) -> tuple[int, int]:
    bits = signal.length - signal.is_signed
    return (-(1 << bits) if signal.is_signed else 0), (1 << bits) - 1


def _nearest(signal: Signal, value: float) -> float:
    """Return the nearest value that a signal can carry."""
    if signal.is_float:
        return value
    low, high = _range(signal)
    raw = min(max(round((value - signal.offset) / signal.scale), low), high)
    return float(raw * signal.scale + signal.offset)


def _plain(message: Message) -> bool:
    """Return whether a message can be encoded in columns: one word of little-endian integers."""
    return (
        message.length <= 8
        and not message.is_multiplexed()
        and all(s.byte_order == "little_endian" and not s.is_float and s.length < 53 for s in message.signals)
    )


def _in_columns(message: Message, columns: Columns, count: int) -> NDArray[np.uint64]:
    word = np.zeros(count, np.uint64)
    for signal in message.signals:
        low, high = _range(signal)
        values = np.asarray(columns.get(signal.name, np.zeros(count)), np.float64)
        raw = np.clip(np.rint((values - signal.offset) / signal.scale), low, high).astype(np.int64)
        word |= (raw & ((1 << signal.length) - 1)).astype(np.uint64) << np.uint64(signal.start)
    words = np.zeros((count, 8), np.uint64)
    words[:, 0] = word
    return words


def _one_by_one(message: Message, columns: Columns, count: int) -> NDArray[np.uint64]:
    words = np.zeros((count, 8), np.uint64)
    signals = {signal.name: signal for signal in message.signals}
    for k in range(count):
        values = {name: _nearest(signal, 0.0) for name, signal in signals.items()}
        values |= {name: _nearest(signals[name], float(column[k])) for name, column in columns.items()}
        try:
            data = message.encode(values, scaling=True, strict=False)
        except cantools.database.EncodeError as error:
            raise InputError(f"cannot be sent: {error}", value=message.name) from error
        words[k] = np.frombuffer(bytes(data).ljust(64, b"\0"), "<u8")
    return words


def sent(
    message: Message, columns: Columns, times: NDArray[np.float64], protection: ProtectionParams, *, bus: int
) -> Frames:
    """Return the frames of a message.

    Args:
        message: of the database.
        columns: values of its signals, each of shape (frames,), as near as a signal can carry them; others: 0.
        times: of the frames [s].
        protection: how the message is protected.
        bus: index of its bus.

    Raises:
        InputError: it has no such signal, or cannot be encoded.
    """
    known = sorted(signal.name for signal in message.signals)
    for name in columns:
        if name not in known:
            raise InputError(f"{message.name} has no such signal; it has {', '.join(known)}", value=name)
    count = len(times)
    words = (_in_columns if _plain(message) else _one_by_one)(message, columns, count)
    tables, rows = Tables(), np.zeros(1, ProtectionConst.dtype)
    fill(rows[0], protection_for(message, protection), tables)
    protect_all(words, np.full(count, message.length), rows.view(np.recarray)[0], tables.array(), 0)
    frames = empty(count)
    frames["t_ns"] = np.rint(times * 1e9).astype(np.int64)
    frames["can_id"] = message.frame_id | (EXTENDED if message.is_extended_frame else 0)
    frames["bus"], frames["length"] = bus, message.length
    frames["flags"] = FD if message.is_fd else 0
    frames["data"] = words.view(np.uint8)
    frames["data"][:, message.length :] = 0
    return frames

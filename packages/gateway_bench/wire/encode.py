"""Columns of values to CAN frames, many at once; the same bytes as cantools makes one by one (`test_encode.py`)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from cantools.database import Message
from numpy.typing import NDArray

from gateway.bus.frames import Frames, empty


def _crc_table() -> NDArray[np.uint8]:
    """CRC-8 SAE J1850: polynomial 1D, bit by bit."""
    table = np.arange(256, dtype=np.uint8)
    for _ in range(8):
        table = np.where(table & 0x80, (table.astype(np.uint16) << 1 ^ 0x1D) & 0xFF, table.astype(np.uint16) << 1)
        table = table.astype(np.uint8)
    return table


_TABLE = _crc_table()


def crc(columns: Sequence[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    """CRC of rows, given as columns of bytes in their order."""
    value = np.full(len(columns[0]), 0xFF, np.uint8)
    for column in columns:
        value = _TABLE[value ^ column]
    return np.asarray(value ^ 0xFF, np.uint8)


def payloads(message: Message, columns: Mapping[str, NDArray[Any]], crc_name: str) -> NDArray[np.uint8]:
    """Bytes of a message, shape (n, 8): values clipped to their signals' ranges and rounded; with its CRC.

    Args:
        message: of cantools; 8 bytes, little-endian integers.
        columns: name -> values, shape (n,); signals not named are 0.
        crc_name: of the signal with the CRC: its own byte, the first or the last.
    """
    assert message.length == 8, "the plants' messages"
    word = np.zeros(len(next(iter(columns.values()))), np.uint64)
    for signal in message.signals:
        if signal.name not in columns:
            continue
        assert signal.byte_order == "little_endian", "the plants' messages"
        raw = np.rint((np.clip(columns[signal.name], signal.minimum, signal.maximum) - signal.offset) / signal.scale)
        mask = np.uint64((1 << signal.length) - 1)
        word |= (raw.astype(np.int64).astype(np.uint64) & mask) << np.uint64(signal.start)
    data = word.view(np.uint8).reshape(-1, 8)
    if crc_name:
        place = message.get_signal_by_name(crc_name).start // 8
        low, high = (np.full(len(data), message.frame_id >> k & 0xFF, np.uint8) for k in (0, 8))
        kept = [data[:, k] for k in range(8) if k != place]
        data[:, place] = crc([*kept, low, high])
    return data


def frames_of(
    message: Message, columns: Mapping[str, NDArray[Any]], t_ns: NDArray[np.int64], crc_name: str = "", bus: int = 0
) -> Frames:
    """Frames of a message at times [ns]; arguments as of :func:`payloads`."""
    frames = empty(len(t_ns))
    frames["t_ns"], frames["can_id"], frames["bus"], frames["length"] = t_ns, message.frame_id, bus, 8
    frames["data"][:, :8] = payloads(message, columns, crc_name)
    return frames


def merged(*batches: Frames) -> Frames:
    """Frames of several messages in the order of their times; of equal times the first batch comes first."""
    frames = np.concatenate(batches)
    return frames[np.argsort(frames["t_ns"], kind="stable")]

"""Many frames of one message at once: columns of values to payloads, with their CRC.

The same as :func:`gateway_bench.vecu.protection.protect` frame by frame, for drives of hundreds of thousands of frames.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from cantools.database.can import Message, Signal
from numpy.typing import ArrayLike, NDArray

from gateway.signals.protection.own import prepared
from gateway.signals.protection.protection import protect_all


def _raw(signal: Signal, values: ArrayLike) -> NDArray[np.int64]:
    """Return what stands for values in a frame, clipped to the signal's range."""
    low = -np.inf if signal.minimum is None else float(signal.minimum)
    high = np.inf if signal.maximum is None else float(signal.maximum)
    clipped = np.clip(np.asarray(values, np.float64), low, high)
    return np.rint((clipped - signal.offset) / signal.scale).astype(np.int64)


def carried(message: Message, columns: Mapping[str, ArrayLike]) -> dict[str, NDArray[np.float64]]:
    """Return values as a receiver decodes them: clipped and quantised, each of shape (frames,)."""
    found = {}
    for name, values in columns.items():
        signal = message.get_signal_by_name(name)
        raw = _raw(signal, values).astype(np.float64)
        found[name] = np.asarray(raw * signal.scale + signal.offset, np.float64)
    return found


def pack(message: Message, columns: Mapping[str, ArrayLike], crc: str = "Crc") -> NDArray[np.uint8]:
    """Encode frames of a message, values clipped to their signals' ranges, and put in the CRC.

    Args:
        message: of at most 8 bytes, its signals little-endian and not multiplexed.
        columns: values of all signals but the CRC, each of shape (frames,).
        crc: name of the CRC's signal: 8 bits on a byte boundary.

    Returns:
        payloads, shape (frames, length).

    Raises:
        ValueError: a signal is missing, or not of that kind.
    """
    if message.length > 8 or message.is_multiplexed():
        raise ValueError(f"{message.name}: not a plain message of at most 8 bytes")
    count = len(np.asarray(next(iter(columns.values()))))
    words = np.zeros(count, np.uint64)
    for signal in message.signals:
        if signal.byte_order != "little_endian" or signal.is_float:
            raise ValueError(f"{message.name}.{signal.name}: not a little-endian integer")
        if signal.name == crc:
            continue
        if signal.name not in columns:
            raise ValueError(f"{message.name}.{signal.name}: no values")
        raw = _raw(signal, columns[signal.name])
        mask = (1 << signal.length) - 1
        words |= (raw & mask).astype(np.uint64) << np.uint64(signal.start)
    payloads = np.zeros((count, 8), np.uint64)
    payloads[:, 0] = words
    row, tables = prepared(message, crc, None)
    protect_all(payloads, np.full(count, message.length), row, tables, 0)
    return payloads.view(np.uint8)[:, : message.length].copy()

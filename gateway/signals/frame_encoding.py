"""Columns of values to CAN frames, many at once: any message of a database, protected as the gateway checks it.

The same bytes as cantools makes one by one (tests/vecu/test_encode.py).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from cantools.database.can import Message
from cantools.database.can.signal import Signal
from numpy.typing import ArrayLike, NDArray

from gateway.bus.frames import EXTENDED, FD, Frames, empty
from gateway.signals.columns import put_column
from gateway.signals.protection.default_profile import own_protection
from gateway.signals.protection.params import ProtectionParams, protection_for
from gateway.signals.protection.protection import Protection, compiled, protect_all
from gateway.signals.ranges import runs
from gateway.signals.tables import signal_row
from gateway_fdi.errors import InputError

Columns = Mapping[str, NDArray[np.float64]]
Flags = NDArray[np.bool_]
#: Bits of the longest signal that has a number.
_LONGEST = 64


def in_range(message: Message, columns: Mapping[str, ArrayLike]) -> dict[str, NDArray[np.float64]]:
    """Return values clipped to the ranges that the database gives to their signals, each of shape (frames,)."""
    found = {}
    for name, values in columns.items():
        signal = message.get_signal_by_name(name)
        low = -np.inf if signal.minimum is None else float(signal.minimum)
        high = np.inf if signal.maximum is None else float(signal.maximum)
        found[name] = np.clip(np.asarray(values, np.float64), low, high)
    return found


def carried(message: Message, columns: Mapping[str, ArrayLike]) -> dict[str, NDArray[np.float64]]:
    """Return values as a receiver decodes them: in their signals' ranges and rounded, each of shape (frames,)."""
    found = in_range(message, columns)
    for name, values in found.items():
        signal = message.get_signal_by_name(name)
        raw = np.rint((values - signal.offset) / signal.scale)
        found[name] = np.asarray(raw * signal.scale + signal.offset, np.float64)
    return found


def parents_first(message: Message) -> list[Signal]:
    """Return the signals of at most 64 bits, each multiplexer before the signals that it selects."""
    left = [signal for signal in message.signals if signal.length <= _LONGEST]
    found: dict[str, Signal] = {}
    while left:
        ready = [one for one in left if one.multiplexer_signal is None or one.multiplexer_signal in found]
        if not ready:
            break  # of a multiplexer that cannot be sent
        found |= {one.name: one for one in ready}
        left = [one for one in left if one.name not in found]
    return list(found.values())


def _there(signal: Signal, message: Message, columns: Columns, there: Mapping[str, Flags], count: int) -> Flags:
    """Return which frames carry a signal."""
    if signal.multiplexer_signal is None:
        return np.ones(count, np.bool_)
    outer = message.get_signal_by_name(signal.multiplexer_signal)
    raw = np.rint((columns[outer.name] - outer.offset) / outer.scale)
    selected = [(low <= raw) & (raw <= high) for low, high in runs(signal.multiplexer_ids or [])]
    found: Flags = there[outer.name] & np.logical_or.reduce(selected, initial=False)
    return found


def payloads(message: Message, columns: Columns, count: int, last: frozenset[str] = frozenset()) -> NDArray[np.uint64]:
    """Return payloads without their protection, shape (frames, 8), zero beyond the message's length.

    Args:
        message: of the database.
        columns: values of its signals, each of shape (frames,), as near as a signal can carry them; others: 0.
        count: frames.
        last: signals that are written after the others: where signals of a database overlap, they are what is sent.

    Raises:
        InputError: it has no such signal, or one that has no number.
    """
    signals = {signal.name: signal for signal in parents_first(message)}
    for name in columns:
        if name not in signals:
            raise InputError(f"{message.name} has no such signal; it has {', '.join(sorted(signals))}", value=name)
    every = {name: columns[name] if name in columns else np.zeros(count) for name in signals}
    there: dict[str, Flags] = {}
    for name, signal in signals.items():
        there[name] = _there(signal, message, every, there, count)
    words = np.zeros((count, 8), np.uint64)
    for signal in sorted(signals.values(), key=lambda one: (one.name in last, one.is_multiplexer)):
        put_column(words, signal_row(signal), every[signal.name], there[signal.name])
    return words


def framed(
    message: Message, words: NDArray[np.uint64], t_ns: NDArray[Any], protection: Protection, *, bus: int
) -> Frames:
    """Return payloads, shape (frames, 8), as frames of these times [ns], with their protection."""
    protect_all(words, np.full(len(words), message.length), *compiled(protection), 0)
    frames = empty(len(words))
    frames["t_ns"] = np.rint(t_ns).astype(np.int64)
    frames["can_id"] = message.frame_id | (EXTENDED if message.is_extended_frame else 0)
    frames["bus"], frames["length"] = bus, message.length
    frames["flags"] = FD if message.is_fd else 0
    frames["data"] = words.view(np.uint8)
    frames["data"][:, message.length :] = 0
    return frames


def sent(
    message: Message, columns: Columns, times: NDArray[np.float64], protection: ProtectionParams, *, bus: int
) -> Frames:
    """Return the frames of a message at these times [s], protected as a configuration says it.

    The columns are as of :func:`payloads`.

    Raises:
        InputError: it has no such signal, or cannot be protected so.
    """
    words = payloads(message, columns, len(times))
    return framed(message, words, times * 1e9, protection_for(message, protection), bus=bus)


def frames_of(
    message: Message, columns: Mapping[str, ArrayLike], t_ns: NDArray[Any], crc: str = "Crc", *, bus: int = 0
) -> Frames:
    """Return the frames of a message of ours: values in their signals' ranges, and the CRC of virtual ECUs.

    Args:
        message: of the database.
        columns: values of its signals, each of shape (frames,); others: 0.
        t_ns: times of the frames [ns].
        crc: name of the CRC's signal; none if the message has no such signal.
        bus: index of its bus.

    Raises:
        InputError: as of :func:`payloads`; a CRC that has not 8 bits on a byte boundary.
    """
    words = payloads(message, in_range(message, columns), len(t_ns))
    try:
        protection = own_protection(message, crc=crc, counter=None)
    except InputError as error:
        text = f"its signal {crc} is no CRC of 8 bits on a byte boundary, which virtual ECUs send"
        raise InputError(text, value=message.name) from error
    return framed(message, words, t_ns, protection, bus=bus)


def merged(*batches: Frames) -> Frames:
    """Return frames of several messages in the order of their times; of equal times the first batch comes first."""
    frames = np.concatenate(batches)
    return frames[np.argsort(frames["t_ns"], kind="stable")]

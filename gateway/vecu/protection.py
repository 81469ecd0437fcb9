"""Alive counter and CRC of the messages that virtual ECUs send."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from cantools.database.can import Message
from numpy.typing import NDArray

from gateway.resources import shipped
from gateway.signals.crc import ALGORITHMS, crc8, crc8_table
from gateway.signals.database import load_database

_CRC = "crc8_sae_j1850"


@cache
def message_of(file: str, name: str) -> Message:
    """Return a message of a shipped database."""
    return load_database([shipped(file)]).message(name)


@cache
def _table() -> NDArray[np.uint8]:
    return crc8_table(_CRC)


def protect(message: Message, values: dict[str, Any], crc: str = "Crc") -> bytes:
    """Encode a message, and put in the CRC over its other bytes and its identifier.

    Args:
        message: to encode.
        values: of all its signals but the CRC.
        crc: name of the CRC's signal: 8 bits on a byte boundary.
    """
    data = bytearray(message.encode({**values, crc: 0}))
    words = np.frombuffer(bytes(data).ljust(64, b"\0"), "<u8")
    at = message.get_signal_by_name(crc).start // 8
    algorithm = ALGORITHMS[_CRC]
    data[at] = crc8(
        words, len(data), at, message.frame_id, _table(), algorithm.init, algorithm.xorout
    )
    return bytes(data)

"""Alive counter and CRC of the messages that virtual ECUs send."""

from __future__ import annotations

from functools import cache
from typing import Any

import cantools
import numpy as np
from cantools.database.can import Message
from numpy.typing import NDArray

from gateway.common.resources import shipped
from gateway.errors import InputError
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
    """Encode a message, and put in the CRC over its other bytes and its identifier, if it has one.

    Args:
        message: to encode.
        values: of all its signals but the CRC.
        crc: name of the CRC's signal: 8 bits on a byte boundary.

    Raises:
        InputError: values that the message cannot carry, or a CRC of another shape.
    """
    place = next((signal for signal in message.signals if signal.name == crc), None)
    given = values if place is None else {**values, crc: 0}
    try:
        data = bytearray(message.encode(given))
    except (cantools.database.EncodeError, KeyError) as error:
        raise InputError(f"cannot be sent: {error}", value=message.name) from error
    if place is None:
        return bytes(data)
    edge = 0 if place.byte_order == "little_endian" else 7
    if place.length != 8 or place.start % 8 != edge:
        raise InputError(
            f"its signal {crc} is no CRC of 8 bits on a byte boundary, which virtual ECUs send",
            value=message.name,
        )
    words = np.frombuffer(bytes(data).ljust(64, b"\0"), "<u8")
    at = place.start // 8
    algorithm = ALGORITHMS[_CRC]
    data[at] = crc8(words, len(data), at, message.frame_id, _table(), algorithm.init, algorithm.xorout)
    return bytes(data)

"""The CRC of the messages that virtual ECUs send."""

from __future__ import annotations

from functools import cache
from typing import Any

import cantools
import numpy as np
from cantools.database.can import Message

from gateway.signals.database import load_database
from gateway.signals.protection.own import prepared
from gateway.signals.protection.protection import protect as protect_words
from gateway_fdi.common.resources import shipped
from gateway_fdi.errors import InputError


@cache
def message_of(file: str, name: str) -> Message:
    """Return a message of a shipped database."""
    return load_database([shipped(file)]).message(name)


def protect(message: Message, values: dict[str, Any], crc: str = "Crc") -> bytes:
    """Encode a message, and put in the CRC over its other bytes and its identifier, if it has one.

    Args:
        message: to encode.
        values: of all its signals but the CRC.
        crc: name of the CRC's signal: 8 bits on a byte boundary.

    Raises:
        InputError: values that the message cannot carry, or a CRC of another shape.
    """
    has_crc = any(signal.name == crc for signal in message.signals)
    try:
        data = message.encode({**values, crc: 0} if has_crc else values)
    except (cantools.database.EncodeError, KeyError) as error:
        raise InputError(f"cannot be sent: {error}", value=message.name) from error
    if not has_crc:
        return bytes(data)
    try:
        row, tables = prepared(message, crc, None)
    except InputError as error:
        text = f"its signal {crc} is no CRC of 8 bits on a byte boundary, which virtual ECUs send"
        raise InputError(text, value=message.name) from error
    words = np.frombuffer(bytes(data).ljust(64, b"\0"), "<u8").copy()
    protect_words(words, len(data), 0, row, tables)
    return words.tobytes()[: len(data)]

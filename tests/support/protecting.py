"""A frame's bytes, encoded by cantools, with the CRC that virtual ECUs send."""

import numpy as np

from gateway.signals.protection.default_profile import prepared
from gateway.signals.protection.protection import protect as protect_words


def protect(message, values, crc="Crc"):
    """Return the payload of a message with these values of all its signals but the CRC."""
    data = message.encode({**values, crc: 0})
    words = np.frombuffer(bytes(data).ljust(64, b"\0"), "<u8").copy()
    protect_words(words, len(data), 0, *prepared(message, crc, None))
    return words.tobytes()[: len(data)]

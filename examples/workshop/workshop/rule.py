"""The checksum of the workshop's frames: the sum of all bytes, and of the identifier's."""

from gateway.signals.protection.checksum import Checksum
from gateway.signals.protection.rules import Frame


def checksum(frame: Frame) -> Checksum:
    """Return the checksum of a message."""
    return Checksum(plus=frame.bytes_of_id)

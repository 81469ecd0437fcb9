"""Edge cases of ISO 15765-2: frames that are judged before the state machine sees them."""

from __future__ import annotations

from typing import NamedTuple

#: Kinds of frames, as the high nibble of the first byte has them.
SINGLE, FIRST, CONSECUTIVE, FLOW_CONTROL = range(4)
#: A separation time that the standard reserves counts as the longest one (9.6.5.5): 127 ms.
LONGEST_STMIN = 0x7F
#: Lengths above this have the escape form of a first frame.
MOST_SHORT = 4095
#: Longest answer of another ECU that is taken [byte].
MOST_LONG = 65535


class Judged(NamedTuple):
    """A frame as it is to be taken.

    Attributes:
        data: its bytes; None: it is to be ignored.
        aborts: whether it ends the message that waits for this flow control (9.6.5.2).
    """

    data: bytes | None
    aborts: bool = False


def judge(data: bytes, before: int = 0) -> Judged:
    """Return a frame as it is to be taken.

    Args:
        data: of a frame, without an address byte.
        before: whether there is an address byte: 0 or 1.
    """
    kind = data[0] >> 4 if data else -1
    if kind == FIRST and not _is_first(data, before):
        return Judged(None)
    if kind == FLOW_CONTROL and len(data) >= 3:
        if data[0] & 0x0F > 2:
            return Judged(None, aborts=True)
        if 0x7F < data[2] < 0xF1 or data[2] > 0xF9:
            return Judged(data[:2] + bytes([LONGEST_STMIN]) + data[3:])
    return Judged(data)


def _is_first(data: bytes, before: int) -> bool:
    """Return whether a first frame is one (9.6.3): full, and of a message that no single frame could carry."""
    if len(data) + before < 8:
        return False
    length = (data[0] & 0x0F) << 8 | data[1]
    if not length:
        return int.from_bytes(data[2:6], "big") > MOST_SHORT
    return length >= (len(data) if len(data) + before == 8 else len(data) - 1)

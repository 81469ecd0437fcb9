"""Messages of DoIP (ISO 13400-2:2019, clauses 7 and 9): header, payload types, codes; a stream cut into messages."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum

HEADER = struct.Struct(">BBHI")
#: Versions of the protocol: of 2012 and of 2019; identification requests may leave it open.
VERSIONS, ANY_VERSION = (0x02, 0x03), 0xFF


class Kind(IntEnum):
    """Payload types."""

    NACK = 0x0000
    IDENTIFY = 0x0001
    IDENTIFY_BY_EID = 0x0002
    IDENTIFY_BY_VIN = 0x0003
    VEHICLE = 0x0004
    ACTIVATE = 0x0005
    ACTIVATED = 0x0006
    ALIVE_REQUEST = 0x0007
    ALIVE = 0x0008
    STATUS_REQUEST = 0x4001
    STATUS = 0x4002
    POWER_REQUEST = 0x4003
    POWER = 0x4004
    DIAGNOSTIC = 0x8001
    DIAGNOSTIC_ACK = 0x8002
    DIAGNOSTIC_NACK = 0x8003


class HeaderNack(IntEnum):
    """Codes of the generic negative acknowledge."""

    INCORRECT_PATTERN = 0x00
    UNKNOWN_TYPE = 0x01
    TOO_LARGE = 0x02
    OUT_OF_MEMORY = 0x03
    INVALID_LENGTH = 0x04


#: After these the socket is closed: the stream cannot be followed any more.
CLOSING = {HeaderNack.INCORRECT_PATTERN, HeaderNack.INVALID_LENGTH}


class Activation(IntEnum):
    """Codes of the routing activation response."""

    UNKNOWN_SOURCE = 0x00
    ALL_SOCKETS = 0x01
    OTHER_SOURCE = 0x02
    ACTIVE_ELSEWHERE = 0x03
    AUTHENTICATION = 0x04
    UNSUPPORTED_TYPE = 0x06
    TLS_REQUIRED = 0x07
    DONE = 0x10


class Nack(IntEnum):
    """Codes of the negative acknowledge of a diagnostic message."""

    INVALID_SOURCE = 0x02
    UNKNOWN_TARGET = 0x03
    TOO_LARGE = 0x04
    OUT_OF_MEMORY = 0x05
    UNREACHABLE = 0x06
    UNKNOWN_NETWORK = 0x07
    TRANSPORT = 0x08


@dataclass(frozen=True)
class Message:
    """A message: its payload type, the payload, and the version that its sender speaks."""

    kind: Kind
    body: bytes
    version: int


@dataclass(frozen=True)
class Refused:
    """A header that is refused; ``version`` is that of the answer."""

    code: HeaderNack
    version: int

    def packed(self) -> bytes:
        """Return the negative acknowledge."""
        return packed(Kind.NACK, bytes([self.code]), self.version)


#: Lengths of the payloads that testers send by TCP, by payload type: least, greatest (None: that of the entity).
BY_TCP: dict[int, tuple[int, int | None]] = {
    Kind.NACK: (1, 1), Kind.ACTIVATE: (7, 11), Kind.ALIVE_REQUEST: (0, 0), Kind.ALIVE: (2, 2),
    Kind.DIAGNOSTIC: (5, None), Kind.DIAGNOSTIC_ACK: (5, None), Kind.DIAGNOSTIC_NACK: (5, None),
}  # fmt: skip
#: The same by UDP. Answers of other entities are heard where they are announced to all.
BY_UDP: dict[int, tuple[int, int | None]] = {
    Kind.NACK: (1, 1), Kind.IDENTIFY: (0, 0), Kind.IDENTIFY_BY_EID: (6, 6), Kind.IDENTIFY_BY_VIN: (17, 17),
    Kind.VEHICLE: (32, 33), Kind.STATUS_REQUEST: (0, 0), Kind.STATUS: (3, 7), Kind.POWER_REQUEST: (0, 0),
    Kind.POWER: (1, 1),
}  # fmt: skip


def packed(kind: int, body: bytes, version: int) -> bytes:
    """Return a message."""
    return HEADER.pack(version, version ^ 0xFF, kind, len(body)) + body


def refusal(
    header: bytes | bytearray, known: dict[int, tuple[int, int | None]], most: int, room: int
) -> tuple[Kind, int, int] | Refused:
    """Return type, length and version of a header, or why it is refused, in the standard's order (7.1.5, Figure 14).

    Args:
        header: its bytes.
        known: lengths of the payload types there are.
        most: longest payload that there can be [byte].
        room: bytes that there is room for at present.
    """
    version, inverse, kind, length = HEADER.unpack_from(header)
    open_ = version == ANY_VERSION and kind in (Kind.IDENTIFY, Kind.IDENTIFY_BY_EID, Kind.IDENTIFY_BY_VIN)
    spoken = version if version in VERSIONS else VERSIONS[-1]
    if inverse != version ^ 0xFF or not (version in VERSIONS or open_):
        return Refused(HeaderNack.INCORRECT_PATTERN, spoken)
    if kind not in known:
        return Refused(HeaderNack.UNKNOWN_TYPE, spoken)
    if length > most:
        return Refused(HeaderNack.TOO_LARGE, spoken)
    if length > room:
        return Refused(HeaderNack.OUT_OF_MEMORY, spoken)
    least, greatest = known[kind]
    right = least <= length <= (most if greatest is None else greatest)
    if not right or (kind == Kind.ACTIVATE and length not in (7, 11)):
        return Refused(HeaderNack.INVALID_LENGTH, spoken)
    return Kind(kind), length, spoken


#: Longest payload that has room at any time [byte]: who claims all the rest keeps no usual request out.
SMALL = 4096


class Splitter:
    """Cuts the stream of one connection into messages; a payload that is refused is passed over, and not kept.

    Args:
        most: longest payload [byte].
        room: returns the bytes that there is room for at present, of all connections together, for longer messages
            than :data:`SMALL`.

    Attributes:
        room: the same.
        claimed: bytes of the unfinished message, if it is longer than :data:`SMALL`, which ``room`` counts.
    """

    def __init__(self, most: int, room: Callable[[], int]) -> None:
        self._most, self.room = most, room
        self._bytes = bytearray()
        self._skip = 0
        self._begun: tuple[Kind, int, int] | None = None
        self.claimed = 0

    def put(self, data: bytes) -> None:
        """Take what came."""
        passed = min(self._skip, len(data))
        self._skip -= passed
        self._bytes += data[passed:]

    def take(self) -> Message | Refused | None:
        """Return the next message or refusal; None: none is complete."""
        if self._begun is None:
            if len(self._bytes) < HEADER.size:
                return None
            found = refusal(self._bytes, BY_TCP, self._most, max(self.room(), SMALL))
            length = HEADER.unpack_from(self._bytes)[3]
            del self._bytes[: HEADER.size]
            if isinstance(found, Refused):
                passed = min(length, len(self._bytes))
                del self._bytes[:passed]
                self._skip = length - passed
                return found
            self._begun, self.claimed = found, found[1] if found[1] > SMALL else 0
        kind, length, version = self._begun
        if len(self._bytes) < length:
            return None
        body = bytes(self._bytes[:length])
        del self._bytes[:length]
        self._begun, self.claimed = None, 0
        return Message(kind, body, version)

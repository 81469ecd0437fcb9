"""AUTOSAR's E2E profiles for CAN (PRS_E2EProtocol, R22-11): the computation of each, and where its header lies.

Byte order, start values and covered bytes are the specification's; where its text leaves room, as the open
implementation autosar-e2e has it, which the tests compare with frame by frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from gateway.signals.bits import field_at
from gateway.signals.protection.checksum import LIST, Checksum
from gateway.signals.protection.crc import KNOWN, Crc
from gateway.signals.protection.protection import Counter, Protection, Window
from gateway_fdi.errors import InputError

#: Of profiles 1 and 11: start value and final exclusive or of the library's CRC8 cancel out.
_J1850_FROM_ZERO = Crc(8, 0x1D)


@dataclass(frozen=True)
class Header:
    """The user's settings of a protected message.

    Attributes:
        length: of the message [byte].
        data_id: 16 or 32 bits.
        data_ids: the list of profiles 2 and 22, 16 bytes.
        mode: how profiles 1 and 11 take the data id in: both, alternating, low, nibble.
        offset: first byte of the header.
        max_delta: largest step of the counter that is not a failure.
        window: state machine; None: each frame alone.
    """

    length: int
    data_id: int = 0
    data_ids: Sequence[int] = ()
    mode: str = "both"
    offset: int = 0
    max_delta: int = 1
    window: Window | None = None

    @property
    def low(self) -> int:
        """Low byte of the data id."""
        return self.data_id & 0xFF

    @property
    def high(self) -> int:
        """High byte of the data id."""
        return self.data_id >> 8 & 0xFF


def _p01(h: Header) -> Protection:
    """CRC8 in byte 0, counter 0..14 in the low nibble of byte 1; the data id goes in before the payload."""
    before: tuple[int, ...] = ()
    listed: tuple[int, ...] = ()
    constants: list[tuple[Any, int, str]] = []
    if h.mode == "both":
        before = h.low, h.high
    elif h.mode == "low":
        before = (h.low,)
    elif h.mode == "alternating":
        listed = tuple(h.high if k % 2 else h.low for k in range(LIST))
    else:
        before = h.low, 0
        constants.append((field_at(h.offset + 1, 4, shift=4), h.high & 0xF, "data id, bits 8 to 11"))
    checksum = Checksum(_J1850_FROM_ZERO, before=before, by_counter=listed, list_after=False)
    counter = Counter(field_at(h.offset + 1, 4), 15, max_step=h.max_delta)
    return Protection(checksum, field_at(h.offset, 8), counter, constants)


@dataclass(frozen=True)
class Profile:
    """A profile.

    Attributes:
        header: its length [byte].
        crc: its polynomial.
        field: first byte of the CRC in the header, and its bits.
        counter: the same, of the counter, which has all values of its bits.
        length, data_id: the same, of header fields that are always the message's length and data id; None: none.
        big: most significant byte first.
        listed: a byte of the list of data ids goes in after the payload, by the counter.
        after: of the data id's low and high byte those that go in after the payload, in this order.
        modes: of P01 and P11, which have rules of their own.
        data_id_bits: of the data id.
        offset_may_differ: whether the header may lie elsewhere than at the begin.
    """

    header: int
    crc: Crc
    field: tuple[int, int] = (0, 8)
    counter: tuple[int, int] = (1, 4)
    length: tuple[int, int] | None = None
    data_id: tuple[int, int] | None = None
    big: bool = False
    listed: bool = False
    after: str = ""
    modes: tuple[str, ...] = ()
    data_id_bits: int = 16
    offset_may_differ: bool = True

    def make(self, h: Header) -> Protection:
        """Return the protection of a message."""

        def at(place: tuple[int, int]) -> Any:
            return field_at(h.offset + place[0], place[1], big=self.big and place[1] > 8)

        fields = ((self.length, h.length, "length"), (self.data_id, h.data_id, "data id"))
        constants = [(at(place), value, name) for place, value, name in fields if place is not None]
        after = tuple({"low": h.low, "high": h.high}[one] for one in self.after.split())
        checksum = Checksum(self.crc, after=after, by_counter=tuple(h.data_ids) if self.listed else ())
        counter = Counter(at(self.counter), 1 << self.counter[1], max_step=h.max_delta)
        return Protection(checksum, at(self.field), counter, constants)


_AUTOSAR8, _CCITT = KNOWN["crc8_autosar"], KNOWN["crc16_ccitt_false"]
_AUTOSAR32, _XZ = KNOWN["crc32_autosar"], KNOWN["crc64_xz"]
PROFILES = {
    "P01": Profile(2, _J1850_FROM_ZERO, modes=("both", "alternating", "low", "nibble")),
    "P02": Profile(2, _AUTOSAR8, listed=True, offset_may_differ=False),
    "P04": Profile(12, _AUTOSAR32, (8, 32), (2, 16), (0, 16), (4, 32), big=True, data_id_bits=32),
    "P05": Profile(3, _CCITT, (0, 16), (2, 8), after="low high"),
    "P06": Profile(5, _CCITT, (0, 16), (4, 8), (2, 16), big=True, after="high low"),
    "P07": Profile(20, _XZ, (0, 64), (12, 32), (8, 32), (16, 32), big=True, data_id_bits=32),
    "P11": Profile(2, _J1850_FROM_ZERO, modes=("both", "nibble")),
    "P22": Profile(2, _AUTOSAR8, listed=True),
}


def protection_of(name: str, header: Header) -> Protection:
    """Return the protection of a message by a profile.

    Raises:
        InputError: a key that the profile does not have, or lacks.
    """
    profile = PROFILES[name]
    if header.offset + profile.header > header.length:
        text = f"{name}'s header has {profile.header} bytes, the message {header.length}"
        raise InputError(text, key="offset", value=header.offset)
    if header.offset and not profile.offset_may_differ:
        raise InputError(f"{name} has its header at the begin", key="offset", value=header.offset)
    if profile.listed and len(header.data_ids) != LIST:
        raise InputError(f"{name} wants a list of 16 data ids", key="data_ids", value=list(header.data_ids))
    if not profile.listed and header.data_ids:
        raise InputError(f"{name} has one data id", key="data_ids", value=list(header.data_ids))
    if profile.modes and header.mode not in profile.modes:
        raise InputError(f"{name} has {', '.join(profile.modes)}", key="data_id_mode", value=header.mode)
    if not 0 <= header.data_id < 1 << profile.data_id_bits:
        raise InputError(f"{name}'s data id has {profile.data_id_bits} bits", key="data_id", value=header.data_id)
    made = _p01(header) if profile.modes else profile.make(header)
    return Protection(
        made.checksum, made.field, made.counter, made.constants, strict=True, window=header.window, name=name
    )

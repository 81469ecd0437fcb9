"""AUTOSAR's E2E profiles for CAN (PRS_E2EProtocol, R22-11): the computation of each, and where its header lies.

Byte order, start values and covered bytes are the specification's; where its text leaves room, as the open
implementation autosar-e2e has it, which the tests compare with frame by frame.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
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


def _listed(h: Header) -> Protection:
    """CRC8H2F in byte 0, counter 0..15 in the low nibble of byte 1; then one byte of the list by the counter."""
    checksum = Checksum(KNOWN["crc8_autosar"], by_counter=tuple(h.data_ids))
    return Protection(checksum, field_at(h.offset, 8), Counter(field_at(h.offset + 1, 4), 16, max_step=h.max_delta))


def _p04(h: Header) -> Protection:
    """Length 16, counter 16, data id 32, CRC32P4; most significant byte first."""
    constants = [
        (field_at(h.offset, 16, big=True), h.length, "length"),
        (field_at(h.offset + 4, 32, big=True), h.data_id, "data id"),
    ]
    counter = Counter(field_at(h.offset + 2, 16, big=True), 1 << 16, max_step=h.max_delta)
    return Protection(Checksum(KNOWN["crc32_autosar"]), field_at(h.offset + 8, 32, big=True), counter, constants)


def _p05(h: Header) -> Protection:
    """CRC16, least significant byte first, counter 8; the data id goes in after the payload, low byte first."""
    checksum = Checksum(KNOWN["crc16_ccitt_false"], after=(h.low, h.high))
    counter = Counter(field_at(h.offset + 2, 8), 256, max_step=h.max_delta)
    return Protection(checksum, field_at(h.offset, 16), counter)


def _p06(h: Header) -> Protection:
    """CRC16, length 16, most significant byte first, counter 8; the data id goes in after it, high byte first."""
    checksum = Checksum(KNOWN["crc16_ccitt_false"], after=(h.high, h.low))
    counter = Counter(field_at(h.offset + 4, 8), 256, max_step=h.max_delta)
    constants = [(field_at(h.offset + 2, 16, big=True), h.length, "length")]
    return Protection(checksum, field_at(h.offset, 16, big=True), counter, constants)


def _p07(h: Header) -> Protection:
    """CRC64, length 32, counter 32, data id 32; most significant byte first."""
    constants = [
        (field_at(h.offset + 8, 32, big=True), h.length, "length"),
        (field_at(h.offset + 16, 32, big=True), h.data_id, "data id"),
    ]
    counter = Counter(field_at(h.offset + 12, 32, big=True), 1 << 32, max_step=h.max_delta)
    return Protection(Checksum(KNOWN["crc64_xz"]), field_at(h.offset, 64, big=True), counter, constants)


@dataclass(frozen=True)
class Profile:
    """A profile: maker of its protection, length of its header, keys that it needs."""

    make: Callable[[Header], Protection]
    header: int
    modes: tuple[str, ...] = ()
    listed: bool = False
    data_id_bits: int = 16
    offset_may_differ: bool = True


PROFILES = {
    "P01": Profile(_p01, 2, ("both", "alternating", "low", "nibble")),
    "P02": Profile(_listed, 2, listed=True, offset_may_differ=False),
    "P04": Profile(_p04, 12, data_id_bits=32),
    "P05": Profile(_p05, 3),
    "P06": Profile(_p06, 5),
    "P07": Profile(_p07, 20, data_id_bits=32),
    "P11": Profile(_p01, 2, ("both", "nibble")),
    "P22": Profile(_listed, 2, listed=True),
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
    made = profile.make(header)
    return Protection(
        made.checksum, made.field, made.counter, made.constants, strict=True, window=header.window, name=name
    )

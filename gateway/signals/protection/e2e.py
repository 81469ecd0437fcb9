"""AUTOSAR's E2E profiles for CAN (PRS_E2EProtocol, R22-11): the computation of each, and where its header lies.

Byte order, start values and covered bytes are the specification's; where its text leaves room, as the open
implementation autosar-e2e has it, which the tests compare with frame by frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from pydantic import Field

from gateway.signals.bits import field_at
from gateway.signals.protection.checksum import LIST, Byte, Checksum
from gateway.signals.protection.crc import KNOWN, Crc
from gateway.signals.protection.protection import Counter, Protection, WindowParams
from gateway_fdi.common.tomlfile import StrictModel
from gateway_fdi.errors import InputError

if TYPE_CHECKING:
    from cantools.database.can import Message

#: Of profiles 1 and 11: start value and final exclusive or of the library's CRC8 cancel out.
_J1850_FROM_ZERO = Crc(8, 0x1D)


@dataclass(frozen=True)
class Profile:
    """A profile.

    Attributes:
        header: its length [byte].
        crc: its polynomial.
        field: first byte of the CRC in the header, and its bits.
        counter: the same, of the counter, which has all values of its bits; of P01 and P11 all but the last.
        length, data_id: the same, of header fields that are always the message's length and data id; None: none.
        big: most significant byte first.
        listed: a byte of the list of data ids goes in after the payload, by the counter.
        after: of the data id's low and high byte those that go in after the payload, in this order.
        modes: of P01 and P11: how the data id goes in before the payload.
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


class E2eCheck(StrictModel):
    """An AUTOSAR E2E profile."""

    profile: Literal["P01", "P02", "P04", "P05", "P06", "P07", "P11", "P22"]
    data_id: int = Field(0, ge=0, description="16 bits; 32 with P04 and P07")
    data_ids: tuple[Byte, ...] = Field((), description="of P02 and P22: 16, one a counter value")
    data_id_mode: Literal["both", "alternating", "low", "nibble"] = Field("both", description="of P01 and P11")
    offset: int = Field(0, ge=0, le=62, description="first byte of the header")
    max_delta: int = Field(1, ge=1, description="largest step of the counter that is used")
    window: WindowParams | None = Field(None, description="E2E state machine; none: each frame is judged alone")

    def protection(self, message: Message) -> Protection:
        """Return it for a message.

        Raises:
            InputError: a key that the profile does not have, or lacks.
        """
        profile = PROFILES[self.profile]
        self._refuse(profile, message)

        def at(place: tuple[int, int]) -> Any:
            return field_at(self.offset + place[0], place[1], big=profile.big and place[1] > 8)

        low, high = self.data_id & 0xFF, self.data_id >> 8 & 0xFF
        fields = ((profile.length, message.length, "length"), (profile.data_id, self.data_id, "data id"))
        constants = [(at(place), value, name) for place, value, name in fields if place is not None]
        if profile.modes:
            before = {"both": (low, high), "low": (low,), "nibble": (low, 0), "alternating": ()}[self.data_id_mode]
            listed = (low, high) * (LIST // 2) if self.data_id_mode == "alternating" else ()
            checksum = Checksum(profile.crc, before=before, by_counter=listed, list_after=False)
            if self.data_id_mode == "nibble":
                constants.append((field_at(self.offset + 1, 4, shift=4), high & 0xF, "data id, bits 8 to 11"))
        else:
            after = tuple({"low": low, "high": high}[one] for one in profile.after.split())
            checksum = Checksum(profile.crc, after=after, by_counter=self.data_ids)
        counter = Counter(
            at(profile.counter), 15 if profile.modes else 1 << profile.counter[1], max_step=self.max_delta
        )
        return Protection(
            checksum, at(profile.field), counter, constants, strict=True, window=self.window, name=self.profile
        )

    def _refuse(self, profile: Profile, message: Message) -> None:
        """Refuse keys that the profile does not have, or lacks."""
        name = self.profile
        if self.offset + profile.header > message.length:
            text = f"{name}'s header has {profile.header} bytes, the message {message.length}"
            raise InputError(text, key="offset", value=self.offset)
        if self.offset and not profile.offset_may_differ:
            raise InputError(f"{name} has its header at the begin", key="offset", value=self.offset)
        if profile.listed and len(self.data_ids) != LIST:
            raise InputError(f"{name} wants a list of 16 data ids", key="data_ids", value=list(self.data_ids))
        if not profile.listed and self.data_ids:
            raise InputError(f"{name} has one data id", key="data_ids", value=list(self.data_ids))
        if profile.modes and self.data_id_mode not in profile.modes:
            raise InputError(f"{name} has {', '.join(profile.modes)}", key="data_id_mode", value=self.data_id_mode)
        if self.data_id >= 1 << profile.data_id_bits:
            raise InputError(f"{name}'s data id has {profile.data_id_bits} bits", key="data_id", value=self.data_id)

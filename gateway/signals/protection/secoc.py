"""AUTOSAR's Secure Onboard Communication: a message's MAC and freshness value, by the specification's profiles.

PRS_SecOcProtocol, R23-11. A secured message is its authentic part, then the freshness value's lowest bits, then the
MAC's highest, most significant bit first, then zero bits to the byte's end. The MAC is a CMAC (AES-128) over the data
id of 16 bits, the authentic part and the whole freshness value; a value that ends within a byte has zero bits after
it.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Self

from pydantic import Field, ValidationError, model_validator

from gateway.host.process import open_to_others
from gateway.signals.bits import field_at
from gateway.signals.protection.checksum import Checksum
from gateway.signals.protection.cmac import BLOCK, Mac
from gateway.signals.protection.freshness import COUNTER, SYNC, SYNCED, Freshness
from gateway.signals.protection.protection import Protection
from gateway_fdi.common.tomlfile import StrictModel
from gateway_fdi.errors import InputError

if TYPE_CHECKING:
    from cantools.database.can import Message


class _Lengths(NamedTuple):
    """Bits of the freshness value, of what is sent of it, of the MAC that is sent; None: trip and reset counter."""

    freshness: int | None
    truncated: int | None
    mac: int


#: Profiles 1 (24Bit-CMAC-8Bit-FV), 2 (24Bit-CMAC-No-FV), 3 (JASPAR); the first leaves the whole value's length open.
PROFILES: dict[int | str, _Lengths] = {
    1: _Lengths(64, 8, 24),
    2: _Lengths(0, 0, 24),
    3: _Lengths(64, 4, 28),
    "sync": _Lengths(None, None, 28),
}


_KINDS = {3: SYNCED, "sync": SYNC}
#: Keys of profile 3; of the master's message two of them.
_OF_SYNCED = {"sync", "trip", "reset", "flag", "per_sync"}


class SecocCheck(StrictModel):
    """A message that SecOC secures."""

    profile: Literal[1, 2, 3, "sync", "database"] = Field(
        description="1, 2 or 3; sync: the freshness master's message; database: lengths and data id of an ARXML file"
    )
    key: Path = Field(description="file with the AES-128 key, 32 hex digits, mode 0600; relative to this file's folder")
    data_id: int | None = Field(None, ge=0, le=0xFFFF, description="goes into the MAC; default: the database's")
    freshness: int | None = Field(None, ge=0, le=64, description="bits of the whole value; default: 64, profile 2: 0")
    truncated: int | None = Field(None, ge=0, le=64, description="lowest bits that are sent; default: the profile's")
    mac: int | None = Field(None, ge=16, le=64, description="highest bits that are sent; default: the profile's")
    authentic: int | None = Field(
        None, ge=0, le=63, description="bytes before freshness value and MAC; default: all that these leave"
    )
    start: int | None = Field(
        None,
        ge=0,
        lt=1 << 63,
        description="first value that is right: of 3 and sync of trip and reset counter together; another one forgets"
        " the values seen; default: 0, trip 1 reset 1",
    )
    attempts: int = Field(2, ge=0, le=64, description="further whole values that are tried, if the next one is wrong")
    sync: str | None = Field(None, description="of profile 3: name of the freshness master's message on this bus")
    trip: int = Field(16, ge=1, le=24, description="bits of the trip counter (3, sync)")
    reset: int = Field(20, ge=2, le=24, description="bits of the reset counter (3, sync)")
    flag: int = Field(2, ge=1, le=4, description="bits of the reset flag (3)")
    per_sync: int = Field(10, ge=1, description="frames that a virtual ECU sends between two of the master's (3)")

    @model_validator(mode="after")
    def _fits_its_profile(self) -> Self:
        if self.profile == "database":
            return self
        if self.data_id is None:
            raise ValueError("data_id: 16 bits that go into the MAC")
        own = {"trip", "reset"} if self.profile == "sync" else _OF_SYNCED if self.profile == 3 else set()
        foreign = (_OF_SYNCED - own) & self.model_fields_set
        if foreign:
            raise ValueError(f"profile {self.profile} has no {', '.join(sorted(foreign))}")
        if self.profile == 3 and self.sync is None:
            raise ValueError("profile 3 needs sync, the message that has trip and reset counter")
        if self.profile == "sync" and {"freshness", "truncated"} & self.model_fields_set:
            raise ValueError("sync: trip and reset counter are its freshness value, sent whole")
        bits, truncated, _ = self._lengths
        if truncated > bits:
            raise ValueError(f"truncated: {truncated} of {bits} bits")
        if self.profile == 3 and not (self._counted > 0 and self.flag <= truncated <= self.flag + self._counted):
            raise ValueError("truncated: the reset flag and bits of the message counter, which freshness has room for")
        if self.start is not None and self.start >> (self.trip + self.reset if self.sync else bits):
            raise ValueError(f"start has more than {self.trip + self.reset if self.sync else bits} bits")
        return self

    def of(self, message: Message) -> SecocCheck:
        """Return it with what the message's database says, where it is asked for; keys that are given stay.

        Its freshness value is a counter (profile 1, without one 2), or profile 3's where ``sync`` is given: the names
        that an ARXML file gives to algorithms are a carmaker's own.

        Raises:
            InputError: the database says nothing, or too little; it says what is none of these profiles.
        """
        if self.profile != "database":
            return self
        said = message.autosar.secoc if message.autosar is not None else None
        if said is None:
            raise InputError(f"the database has no SecOC of {message.name}", key="profile", value="database")
        found = {
            "data_id": said.data_id,
            "freshness": said.freshness_bit_length,
            "truncated": said.freshness_tx_bit_length,
            "mac": said.auth_tx_bit_length,
            "authentic": said.payload_length,
        }
        keys = found | {name: getattr(self, name) for name in self.model_fields_set}
        lacking = [name for name, value in keys.items() if value is None]
        if lacking:
            raise InputError(f"the database does not say {', '.join(lacking)} of {message.name}", key=lacking[0])
        try:
            return SecocCheck(**keys | {"profile": 3 if self.sync else 1 if keys["freshness"] else 2})
        except ValidationError as error:
            first = error.errors()[0]
            key = str(first["loc"][0]) if first["loc"] else "profile"
            text = f"the database's SecOC of {message.name}: {first['msg']}"
            raise InputError(text, key=key, value=keys.get(key)) from error

    @property
    def _lengths(self) -> tuple[int, int, int]:
        """Bits of the freshness value, of what is sent of it, of the MAC that is sent."""
        usual, both = PROFILES[self.profile], self.trip + self.reset
        whole = both if usual.freshness is None else usual.freshness
        sent = both if usual.truncated is None else usual.truncated
        bits = whole if self.freshness is None else self.freshness
        truncated = sent if self.truncated is None else self.truncated
        return bits, truncated, usual.mac if self.mac is None else self.mac

    @property
    def _counted(self) -> int:
        """Bits of profile 3's message counter."""
        return self._lengths[0] - self.trip - self.reset - self.flag

    def protection(self, message: Message) -> Protection:
        """Return it for a message.

        Raises:
            InputError: it does not fit the message; a key that cannot be read, or that others can read.
        """
        if self.profile == "database":
            return self.of(message).protection(message)
        assert self.data_id is not None
        bits, truncated, mac = self._lengths
        tail = (truncated + mac + 7) // 8
        authentic = message.length - tail if self.authentic is None else self.authentic
        if authentic < 0 or authentic + tail > message.length:
            text = f"freshness value and MAC have {tail} bytes, the message {message.length}"
            raise InputError(text, key="mac" if self.authentic is None else "authentic", value=self.authentic or mac)
        data_id = self.data_id >> 8, self.data_id & 0xFF
        checksum = Checksum(mac=Mac(read_key(self.key)), last=authentic, before=data_id, fresh=bits)
        epoch = 1 << self.reset | 1
        start = self.start if self.start is not None else epoch if self.profile in (3, "sync") else 0
        fresh = Freshness(
            kind=_KINDS.get(self.profile, COUNTER),
            bits=bits,
            truncated=truncated,
            field=_bits_at(8 * authentic, truncated) if truncated else None,
            start=start,
            reset=self.reset,
            flag=self.flag,
            message=self._counted if self.profile == 3 else 0,
            sync=self.sync or "",
            attempts=self.attempts,
            per_sync=self.per_sync,
        )
        field = _bits_at(8 * authentic + truncated, mac)
        unused = 8 * tail - truncated - mac
        constants = [(_bits_at(8 * (authentic + tail) - unused, unused), 0, "unused bits")] if unused else []
        return Protection(checksum, field, constants=constants, name=f"SecOC {self.profile}", freshness=fresh)


def _bits_at(first: int, bits: int) -> Any:
    """Return the place of a number, most significant bit first, as a record of :class:`gateway.signals.bits.Field`."""
    return field_at(first // 8, bits, big=True, shift=first % 8)


def read_key(file: Path) -> bytes:
    """Return a key of AES-128.

    Raises:
        InputError: it cannot be read, others can read it, or it is none.
    """
    try:
        shared, text = open_to_others(file), file.read_text(encoding="ascii").strip()
    except (OSError, ValueError) as error:
        raise InputError(f"no key can be read here: {error}", key="key", value=str(file)) from error
    if shared:
        raise InputError("others can read this key: chmod 600", key="key", value=str(file))
    try:
        key = bytes.fromhex(text)
    except ValueError:
        key = b""
    if len(key) != BLOCK:
        raise InputError("a key is 32 hex digits", key="key", value=str(file))
    return key

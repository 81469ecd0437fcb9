"""A user's settings of a message's protection, and the protection they give a message of a database."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, field_validator, model_validator

from gateway.signals.bits import LONGEST, field_of
from gateway.signals.protection.checksum import LIST, MOST_EXTRA, Byte, Checksum
from gateway.signals.protection.crc import KNOWN, Crc
from gateway.signals.protection.e2e import E2eCheck
from gateway.signals.protection.protection import Counter, Protection
from gateway.signals.protection.rules import OTHERS, RULES, Frame, rule_of
from gateway.signals.protection.secoc import SecocCheck
from gateway_fdi.common.tomlfile import StrictModel
from gateway_fdi.errors import InputError, nearest, under

if TYPE_CHECKING:
    from cantools.database.can import Message
    from cantools.database.can.signal import Signal

#: Names that databases of cars give to checksums and counters (opendbc's convention first), ending so.
CHECKSUMS = ("CHECKSUM", "CHKSUM", "CHKSM", "CRC")
COUNTERS = ("COUNTER", "ALIVE", "CNT", "FRAMECNT")
#: Keys of which a protection with a checksum has one, and all that say how a message is protected.
CHECKSUM_KEYS = ("crc", "checksum", "e2e", "secoc")
KEYS = (*CHECKSUM_KEYS, "protection", "counter")


class CounterCheck(StrictModel):
    """Alive counter: a signal that every transmission raises by one, modulo its values."""

    signal: str = Field(description="name of the counter signal")
    max_step: int = Field(1, ge=1, description="largest step that is not a failure")
    modulus: int | None = Field(None, ge=2, description="how many values it has; default: all that its bits have")
    first: int = Field(0, ge=0, description="the lowest of them")


class DataId(StrictModel):
    """Bytes that go into a CRC beside the payload."""

    bytes: tuple[Byte, ...] = Field(min_length=1, max_length=LIST, description="by_counter: 16, one a counter value")
    place: Literal["before", "after", "by_counter"] = Field(
        "after", description="before or after the payload; by_counter: after it, the one of the counter's value"
    )

    @model_validator(mode="after")
    def _as_many(self) -> Self:
        if self.place == "by_counter" and len(self.bytes) != LIST:
            raise ValueError(f"by_counter: {LIST} bytes, one for each value of the counter")
        if self.place != "by_counter" and len(self.bytes) > MOST_EXTRA:
            raise ValueError(f"at most {MOST_EXTRA} bytes")
        return self


class CrcCheck(StrictModel):
    """A CRC over the payload without the CRC itself, and a data id."""

    signal: str = Field(description='name of the CRC signal; "byte 7", "bytes 6-7": where the database has none')
    algorithm: Literal[
        "crc8_sae_j1850", "crc8_autosar", "crc16_ccitt_false", "crc16_xmodem", "crc16_arc", "crc32", "crc32_autosar",
        "crc64_xz",
    ] = Field("crc8_sae_j1850", description="a known CRC; or give width and poly")  # fmt: skip
    width: int | None = Field(None, ge=4, le=64, description="of the CRC [bit]; with poly, instead of algorithm")
    poly: int | None = Field(None, ge=1, description="without its highest term")
    init: int = Field(0, ge=0, description="first value of the register")
    refin: bool = Field(False, description="bytes go in with their least significant bit first")
    refout: bool = Field(False, description="the register is reflected at the end")
    xorout: int = Field(0, ge=0, description="applied at the end")
    over: tuple[int, int] | None = Field(
        None, description="[first byte, byte after the last one]; default: the whole payload"
    )
    data_id: Annotated[int, Field(ge=0, le=0xFFFF)] | DataId | None = Field(
        None, description="16 bits after the payload, low byte first; or { bytes = [...], place = ... }"
    )

    @model_validator(mode="after")
    def _one_polynomial(self) -> Self:
        own = {"init", "refin", "refout", "xorout"} & self.model_fields_set
        if (self.width is None) != (self.poly is None):
            raise ValueError("width and poly are given together")
        if self.width is None and own:
            raise ValueError(f"{', '.join(sorted(own))}: of a CRC with width and poly")
        if self.width is not None and "algorithm" in self.model_fields_set:
            raise ValueError("give algorithm, or width and poly")
        width = self.crc.width
        for name in ("poly", "init", "xorout"):
            if getattr(self.crc, name) >> width:
                raise ValueError(f"{name} has more than {width} bits")
        if self.over is not None and not 0 <= self.over[0] < self.over[1] <= 64:
            raise ValueError("over: [first byte, byte after the last one], within 0 and 64")
        return self

    @property
    def crc(self) -> Crc:
        """Its polynomial."""
        if self.width is None or self.poly is None:
            return KNOWN[self.algorithm]
        return Crc(self.width, self.poly, self.init, self.refin, self.refout, self.xorout)

    def checksum(self, _: Message | None = None) -> Checksum:
        """Return what is computed."""
        first, last = self.over or (0, None)
        given = self.data_id
        if isinstance(given, int):
            return Checksum(self.crc, first=first, last=last, after=(given & 0xFF, given >> 8))
        if given is None:
            return Checksum(self.crc, first=first, last=last)
        before = given.bytes if given.place == "before" else ()
        after = given.bytes if given.place == "after" else ()
        listed = given.bytes if given.place == "by_counter" else ()
        return Checksum(self.crc, first=first, last=last, before=before, after=after, by_counter=listed)


class SumCheck(StrictModel):
    """A carmaker's rule, or a sum or exclusive or of bytes or half bytes."""

    rule: str = Field(description="a carmaker's rule; or sum, xor")
    signal: str | None = Field(None, description='name of the checksum signal; default: the one called so; or "byte 7"')
    of: Literal["bytes", "nibbles"] = Field("bytes", description="bytes or nibbles of a sum or an exclusive or")
    plus: int = Field(0, description="added to a sum; first value of an exclusive or")
    negative: bool = Field(False, description="the sum is taken from plus")
    xorout: int = Field(0, ge=0, description="applied to a sum at the end")
    over: tuple[int, int] | None = Field(None, description="as of a CRC")

    @field_validator("rule")
    @classmethod
    def _is_known(cls, rule: str) -> str:
        known = sorted([*RULES, *OTHERS, "sum", "xor"])
        if rule not in known:
            raise ValueError(f"the rules are {', '.join(known)}{nearest(rule, known)}")
        return rule

    @model_validator(mode="after")
    def _no_more(self) -> Self:
        own = {"of", "plus", "negative", "xorout", "over"} & self.model_fields_set
        if self.rule not in ("sum", "xor") and own:
            raise ValueError(f"{', '.join(sorted(own))}: of sum and xor; {self.rule} says it itself")
        return self

    def checksum(self, message: Message) -> Checksum:
        """Return what is computed for a message."""
        rule = None if self.rule in ("sum", "xor") else rule_of(self.rule)
        if rule is not None:
            return rule(Frame(message.frame_id, message.is_extended_frame, message.length))
        first, last = self.over or (0, None)
        return Checksum(
            xor=self.rule == "xor", nibbles=self.of == "nibbles", first=first, last=last, plus=self.plus,
            negative=self.negative, xorout=self.xorout,
        )  # fmt: skip


def _by_name(value: Any) -> Any:
    return {"rule": value} if isinstance(value, str) else value


#: A rule by its name, or a table.
ChecksumText = Annotated[SumCheck, BeforeValidator(_by_name, json_schema_input_type=str | SumCheck)]


class ProtectionParams(StrictModel):
    """How a message is protected: keys of a check, of a virtual ECU's message, ..."""

    counter: CounterCheck | None = None
    crc: CrcCheck | None = None
    checksum: ChecksumText | None = Field(None, description='a carmaker\'s rule ("toyota"), sum, or xor')
    e2e: E2eCheck | None = Field(None, description="AUTOSAR E2E profile")
    secoc: SecocCheck | None = Field(None, description="AUTOSAR SecOC: MAC and freshness value")
    protection: Literal["auto"] | None = Field(
        None, description="auto: as names and attributes in the database say; gateway check prints what was taken"
    )

    @model_validator(mode="after")
    def _one_of_them(self) -> Self:
        given = [name for name in CHECKSUM_KEYS if getattr(self, name) is not None]
        if len(given) > 1:
            raise ValueError(f"{' and '.join(given)}: a message has one of them")
        if self.protection is not None and (given or self.counter is not None):
            raise ValueError("protection = auto takes what the database says; give it, or the rest")
        if self.counter is not None and (self.e2e is not None or self.secoc is not None):
            raise ValueError("e2e has a counter of its own, secoc a freshness value")
        return self

    def lie_in(self, folder: Path) -> Self:
        """Return it with the file of its key relative to a folder."""
        if self.secoc is None:
            return self
        return self.model_copy(
            update={"secoc": self.secoc.model_copy(update={"key": folder / self.secoc.key.expanduser()})}
        )


#: Bytes that a database does not describe, least significant one first.
_BYTES = re.compile(r"bytes? ([0-9]{1,2})(?:-([0-9]{1,2}))?")


def _undescribed(message: Message, name: str, first: int, last: int, key: str) -> Signal:
    from cantools.database.can.signal import Signal as Made  # noqa: PLC0415 - not where no database is read

    if not first <= last < message.length or last - first >= 8:
        text = f"{message.name} has bytes 0 to {message.length - 1}, a checksum at most 8 of them"
        raise InputError(text, key=key, value=name)
    return Made(name, 8 * first, 8 * (last - first + 1))


def signal_of(message: Message, name: str | None, called: tuple[str, ...], what: str, table: str = "") -> Signal:
    """Return a signal by its name, None: by the end of its name, as such signals (``what``) are ``called``.

    ``table`` is the one whose key "signal" names it.

    Raises:
        InputError: there is none, or several are called so.
    """
    if name is not None and (place := _BYTES.fullmatch(name)) is not None:
        return _undescribed(message, name, int(place[1]), int(place[2] or place[1]), f"{table}.signal".lstrip("."))
    names, key = [signal.name for signal in message.signals], f"{table}.signal".lstrip(".")
    if name is None:
        found = [n for n in names if n.upper().rstrip("0123456789_").endswith(called)]
        if len(found) != 1:
            text = f"which signal of {message.name} is the {what}? Give signal; it has {', '.join(names)}"
            raise InputError(text, key=key)
        name = found[0]
    if name not in names:
        raise InputError(f"{message.name} has no such signal{nearest(name, names)}", key=key, value=name)
    return next(signal for signal in message.signals if signal.name == name)


def _counter(message: Message, asked: CounterCheck) -> Counter:
    signal = signal_of(message, asked.signal, COUNTERS, "counter", "counter")
    if signal.is_float or signal.length > 32:
        raise InputError("a counter is an integer of at most 32 bits", key="counter.signal", value=asked.signal)
    values = 1 << signal.length
    modulus = values - asked.first if asked.modulus is None else asked.modulus
    if asked.first + modulus > values:
        text = f"{signal.length} bits have {values} values"
        raise InputError(text, key="counter.modulus", value=modulus)
    return Counter(field_of(signal), modulus, asked.first, asked.max_step)


def protection_for(message: Message, asked: ProtectionParams) -> Protection:
    """Return the protection of a message.

    Raises:
        InputError: signals that it does not have, a checksum of another width, ...; the key is that of the table.
    """
    for key in ("counter", "crc", "checksum", "e2e", "secoc") if message.length > LONGEST else ():
        if getattr(asked, key) is not None:
            text = f"{message.name} has {message.length} bytes: beyond {LONGEST} neither counter nor checksum is read"
            raise InputError(text, key=key)
    if asked.e2e is not None:
        with under("e2e"):
            return asked.e2e.protection(message)
    if asked.secoc is not None:
        with under("secoc"):
            return asked.secoc.protection(message)
    counter = None if asked.counter is None else _counter(message, asked.counter)
    given: CrcCheck | SumCheck | None = asked.crc or asked.checksum
    if given is None:
        return Protection(counter=counter)
    table, what, rule = ("checksum", "checksum", asked.checksum.rule) if asked.checksum else ("crc", "CRC", "")
    if given.over is not None and given.over[1] > message.length:
        raise InputError(f"{message.name} has {message.length} bytes", key=f"{table}.over", value=list(given.over))
    signal = signal_of(message, given.signal, CHECKSUMS, what, table)
    checksum = given.checksum(message)
    if checksum.crc is not None and checksum.crc.width != signal.length:
        text = f"{rule or 'the CRC'} has {checksum.crc.width} bits, its signal {signal.length}"
        raise InputError(text, key=f"{table}.signal", value=signal.name)
    if checksum.by_counter and counter is None:
        if asked.crc is not None:
            raise InputError("a data id by_counter needs the counter", key="crc.data_id", value="by_counter")
        counter = _counter(message, CounterCheck(signal=signal_of(message, None, COUNTERS, "counter", "counter").name))
    if asked.crc is not None:
        rule = asked.crc.algorithm if asked.crc.width is None else f"crc{asked.crc.width}"
    return Protection(checksum, field_of(signal), counter, name=rule)
